"""The path of a query: rays, plan, prepared query, launch, answers in device memory.

A prepared query is looked up by its plan and the layout of its rays. Queries that cannot be prepared are traced as a batch:
those that sort rays, count work, or have masks or environments; those on lazily built trees or influence areas; those with
triangle tests whose records depend on the origin of the rays; streams through instances; and calls inside a graph capture,
whose launches Warp must see with all their arrays.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, NamedTuple, overload

import warp as wp

from wrt.engine.background import run_in_background
from wrt.engine.facts.query_kinds import AUTO, QUERIES, Query
from wrt.engine.launch.batch import trace_batch
from wrt.engine.launch.device_calls import answer_known, keep_call
from wrt.engine.launch.parts import trace_in_parts
from wrt.engine.launch.prepared import prepare
from wrt.engine.plan.call_clock import call_clock
from wrt.engine.plan.choices import find_choice
from wrt.engine.plan.planner import choose_plan, chosen_plan
from wrt.engine.rays.device_rays import DeviceRays, examine, to_device
from wrt.engine.rays.host_rays import Point
from wrt.engine.rays.ray_integers import ENVIRONMENTS, MASKS
from wrt.engine.rays.rays import as_rays, one_object
from wrt.engine.rays.staged_rays import StagedRays, stage
from wrt.kernels.answers import ANSWERS
from wrt.kernels.compilation.module_compiler import NotCompiledError, without_compiling
from wrt.kernels.runtime.launch import use_threads

if TYPE_CHECKING:
    from wrt.engine.device_hits import DeviceHits
    from wrt.engine.facts.scene_state import SceneState
    from wrt.engine.launch.given_areas import GivenAreas
    from wrt.engine.plan.contest import Contest
    from wrt.engine.plan.plan import ChosenPlan, Plan
    from wrt.engine.rays.rays import GivenRays, ResultForm

INFINITE = float("inf")

LOADED_RAYS = 1024
"""Rays that are traced to load the kernels of a plan."""


class Answer(NamedTuple):
    """The answer to a query.

    Attributes:
        hits: in device memory.
        form: of the results.
        plan: how the query was answered.
        work: each ray's counters; None if nothing was counted.
    """

    hits: DeviceHits
    form: ResultForm
    plan: Plan
    work: wp.array | None = None


def answer(scene: SceneState, rays: GivenRays, query: Query) -> Answer:
    """Answers a query "closest", "any" or "count".

    Args:
        scene: what the rays meet.
        rays: as the caller passed them.
        query: its kind and options.

    Raises:
        TypeError, ValueError: as `wrt.Scene.intersect`.
    """
    is_plain = not scene.is_cpu and query is QUERIES.get(query.kind)
    if is_plain and (known := answer_known(scene, rays, query.kind)) is not None:
        return Answer(*known)
    if scene.num_threads is None:  # spares few rays a context
        return _answer(scene, rays, query)
    with use_threads(scene.num_threads):
        return _answer(scene, rays, query)


def _answer(scene: SceneState, rays: GivenRays, query: Query) -> Answer:
    given = None
    if query.areas is not None:
        from wrt.engine.launch.given_areas import take_areas

        scene, given = take_areas(scene, query.areas, one_object(rays).shape)
    brought = on_device(scene, rays, query, may_stage(scene, query))
    chosen, contest = find_choice(scene, brought.facts, query, brought.sample)
    if contest is not None and not query.counters and (brought.in_place or not scene.device.is_capturing):
        return Answer(trace_measured(scene, contest, brought, query), brought.form, contest.shown)  # type: ignore[arg-type]
    hits, work = trace_chosen(scene, chosen, brought, query.kind, query.counters, given)
    if not scene.is_cpu and query is QUERIES.get(query.kind):
        keep_call(scene, rays, query.kind, chosen, brought)  # type: ignore[arg-type]
    return Answer(hits, brought.form, chosen.plan, work)


def answer_relative(scene: SceneState, rays: DeviceRays, query: Query) -> DeviceHits:
    """The answer to rays that are on the device, relative to the scene's centre, by a plan of "auto"
    (`wrt.engine.rays.device_rays.relative_rays`)."""
    with use_threads(scene.num_threads):
        rays = with_integers(scene, examine(rays, scene.device), query)
        chosen, contest = find_choice(scene, rays.facts, query, rays.sample)
        if contest is not None and not scene.device.is_capturing:
            return trace_measured(scene, contest, rays, query)
        return trace_chosen(scene, chosen, rays, query.kind)[0]


def may_stage(scene: SceneState, query: Query) -> bool:
    """Whether few rays need not be brought to the device: the query will be prepared, and its rays go one by one."""
    chosen_by_scene = query.traversal == query.triangle_test == AUTO == scene.triangle_test
    return chosen_by_scene and scene.is_cpu and not query.counters and scene.lazy_tree is None and scene.alpha_masks is None


@overload
def on_device(scene: SceneState, rays: GivenRays, query: Query) -> DeviceRays: ...
@overload
def on_device(scene: SceneState, rays: GivenRays, query: Query, staged: bool) -> DeviceRays | StagedRays: ...
def on_device(scene: SceneState, rays: GivenRays, query: Query, staged: bool = False) -> DeviceRays | StagedRays:
    """The rays on the scene's device, with the masks and environments of their query.

    Args:
        scene: whose device and centre these are.
        rays: the rays.
        query: their query.
        staged: whether few rays go one by one on the CPU: those in NumPy arrays are left to a prepared query to copy, and in no
            others coherence is looked for.

    Raises:
        TypeError: rays that are no arrays of real numbers; masks or environments that are no integers.
        ValueError: as `wrt.engine.rays.device_rays.lay_out`; masks or environments in a scene whose geometries have none.
    """
    if query.mask is None and query.environment is None:
        few = scene.few_rays if staged else 0
        own = as_rays(*rays) if isinstance(rays, tuple) else rays
        staging = stage(own, scene.device, scene.center, few) if staged else None
        return staging or to_device(own, scene.device, scene.center, few)
    check_has_integers(scene, query)
    return with_integers(scene, to_device(one_object(rays), scene.device, scene.center), query)


def check_has_integers(scene: SceneState, query: Query) -> None:
    """Refuses masks or environments in a scene whose geometries have none.

    Raises:
        ValueError: it has none.
    """
    if not scene.instances:
        name = "environment" if query.mask is None else "mask"
        raise ValueError(f"{name} needs instances, and this scene has none; make it from wrt.Instance(mesh, {name}=...)")


def with_integers(scene: SceneState, rays: DeviceRays, query: Query) -> DeviceRays:
    """The rays, with masks and environments of their query if it has some; errors are those of `on_device`."""
    for integers, values in ((MASKS, query.mask), (ENVIRONMENTS, query.environment)):
        if values is not None:
            check_has_integers(scene, query)
            integers.set(rays, values, scene.device)
    return rays


def trace(
    scene: SceneState, plan: Plan, rays: DeviceRays, kind: str, counters: bool = False
) -> tuple[DeviceHits, wp.array | None]:
    """Results of rays by a plan, and each ray's work if it is to be counted.

    Args:
        scene: what the rays meet.
        plan: how; made for these rays.
        rays: the rays.
        kind: "closest", "any" or "count".
        counters: whether work is counted.
    """
    return trace_chosen(scene, chosen_plan(scene, plan, rays.count, kind), rays, kind, counters)


def trace_measured(scene: SceneState, contest: Contest, rays: DeviceRays, query: Query) -> DeviceHits:
    """As `trace_chosen`, by the plan of a contest, which learns what the call takes. `contest.shown` is the plan then."""
    kind, count = query.kind, rays.facts.count
    if contest.reach < INFINITE:  # written out: many small calls pass here
        x, y, z = Point.from_address(rays.origins.ptr)
        known = contest.origin
        is_elsewhere = known is None or (x - known[0]) ** 2 + (y - known[1]) ** 2 + (z - known[2]) ** 2 > contest.reach
        if is_elsewhere:
            contest.learner.leave_trial()
            if contest.learner.may_look() and contest.place(scene, (x, y, z)):
                renew(scene, contest, rays, query)
    if contest.left > 0:
        contest.left -= 1
        return trace_chosen(scene, contest.current, rays, kind)[0]
    if contest.learner.takes_change():
        renew(scene, contest, rays, query)
    if contest.wants_loading():
        run_in_background(partial(load_rivals, scene, contest, rays.copied(LOADED_RAYS), kind))
    hits = trace_in_parts(scene, contest, rays, kind)
    if hits is None:
        chosen = contest.turn(scene)
        clock = call_clock()
        start = clock()
        hits, _ = trace_chosen(scene, chosen, rays, kind)
        contest.tell(chosen, count, clock() - start)
    return hits


def renew(scene: SceneState, contest: Contest, rays: DeviceRays, query: Query) -> None:
    """Lets the rules choose again for rays that are others than before."""
    clock = call_clock()
    start = clock()
    plan = choose_plan(scene, rays.facts, query, rays.sample)
    contest.renew(scene, chosen_plan(scene, plan, rays.facts.count, query.kind))
    contest.learner.changed(clock() - start)


def load_rivals(scene: SceneState, contest: Contest, rays: DeviceRays, kind: str) -> None:
    """Loads the kernels of a contest's other plans, as far as they are compiled, by tracing rays."""
    for chosen in contest.find_rivals(scene):
        try:
            with without_compiling(), use_threads(1):
                trace_chosen(scene, chosen, rays, kind)
            chosen.ready = True
        except NotCompiledError:
            chosen.ready = False


