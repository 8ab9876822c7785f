"""Streams: hundreds of rays, filtered node by node into compact lists of active ones (survey, section 3.4).

**Problem.** A packet goes where any of its rays goes, and takes all of them along: once the rays part company, most lanes
compute nothing. A single ray has few lanes' worth of work between two decisions, and waits for each of them.

**Idea.** Tracing is filtering. A stream of rays comes to a node; a filter tests all of them and appends those that pass to
the stream of each child. Only active rays go on, lists hold their numbers without gaps, and it does not matter whether the
rays that meet at a node are neighbours: the longer the stream, the fuller the vectors. At a leaf the rays are filtered by
the triangles in the same way (Gribble and Ramani 2008; Wald et al. 2007).

**Here.** An item of a kernel is one stream of up to `TraversalConfig.stream` rays, with any origins, signs and ranges. Its
rays lie in a local array (`stream_ray`), everything else is lists of their numbers.
* In the wide BVH (`stream_bvh`) the lanes of a box test hold the W children, as for a single ray; what a stream brings is
  that the tests follow one another without a decision between them, and that the children's lists are compacted 16 rays
  at a time.
* In the kd-tree (`stream_kdtree`) the lanes hold rays, as in the papers.
* At leaves, pairs (ray, leaf) are filtered by `pair_tester`: first all of them by whether the ray's line meets any triangle
  of the block, without a branch; then those that are left are worked out. One ray x W triangles: lists are too short at
  leaves for W rays x one triangle (4096 random rays make 5,500 pairs with the bunny's 4,437 leaves), and blocks are full.

**What we changed.** The papers simulate a machine that gathers and compacts W rays at a time; CPUs have such instructions
now, and where they do not, the compaction is a loop without a branch. Finished rays (any hit) and rays whose best hit lies
before a child drop out in the BVH when the child's list is filtered by its boxes, as these intervals end at the best hit; in
the kd-tree when its list is taken from the stack.

**Limits.** A list is ordered for all its rays: a child is visited when the first of them enters it, so that some rays meet
nodes that a single ray would skip. A stream takes some hundred bytes a ray of local memory, and a thread to itself: on CUDA,
where it compiles but has not been measured, that is the wrong shape. Neighbouring rays are better off in packets, whose
culling spares them most tests.

References:
    I. Wald, C. P. Gribble, S. Boulos, A. Kensler: SIMD ray stream tracing - SIMD ray traversal with generalized ray packets
        and on-the-fly re-ordering. Technical report UUSCI-2007-012, University of Utah, 2007.
    C. P. Gribble, K. Ramani: Coherent ray tracing via stream filtering. IEEE Symposium on Interactive Ray Tracing 2008.
    V. Rahikainen: On real-time ray tracing. MSc thesis, University of Tampere, 2013 (the survey).
"""

from functools import cache

import warp as wp

from wrt.kernels import bvh
from wrt.kernels.boxes import INFINITY, RaySlabs, clamp_to_box, ray_slabs, reach
from wrt.kernels.lanes import lanes, lowest_bit
from wrt.kernels.memory import load_int, store_int
from wrt.kernels.rays import HitBatch, RayBatch, load_ray
from wrt.kernels.traversal.config import ANY, TraversalConfig
from wrt.kernels.traversal.crossings import take_crossing
from wrt.kernels.traversal.leaf import Candidate, improves, start, store_best
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.records import TriangleBlocks

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

LIST_LANES = 16
"""Numbers of a list that are filtered at a time, whatever the tree's width."""

RAY_BITS = 16
"""Bits of a ray's number in a list of the BVH; the children's bits are above."""

PAIRS = 256
"""Pairs (ray, leaf) that wait at most before they are tested; `PAIR_ROOM` with those of the ray that fills them up."""

PAIR_ROOM = PAIRS + 2 * LIST_LANES


@wp.struct
class StreamCounters:
    """Work done for one stream, at the number of its first ray.

    A vector of a list is full if all its lanes hold rays. The lanes of a triangle test hold the W triangles of a block.
    """

    nodes: int
    """Rays tested at inner nodes: a list of n rays counts n."""
    leaves: int
    """Pairs (ray, leaf)."""
    triangles: int
    """Triangles tested, each for each ray."""
    traversal_slots: int
    """Lanes of the vectors by which lists were filtered."""
    traversal_active: int
    """Those that held a ray."""
    intersection_slots: int
    """Lanes of the triangle tests."""
    intersection_active: int
    """Those that held a triangle."""


