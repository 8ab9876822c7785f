"""Pairs (ray, block) of interleaved walks: the lines that meet triangles, and the evaluation of these candidates.

As `wrt.kernels.traversal.stream.stream_pairs`, but all blocks of a leaf are in the list from the beginning, so that no pair
is stored again, and the lists of candidates, which are evaluated 16 at a time, are longer.
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime.options import exact_module
from wrt.kernels.traversal.interleaved.ray_slots import pair_room
from wrt.kernels.traversal.stream.stream_candidates import candidate_tester
from wrt.kernels.traversal.stream.stream_kernel import stream_ray
from wrt.kernels.traversal.stream.stream_lists import PAIRS, Pairs, StreamHits, append_candidates
from wrt.kernels.traversal.stream.stream_pairs import line_lanes
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks

exact_module(__name__)


@cache
def block_tester(config: TraversalConfig) -> wp.Function:
    """`wp.func(triangles, stream, blocks, count, pairs, found)`: tests the first `count` pairs of `blocks`.

    found: `StreamHits`.
    """
    test, width = TRIANGLE_TESTS[config.triangle_test], config.width
    StreamRay, RayState = stream_ray(config.triangle_test), test.ray_state
    test_candidates, intersect_lines = candidate_tester(config), line_lanes(config)
    append = append_candidates(width, not config.answer.ends_at_first)

    @wp.func_native(f"""
        const int k = blocks.data[p];
        block = blocks.data[{pair_room(width)} + p]; state = rays.data[k].state;
        return k;
    """)
    def load_pair(
        blocks: wp.array(dtype=int), p: int, rays: wp.array(dtype=StreamRay), block: wp.ref[int], state: wp.ref[RayState]
    ) -> int: ...

    @wp.func
    def find_candidates(
        triangles: TriangleBlocks,
        stream: wp.array(dtype=StreamRay),
        blocks: wp.array(dtype=int),
        count: int,
        pairs: wp.ref[Pairs],
        tested: wp.ref[int],
    ):
        found = int(0)
        p = int(tested)
        while p < count and found <= PAIRS:
            block = int(0)
            state = RayState()
            k = load_pair(blocks, p, stream, block, state)
            found = append(triangles.primitive, pairs, found, k, block, intersect_lines(triangles, block, state))
            p += 1
        tested = p
        return found

    @wp.func
    def test_blocks(
        triangles: TriangleBlocks,
        stream: wp.array(dtype=StreamRay),
        blocks: wp.array(dtype=int),
        count: int,
        pairs: wp.ref[Pairs],
        found: wp.ref[StreamHits],
    ):
        tested = int(0)
        while tested < count:
            candidates = find_candidates(triangles, stream, blocks, count, pairs, tested)
            test_candidates(triangles, stream, pairs, candidates, found)

    return test_blocks