def trace_chosen(
    scene: SceneState,
    chosen: ChosenPlan,
    rays: DeviceRays | StagedRays,
    kind: str,
    counters: bool = False,
    given: GivenAreas | None = None,
) -> tuple[DeviceHits, wp.array | None]:
    """As `trace`, by a plan from the scene's cache; `given` are the areas of the rays, if they are known."""
    layout, count = rays.own_layout, rays.facts.count
    prepares = chosen.prepares and not counters and layout is not None and count > 0
    plan = chosen.carried_out
    columns = rays.facts.columns if plan.reorder == "tiles" else 0
    if prepares and (rays.in_place or not scene.device.is_capturing):
        if chosen.missed_savings:
            scene.cache.missed_savings += chosen.missed_savings * count
        prepared = chosen.prepared.take(layout) or prepare(scene, plan, kind, layout)
        hits = prepared.run(scene, rays, columns)
        chosen.prepared.give_back(prepared, layout)
        return hits, None
    batch = rays.batch
    batch.columns = columns
    if scene.area_trees is not None and plan.accelerator != "none" and ANSWERS[kind].nearest:
        from wrt.engine.launch.area_trees import trace_by_area

        return trace_by_area(scene, plan, batch, kind, counters, given)
    return trace_batch(scene, plan, batch, kind, counters)
