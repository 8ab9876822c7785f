"""A step in the leaves that leaves one triangle out: the one that the ray starts on.

**Problem.** A ray that leaves a surface meets the triangle that it starts on again, at a t of about 0, in front or behind as
rounding has it. A lower bound for t loses thin walls and corners along with it; `wrt.kernels.spawn` moves the origin by what
rounding can do. Where the triangle is known it can be told by its number instead: the origin stays where it is, and nothing
else is lost, however near.

**Idea.** The candidate is dropped after its test and before it is compared with the best hit: whatever bounds a search, its
hits do not come from the triangle. Boxes are visited as before. So the answer is that of the mesh without the triangle, in a
scene of the same box.

**Limits.** Neighbours stay: a ray from an edge, or from beside it within rounding, may meet the triangle on the other side of
the edge at a t of about 0, and a ray from one of two coincident triangles meets the other.
"""

from functools import cache

import warp as wp

from wrt.kernels.boxes import RaySlabs
from wrt.kernels.lanes import lanes, lowest_bit
from wrt.kernels.traversal.config import ANY, TraversalConfig
from wrt.kernels.traversal.leaf import Candidate, clamp_block, improves
from wrt.kernels.traversal.results import Skipping
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.records import TriangleBlocks

wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@cache
def skipping_step(config: TraversalConfig, Tree: type) -> wp.Function:
    """A block's step with the parameters of `wrt.kernels.traversal.crossings.crossing_step`, for the nearest queries."""
    test, width, any_hit = TRIANGLE_TESTS[config.triangle_test], config.width, config.query == ANY
    Lanes, RayState = lanes(width), test.ray_state
    intersect_block, clamp = test.block_test(width), clamp_block(test.record, width, config.cull_backfaces)

    @wp.func
    def step(
        tree: Tree,
        node: int,
        interval: wp.vec2,
        triangles: TriangleBlocks,
        block: int,
        state: RayState,
        slabs: wp.ref[RaySlabs],
        search: wp.ref[Skipping],
        i: int,
        best: Candidate,
    ):
        t_lanes = Lanes()
        u_lanes = Lanes()
        v_lanes = Lanes()
        mask = intersect_block(triangles.records, block, state, t_lanes, u_lanes, v_lanes)
        if mask != wp.uint32(0):
            mask = clamp(triangles.records, block, slabs, mask, t_lanes, search.t_min, best.t)
        while mask != wp.uint32(0):
            lane = lowest_bit(mask)
            mask = mask & (mask - wp.uint32(1))
            t = t_lanes[lane]
            primitive = triangles.primitive[block * wp.static(width) + lane]
            if primitive != search.skipped and improves(t, primitive, search.t_min, best):
                best.t = t
                best.primitive = primitive
                best.u = u_lanes[lane]
                best.v = v_lanes[lane]
                if wp.static(any_hit):
                    mask = wp.uint32(0)
        return best

    return step
