"""The path of a query: rays, plan, prepared query, launch, answers in device memory.

A prepared query is looked up by its plan and the layout of its rays. Queries that cannot be prepared are traced as a batch:
those that sort rays, count work, or have masks or environments; those on lazily built trees or influence areas; those with
triangle tests whose records depend on the origin of the rays; many rays through instances; and calls inside a graph capture,
whose launches Warp must see with all their arrays.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, overload

import warp as wp

from wrt.engine.facts.query_kinds import AUTO, CLOSEST, QUERIES, Query
from wrt.engine.launch.batch import trace_batch
from wrt.engine.launch.prepared import prepare
from wrt.engine.plan.planner import chosen_plan, find_plan
from wrt.engine.rays.ray_buffers import RayBuffers, buffers_of, set_environment, set_mask, to_device
from wrt.engine.rays.staged_rays import STAGED, STAGED_CENTERED
from wrt.kernels.answers import ANSWERS
from wrt.kernels.runtime.launch import use_threads

if TYPE_CHECKING:
    from wrt.engine.device_hits import DeviceHits
    from wrt.engine.facts.scene_state import SceneState
    from wrt.engine.launch.given_areas import GivenAreas
    from wrt.engine.plan.plan import ChosenPlan, Plan
    from wrt.engine.rays.ray_arrays import RayArrays
    from wrt.engine.rays.rays import Rays, ResultForm
    from wrt.engine.rays.staged_rays import StagedRays


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


def answer(scene: SceneState, rays: Rays, query: Query) -> Answer:
    """Answers a query "closest", "any" or "count".

    Raises:
        TypeError, ValueError: as `wrt.Scene.intersect`.
    """
    if scene.num_threads is None:  # spares few rays a context
        return _answer(scene, rays, query)
    with use_threads(scene.num_threads):
        return _answer(scene, rays, query)


def _answer(scene: SceneState, rays: Rays, query: Query) -> Answer:
    given = None
    if query.areas is not None:
        from wrt.engine.launch.given_areas import take_areas

        scene, given = take_areas(scene, query.areas, rays.shape)
    buffers = on_device(scene, rays, query, may_stage(scene, query))
    chosen = find_plan(scene, buffers, query)  # type: ignore[arg-type]
    hits, work = trace_chosen(scene, chosen, buffers, query.kind, query.counters, given)
    return Answer(hits, buffers.form, chosen.plan, work)


def closest_of_relative(scene: SceneState, arrays: RayArrays) -> DeviceHits:
    """Closest hits, by a plan of "auto", of rays that are on the device, relative to the scene's centre."""
    with use_threads(scene.num_threads):
        buffers = buffers_of(arrays, scene.device)
        return trace_chosen(scene, find_plan(scene, buffers, QUERIES[CLOSEST]), buffers, CLOSEST, False)[0]


def may_stage(scene: SceneState, query: Query) -> bool:
    """Whether few rays need not be brought to the device: the query will be prepared, and its rays go one by one."""
    chosen_by_scene = query.traversal == query.triangle_test == AUTO == scene.triangle_test
    return chosen_by_scene and scene.is_cpu and not query.counters and scene.lazy_tree is None


@overload
def on_device(scene: SceneState, rays: Rays, query: Query) -> RayBuffers: ...
@overload
def on_device(scene: SceneState, rays: Rays, query: Query, staged: bool) -> RayBuffers | StagedRays: ...
def on_device(scene: SceneState, rays: Rays, query: Query, staged: bool = False) -> RayBuffers | StagedRays:
    """The rays on the scene's device, with the masks and environments of their query.

    Raises:
        ValueError: masks or environments in a scene whose geometries have none.
    """
    if query.mask is None and query.environment is None:
        return to_device(rays, scene.device, scene.center, scene.few_rays if staged else 0)
    if not scene.instances:
        name = "environment" if query.mask is None else "mask"
        raise ValueError(f"{name} needs instances, and this scene has none; make it from wrt.Instance(mesh, {name}=...)")
    buffers = to_device(rays, scene.device, scene.center)
    if query.mask is not None:
        set_mask(buffers, query.mask, scene.device)
    if query.environment is not None:
        set_environment(buffers, query.environment, scene.device)
    return buffers


def trace(
    scene: SceneState, plan: Plan, buffers: RayBuffers, kind: str, counters: bool = False
) -> tuple[DeviceHits, wp.array | None]:
    """Results of rays by a plan, and each ray's work if it is to be counted.

    Args:
        scene: what the rays meet.
        plan: how; made for these rays.
        buffers: the rays.
        kind: "closest", "any" or "count".
        counters: whether work is counted.
    """
    return trace_chosen(scene, chosen_plan(scene, plan, buffers, kind), buffers, kind, counters)


def trace_chosen(
    scene: SceneState,
    chosen: ChosenPlan,
    buffers: RayBuffers | StagedRays,
    kind: str,
    counters: bool,
    given: GivenAreas | None = None,
) -> tuple[DeviceHits, wp.array | None]:
    """As `trace`, by a plan from the scene's cache; `given` are the areas of the rays, if they are known."""
    layout = buffers.layout
    prepares = chosen.prepares and not counters and layout is not None and buffers.count > 0
    if prepares and (buffers.in_place or not scene.device.is_capturing):
        return run_prepared(scene, chosen, buffers, kind, layout), None
    plan, rays = chosen.carried_out, buffers.batch
    rays.columns = buffers.columns if plan.reorder == "tiles" else 0
    if scene.area_trees is not None and plan.accelerator != "none" and ANSWERS[kind].nearest:
        from wrt.engine.launch.area_trees import trace_by_area

        return trace_by_area(scene, plan, rays, kind, counters, given)
    return trace_batch(scene, plan, rays, kind, counters)


def run_prepared(scene: SceneState, chosen: ChosenPlan, buffers: Any, kind: str, layout: Any) -> DeviceHits:
    """Answers rays by a prepared query, made if none is free."""
    if chosen.missed_savings:
        scene.cache.missed_savings += chosen.missed_savings * buffers.count
    prepared = chosen.take(layout) or prepare(scene, chosen.carried_out, kind, layout)
    prepared.fit(scene)
    if layout in (STAGED, STAGED_CENTERED):
        hits = prepared.run_staged(buffers.given)
    else:
        hits = prepared.run(scene, buffers.given, buffers.columns if chosen.carried_out.reorder == "tiles" else 0)
    chosen.give_back(layout, prepared)
    return hits
