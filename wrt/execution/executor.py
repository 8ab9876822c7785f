"""Carrying out a plan: memory for the hits, the kernel and its inputs, rays in another order where the plan says so.
Most calls on the CPU find all that ready (`wrt.execution.ready`).
"""

from __future__ import annotations

from dataclasses import asdict
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any

import warp as wp

from wrt.execution.plan import ALL, ANY, CLOSEST, COUNT, Plan, kernel_factory, plan_for, stack_levels, traversal_config, way_of
from wrt.execution.wide_trees import saved, walked_tree
from wrt.kernels.layout.ray_batch import HitBatch
from wrt.kernels.runtime.launch import CHUNKS_PER_THREAD, MAX_CHUNK, Chunks, get_num_threads, kept, launch, specialise
from wrt.memory import empty

if TYPE_CHECKING:
    from wrt.execution.ready import HitArrays
    from wrt.kernels.layout.ray_batch import RayBatch
    from wrt.kernels.traversal.traversal_config import TraversalConfig
    from wrt.rays.rays import RayBuffers
    from wrt.scene.scene import Scene

BRUTE_FORCE_TESTS = 10_000_000
"""Triangle tests that brute force does in one launch on the CPU: some hundredths of a second."""

LEAST_CHUNK = 256
"""Rays that are worth a chunk of their own on the CPU: tens of microseconds, where claiming a chunk takes less than one."""

STREAMS_IN_A_ROW = 16
"""Streams of an item at most: Warp clears an item's local memory, which takes 5 ns a ray if it is for one stream."""

ITEMS_PER_THREAD = 32
"""Items of streams that a thread has at least, if rays are many: enough to balance the load."""

RAYS, HITS = 3, 4
"""Which of a traversal kernel's arguments they are."""


def trace(
    scene: Scene, plan: Plan, buffers: RayBuffers, query: str, counters: bool = False
) -> tuple[HitBatch | HitArrays, wp.array | None]:
    """Results of any query but "all", and each ray's work if it is to be counted."""
    plan = plan_for(plan, query)
    columns = buffers.columns if plan.reorder == "tiles" else 0
    if not counters and scene.device.is_cpu:
        from wrt.execution.ready import can_be_ready, trace_ready

        if can_be_ready(scene, plan, buffers):
            return trace_ready(scene, plan, buffers.laid_out, query, columns), None
    rays = buffers.batch
    rays.columns = columns
    if scene.local_trees is not None and plan.accelerator != "none" and query in (CLOSEST, ANY):
        from wrt.execution.area_trees import trace_by_area

        return trace_by_area(scene, plan, rays, query, counters)
    return trace_batch(scene, plan, rays, query, counters)


def trace_batch(scene: Scene, plan: Plan, rays: RayBatch, query: str, counters: bool) -> tuple[HitBatch, wp.array | None]:
    """Results of rays by the scene's tree, and each ray's work if it is to be counted; the plan is the query's own."""
    device = scene.device
    scene.missed += 0.0 if plan.is_wide else saved(rays.count, plan.coherent)
    hits = new_hits(rays.count, query, device)
    kind = way_of(plan).counters
    work = wp.zeros(rays.count, dtype=kind, device=device) if counters else no_work(kind, device.alias)
    if plan.reorder != "cells":
        run(scene, plan, rays, hits, query, work, counters)
        return hits, work if counters else None

    from wrt.kernels.query.ray_order import find_order, sort_rays, unsort_hits

    order = find_order(rays, scene.tree.low, scene.tree.high, device)
    sorted_hits, sorted_work = new_hits(rays.count, query, device), wp.zeros_like(work)
    run(scene, plan, sort_rays(rays, order, empty), sorted_hits, query, sorted_work, counters)
    unsort_hits(order, sorted_hits, hits, query)
    if not counters:
        return hits, None
    values = work.numpy()
    values[order.numpy()] = sorted_work.numpy()
    return hits, wp.array(values, dtype=work.dtype, device=device)


@lru_cache
def no_work(kind: type, device: str) -> wp.array:
    """What kernels get that count nothing: made once, as small batches feel every allocation."""
    with kept(wp.get_device(device)):
        return wp.zeros(1, dtype=kind, device=device)


def counter_rows(work: wp.array) -> Any:
    """The struct by which kernels get where to write counters."""
    from wrt.kernels.traversal.leaf import CounterRows, Counters
    from wrt.kernels.traversal.stream.stream_kernel import StreamCounterRows

    struct = CounterRows() if work.dtype is Counters else StreamCounterRows()
    struct.rows = work
    return struct


def new_hits(count: int, query: str, device: wp.Device) -> HitBatch:
    """Memory for what the query asks."""
    hits = HitBatch()
    if query == ANY:
        hits.occluded = empty(count, wp.bool, device)
    elif query == COUNT:
        hits.counts = empty(count, wp.int32, device)
    else:
        hits.t = empty(count, wp.float32, device)
        hits.primitive = empty(count, wp.int32, device)
        hits.uv = empty(count, wp.vec2, device)
    return hits


