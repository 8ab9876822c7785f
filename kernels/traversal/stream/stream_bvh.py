"""Streams through a wide BVH: a list of rays against the W children of a node, depth first.

A list is words: a ray's number, and above it a bit for each inner child that the ray meets. The lists of the nodes on the
path follow one another on a stack of words, each as long as its node's survivors; the list of a child is collected from its
parent's words when its turn comes, so that no ray is ever in more than one list a level and `levels` lists of a whole stream
are all the room that there has to be. Keys say which child comes next, as for a single ray (`wrt.kernels.simd.box_lanes`), but
a key is that of the first of the rays to enter.

Where any hit will do, the nearest child is as good a guess as another. Rays to a light start on a surface, which is near and
hides nothing: for alike ones the farthest child comes first, which takes 0.94 to 0.96 of the time (bunny, dragon, atrium).
Ambient rays do not care, to 1 %; the child that a ray is longest in cost 1.1 times the time.

Leaves are tested as soon as their parent's list is filtered: their pairs come from 16 leaves at once, where a leaf of its own
would have a handful of rays, and what they hit shortens the rays for the inner children, which are filtered later.

**Measured** (one thread of a Zen 5, Stanford bunny, 16 children a node, the rays of `wrt bench` at 512 x 512; nanoseconds a
ray, and in brackets the share of the lists' lanes that hold rays):

    stream of        64           256          1024         4096        single rays    packets
    far           48 (0.97)    46 (0.97)    41 (0.98)    48 (0.99)         63            24
    near          73 (0.99)    72 (0.99)    73 (0.99)    73 (1.00)        108            25
    random       182 (0.48)   143 (0.74)   106 (0.90)    84 (0.97)        147           153
    ao           120 (0.88)   107 (0.95)   103 (0.98)   102 (0.99)        181           186

The triangle tests' lanes hold triangles to 0.91 whatever the stream: blocks are built so. Splitting a stream by octants, so
that its rays agree on the order of children, saved three to five leaves in a hundred and lost a quarter of the speed to
shorter lists; fetching nodes and the blocks of waiting pairs ahead of their turn gained nothing, and a cache line of its own
for what box tests read of a ray made streams 1.04 to 1.07 times as slow, as there are more lines then. The table is of a time
when candidates were tested one by one; 16 at a time (`wrt.kernels.traversal.stream.stream_candidates`), random rays take 0.74
to 0.83 of that and ambient ones 0.81 to 0.97 (bunny, dragons of 202,520 and 810,080 triangles, atrium).

**What is left** (a thread of a Zen 4, which takes two cycles for a vector of 16 floats). A ray at a node is 6 subtractions, 6
products and 6 comparisons of vectors and 11 numbers of the ray to spread: 13 cycles at least, and a block 21; ambient rays in
the atrium are at 1.4 nodes and meet half a block each. To load the rays takes as long as a node and a half.

References: see `wrt.kernels.traversal.stream.stream_kernel`.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.ray_batch import HitBatch, RayBatch
from wrt.kernels.layout.unchecked import load_int, store_int
from wrt.kernels.simd.box_lanes import NO_CHILD
from wrt.kernels.traversal.stream.stream_kernel import (
    LIST_LANES,
    StreamCounterRows,
    StreamCounters,
    round_up,
    store_stream,
    stream_ray,
)
from wrt.kernels.traversal.stream.stream_lanes import collect_child, filter_boxes, next_child
from wrt.kernels.traversal.stream.stream_load import load_stream
from wrt.kernels.traversal.stream.stream_pairs import Pairs, pair_tester
from wrt.kernels.traversal.traversal_config import ANY, TraversalConfig
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

BELOW_ALL_KEYS = wp.constant(-0x80000000)


@cache
def make_trace(config: TraversalConfig) -> wp.Function:
    """`wp.func(tree, triangles, stream, words, rays, hits, first_ray, work)`: traces the rays words[0 .. rays - 1]."""
    StreamRay = stream_ray(config.triangle_test)
    far_first = config.query == ANY and config.coherent
    filter_list, following = filter_boxes(config.width, config.triangle_test, far_first), next_child(config.width)
    test_pairs = pair_tester(config)
    counting, width, levels, row = config.counters, config.width, config.levels, config.levels * config.width

    @wp.func
    def trace(
        tree: WideNodes,
        triangles: TriangleBlocks,
        stream: wp.array(dtype=StreamRay),
        words: wp.array(dtype=int),
        rays: int,
        hits: wp.ref[HitBatch],
        first_ray: int,
        work: wp.ref[StreamCounters],
    ):
        keys = wp.zeros(shape=(row,), dtype=int)
        path = wp.zeros(shape=(levels,), dtype=int)
        begins = wp.zeros(shape=(levels,), dtype=int)
        sizes = wp.zeros(shape=(levels,), dtype=int)
        lasts = wp.zeros(shape=(levels,), dtype=int)
        pairs = Pairs()
        level = int(-1)
        node = int(0)
        begin = int(0)
        size = int(0)
        incoming = int(rays)
        while level >= 0 or incoming > 0:
            if incoming > 0:
                level += 1
                begin += size
                first_key = level * wp.static(width)
                for lane in range(wp.static(width)):
                    store_int(keys, first_key + lane, NO_CHILD)
                size = int(0)
                tested = int(0)
                while tested < incoming:
                    paired = filter_list(
                        tree.bounds, tree.child, node, stream, words, begin, incoming, keys, first_key, pairs, tested, size
                    )
                    if paired > 0:
                        test_pairs(triangles, stream, pairs, paired, hits, first_ray, work)
                if wp.static(counting):
                    work.nodes += incoming
                store_int(path, level, node)
                store_int(begins, level, begin)
                store_int(sizes, level, size)
                store_int(lasts, level, BELOW_ALL_KEYS)
                incoming = int(0)
            key = following(keys, level * wp.static(width), load_int(lasts, level))
            if key != NO_CHILD:
                lane = key & wp.static(width - 1)
                store_int(lasts, level, key)
                node = load_int(tree.child, load_int(path, level) * wp.static(width) + lane)
                incoming = collect_child(words, begin, size, lane)
                if wp.static(counting):
                    work.traversal_slots += round_up(size)
                    work.traversal_active += size
            else:
                level -= 1
                if level >= 0:
                    begin = load_int(begins, level)
                    size = load_int(sizes, level)

    return trace


@cache
def list_valid(triangle_test: str) -> wp.Function:
    """`wp.func(stream, count, words) -> int`: the numbers of the first `count` rays that are valid; how many they are."""
    StreamRay = stream_ray(triangle_test)

    @wp.func_native("""
        int size = 0;
        for (int k = 0; k < count; ++k) { words.data[size] = k; size += rays.data[k].best.t >= 0.0f ? 1 : 0; }
        return size;
    """)
    def list_valid_native(rays: wp.array(dtype=StreamRay), count: int, words: wp.array(dtype=int)) -> int: ...

    return list_valid_native


@cache
def make_kernel(config: TraversalConfig) -> wp.Kernel:
    """The kernel for one specialisation."""
    StreamRay = stream_ray(config.triangle_test)
    load, store, trace = load_stream(config.triangle_test), store_stream(config), make_trace(config)
    list_rays, counting, size = list_valid(config.triangle_test), config.counters, config.stream
    room = (config.levels + 1) * size + LIST_LANES

    def stream_bvh(
        first: int,
        tree: WideNodes,
        triangles: TriangleBlocks,
        rays: RayBatch,
        hits: HitBatch,
        counters: StreamCounterRows,
    ):
        stream = wp.zeros(shape=(size,), dtype=StreamRay)
        words = wp.zeros(shape=(room,), dtype=int)
        begin = (first + wp.tid()) * rays.run
        end = wp.min(begin + rays.run, rays.count)
        while begin < end:
            count = wp.min(wp.static(size), end - begin)
            work = StreamCounters()
            load(rays, begin, count, tree.low, tree.high, stream)
            trace(tree, triangles, stream, words, list_rays(stream, count, words), hits, begin, work)
            store(stream, begin, count, hits)
            if wp.static(counting):
                counters.rows[begin] = work
            begin += wp.static(size)

    return wp.kernel(stream_bvh, module="unique", enable_backward=False, module_options={"fuse_fp": False})
