"""Interleaved walks of a wide BVH: each ray visits its own nodes in its own order, and dozens of rays take turns.

**Problem.** A single ray (`wrt.kernels.traversal.single.single_bvh`) waits at each node: for the boxes, which are in no near
cache, for a long chain of operations, and for branches that depend on their result and are predicted wrongly. A stream
(`wrt.kernels.traversal.stream.stream_bvh`) does not wait, but its rays visit the children of a node in one order, and
incoherent rays part after a few levels; lists of one or two rays are then all cost.

**Idea.** Rays keep their own stacks, as single rays do, but a pass of a loop moves each of them by one node. The rays are
independent, so the processor works on several at a time; the boxes of a ray's next node are fetched while the others have
their turn (Wald et al. 2007 and Barringer and Akenine-Möller 2014 have the same two aims). There is no branch on what a ray
meets, but for skipping children behind a hit: children are sorted by a network
(`wrt.kernels.traversal.interleaved.child_order`), and rays that reach a leaf, or the end, leave the list of the others a vector
at a time (`wrt.kernels.traversal.interleaved.ray_slots`). When all are before leaves, they are tested
(`wrt.kernels.traversal.interleaved.leaf_pairs`). Rays that are done make room for the next ones.

**Order.** For closest hits a ray visits the nearest child first and skips children that lie behind its best hit. Other
queries visit children in the order of their lanes, without keys and without sorting.

**Limits.** Coherent rays visit the same nodes, which packets and streams load once for many of them. Rays that visit one or
two nodes take most of their time to be loaded and to begin. The slots of a thread are tens of kilobytes; this does not suit
CUDA, where it compiles but has not been measured. Figures: notebooks/records/2026-11-22-interleaved-rays.md.

References:
    I. Wald, C. P. Gribble, S. Boulos, A. Kensler: SIMD ray stream tracing - SIMD ray traversal with generalized ray packets
        and on-the-fly re-ordering. Technical report UUSCI-2007-012, University of Utah, 2007.
    R. Barringer, T. Akenine-Möller: Dynamic ray stream traversal. ACM Transactions on Graphics 33(4), 2014.
"""

from dataclasses import replace
from functools import cache

import warp as wp

from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.ray_batch import HitBatch, RayBatch
from wrt.kernels.layout.scratch import leave_scratch, take_scratch
from wrt.kernels.runtime.options import exact_module, specialised_kernel
from wrt.kernels.traversal.interleaved.leaf_pairs import block_tester
from wrt.kernels.traversal.interleaved.ray_slots import pair_room, slot_words, walk_to_leaves
from wrt.kernels.traversal.stream.stream_kernel import (
    LIST_LANES,
    StreamCounterRows,
    StreamCounters,
    ray_words,
    store_stream,
    stream_ray,
)
from wrt.kernels.traversal.stream.stream_lanes import NONE
from wrt.kernels.traversal.stream.stream_lists import Pairs
from wrt.kernels.traversal.stream.stream_root import load_root
from wrt.kernels.traversal.traversal_config import StreamConfig, TraversalConfig
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks

exact_module(__name__)

LOADED = 1024
"""Rays that are loaded at a time, at most: more leave the near caches before they are traced, fewer leave slots idle at the end
(notebooks/records/2026-11-22-interleaved-rays.md)."""


def make_kernel(config: TraversalConfig) -> wp.Kernel:
    """The kernel for one specialisation."""
    return make_walk(replace(config, stream=StreamConfig(min(config.stream.rays, LOADED))))


@cache
def make_walk(config: TraversalConfig) -> wp.Kernel:
    """The same; `config.stream` is of the rays that are loaded at a time."""
    StreamRay = stream_ray(config.triangle_test)
    walk, room, width = walk_to_leaves(config), slot_words(config), config.width
    counting, size = config.counters, config.stream.rays
    load, store, test_blocks = load_root(config.triangle_test, size, width, NONE), store_stream(config), block_tester(config)
    block_words, list_words = 2 * pair_room(width), size + LIST_LANES
    bytes, on_cuda = 4 * size * ray_words(config.triangle_test), config.stack.block > 0

    def interleaved_bvh(
        first: int,
        tree: WideNodes,
        triangles: TriangleBlocks,
        rays: RayBatch,
        hits: HitBatch,
        counters: StreamCounterRows,
    ):
        scratch = wp.uint64(0)
        if wp.static(on_cuda):
            stream = wp.zeros(shape=(size,), dtype=StreamRay)
            list = wp.zeros(shape=(list_words,), dtype=int)
        else:
            scratch = take_scratch(wp.static(bytes + 4 * list_words))
            stream = wp.array(ptr=scratch, shape=(size,), dtype=StreamRay)
            list = wp.array(ptr=scratch + wp.uint64(wp.static(bytes)), shape=(list_words,), dtype=int)
        keys = wp.zeros(shape=(width,), dtype=int)  # not used
        memory = wp.zeros(shape=(room,), dtype=int)  # slots are slower in scratch memory
        blocks = wp.zeros(shape=(block_words,), dtype=int)
        pairs = Pairs()
        begin = (first + wp.tid()) * rays.run
        end = wp.min(begin + rays.run, rays.count)
        while begin < end:
            work = StreamCounters()
            kept = int(0)
            leaves = wp.uint32(0)
            count = load(rays, begin, end, tree, stream, list, keys, leaves, kept)
            started = int(0)
            waiting = int(0)
            visited = int(0)
            paired = int(1)
            while paired > 0:
                paired = walk(
                    tree, triangles.records, stream, list, kept, memory, started, waiting, visited, work.triangles, blocks
                )
                if wp.static(counting):
                    work.leaves += waiting
                    work.intersection_slots += paired * wp.static(width)
                test_blocks(triangles, stream, blocks, paired, pairs, hits, begin)
            store(stream, kept, begin, count, hits)
            if wp.static(counting):
                work.nodes = visited
                work.intersection_active = work.triangles
                counters.rows[begin] = work
            begin += count
        if wp.static(not on_cuda):
            leave_scratch(scratch)

    return specialised_kernel(interleaved_bvh)