def new_lists(count: int, hits: int, device: wp.Device) -> HitBatch:
    """Memory for all hits of `count` rays: so many hits together."""
    lists = new_hits(hits, ALL, device)
    lists.counts = empty(count, wp.int32, device)
    return lists


def run(scene: Scene, plan: Plan, rays: RayBatch, hits: HitBatch, query: str, work: wp.array, counters: bool) -> None:
    """Traces rays; `work` has an entry for each ray if `counters`, else any number. Builds what rays ask for, if any waits."""
    if scene.instances:
        run_instances(scene, plan, rays, hits, query, work, counters)
        return
    if scene.growing is not None and plan.accelerator != "none" and scene.growing.current.waiting:
        from wrt.execution.lazy_tracing import trace_growing

        device = scene.device
        idle = no_work(way_of(plan).counters, device.alias)

        def trace_part(some: RayBatch, found: HitBatch) -> None:
            run_kernel(scene, plan, some, found, query, idle, False)

        trace_growing(scene.growing, rays, hits, query, trace_part, lambda count: new_hits(count, query, device))
        if not counters:
            return
    run_kernel(scene, plan, rays, hits, query, work, counters)


def run_kernel(scene: Scene, plan: Plan, rays: RayBatch, hits: HitBatch, query: str, work: wp.array, counters: bool) -> None:
    """Launches the traversal for the tree as it stands."""
    config = traversal_config(plan, scene, query, counters)
    kernel, inputs = kernel_and_inputs(scene, plan, config, rays, hits, work)
    rays.run, items, chunks = divide(scene, plan, config, rays.count)
    launch(kernel, items, inputs, device=scene.device, **asdict(chunks))


def divide(scene: Scene, plan: Plan, config: TraversalConfig, count: int) -> tuple[int, int, Chunks]:
    """Rays of an item of a plan's kernel, the items of so many rays, and their chunks."""
    way, grain = way_of(plan), way_of(plan).rays_per_item(config)
    longest = max(1, BRUTE_FORCE_TESTS // scene.triangle_count) if plan.accelerator == "none" else MAX_CHUNK
    if way.streams:
        grain *= streams_in_a_row(count, grain, scene.device)
    chunks_per_thread = ITEMS_PER_THREAD if way.streams else CHUNKS_PER_THREAD
    return grain, -(-count // grain), Chunks(max(1, LEAST_CHUNK // grain), max(1, longest // grain), chunks_per_thread)


def run_instances(scene: Scene, plan: Plan, rays: RayBatch, hits: HitBatch, query: str, work: wp.array, counters: bool) -> None:
    """Launches the traversal of two levels; arguments as those of `run`. All hits: `hits.begins` must be there.

    Raises:
        ValueError: work is to be counted for rays that do not go one by one.
    """
    from wrt.execution.instance_rounds import trace_batch

    if plan.traversal != "single":
        if counters:
            raise ValueError("work on two levels is counted ray by ray; pass traversal='single' with counters=True")
        trace_batch(scene, plan, rays, hits, query)
        return
    config = traversal_config(plan, scene, query, counters)
    kernel, inputs = kernel_and_inputs(scene, plan, config, rays, hits, work)
    launch(kernel, rays.count, inputs, device=scene.device, chunk=1024)


def kernel_and_inputs(
    scene: Scene, plan: Plan, config: TraversalConfig, rays: RayBatch, hits: HitBatch, work: wp.array
) -> tuple[wp.Kernel, list[Any]]:
    """The kernel that carries out a plan on the tree as it stands, and what it gets after the number of the first item.

    On two levels that is the one for rays that go one by one.
    """
    counters = counter_rows(work)
    if scene.instances:
        from wrt.kernels.traversal.two_level.instance_single import make_kernel

        factory = partial(make_kernel, kind=plan.accelerator, levels=stack_levels(scene.tree.depth))
        return specialise(factory, config), [scene.upper(), scene.lower(plan, rays), rays, hits, counters]
    if plan.accelerator == "none":
        from wrt.kernels.traversal.brute_force import AllTriangles

        tree = AllTriangles()
        tree.count, tree.low, tree.high = scene.triangle_count, scene.tree.low, scene.tree.high
    else:
        tree = walked_tree(plan, scene).struct()
    return specialise(kernel_factory(plan, scene), config), [tree, scene.triangles(plan, rays), rays, hits, counters]


def streams_in_a_row(count: int, stream: int, device: wp.Device) -> int:
    """Streams that share the local memory of an item, as far as each thread still has `ITEMS_PER_THREAD` items."""
    if device.is_cuda:
        return 1
    return min(max(1, count // (stream * ITEMS_PER_THREAD * get_num_threads())), STREAMS_IN_A_ROW)
