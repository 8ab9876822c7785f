"""Pairs (ray, leaf) of a stream: the intersection filter.

Round by round, a block of each leaf: a pair whose ray's line meets some triangle of the block is kept, with the mask of
these triangles; of those that are kept, hits are worked out one by one and selected rather than branched for. Each
comparison ends a long chain of arithmetic, and a wrong guess would throw away what has been done for the next pairs
meanwhile: with a branch, random rays took 1.6 times as long altogether. A select that is written as such may still become one,
so the closest hit is selected bit by bit (`take_better`): random rays took 0.92 of the time in the atrium. To filter by the
ray's range as well, along its main axis or by the triangles' boxes, spares up to half of the hits and took 1.1 to 1.3 times as
long. Any hit is different: what comes after a ray's first one is not looked at, which saves ambient and shadow rays of the
atrium an eighth of their time, more than half of which goes to the one ray in five that hits something.

References: see `wrt.kernels.traversal.stream`.
"""

from functools import cache

import warp as wp

from wrt.kernels import bvh
from wrt.kernels.boxes import RaySlabs
from wrt.kernels.lanes import lanes, lowest_bit
from wrt.kernels.memory import load_int
from wrt.kernels.rays import HitBatch
from wrt.kernels.traversal.config import ANY, TraversalConfig
from wrt.kernels.traversal.crossings import take_crossing
from wrt.kernels.traversal.leaf import Candidate, improves, triangle_step
from wrt.kernels.traversal.stream import LIST_LANES, StreamCounters, get_ray, stream_ray
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.records import TriangleBlocks

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

PAIRS = 256
"""Pairs that wait at most before they are tested; lists have room for those of the ray that fills them up."""

PairList = wp.types.vector(length=PAIRS + 2 * LIST_LANES, dtype=wp.int32)


@wp.struct
class Pairs:
    """Lists of pairs."""

    rays: PairList
    """Rays of the pairs to be tested, and"""
    leaves: PairList
    """their leaves: child words of `wrt.kernels.bvh`."""
    hit_rays: PairList
    """Rays whose line meets a triangle of a block, and"""
    hit_blocks: PairList
    """the block, and"""
    hit_masks: PairList
    """its triangles that they meet."""


@wp.func_native("leaf = pairs.leaves.c[p]; return pairs.rays.c[p];")
def load_pair(pairs: wp.ref[Pairs], p: int, leaf: wp.ref[int]) -> int:
    """Ray and leaf of a pair."""
    ...


@wp.func_native("pairs.rays.c[p] = ray; pairs.leaves.c[p] = leaf;")
def store_pair(pairs: wp.ref[Pairs], p: int, ray: int, leaf: int):
    """Puts a pair into its place."""
    ...


@wp.func_native("block = pairs.hit_blocks.c[p]; mask = (unsigned)pairs.hit_masks.c[p]; return pairs.hit_rays.c[p];")
def load_meeting(pairs: wp.ref[Pairs], p: int, block: wp.ref[int], mask: wp.ref[wp.uint32]) -> int:
    """Ray, block and triangles of a pair that was kept."""
    ...


@wp.func_native("pairs.hit_rays.c[p] = ray; pairs.hit_blocks.c[p] = block; pairs.hit_masks.c[p] = (int)mask;")
def store_meeting(pairs: wp.ref[Pairs], p: int, ray: int, block: int, mask: wp.uint32):
    """Puts a pair that is kept into its place."""
    ...


@cache
def line_filter(config: TraversalConfig) -> wp.Function:
    """`wp.func(triangles, stream, pairs, count, work) -> kept`: one block of each of the first `count` pairs.

    Leaves the pairs with blocks that remain in the lists, and their number in `count`.
    """
    test, width, counting = TRIANGLE_TESTS[config.triangle_test], config.width, config.counters
    StreamRay, RayState, Lanes = stream_ray(config.triangle_test), test.ray_state, lanes(config.width)
    get, intersect_block = get_ray(config.triangle_test), test.forms(config.crossing).block_test(width)

    @wp.func
    def lines_meet(triangles: TriangleBlocks, block: int, state: RayState):
        t = Lanes()  # where nothing reads t, u and v, the compiler leaves out what makes them
        u = Lanes()
        v = Lanes()
        return intersect_block(triangles.records, block, state, t, u, v)

    @wp.func
    def keep_pairs(
        triangles: TriangleBlocks,
        stream: wp.array(dtype=StreamRay),
        pairs: wp.ref[Pairs],
        count: wp.ref[int],
        work: wp.ref[StreamCounters],
    ):
        kept = int(0)
        left = int(0)
        p = int(0)
        while p < count:
            leaf = int(0)
            k = load_pair(pairs, p, leaf)
            slabs = RaySlabs()
            state = RayState()
            best = Candidate()
            get(stream, k, slabs, state, best)
            block = bvh.first_block(leaf)
            remaining = bvh.leaf_triangles(leaf)
            mask = lines_meet(triangles, block, state)
            store_meeting(pairs, kept, k, block, mask)
            kept += wp.where(mask != wp.uint32(0), 1, 0)
            store_pair(pairs, left, k, bvh.leaf_child(block + 1, remaining - wp.static(width)))
            left += wp.where(remaining > wp.static(width), 1, 0)
            if wp.static(counting):
                there = wp.min(remaining, wp.static(width))
                work.triangles += there
                work.intersection_slots += wp.static(width)
                work.intersection_active += there
            p += 1
        count = left
        return kept

    return keep_pairs


