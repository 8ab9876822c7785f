"""Pairs (ray, leaf) of a stream: the intersection filter.

Each round tests one block of each leaf. Triangles that the ray's line meets become candidates, pairs (ray, triangle), without a
branch: each comparison ends a long chain of arithmetic, and a mispredicted branch would discard the work already started for
the next pairs. Candidates are evaluated 16 at a time (`wrt.kernels.traversal.stream.stream_candidates`). Filtering by the ray's
range as well removes candidates but is slower (notebooks/records/2026-11-22-stream-candidates.md).

References: see `wrt.kernels.traversal.stream.stream_kernel`.
"""

from functools import cache

import warp as wp

from wrt.kernels.answers.best_hit import BestHit
from wrt.kernels.layout import bvh_nodes as bvh
from wrt.kernels.layout.ray_batch import HitBatch
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.boxes import RaySlabs
from wrt.kernels.simd.lanes import lanes
from wrt.kernels.traversal.stream.stream_candidates import candidate_tester
from wrt.kernels.traversal.stream.stream_kernel import StreamCounters, get_ray, stream_ray
from wrt.kernels.traversal.stream.stream_lists import PAIRS, Pairs, append_candidates, load_pair, store_pair
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks

exact_module(__name__)


@cache
def line_lanes(config: TraversalConfig) -> wp.Function:
    """`wp.func(triangles, block, state) -> mask`: which triangles of a block the line of a ray meets."""
    test, Lanes = TRIANGLE_TESTS[config.triangle_test], lanes(config.width)
    RayState, forms = test.ray_state, test.forms(config.answer.crossings, config.answer.oriented)
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
    append, intersect_lines = append_candidates(width, not config.answer.ends_at_first), line_lanes(config)

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
    """`wp.func(triangles, stream, pairs, number, hits, begin, work)`: tests the first `number` pairs completely.

    hits: destination of the hits in queries for all hits. begin: number of the stream's first ray.
    """
    StreamRay = stream_ray(config.triangle_test)
    find_candidates, test_candidates, counting = line_filter(config), candidate_tester(config), config.counters

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
            tested = int(0)
            left = int(0)
            while tested < count:
                found = find_candidates(triangles, stream, pairs, count, tested, left, work)
                test_candidates(triangles, stream, pairs, found, hits, begin)
            count = left

    return test_pairs
