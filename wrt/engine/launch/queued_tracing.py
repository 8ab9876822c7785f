"""Rays through a tree, subtree by subtree: the generations of the queued traversal."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import warp as wp

from wrt.builders.convert.queue_points import find_queue_points
from wrt.engine.launch.traversal_launch import counter_rows
from wrt.engine.launch.triangle_records import records_of
from wrt.engine.memory import empty
from wrt.engine.plan.plan import Plan, kernel_factory, stack_levels, traversal_config, walked_tree
from wrt.kernels.compilation.cache_size import l2_bytes
from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.query.ordering.ray_order import sort_buckets
from wrt.kernels.runtime.launch import launch, specialise
from wrt.kernels.traversal.queued.next_queue import MAX_QUEUES, RayQueue, gather_numbers, make_advance
from wrt.kernels.traversal.queued.queued_bvh import QueuedNodes
from wrt.kernels.triangle import TRIANGLE_TESTS

if TYPE_CHECKING:
    from wrt.engine.device_hits import DeviceHits
    from wrt.engine.facts.scene_state import SceneState
    from wrt.kernels.layout.ray_batch import RayBatch

CHUNK = 256
"""Rays that are worth a chunk of their own."""


class UpperNodes(NamedTuple):
    """A tree above its queue points.

    Attributes:
        nodes: the upper tree.
        roots: (points,) child words in the tree.
        depth: of the upper tree.
    """

    nodes: WideNodes
    roots: wp.array
    depth: int


def trace_queued(
    scene: SceneState, plan: Plan, rays: RayBatch, hits: DeviceHits, query: str, work: wp.array, counters: bool
) -> None:
    """Traces rays generation by generation; arguments as in `wrt.engine.launch.traversal_launch.run_kernel`."""
    for _ in generations(scene, plan, rays, hits, query, work, counters):
        pass


def generations(
    scene: SceneState,
    plan: Plan,
    rays: RayBatch,
    hits: DeviceHits,
    query: str,
    work: wp.array,
    counters: bool,
    upper: UpperNodes | None = None,
) -> Iterator[tuple[QueuedNodes, int]]:
    """The rays that wait in each generation, and how many they are, before they are traced; for those that measure.

    Arguments as in `trace_queued`; `upper`: the tree above its queue points, None for that of the machine's L2 cache.
    """
    device, upper = scene.device, upper or upper_nodes(scene, plan, l2_bytes())
    hits.clear(query)
    config, points = traversal_config(plan, scene, query, counters), len(upper.roots)
    kernel = specialise(kernel_factory(plan, scene), config)
    advance = make_advance(plan.width, stack_levels(upper.depth), query, counters)
    records, found, rows = records_of(scene, plan, rays), hits.struct(), counter_rows(work)
    tree = QueuedNodes()
    tree.nodes, tree.roots, tree.queue = walked_tree(plan, scene).struct(), upper.roots, RayQueue()  # type: ignore[assignment]
    tree.queue.entry, tree.queue.point = empty(rays.count, wp.float32, device), empty(rays.count, wp.int32, device)
    tree.order, waiting = wp.empty(0, dtype=int, device=device), rays.count
    while waiting:
        bucket = empty(waiting, wp.uint16, device)
        inputs = [upper.nodes, rays, found, tree.order, points, tree.queue, bucket, rows]
        launch(advance, waiting, inputs, device=device, chunk=CHUNK)
        places, begins = sort_buckets(bucket, points + 1)
        waiting = begins[points]
        tree.order = in_order(tree.order, places, waiting)
        if waiting:
            yield tree, waiting
            launch(kernel, waiting, [tree, records, rays, found, rows], device=device, chunk=CHUNK)


def in_order(numbers: wp.array, places: wp.array, count: int) -> wp.array:
    """The first `count` rays of a sorted list: elements `places` of `numbers`, or of 0, 1, 2 ... if that is empty."""
    if not len(numbers):
        return places
    result = empty(count, wp.int32, places.device)
    launch(gather_numbers, count, [numbers, places, result], device=places.device, chunk=CHUNK)
    return result


def upper_nodes(scene: SceneState, plan: Plan, cache_bytes: int) -> UpperNodes:
    """The tree above its queue points for a cache of a size, made once for each kind of triangle record."""
    record, tables = TRIANGLE_TESTS[plan.triangle_test].record, scene.cache.tables
    key = "queue points", f"{record.components} {cache_bytes}"
    with scene.cache.lock:
        if key not in tables:
            tables[key] = _make(scene, 4 * (record.components + 1) * plan.width, cache_bytes)
        return tables[key]


def _make(scene: SceneState, block_bytes: int, cache_bytes: int) -> UpperNodes:
    tree = scene.tree.to(wp.get_device("cpu"))
    cut, device, nodes = find_queue_points(tree, block_bytes, cache_bytes, MAX_QUEUES), scene.device, WideNodes()
    nodes.bounds, nodes.child = (
        wp.array(values, dtype=dtype, device=device) for values, dtype in ((cut.bounds, wp.float32), (cut.child, wp.int32))
    )
    nodes.low, nodes.high = tree.low, tree.high
    return UpperNodes(nodes, wp.array(np.ascontiguousarray(cut.roots), dtype=int, device=device), cut.depth)
