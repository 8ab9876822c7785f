"""A large batch whose first parts are traced by several plans in turn, and the rest by the one that took least.

Parts are ranges of the rays, of pictures whole rows, and each is a batch of its own that writes into the answers of all. At
each of `PLACES` places, spread over the batch, every plan traces a part of as many rays beside those of the others; which comes
first changes from place to place. A plan that takes `HOPELESS_PART` times as long at one place has no part at the next, and
one that is not faster at most places does not replace the best so far.
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

LARGEST_SHARE = 0.16
"""Share of a batch that is traced in turn, at most: a plan that takes half as long again then costs about 5 % of the time."""

FEWEST_RAYS = 4096
"""Rays of a part: many packets, and long enough to be timed."""

RAYS_PER_THREAD = 4096
"""The same for each thread."""

ROWS, GROUP = 16, 1024
"""Rows of pictures, and rays of other batches, of which a part has a whole number."""

HOPELESS_PART = 1.6
"""Times the least time at one place."""

SPIKE = 3.0
"""Times the least time of a place from which a part was disturbed: it counts as much."""


def part_size(plans: Mapping[str, ChosenPlan], rays: DeviceRays) -> int | None:
    """Rays of a part; None if the batch is too small for parts."""
    threads, facts = get_num_threads(), rays.facts
    stream = max(one.plan.stream for one in plans.values())
    least = max(FEWEST_RAYS, threads * RAYS_PER_THREAD, stream * threads if threads > 1 else stream)
    unit = ROWS * facts.columns if facts.columns else GROUP
    size = -(-least // unit) * unit
    return size if PLACES * len(plans) * size <= LARGEST_SHARE * facts.count else None


def trace_in_parts(scene: SceneState, contest: Contest, rays: DeviceRays, kind: str) -> DeviceHits | None:
    """Traces a batch for which a trial is due, and tells the contest; None, and nothing is done, if whole calls must take
    turns, or no trial is due."""
    learner = contest.learner
    ways = contest.ways()
    plans = {name: contest.chosen[name] for name in ways}
    if not learner.is_due(ways) or rays.own_layout is None or not all(one.prepares for one in plans.values()):
        return None
    size = part_size(plans, rays)
    if size is None:
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
    active, seconds, least = [best, *(name for name in plans if name != best)], dict.fromkeys(plans, 0.0), []
    shared = dict.fromkeys(plans, 0.0)  # least seconds of the places where a plan had a part
    wins = dict.fromkeys(plans, 0)  # places where it was faster than the best so far
    gaps, at, lost = [], 0, 0.0
    for place in range(PLACES):
        begin = (2 * place + 1) * count // (2 * PLACES) // unit * unit
        begin = max(begin - size * len(active) // 2 // unit * unit, at)
        gaps.append((at, begin))
        turns = active[place % len(active) :] + active[: place % len(active)]
        took = {name: trace(plans[name], begin + k * size, size) for k, name in enumerate(turns)}
        at = begin + size * len(turns)
        fastest = min(took.values())
        least.append(fastest)
        for name, value in took.items():
            seconds[name] += min(value, SPIKE * fastest)
            shared[name] += fastest
            wins[name] += best not in took or value < (1.0 - MARGIN) * took[best]
            lost += value - fastest
        active = [name for name in active if took[name] < HOPELESS_PART * fastest]
    gaps.append((at, count))
    rate = sum(least) / len(least) / size
    rates = {name: rate * seconds[name] / shared[name] for name in plans}
    for name in plans:
        if 2 * wins[name] <= PLACES:  # one part may have been disturbed
            rates[name] = max(rates[name], rates[best])
    return rates, lost, gaps
