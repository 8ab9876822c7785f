"""Stream traversal of a kd-tree: lists of rays with their intervals, filtered by one plane after another.

The lanes hold rays; their data is gathered by number, 16 rays at a time. A list has, for each ray, the interval of t in which
it is inside the node, because in a kd-tree only this interval tells whether a ray is active. An inner node splits a list into
two: the list of the near child replaces it, the list of the far child is pushed on a stack and, when the near child is done,
popped and filtered by the best hits.

**Octants.** The sign of the direction decides which child is near. A stream is therefore split by octants before it enters the
tree (a counting sort of ray numbers), and the lists of one octant descend together: one node, one axis and one order for all
lanes. A separate order per ray would need one list per order at every node.

**Memory.** Every ray of a list may have a far child on the stack at each level of a tree of up to `MAX_TREE_DEPTH` levels. The
stack has room for `STACK_LISTS` times the stream, so a list that enters the tree has at most `STACK_LISTS / MAX_TREE_DEPTH` of
the stream's rays, and an octant with more rays is traced in several lists.

**Limits.** The tree is deep, and the octants divide a stream by eight. Lists of random rays are down to a few rays before they
reach a leaf; for them lockstep traversal (`wrt.kernels.traversal.lockstep.lockstep_kernel`) uses the lanes better. Figures:
notebooks/records/2026-11-21-streams.md.

References: see `wrt.kernels.traversal.stream.stream_kernel`.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout import kdtree_nodes as kdtree
from wrt.kernels.layout.bvh_nodes import MAX_LEAF_TRIANGLES, leaf_child
from wrt.kernels.layout.kdtree_nodes import LEAF, MAX_TREE_DEPTH, KdNodes
from wrt.kernels.layout.ray_batch import HitBatch, RayBatch
from wrt.kernels.layout.unchecked import load_int, store_int
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import specialised_kernel
from wrt.kernels.traversal.stream.stream_candidates import PAIRS, Pairs, StreamHits, pair_tester
from wrt.kernels.traversal.stream.stream_kernel import (
    LIST_LANES,
    StreamCounterRows,
    StreamCounters,
    round_up,
    store_stream,
    stream_ray,
)
from wrt.kernels.traversal.stream.stream_lanes import RayIntervals, filter_hits, filter_plane, set_arrays
from wrt.kernels.traversal.stream.stream_load import load_stream
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks

STACK_LISTS = 16
"""Size of the stack in rays, as a multiple of the stream."""


@wp.func_native("for (int i = 0; i < count; ++i) { pairs.rays.c[i] = list.rays.data[first + i]; pairs.leaves.c[i] = leaf; }")
def fill_pairs(list: wp.ref[RayIntervals], first: int, count: int, leaf: int, pairs: wp.ref[Pairs]):
    """Writes pairs of the rays of a list and a leaf."""


@cache
def enter_scene(triangle_test: str) -> wp.Function:
    """`wp.func(rays, order, begin, end, low, high, list) -> count`: lists those of the rays order[begin .. end - 1] that meet
    the scene's box."""
    StreamRay = stream_ray(triangle_test)

    arguments = "rays.data, order.data, begin, end, low.c, high.c, list"

    @native.func_native("stream.h", f"return wrt::enter_box({arguments});")
    def enter_native(
        rays: wp.array(dtype=StreamRay),
        order: wp.array(dtype=int),
        begin: int,
        end: int,
        low: wp.vec3,
        high: wp.vec3,
        list: wp.ref[RayIntervals],
    ) -> int: ...

    return enter_native


@cache
def leaf_tester(config: TraversalConfig) -> wp.Function:
    """`wp.func(triangles, stream, list, size, node, pairs, found, work)`: tests the rays of a list against a leaf."""
    StreamRay, test_pairs, width = stream_ray(config.triangle_test), pair_tester(config), config.width
    max_triangles = MAX_LEAF_TRIANGLES // width * width

    @wp.func
    def test_leaf(
        triangles: TriangleBlocks,
        stream: wp.array(dtype=StreamRay),
        list: wp.ref[RayIntervals],
        size: int,
        node: wp.vec2i,
        pairs: wp.ref[Pairs],
        found: wp.ref[StreamHits],
        work: wp.ref[StreamCounters],
    ):
        triangle = int(0)
        count = kdtree.leaf_triangles(node)
        while triangle < count:
            block = kdtree.first_block(node) + triangle / wp.static(width)
            leaf = leaf_child(block, wp.min(count - triangle, wp.static(max_triangles)))
            first = int(0)
            while first < size:
                number = wp.min(size - first, PAIRS)
                fill_pairs(list, first, number, leaf, pairs)
                test_pairs(triangles, stream, pairs, number, found, work)
                first += PAIRS
            triangle += wp.static(max_triangles)

    return test_leaf


