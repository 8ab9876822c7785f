"""The block steps of kinds of answers that are not `nearest`: they are offered each hit, or test triangles themselves."""

from functools import cache

import warp as wp

from wrt.kernels.answers.best_hit import BestHit
from wrt.kernels.simd.boxes import RaySlabs
from wrt.kernels.simd.lanes import lanes, lowest_bit
from wrt.kernels.traversal.crossings import offering_step
from wrt.kernels.traversal.leaf import Leaf, clamp_block, leaf_search
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle import TRIANGLE_TESTS


def make_leaf_step(config: TraversalConfig, Tree: type) -> wp.Function:
    """A block step with the parameters of `wrt.kernels.traversal.crossings.offering_step`."""
    return (own_test_step if config.answer.own_test is not None else offering_step)(config, Tree)


@cache
def own_test_step(config: TraversalConfig, Tree: type) -> wp.Function:
    """The step of a kind with a test of its own: it gets the triangles whose boxes the ray meets; `hits` is its search."""
    test, width, answer = TRIANGLE_TESTS[config.triangle_test], config.width, config.answer
    Lanes, LeafSearch, meet_boxes = lanes(width), leaf_search(config.triangle_test), clamp_block(test.record, width)
    lane_mask, Search, test_triangle, best_of = (1 << width) - 1, answer.Search, answer.own_test, answer.best_of

    @wp.func
    def step(
        tree: Tree,
        leaf: Leaf,
        block: int,
        search: wp.ref[LeafSearch],
        cells: wp.ref[RaySlabs],
        hits: wp.ref[Search],
        i: int,
        best: BestHit,
    ):
        starts = Lanes(leaf.within[0])
        mask = wp.uint32(wp.static(lane_mask))
        mask = meet_boxes(search.triangles.records, block, search.slabs, mask, starts, leaf.within[0], best.t)
        while mask != wp.uint32(0):
            primitive = search.triangles.primitive[block * wp.static(width) + lowest_bit(mask)]
            mask = mask & (mask - wp.uint32(1))
            if primitive >= 0:
                test_triangle(hits, primitive)
        return best_of(hits, best)

    return step
