"""A large batch whose first parts are traced by several plans in turn, and the rest by the one that took least.

Parts are ranges of the rays, of pictures whole rows, and each is a batch of its own that writes into the answers of all. At
each of `PLACES` places, spread over the batch, every plan traces a part of as many rays beside those of the others; which comes
first changes from place to place. The middle is first: pictures have nothing to hit at their edges. A plan that has taken
`HOPELESS_PART` times as long has no part at the next place, and one that is not faster where most of the time goes does not
replace the best so far.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from wrt.engine.device_hits import DeviceHits
from wrt.engine.launch.prepared import prepare
from wrt.engine.plan.call_clock import call_clock
from wrt.engine.plan.learner import MARGIN
from wrt.kernels.runtime.launch import get_num_threads

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from wrt.engine.facts.scene_state import SceneState
    from wrt.engine.plan.contest import Contest
    from wrt.engine.plan.plan import ChosenPlan
    from wrt.engine.rays.device_rays import DeviceRays

PLACES = 3
"""Places at which plans are compared."""

LARGEST_SHARE = 0.8
"""Share of a batch that is traced in turn, at most. In a smaller batch whole calls take turns, which cost several times as much
and compare rays from different places when the rays jump (notebooks/records/2026-11-28-auto.md)."""

RAYS_PER_THREAD = 2048
"""Rays of a part for each thread: many packets, and long enough to be timed."""

STREAM_PARTS, WHOLE_SHARE = 4, 0.25
"""Parts of a stream of coherent rays that are compared on one thread where whole ones would be more than this share of a batch.
Shorter streams of other rays take up to twice as long. More threads need a whole one each.
"""

ROWS, GROUP = 16, 1024
"""Rows of pictures, and rays of other batches, of which a part has a whole number."""

HOPELESS_PART = 1.6
"""Times the least time."""

SPIKE = 3.0
"""Times the least time of a place from which a part was disturbed: it counts as much."""


def part_size(plans: Mapping[str, ChosenPlan], rays: DeviceRays) -> int | None:
    """Rays of a part; None if the batch is too small for parts."""
    threads, facts = get_num_threads(), rays.facts
    stream = max(one.plan.stream for one in plans.values())
    unit = ROWS * facts.columns if facts.columns else GROUP
    shorter = [(stream // STREAM_PARTS, LARGEST_SHARE)] if threads == 1 and facts.coherent else []
    for rays_of_stream, share in ((stream * threads, LARGEST_SHARE if threads > 1 else WHOLE_SHARE), *shorter):
        size = -(-max(threads * RAYS_PER_THREAD, rays_of_stream) // unit) * unit
        if PLACES * len(plans) * size <= share * facts.count:
            return size
    return None


def trace_in_parts(scene: SceneState, contest: Contest, rays: DeviceRays, kind: str) -> DeviceHits | None:
    """Traces a batch for which a trial is due, and tells the contest; None, and nothing is done, if whole calls must take
    turns, or no trial is due."""
    learner = contest.learner
    if scene.instances:  # where rivals of packets are single rays, too slow to be tried by parts
        return None
    ways = contest.ways()
    plans = {name: contest.chosen[name] for name in ways}
    if learner.is_trying or len(ways) < 2 or rays.own_layout is None or not all(one.prepares for one in plans.values()):
        return None
    size = part_size(plans, rays)
    if size is None or not learner.is_due(ways, PLACES * size / rays.facts.count):
        return None
    hits, clock = DeviceHits.new_on_host(kind, rays.count, scene.device), call_clock()

    def trace(chosen: ChosenPlan, begin: int, count: int) -> float:
        """Seconds for a part."""
        if count <= 0:
            return 0.0
        layout, plan = rays.layout, chosen.carried_out
        some, found = rays.part(begin, count), hits.part(begin, count)
        prepared = chosen.prepared.take(layout) or prepare(scene, plan, kind, layout)
        start = clock()
        prepared.run(scene, some, rays.facts.columns if plan.reorder == "tiles" else 0, found)
        seconds = clock() - start
        chosen.prepared.give_back(prepared, layout)
        return seconds

    rates, lost, gaps = compare_parts(plans, learner.best, rays.count, size, trace, rays.facts.columns * ROWS or GROUP)
    learner.conclude(rates, lost)
    chosen = plans[learner.best]
    seconds = sum(trace(chosen, begin, end - begin) for begin, end in gaps)
    contest.tell(chosen, sum(end - begin for begin, end in gaps), seconds)
    return hits


def compare_parts(
    plans: Mapping[str, ChosenPlan],
    best: str,
    count: int,
    size: int,
    trace: Callable[[ChosenPlan, int, int], float],
    unit: int,
) -> tuple[dict[str, float], float, list[tuple[int, int]]]:
    """Traces parts by plans in turn.

    Args:
        plans: by name.
        best: the one that is the best so far.
        count: rays of the batch.
        size: rays of a part, a multiple of `unit`.
        trace: traces a part, (plan, first ray, rays) -> seconds.
        unit: parts begin at a multiple of this number of rays.

    Returns:
        Seconds a ray of each plan; seconds that were lost; the ranges of rays that are left.
    """
    active, seconds = [best, *(name for name in plans if name != best)], dict.fromkeys(plans, 0.0)
    shared = dict.fromkeys(plans, 0.0)  # least seconds of the places where a plan had a part
    wins = dict.fromkeys(plans, 0.0)  # those of places where it was faster than the best so far
    begins, ends, lost = places_of(count, size * len(plans), unit), [0] * PLACES, 0.0
    for turn, place in enumerate(sorted(range(PLACES), key=lambda one: abs(2 * one + 1 - PLACES))):
        turns = active[turn % len(active) :] + active[: turn % len(active)]
        took = {name: trace(plans[name], begins[place] + k * size, size) for k, name in enumerate(turns)}
        ends[place] = begins[place] + size * len(turns)
        fastest = min(took.values())
        for name, value in took.items():
            seconds[name] += min(value, SPIKE * fastest)
            shared[name] += fastest
            wins[name] += fastest if best not in took or value < (1.0 - MARGIN) * took[best] else 0.0
            lost += value - fastest
        active = [name for name in active if seconds[name] < HOPELESS_PART * shared[name]]
    longest = max(shared.values())  # of all places: a plan that was the fastest once has parts until the end, or another had
    rates = {name: longest / (PLACES * size) * seconds[name] / shared[name] for name in plans}
    for name in plans:
        if 2.0 * wins[name] <= longest:  # one part may have been disturbed
            rates[name] = max(rates[name], rates[best])
    gaps = [*zip([0, *ends], [*begins, count], strict=True)]
    return rates, lost, gaps


def places_of(count: int, size: int, unit: int) -> list[int]:
    """Where the ranges of this many rays begin at which plans are compared, in a batch of `count`."""
    begins, at = [], 0
    for place in range(PLACES):
        middle = (2 * place + 1) * count // (2 * PLACES) // unit * unit
        begins.append(max(middle - size // 2 // unit * unit, at))
        at = begins[-1] + size
    return begins
