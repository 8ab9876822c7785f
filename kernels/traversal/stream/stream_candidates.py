"""Pairs of a stream: rays with leaves, the triangles that their lines meet, and which of these candidates are hits.

## Pairs (ray, leaf)

Each round tests one block of each leaf. Triangles that the ray's line meets become candidates, pairs (ray, triangle), without a
branch: each comparison ends a long chain of arithmetic, and a mispredicted branch would discard the work already started for
the next pairs. Candidates are evaluated 16 at a time. Filtering by the ray's range as well removes candidates but is slower
(notebooks/records/2026-11-22-stream-candidates.md).

## Candidates

**Problem.** A candidate is a ray and a triangle somewhere in memory. Its evaluation is about a hundred instructions, a load of
the triangle's id that misses the caches, and up to three unpredictable branches (is the hit in the ray's range, does the ray
have a better hit, are there more candidates). One at a time, this is a large part of the time of incoherent rays, most of it
latency.

**Idea.** Candidates are independent until the last step, so 16 of them, of any rays and triangles, are evaluated at a time, one
per lane (`kernels/native/stream_candidates.h`). Rays are loaded by vector loads and a transposition, triangles word by word,
which is faster than gathers. Candidates within the range of their rays are then merged one after the other, so that a ray with
several of them keeps the best. Figures: notebooks/records/2026-11-22-stream-candidates.md.

A triangle test supplies its code for these lanes in `TestForm.native`. For other tests, for queries for all hits, and
with back-face culling, candidates are evaluated one after the other by the scalar test (`triangle_step`), with the same bits.

References: see `wrt.kernels.traversal.stream.stream_kernel`.
"""

from functools import cache

import warp as wp

from wrt.kernels.answers.answer_kind import BestHit
from wrt.kernels.layout import bvh_nodes as bvh
from wrt.kernels.layout.ray_batch import HitBatch
from wrt.kernels.layout.unchecked import load_int
from wrt.kernels.runtime import native
from wrt.kernels.simd.boxes import RaySlabs
from wrt.kernels.simd.lanes import lanes
from wrt.kernels.traversal.leaf import triangle_step
from wrt.kernels.traversal.stream.stream_kernel import LIST_LANES, StreamCounters, get_ray, ray_number, stream_ray
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks

PAIRS = 256
"""Greatest number of pairs, and of candidates, before they are tested; the lists also have room for those that one more step
finds."""

PairList = wp.types.vector(length=PAIRS + 2 * LIST_LANES, dtype=wp.int32)


@wp.struct
class Pairs:
    """Lists of pairs: (ray, leaf) to be tested, and (ray, triangle) candidates."""

    rays: PairList
    """Ray of each pair to be tested."""
    leaves: PairList
    """Leaf of each pair: a child word of `wrt.kernels.layout.bvh_nodes`."""
    candidate_rays: PairList
    """Ray of each candidate: its line meets the triangle."""
    candidates: PairList
    """Slot of the candidate's triangle: block * W + lane."""


@wp.struct
class StreamHits:
    """Where hits go that are not stored with the rays of a stream: in queries for all hits."""

    hits: HitBatch
    begin: int
    """Number of the stream's first ray."""


@wp.func_native("leaf = pairs.leaves.c[p]; return pairs.rays.c[p];")
def load_pair(pairs: wp.ref[Pairs], p: int, leaf: wp.ref[int]) -> int:
    """Ray and leaf of a pair."""


@wp.func_native("pairs.rays.c[p] = ray; pairs.leaves.c[p] = leaf;")
def store_pair(pairs: wp.ref[Pairs], p: int, ray: int, leaf: int):
    """Stores a pair at index p."""


@wp.func_native("slot = pairs.candidates.c[p]; return pairs.candidate_rays.c[p];")
def load_candidate(pairs: wp.ref[Pairs], p: int, slot: wp.ref[int]) -> int:
    """Ray and slot of a candidate."""


@cache
def append_candidates(width: int, fetching: bool = True) -> wp.Function:
    """`func(primitives, pairs, count, ray, block, mask) -> int`: appends candidates of a ray and the triangles in the mask of a
    block.

    Returns the new number of candidates. If `fetching`, the ids of the triangles are prefetched, because they are not in a
    cache when the candidates are evaluated (notebooks/records/2026-11-22-stream-candidates.md).
    """
    call = f"wrt::append_candidates<{width}, {int(fetching)}>(primitives.data, pairs, count, ray, block, mask)"

    @native.func_native("stream.h", f"return {call};")
    def append_native(
        primitives: wp.array(dtype=int),
        pairs: wp.ref[Pairs],
        count: int,
        ray: int,
        block: int,
        mask: wp.uint32,
    ) -> int: ...

    return append_native