@wp.func_native("""
    const float t = hit.c[0];
    const bool ahead = (t < best.t) | ((t == best.t) & ((best.primitive < 0) | (primitive < best.primitive)));
    const unsigned taken = 0u - (unsigned)((t >= t_min) & ahead);
    auto pick = [&](float old, float other) {
        const unsigned kept = wp::cast<unsigned>(old) & ~taken;
        return wp::cast<float>(kept | (wp::cast<unsigned>(other) & taken));
    };
    best.primitive = (int)(((unsigned)best.primitive & ~taken) | ((unsigned)primitive & taken));
    best.t = pick(best.t, t);
    best.u = pick(best.u, hit.c[1]);
    best.v = pick(best.v, hit.c[2]);
""")
def take_better(hit: wp.vec3, primitive: int, t_min: float, best: wp.ref[Candidate]):
    """Takes over a hit (t, u, v) if it `improves` the best so far, without a branch."""
    ...


@cache
def hit_finder(config: TraversalConfig) -> wp.Function:
    """`wp.func(triangles, stream, k, block, mask, hits, i)`: the hits of ray k among some triangles of a block.

    hits, i: where they go, and the ray's number in the batch, if the query is for all of them.
    """
    StreamRay, RayState = stream_ray(config.triangle_test), TRIANGLE_TESTS[config.triangle_test].ray_state
    get, candidate = get_ray(config.triangle_test), triangle_step(config)
    width, any_hit, crossing, take = config.width, config.query == ANY, config.crossing, take_crossing(config)

    @wp.func_native(f"""
        rays.data[k].best = best;
        if ({int(any_hit)} && best.primitive >= 0) rays.data[k].best.t = __builtin_bit_cast(float, 0xff800000u);  // -inf
    """)
    def put_best(rays: wp.array(dtype=StreamRay), k: int, best: Candidate): ...

    @wp.func
    def find_hits(
        triangles: TriangleBlocks,
        stream: wp.array(dtype=StreamRay),
        k: int,
        block: int,
        triangle_mask: wp.uint32,
        hits: wp.ref[HitBatch],
        i: int,
    ):
        mask = wp.uint32(triangle_mask)
        slabs = RaySlabs()
        state = RayState()
        best = Candidate()
        t_min = get(stream, k, slabs, state, best)
        if wp.static(any_hit):
            mask = wp.where(best.primitive < 0, mask, wp.uint32(0))  # it may have had its hit since its pairs were listed
        while mask != wp.uint32(0):
            slot = block * wp.static(width) + lowest_bit(mask)
            mask = mask & (mask - wp.uint32(1))
            hit = candidate(triangles.records, slot, state, slabs)
            primitive = load_int(triangles.primitive, slot)
            if wp.static(crossing):
                if hit[0] >= t_min and hit[0] <= best.t:
                    best = take(hits, i, best, hit[0], primitive, hit[1], hit[2])
            elif wp.static(not any_hit):
                take_better(hit, primitive, t_min, best)
            else:  # most candidates of such rays lie behind them, which is easily guessed
                better = improves(hit[0], primitive, t_min, best)
                best.t = wp.where(better, hit[0], best.t)
                best.primitive = wp.where(better, primitive, best.primitive)
                best.u = wp.where(better, hit[1], best.u)
                best.v = wp.where(better, hit[2], best.v)
                mask = wp.where(better, wp.uint32(0), mask)
        put_best(stream, k, best)

    return find_hits


@cache
def pair_tester(config: TraversalConfig) -> wp.Function:
    """`wp.func(triangles, stream, pairs, number, hits, begin, work)`: tests the first so many pairs to the end.

    hits, begin: where all hits go, if that is the query, and the number of the stream's first ray.
    """
    StreamRay = stream_ray(config.triangle_test)
    keep_pairs, find_hits, counting = line_filter(config), hit_finder(config), config.counters

    @wp.func
    def test_pairs(
        triangles: TriangleBlocks,
        stream: wp.array(dtype=StreamRay),
        pairs: wp.ref[Pairs],
        number: int,
        hits: wp.ref[HitBatch],
        begin: int,
        work: wp.ref[StreamCounters],
    ):
        count = int(number)
        if wp.static(counting):
            work.leaves += count
        while count > 0:
            kept = keep_pairs(triangles, stream, pairs, count, work)
            p = int(0)
            while p < kept:
                block = int(0)
                mask = wp.uint32(0)
                k = load_meeting(pairs, p, block, mask)
                find_hits(triangles, stream, k, block, mask, hits, begin + k)
                p += 1

    return test_pairs