@cache
def make_trace(config: TraversalConfig) -> wp.Function:
    """`wp.func(tree, triangles, stream, list, count, stack, found, work)`: traces the `count` rays of a list, all of
    one octant, from the root.

    list: rays and their intervals in the scene's box; it is overwritten. stack: memory for the lists of far children. found:
    `StreamHits`.
    """
    StreamRay = stream_ray(config.triangle_test)
    split, pop_list = filter_plane(config.triangle_test), filter_hits(config.triangle_test)
    test_leaf, counting = leaf_tester(config), config.counters

    @wp.func_native("return rays.data[k].slabs.inverse.c[axis] < 0.0f;")
    def is_negative(rays: wp.array(dtype=StreamRay), k: int, axis: int) -> bool: ...

    @wp.func
    def trace(
        tree: KdNodes,
        triangles: TriangleBlocks,
        stream: wp.array(dtype=StreamRay),
        list: wp.ref[RayIntervals],
        count: int,
        stack: wp.ref[RayIntervals],
        found: wp.ref[StreamHits],
        work: wp.ref[StreamCounters],
    ):
        stack_node = wp.zeros(shape=(MAX_TREE_DEPTH,), dtype=int)
        stack_size = wp.zeros(shape=(MAX_TREE_DEPTH,), dtype=int)
        pairs = Pairs()
        waiting = int(0)
        top = int(0)
        at = int(0)
        size = int(count)
        while size > 0:
            node = kdtree.load_node(tree.nodes, at)
            axis = kdtree.split_axis(node)
            if axis != LEAF:
                if wp.static(counting):
                    work.nodes += size
                    work.traversal_slots += round_up(size)
                    work.traversal_active += size
                near = at + 1
                far = kdtree.right_child(node)
                if is_negative(stream, load_int(list.rays, 0), axis):
                    near = far
                    far = at + 1
                far_count = int(0)
                position = kdtree.split_position(node)
                size = split(axis, position, stream, list, size, stack, top, far_count)
                if far_count > 0:
                    store_int(stack_node, waiting, far)
                    store_int(stack_size, waiting, far_count)
                    waiting += 1
                    top += far_count
                at = near
            else:
                test_leaf(triangles, stream, list, size, node, pairs, found, work)
                size = int(0)
            while size == 0 and waiting > 0:
                waiting -= 1
                at = load_int(stack_node, waiting)
                far_count = load_int(stack_size, waiting)
                top -= far_count
                size = pop_list(stream, stack, top, far_count, list)

    return trace


@cache
def make_stream_kdtree_kernel(config: TraversalConfig) -> wp.Kernel:
    """The kernel for one specialisation."""
    StreamRay, enter = stream_ray(config.triangle_test), enter_scene(config.triangle_test)
    counting, size = config.counters, config.stream.rays
    load, store, trace = load_stream(config.triangle_test, size), store_stream(config), make_trace(config)
    piece = -(-size * STACK_LISTS // MAX_TREE_DEPTH)
    list_size, stack_size = piece + LIST_LANES, piece * MAX_TREE_DEPTH + LIST_LANES

    @native.func_native("stream.h", "wrt::sort_by_octant(rays.data, count, order.data, ends.data);")
    def sort_by_octant(rays: wp.array(dtype=StreamRay), count: int, order: wp.array(dtype=int), ends: wp.array(dtype=int)): ...

    def stream_kdtree(
        first: int,
        tree: KdNodes,
        triangles: TriangleBlocks,
        rays: RayBatch,
        hits: HitBatch,
        counters: StreamCounterRows,
    ):
        stream = wp.zeros(shape=(size,), dtype=StreamRay)
        order = wp.zeros(shape=(size,), dtype=int)
        ends = wp.zeros(shape=(8,), dtype=int)
        rays_in_node = RayIntervals()
        list_rays = wp.zeros(shape=(list_size,), dtype=int)
        list_entry = wp.zeros(shape=(list_size,), dtype=float)
        list_leave = wp.zeros(shape=(list_size,), dtype=float)
        set_arrays(rays_in_node, list_rays, list_entry, list_leave)
        stack = RayIntervals()
        stack_rays = wp.zeros(shape=(stack_size,), dtype=int)
        stack_entry = wp.zeros(shape=(stack_size,), dtype=float)
        stack_leave = wp.zeros(shape=(stack_size,), dtype=float)
        set_arrays(stack, stack_rays, stack_entry, stack_leave)
        begin = (first + wp.tid()) * rays.run
        end = wp.min(begin + rays.run, rays.count)
        found = StreamHits()
        found.hits = hits
        while begin < end:
            work = StreamCounters()
            found.begin = begin
            kept = int(0)
            count = load(rays, begin, end, tree.low, tree.high, stream, kept)
            sort_by_octant(stream, kept, order, ends)
            done = int(0)
            octant = int(0)
            while octant < 8:
                last = load_int(ends, octant)
                piece_end = wp.min(last, done + wp.static(piece))
                if done < piece_end:
                    listed = enter(stream, order, done, piece_end, tree.low, tree.high, rays_in_node)
                    trace(tree, triangles, stream, rays_in_node, listed, stack, found, work)
                done = piece_end
                octant += wp.where(done == last, 1, 0)
            store(stream, kept, begin, count, hits)
            if wp.static(counting):
                counters.rows[begin] = work
            begin += count

    return specialised_kernel(stream_kdtree)