@wp.func
def round_up(count: int):
    """Lanes of the vectors that a list of so many rays fills."""
    return (count + wp.static(LIST_LANES - 1)) & wp.static(-LIST_LANES)


def rays_per_item(config: TraversalConfig) -> int:
    """An item of the kernel is a stream."""
    return config.stream


@cache
def stream_ray(triangle_test: str) -> type:
    """The struct of a ray of a stream: all that tests need of it, and its best hit."""
    RayState = TRIANGLE_TESTS[triangle_test].ray_state

    class StreamRay:
        slabs: RaySlabs
        t_min: float
        best: Candidate
        state: RayState

    StreamRay.__doc__ = """A ray as box and triangle tests want it. `best.t` is -inf if it needs no (more) tests."""
    return wp.struct(StreamRay)


@cache
def load_stream(triangle_test: str) -> wp.Function:
    """`wp.func(rays, begin, count, low, high, stream)`: brings in the rays begin .. begin + count - 1; low, high: the scene."""
    StreamRay = stream_ray(triangle_test)
    prepare = TRIANGLE_TESTS[triangle_test].prepare

    @wp.func_native("rays.data[k] = ray;")
    def put_ray(rays: wp.array(dtype=StreamRay), k: int, ray: StreamRay): ...

    @wp.func
    def load(rays: RayBatch, begin: int, count: int, low: wp.vec3, high: wp.vec3, stream: wp.array(dtype=StreamRay)):
        for k in range(count):
            ray = load_ray(rays, begin + k)
            own = StreamRay()
            own.best = start(-INFINITY)
            if ray.valid:
                own.slabs = ray_slabs(ray.origin, ray.direction, reach(ray.origin, low, high))
                own.t_min = ray.t_min + 0.0  # turns -0 into +0: as an integer, -0 would be the least key of all
                own.best.t = ray.t_max
                own.state = prepare(ray.origin, ray.direction)
            put_ray(stream, k, own)

    return load


@cache
def get_ray(triangle_test: str) -> wp.Function:
    """`wp.func(stream, k, slabs, state, best) -> t_min`: reads a ray's parts."""
    StreamRay = stream_ray(triangle_test)
    RayState = TRIANGLE_TESTS[triangle_test].ray_state

    @wp.func_native(
        "slabs = rays.data[k].slabs; state = rays.data[k].state; best = rays.data[k].best; return rays.data[k].t_min;"
    )
    def get_ray_native(
        rays: wp.array(dtype=StreamRay),
        k: int,
        slabs: wp.ref[RaySlabs],
        state: wp.ref[RayState],
        best: wp.ref[Candidate],
    ) -> float: ...

    return get_ray_native


@cache
def store_stream(config: TraversalConfig) -> wp.Function:
    """`wp.func(stream, begin, count, hits)`: writes the answers of the rays begin .. begin + count - 1."""
    StreamRay = stream_ray(config.triangle_test)
    store_one = store_best(config)

    @wp.func_native("best = rays.data[k].best;")
    def get_best(rays: wp.array(dtype=StreamRay), k: int, best: wp.ref[Candidate]): ...

    @wp.func
    def store(stream: wp.array(dtype=StreamRay), begin: int, count: int, hits: HitBatch):
        for k in range(count):
            best = Candidate()
            get_best(stream, k, best)
            store_one(hits, begin + k, best)

    return store