def evaluates_in_lanes(config: TraversalConfig) -> bool:
    """Whether candidates are evaluated 16 at a time."""
    return bool(TRIANGLE_TESTS[config.triangle_test].native) and config.answer.nearest and not config.cull_backfaces


def lane_form(config: TraversalConfig) -> str:
    """C++ template arguments of what evaluates candidates, where `evaluates_in_lanes`."""
    test = TRIANGLE_TESTS[config.triangle_test]
    return f"{test.native}, {config.width}, {test.record.components}, {int(config.answer.rules.ends_at_first)}, {LIST_LANES}"


@cache
def test_in_lanes(config: TraversalConfig) -> wp.Function:
    """`func(records, primitives, rays, pairs, count)`: evaluates the first `count` candidates and merges their hits."""
    StreamRay = stream_ray(config.triangle_test)
    call = f"wrt::test_candidates<{lane_form(config)}>(records.data, primitives.data, rays.data, pairs, count)"

    @native.func_native("stream_candidates.h", f"{call};")
    def test_in_lanes_native(
        records: wp.array(dtype=float),
        primitives: wp.array(dtype=int),
        rays: wp.array(dtype=StreamRay),
        pairs: wp.ref[Pairs],
        count: int,
    ): ...

    return test_in_lanes_native


@native.func_native("stream_candidates.h", "wrt::record_if_better(hit.c, primitive, t_min, best);")
def record_if_better(hit: wp.vec3, primitive: int, t_min: float, best: wp.ref[BestHit]):
    """Replaces the best hit by the hit (t, u, v) if that `improves` it.

    It uses bit operations, because the compiler may turn a select into a branch, which is slower for incoherent rays
    (notebooks/records/2026-11-22-stream-candidates.md).
    """


@cache
def put_best(test: str, any_hit: bool) -> wp.Function:
    """`wp.func(rays, k, best)`: writes the best hit of ray k of a stream; one whose any hit suffices has its answer then."""
    StreamRay = stream_ray(test)

    @native.func_native(
        "lanes.h",
        f"""
        rays.data[k].best = best;
        if ({int(any_hit)} && best.primitive >= 0) rays.data[k].best.t = -WRT_INFINITY;
    """,
    )
    def put(rays: wp.array(dtype=StreamRay), k: int, best: BestHit): ...

    return put


@cache
def scalar_test_step(config: TraversalConfig) -> wp.Function:
    """`wp.func(triangles, stream, k, slot, hits, i)`: evaluates one candidate, of ray k of the stream and i of the batch."""
    test, StreamRay, get = TRIANGLE_TESTS[config.triangle_test], stream_ray(config.triangle_test), get_ray(config.triangle_test)
    RayState, own = test.ray_state, test.own_candidate is not None
    candidate = test.own_candidate(config.width) if own else triangle_step(config)
    any_hit, nearest, accept = config.answer.rules.ends_at_first, config.answer.nearest, config.answer.search.accept

    put = put_best(config.triangle_test, any_hit)

    @wp.func
    def test_one(
        triangles: TriangleBlocks,
        stream: wp.array(dtype=StreamRay),
        k: int,
        slot: int,
        hits: wp.ref[HitBatch],
        i: int,
    ):
        slabs = RaySlabs()
        state = RayState()
        best = BestHit()
        t_min = get(stream, k, slabs, state, best)
        if wp.static(any_hit) and best.primitive >= 0:
            return  # the ray already has a hit
        if wp.static(own):
            hit = candidate(triangles.records, slot, state, slabs, t_min)
        else:
            hit = candidate(triangles.records, slot, state, slabs)
        primitive = load_int(triangles.primitive, slot)
        if wp.static(nearest):
            record_if_better(hit, primitive, t_min, best)
        elif hit[0] >= t_min and hit[0] <= best.t:
            best = accept(hits, i, best, hit[0], primitive, hit[1], hit[2])
        put(stream, k, best)

    return test_one


