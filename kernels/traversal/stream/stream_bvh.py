"""Stream traversal of a wide BVH: a list of rays against the W children of a node, depth first.

An element of a list is a word: the number of a ray and, above it, one bit for each child that the ray meets. The lists of the
nodes on the path are stored one after the other on a stack of words, each as long as the number of rays that its node's filter
kept. The list of a child is collected from the words of its parent when the child is visited, so no ray is in more than one
list per level, and `levels` lists of a whole stream are enough memory, with another one for a leaf. Keys give the next child,
as for a single ray (`wrt.kernels.simd.box_lanes`), but a key is that of the first ray to enter.

The list of the root is written while the rays are loaded (`wrt.kernels.traversal.stream.stream_load`).

Any-hit queries do not need the nearest child first: their children are visited as they come. But coherent rays to a light start
on a surface, which is near and occludes nothing, so for these the farthest child is visited first.

Leaves are tested as soon as the list of their parent has been filtered (`wrt.kernels.traversal.stream.stream_leaves`). Their
pairs then come from up to 16 leaves at once, whereas a single leaf has only a few rays, and their hits shorten the rays for the
inner children, which are filtered later.

Figures, lane utilisation, and variants that were tried: notebooks/records/2026-11-21-streams.md,
notebooks/records/2026-11-22-stream-candidates.md and notebooks/records/2026-11-24-streams.md.

References: see `wrt.kernels.traversal.stream.stream_kernel`.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.ray_batch import HitBatch, RayBatch
from wrt.kernels.layout.scratch import leave_scratch, take_scratch
from wrt.kernels.layout.unchecked import load_int, store_int
from wrt.kernels.runtime.options import specialised_kernel
from wrt.kernels.simd.box_lanes import NO_CHILD
from wrt.kernels.traversal.stream.stream_candidates import Pairs, StreamHits
from wrt.kernels.traversal.stream.stream_kernel import (
    FAR,
    LIST_LANES,
    NEAR,
    NONE,
    StreamCounterRows,
    StreamCounters,
    ray_words,
    round_up,
    store_stream,
    stream_ray,
)
from wrt.kernels.traversal.stream.stream_lanes import collect_words, filter_boxes, next_child
from wrt.kernels.traversal.stream.stream_leaves import NodeList, leaf_tester
from wrt.kernels.traversal.stream.stream_load import load_root
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks

BELOW_ALL_KEYS = wp.constant(-0x80000000)
"""Less than every key: the last key visited, before the first child of a node."""


def child_order(config: TraversalConfig) -> int:
    """Which child of a node is visited first."""
    if config.answer.rules.ends_at_first:
        return FAR if config.coherent else NONE
    return NEAR if config.answer.rules.front_to_back else NONE


@cache
def stream_loader(config: TraversalConfig) -> wp.Function:
    """The function that loads a stream with the list of its root: `wrt.kernels.traversal.stream.stream_load.load_root`."""
    order = child_order(config)
    return load_root(config.triangle_test, config.stream.rays, config.width, order, boxes=order == NONE and config.width >= 8)


@cache
def make_trace(config: TraversalConfig) -> wp.Function:
    """`wp.func(tree, triangles, stream, words, keys, listed, found, work)`: traces a stream.

    Args (of the function): words, keys: the list of the root and the keys of its children, as `stream_loader` writes them, with
        room for those of other nodes. listed: `NodeList` of the root; it changes. found: `StreamHits`.
    """
    StreamRay, test_leaves = stream_ray(config.triangle_test), leaf_tester(config)
    filter_list, following = filter_boxes(config.width, config.triangle_test, child_order(config)), next_child(config.width)
    counting, width, levels = config.counters, config.width, config.stack.levels

    @wp.func
    def trace(
        tree: WideNodes,
        triangles: TriangleBlocks,
        stream: wp.array(dtype=StreamRay),
        words: wp.array(dtype=int),
        keys: wp.array(dtype=int),
        listed: wp.ref[NodeList],
        found: wp.ref[StreamHits],
        work: wp.ref[StreamCounters],
    ):
        path = wp.zeros(shape=(levels,), dtype=int)
        begins = wp.zeros(shape=(levels,), dtype=int)
        sizes = wp.zeros(shape=(levels,), dtype=int)
        lasts = wp.zeros(shape=(levels,), dtype=int)
        pairs = Pairs()
        level = int(0)
        if wp.static(counting):
            work.nodes += listed.size
        while level >= 0:
            test_leaves(tree, triangles, stream, words, listed, pairs, found, work)
            store_int(path, level, listed.node)
            store_int(begins, level, listed.begin)
            store_int(sizes, level, listed.size)
            store_int(lasts, level, BELOW_ALL_KEYS)
            incoming = int(0)
            while level >= 0 and incoming == 0:
                key = following(keys, level * wp.static(width), load_int(lasts, level))
                if key != NO_CHILD:
                    lane = key & wp.static(width - 1)
                    store_int(lasts, level, key)
                    listed.node = load_int(tree.child, load_int(path, level) * wp.static(width) + lane)
                    incoming = collect_words(words, listed.begin, listed.size, wp.uint32(1) << wp.uint32(lane))
                    if wp.static(counting):
                        work.traversal_slots += round_up(listed.size)
                        work.traversal_active += listed.size
                else:
                    level -= 1
                    if level >= 0:
                        listed.begin = load_int(begins, level)
                        listed.size = load_int(sizes, level)
            if incoming > 0:
                level += 1
                listed.begin += listed.size
                row = level * wp.static(width)
                arrived = wp.vec2i(listed.begin, incoming)
                listed.size = filter_list(tree, listed.node, stream, words, arrived, keys, row, listed.leaves)
                if wp.static(counting):
                    work.nodes += incoming

    return trace


@cache
def make_stream_bvh_kernel(config: TraversalConfig) -> wp.Kernel:
    """The kernel for one specialisation."""
    StreamRay = stream_ray(config.triangle_test)
    counting, size = config.counters, config.stream.rays
    load, store, trace = stream_loader(config), store_stream(config), make_trace(config)
    key_room = config.stack.levels * config.width
    ray_bytes, on_cuda = 4 * ray_words(config.triangle_test), config.stack.block > 0
    room = (config.stack.levels + 1) * size + LIST_LANES

    def stream_bvh(
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
            words = wp.zeros(shape=(room,), dtype=int)
        else:
            scratch = take_scratch(wp.static(size * ray_bytes + 4 * room))
            stream = wp.array(ptr=scratch, shape=(size,), dtype=StreamRay)
            words = wp.array(ptr=scratch + wp.uint64(wp.static(size * ray_bytes)), shape=(room,), dtype=int)
        keys = wp.zeros(shape=(key_room,), dtype=int)
        begin = (first + wp.tid()) * rays.run
        end = wp.min(begin + rays.run, rays.count)
        found = StreamHits()
        found.hits = hits
        while begin < end:
            work = StreamCounters()
            kept = int(0)
            root = NodeList()
            count = load(rays, wp.vec2i(begin, end), tree, stream, words, keys, root.leaves, kept)
            root.size = kept
            found.begin = begin
            trace(tree, triangles, stream, words, keys, root, found, work)
            store(stream, kept, begin, count, hits)
            if wp.static(counting):
                counters.rows[begin] = work
            begin += count
        if wp.static(not on_cuda):
            leave_scratch(scratch)

    return specialised_kernel(stream_bvh)