@cache
def pair_tester(config: TraversalConfig) -> wp.Function:
    """`wp.func(triangles, stream, pair_rays, pair_leaves, hit_rays, hit_blocks, hit_masks, number, hits, begin, work)`.

    Tests pairs of a ray, the stream's first being number `begin`, and a leaf, a child word of `wrt.kernels.bvh`; `hits` is
    where all of them go, if that is the query. Round by round, a block of each leaf: a pair whose ray's line meets some
    triangle of the block is kept, with the mask of these triangles; of those that are kept, hits are worked out one by one
    and selected rather than branched for. Each comparison ends a long chain of arithmetic, and a wrong guess would throw away
    what has been done for the next pairs meanwhile: with a branch, random rays took 1.6 times as long altogether.
    """
    test, width = TRIANGLE_TESTS[config.triangle_test], config.width
    StreamRay, RayState, Lanes = stream_ray(config.triangle_test), test.ray_state, lanes(config.width)
    get, forms = get_ray(config.triangle_test), test.forms(config.crossing)
    intersect_block, intersect = forms.block_test(width), forms.intersect
    load_record, box_low, box_high = test.record.load, test.record.box_low, test.record.box_high
    counting, any_hit, crossing, take = config.counters, config.query == ANY, config.crossing, take_crossing(config)

    @wp.func_native(f"""
        rays.data[k].best = best;
        if ({int(any_hit)} && best.primitive >= 0) rays.data[k].best.t = __builtin_bit_cast(float, 0xff800000u);  // -inf
    """)
    def put_best(rays: wp.array(dtype=StreamRay), k: int, best: Candidate): ...

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
        pair_rays: wp.array(dtype=int),
        pair_leaves: wp.array(dtype=int),
        hit_rays: wp.array(dtype=int),
        hit_blocks: wp.array(dtype=int),
        hit_masks: wp.array(dtype=int),
        pairs: wp.ref[int],
        work: wp.ref[StreamCounters],
    ):
        kept = int(0)
        left = int(0)
        p = int(0)
        while p < pairs:
            k = load_int(pair_rays, p)
            leaf = load_int(pair_leaves, p)
            slabs = RaySlabs()
            state = RayState()
            best = Candidate()
            get(stream, k, slabs, state, best)
            block = bvh.first_block(leaf)
            count = bvh.leaf_triangles(leaf)
            mask = lines_meet(triangles, block, state)
            store_int(hit_rays, kept, k)
            store_int(hit_blocks, kept, block)
            store_int(hit_masks, kept, int(mask))
            kept += wp.where(mask != wp.uint32(0), 1, 0)
            store_int(pair_rays, left, k)
            store_int(pair_leaves, left, bvh.leaf_child(block + 1, count - wp.static(width)))
            left += wp.where(count > wp.static(width), 1, 0)
            if wp.static(counting):
                there = wp.min(count, wp.static(width))
                work.triangles += there
                work.intersection_slots += wp.static(width)
                work.intersection_active += there
            p += 1
        pairs = left
        return kept

    @wp.func
    def work_out(
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
        while mask != wp.uint32(0):
            slot = block * wp.static(width) + lowest_bit(mask)
            mask = mask & (mask - wp.uint32(1))
            corners = load_record(triangles.records, slot, wp.static(width))
            hit = intersect(state, corners)
            t = clamp_to_box(slabs, box_low(corners), box_high(corners), hit[0])
            primitive = load_int(triangles.primitive, slot)
            if wp.static(crossing):
                if t >= t_min and t <= best.t:
                    best = take(hits, i, best, t, primitive, hit[1], hit[2])
            else:
                better = improves(t, primitive, t_min, best)
                best.t = wp.where(better, t, best.t)
                best.primitive = wp.where(better, primitive, best.primitive)
                best.u = wp.where(better, hit[1], best.u)
                best.v = wp.where(better, hit[2], best.v)
        put_best(stream, k, best)

    @wp.func
    def test_pairs(
        triangles: TriangleBlocks,
        stream: wp.array(dtype=StreamRay),
        pair_rays: wp.array(dtype=int),
        pair_leaves: wp.array(dtype=int),
        hit_rays: wp.array(dtype=int),
        hit_blocks: wp.array(dtype=int),
        hit_masks: wp.array(dtype=int),
        number: int,
        hits: wp.ref[HitBatch],
        begin: int,
        work: wp.ref[StreamCounters],
    ):
        pairs = int(number)
        if wp.static(counting):
            work.leaves += pairs
        while pairs > 0:
            kept = keep_pairs(triangles, stream, pair_rays, pair_leaves, hit_rays, hit_blocks, hit_masks, pairs, work)
            p = int(0)
            while p < kept:
                k = load_int(hit_rays, p)
                mask = wp.uint32(load_int(hit_masks, p))
                work_out(triangles, stream, k, load_int(hit_blocks, p), mask, hits, begin + k)
                p += 1

    return test_pairs