@cache
def candidate_tester(config: TraversalConfig) -> wp.Function:
    """`wp.func(triangles, stream, pairs, count, found)`: evaluates the first `count` candidates.

    found: `StreamHits`.
    """
    StreamRay = stream_ray(config.triangle_test)
    if evaluates_in_lanes(config):
        in_lanes = test_in_lanes(config)

        @wp.func
        def test_all(
            triangles: TriangleBlocks,
            stream: wp.array(dtype=StreamRay),
            pairs: wp.ref[Pairs],
            count: int,
            found: wp.ref[StreamHits],
        ):
            in_lanes(triangles.records, triangles.primitive, stream, pairs, count)

        return test_all

    test_one, number_of = scalar_test_step(config), ray_number(config.triangle_test)

    @wp.func
    def test_each(
        triangles: TriangleBlocks,
        stream: wp.array(dtype=StreamRay),
        pairs: wp.ref[Pairs],
        count: int,
        found: wp.ref[StreamHits],
    ):
        p = int(0)
        while p < count:
            slot = int(0)
            k = load_candidate(pairs, p, slot)
            test_one(triangles, stream, k, slot, found.hits, found.begin + number_of(stream, k))
            p += 1

    return test_each


@cache
def line_lanes(config: TraversalConfig) -> wp.Function:
    """`wp.func(triangles, block, state) -> mask`: which triangles of a block the line of a ray meets."""
    test, Lanes = TRIANGLE_TESTS[config.triangle_test], lanes(config.width)
    RayState, forms = test.ray_state, test.forms(config.answer.rules.crossings, config.answer.rules.oriented)
    intersect_block = (forms.line_test or forms.block_test)(config.width)

    @wp.func
    def intersect_lines(triangles: TriangleBlocks, block: int, state: RayState):
        t = Lanes()  # t, u and v are not used
        u = Lanes()
        v = Lanes()
        return intersect_block(triangles.records, block, state, t, u, v)

    return intersect_lines


@cache
def line_filter(config: TraversalConfig) -> wp.Function:
    """`wp.func(triangles, stream, pairs, count, tested, left, work) -> found`: tests one block of each pair tested .. count -
    1.

    Lists the candidates and returns their number; stops when the candidate list may become full. Pairs with blocks that remain
    are moved to the front of the pair list; `left` is their number.
    """
    test, width, counting = TRIANGLE_TESTS[config.triangle_test], config.width, config.counters
    StreamRay, RayState, get = stream_ray(config.triangle_test), test.ray_state, get_ray(config.triangle_test)
    append, intersect_lines = append_candidates(width, not config.answer.rules.ends_at_first), line_lanes(config)

    @wp.func
    def find_candidates(
        triangles: TriangleBlocks,
        stream: wp.array(dtype=StreamRay),
        pairs: wp.ref[Pairs],
        count: int,
        tested: wp.ref[int],
        left: wp.ref[int],
        work: wp.ref[StreamCounters],
    ):
        found = int(0)
        p = int(tested)
        remaining = int(left)
        while p < count and found <= PAIRS:
            leaf = int(0)
            k = load_pair(pairs, p, leaf)
            slabs = RaySlabs()
            state = RayState()
            best = BestHit()
            get(stream, k, slabs, state, best)
            block = bvh.first_block(leaf)
            triangles_left = bvh.leaf_triangles(leaf)
            found = append(triangles.primitive, pairs, found, k, block, intersect_lines(triangles, block, state))
            store_pair(pairs, remaining, k, bvh.leaf_child(block + 1, triangles_left - wp.static(width)))
            remaining += wp.where(triangles_left > wp.static(width), 1, 0)
            if wp.static(counting):
                tested_lanes = wp.min(triangles_left, wp.static(width))
                work.triangles += tested_lanes
                work.intersection_slots += wp.static(width)
                work.intersection_active += tested_lanes
            p += 1
        tested = p
        left = remaining
        return found

    return find_candidates


@cache
def pair_tester(config: TraversalConfig) -> wp.Function:
    """`wp.func(triangles, stream, pairs, number, found, work)`: tests the first `number` pairs completely.

    found: `StreamHits`.
    """
    StreamRay = stream_ray(config.triangle_test)
    find_candidates, test_candidates, counting = line_filter(config), candidate_tester(config), config.counters

    @wp.func
    def test_pairs(
        triangles: TriangleBlocks,
        stream: wp.array(dtype=StreamRay),
        pairs: wp.ref[Pairs],
        number: int,
        found: wp.ref[StreamHits],
        work: wp.ref[StreamCounters],
    ):
        count = int(number)
        if wp.static(counting):
            work.leaves += count
        while count > 0:
            tested = int(0)
            left = int(0)
            while tested < count:
                candidates = find_candidates(triangles, stream, pairs, count, tested, left, work)
                test_candidates(triangles, stream, pairs, candidates, found)
            count = left

    return test_pairs
