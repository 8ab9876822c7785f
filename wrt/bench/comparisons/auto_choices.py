"""What "auto" chooses for a grid of cases, and its time over that of the best engine.

The engines are all traversals that "auto" may choose and that can answer the query, those in packets with every culling that
"auto" may choose. Then "auto" and the fastest of them take more turns, and the latter twice in each round: how far it is from
itself is what cannot be told from noise.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from wrt.bench.comparisons.auto_cases import KINDS, SIZES, Case, cases
from wrt.bench.core.paired_timing import Contender, Timing, take_turns
from wrt.engine.facts.query_kinds import ANY, AUTO, CLOSEST, QUERIES
from wrt.engine.plan.call_clock import call_clock
from wrt.engine.plan.choices import find_choice, make_plan
from wrt.engine.plan.plan import Plan, config_for_layout, kernel_factory, plan_for_query, traversal_config
from wrt.engine.plan.plan_checks import can_answer, fits
from wrt.engine.plan.planner import choose_plan, default_test
from wrt.engine.plan.tuned_choices import class_name
from wrt.engine.rays.device_rays import to_device
from wrt.kernels.runtime.launch import expect, specialise, use_threads
from wrt.kernels.traversal import TRAVERSALS
from wrt.kernels.traversal.capabilities import Capabilities
from wrt.kernels.traversal.packet import CULLINGS
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene

HOPELESS = 4.0
"""An engine that once took this many times as long as another takes no part: it would take most of the time. What the rules
choose always does."""

LEARNING_SECONDS, LEARNING_CALLS = 0.6, 8
"""Seconds, and calls at least, in which "auto" learns before it is timed."""

SETTLE = 0.01
"""Seconds below which a turn starts with an untimed call."""

MORE_SECONDS, MAX_ROUNDS = 0.3, 25
"""Seconds for more turns of "auto" and the best engine, and rounds at most: the least of a few turns is still by chance."""

AGAIN = " again"
"""After the name of the best engine, which is timed against itself."""


@dataclass(frozen=True)
class Choice:
    """What was measured of one case.

    Attributes:
        scene, kind: the scene's name and the kind of rays.
        triangles, rays: how many.
        rays_class: class of the rays and the scene (`wrt.engine.plan.tuned_choices.class_name`).
        auto: the engine that "auto" uses at the end, and why.
        rules: the engine that its rules choose.
        reason: as in the plan.
        best: the fastest engine.
        ratio, rules_ratio: time of "auto", and of what the rules choose, over the time of the best.
        noise: times of the best against itself, the greater over the smaller: ratios that near to one may be chance.
        compared: the engines that "auto" could choose from, as their kernels were loaded.
        auto_milliseconds: least time of "auto".
        milliseconds: least time of each engine, which other work on the machine changes least; hopeless ones are left out.
        open3d: the same of Open3D; None if it did not take part.
    """

    scene: str
    kind: str
    triangles: int
    rays: int
    rays_class: str
    auto: str
    rules: str
    reason: str
    best: str
    ratio: float
    rules_ratio: float
    auto_milliseconds: float
    milliseconds: dict[str, float]
    open3d: float | None = None
    noise: float = 1.0
    compared: tuple[str, ...] = ()


def compare_choices(
    name: str,
    scene: Scene,
    mesh: TriangleMesh,
    *,
    kinds: Sequence[str] = KINDS,
    sizes: Sequence[int] = SIZES,
    rounds: int = 5,
    peer: Any = None,
    on_turn: Callable[[str], None] = lambda name: None,
) -> Iterator[Choice]:
    """The cases of a scene, one after the other.

    Args:
        name: of the scene.
        scene: on the CPU.
        mesh: its triangles as one mesh.
        kinds, sizes: as in `cases`.
        rounds: number of rounds per engine.
        peer: a `wrt.bench.peers.peer.Peer` that has built the mesh, timed beside; None for none.
        on_turn: told the name of each turn.
    """
    expect_engines(scene, mesh, kinds, sizes)
    gc.collect()
    gc.freeze()  # every round collects garbage: what is there now would be scanned each time
    for case in cases(mesh, kinds, sizes):
        begin = f"{name}, {case.kind}, {case.rays_count:,} rays"
        yield compare(name, scene, case, rounds, peer, lambda engine, begin=begin: on_turn(f"{begin}: {engine}"))  # type: ignore[misc]
    gc.unfreeze()


def compare(name: str, scene: Scene, case: Case, rounds: int, peer: Any, on_turn: Callable[[str], None]) -> Choice:
    """Times the engines of one case in turns."""
    plans = engines(scene, case)
    chosen = plans[AUTO].engine
    runs = {engine: partial(ask, scene, case, plan) for engine, plan in plans.items() if engine != AUTO}
    with use_threads(scene.num_threads):
        clock = call_clock()
    seconds = {}
    for engine, run in runs.items():
        run()
        start = clock()
        run()
        seconds[engine] = clock() - start
    on_turn(AUTO)
    runs[AUTO] = partial(ask, scene, case, AUTO)
    settle(runs[AUTO], clock)
    shortest = min(seconds.values())
    contenders = [Contender(one, runs[one]) for one in runs if one in (AUTO, chosen) or seconds[one] < HOPELESS * shortest]
    query = None if peer is None else peer.query(case.workload)
    if query is not None:
        contenders.append(Contender("Open3D", query.run))
    timings: dict[str, Timing] = take_turns(contenders, rounds, settle=SETTLE, clock=clock, on_turn=on_turn)
    beside = timings.pop("Open3D", None)
    times = {engine: 1e3 * timing.spread[0] for engine, timing in timings.items()}
    best = min((engine for engine in times if engine != AUTO), key=times.__getitem__)
    noise = take_more_turns(times, best, runs, rounds, clock, on_turn)
    auto, (plan, compared) = times.pop(AUTO), explain(scene, case)
    best = min(times, key=times.__getitem__)
    return Choice(
        scene=name,
        kind=case.kind,
        triangles=scene.triangle_count,
        rays=case.rays_count,
        rays_class=class_of_case(scene, case),
        auto=plan.engine,
        rules=chosen,
        reason=plan.reason,
        best=best,
        ratio=auto / times[best],
        rules_ratio=times[chosen] / times[best],
        auto_milliseconds=auto,
        milliseconds=times,
        open3d=None if beside is None else 1e3 * beside.spread[0],
        noise=noise,
        compared=compared,
    )


def take_more_turns(
    times: dict[str, float],
    best: str,
    runs: Mapping[str, Callable[[], Any]],
    rounds: int,
    clock: Callable[[], float],
    on_turn: Callable[[str], None],
) -> float:
    """More turns of "auto" and of the best engine, and as many of the latter under another name; `Choice.noise`.

    Args:
        times: least milliseconds so far; what is found is put in.
        best: the engine.
        runs: what is timed, by name.
        rounds: at least.
        clock, on_turn: as in `take_turns`.
    """
    again = best + AGAIN
    contenders = [Contender(AUTO, runs[AUTO]), Contender(best, runs[best]), Contender(again, runs[best])]
    more = min(max(rounds, int(MORE_SECONDS / (6e-3 * times[best]))), MAX_ROUNDS)  # each turn may have an untimed call
    timings = take_turns(contenders, more, settle=SETTLE, clock=clock, on_turn=on_turn)
    found = {name: 1e3 * timing.spread[0] for name, timing in timings.items()}
    for name in (AUTO, best):
        times[name] = min(times[name], found[name])
    return max(found[best], found[again]) / min(found[best], found[again])


def class_of_case(scene: Scene, case: Case) -> str:
    """The class of the rays of a case."""
    rays = to_device(case.rays, scene.state.device, scene.state.center)
    return class_name(scene.state.facts, rays.facts, ANY if case.is_occlusion else CLOSEST)


def settle(run: Callable[[], Any], clock: Callable[[], float]) -> None:
    """Calls "auto" until it has learned."""
    until, calls = clock() + LEARNING_SECONDS, 0
    while clock() < until or calls < LEARNING_CALLS:
        run()
        calls += 1


def explain(scene: Scene, case: Case) -> tuple[Plan, tuple[str, ...]]:
    """The plan of "auto" after what it has learned, and the engines that it has compared."""
    kind = ANY if case.is_occlusion else CLOSEST
    plan, rays = scene.explain(case.rays, query=kind), to_device(case.rays, scene.state.device, scene.state.center)
    with use_threads(scene.num_threads):
        contest = find_choice(scene.state, rays.facts, QUERIES[kind], rays.sample).contest
    return plan, () if contest is None else tuple(contest.ways())


def expect_engines(scene: Scene, mesh: TriangleMesh, kinds: Sequence[str], sizes: Sequence[int]) -> None:
    """Begins to compile the kernels of all engines of all cases, side by side."""
    state = scene.state
    if state.instances:
        return
    kernels = []
    for case in cases(mesh, kinds, sizes):
        kind = ANY if case.is_occlusion else CLOSEST
        for plan in engines(scene, case).values():
            one = plan_for_query(plan, kind)
            config = config_for_layout(traversal_config(one, state, kind, False), one, state)
            kernels.append(specialise(kernel_factory(one, state), config))
    expect([*dict.fromkeys(kernels)], state.device)


def ask(scene: Scene, case: Case, traversal: str | Plan) -> Any:
    """The answers of a case."""
    return (scene.occluded if case.is_occlusion else scene.intersect)(case.rays, traversal=traversal)


def engines(scene: Scene, case: Case) -> dict[str, Plan]:
    """Plans by name, and by its own the one that the rules of "auto" choose."""
    state, kind = scene.state, ANY if case.is_occlusion else CLOSEST
    buffers = to_device(case.rays, state.device, state.center)
    plans = {AUTO: choose_plan(state, buffers.facts, QUERIES[kind], buffers.sample)}
    for traversal in TRAVERSALS.values():
        if traversal.score is None or not can_answer(
            traversal, state.facts, kind, False, default_test(state.facts.triangle_test)
        ):
            continue
        plan = make_plan(state, buffers, traversal.name, AUTO, kind)
        test = TRIANGLE_TESTS[plan.triangle_test]
        able = [one for one in CULLINGS.values() if max(*one.scores, *one.filtered_scores) > 1.0]
        for culling in able if Capabilities.PACKETS in traversal.capabilities else [None]:
            if culling is None or fits(culling, traversal, state.accelerator.kind, test):
                one = plan if culling is None else replace(plan, culling=culling.name)
                plans[one.engine] = one
    return plans
