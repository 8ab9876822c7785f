"""A batch of rays through a scene's tree or its two levels: rays in another order, lazily built trees, instances, counters."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import warp as wp

from wrt.engine.device_hits import DeviceHits
from wrt.engine.facts.wide_trees import wide_form_savings
from wrt.engine.launch.instance_rounds import trace_rounds
from wrt.engine.launch.lazy_tracing import trace_lazily
from wrt.engine.launch.traversal_launch import no_work, run_kernel
from wrt.engine.memory import empty
from wrt.engine.plan.plan import Plan, traversal_of
from wrt.kernels.traversal.capabilities import Capabilities

if TYPE_CHECKING:
    from wrt.engine.facts.scene_state import SceneState
    from wrt.kernels.layout.ray_batch import RayBatch


def trace_batch(
    scene: SceneState, plan: Plan, rays: RayBatch, query: str, counters: bool
) -> tuple[DeviceHits, wp.array | None]:
    """Results of rays by the scene's tree, and each ray's work if it is to be counted; the plan is the query's own."""
    device = scene.device
    plan = recordable(scene, plan) if device.is_capturing else plan
    if not plan.is_wide and scene.facts.can_be_wide:
        scene.cache.missed_savings += wide_form_savings(rays.count, plan.coherent)
    hits = DeviceHits.new(query, rays.count, device)
    kind = traversal_of(plan).counters
    work = wp.zeros(rays.count, dtype=kind, device=device) if counters else no_work(kind, device.alias)
    if plan.reorder != "cells":
        run(scene, plan, rays, hits, query, work, counters)
        return hits, work if counters else None

    from wrt.kernels.query.ordering.ray_order import find_order, sort_rays, unsort_hits

    order = find_order(rays, scene.tree.low, scene.tree.high, device)
    sorted_hits, sorted_work = DeviceHits.new(query, rays.count, device), wp.zeros_like(work)
    run(scene, plan, sort_rays(rays, order, empty), sorted_hits, query, sorted_work, counters)
    unsort_hits(order, sorted_hits.struct(), hits.struct(), query)
    if not counters:
        return hits, None
    values = work.numpy()
    values[order.numpy()] = sorted_work.numpy()
    return hits, wp.array(values, dtype=work.dtype, device=device)


def recordable(scene: SceneState, plan: Plan) -> Plan:
    """The plan, or the nearest one that a graph can repeat: orders of rays and lists of streams are made on the host."""
    capabilities = traversal_of(plan).capabilities
    in_lists = scene.instances and not traversal_of(plan).walks_single_rays and Capabilities.PACKETS not in capabilities
    if in_lists or Capabilities.QUEUED in capabilities:
        plan = replace(plan, traversal="single", packet=1, stream=1, culling="")
    return replace(plan, reorder="none") if plan.reorder == "cells" else plan


def run(scene: SceneState, plan: Plan, rays: RayBatch, hits: DeviceHits, query: str, work: wp.array, counters: bool) -> None:
    """Traces rays; `work` has an entry for each ray if `counters`, else any number. Builds what a lazy tree lacks for them.

    Raises:
        ValueError: work is to be counted for rays that do not go one by one through two levels.
    """
    if scene.instances and not traversal_of(plan).walks_single_rays:
        if counters:
            raise ValueError("work on two levels is counted ray by ray; pass traversal='single' with counters=True")
        if Capabilities.PACKETS not in traversal_of(plan).capabilities:
            trace_rounds(scene, plan, rays, hits, query)
            return
    if Capabilities.QUEUED in traversal_of(plan).capabilities:
        from wrt.engine.launch.queued_tracing import trace_queued

        trace_queued(scene, plan, rays, hits, query, work, counters)
        return
    if scene.lazy_tree is not None and plan.accelerator != "none" and scene.lazy_tree.current.unbuilt:
        idle = no_work(traversal_of(plan).counters, scene.device.alias)

        def trace_part(some: RayBatch, found: DeviceHits) -> None:
            run_kernel(scene, plan, some, found, query, idle, False)

        trace_lazily(scene.lazy_tree, rays, hits, query, trace_part)
        if not counters:
            return
    run_kernel(scene, plan, rays, hits, query, work, counters)
