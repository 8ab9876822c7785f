"""The kernels that trace rays through a cloud, one ray at a time: by a walk of its BVH, and by brute force, the judge."""

from functools import cache

import warp as wp

from wrt.kernels.answers.answer_kind import BestHit, improves, start
from wrt.kernels.clouds.cloud_test import PointRay, meet_point, points_near, prepare
from wrt.kernels.layout import bvh_nodes as bvh
from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.ray_batch import Ray
from wrt.kernels.simd.boxes import BoxRay, RaySlabs, ray_slabs, reach
from wrt.kernels.simd.lanes import lanes, lowest_bit
from wrt.kernels.traversal.brute_force import AllTriangles
from wrt.kernels.traversal.leaf import Counters
from wrt.kernels.traversal.single.key_walk import make_key_walk
from wrt.kernels.traversal.single.single_kernel import make_ray_kernel
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks


@wp.struct
class CloudSearch:
    """What leaves need of the ray and the points."""

    points: TriangleBlocks
    ray: PointRay
    slabs: RaySlabs
    t_min: float


@wp.func
def begin_search(points: TriangleBlocks, ray: Ray, low: wp.vec3, high: wp.vec3):
    """The search of a ray for points in a box."""
    return CloudSearch(
        points,
        prepare(ray.origin, ray.direction),
        ray_slabs(ray.origin, ray.direction, reach(ray.origin, low, high)),
        ray.t_min,
    )


@cache
def make_point_step(config: TraversalConfig) -> wp.Function:
    """`wp.func(search, slot, hits, i, best) -> best`: decides about the point in a slot."""
    meet = meet_point(max(config.width, 2), TRIANGLE_TESTS[config.triangle_test].record.components)
    nearest, accept = config.answer.nearest, config.answer.search.accept
    Results = config.answer.search.State

    @wp.func
    def step(search: wp.ref[CloudSearch], slot: int, hits: wp.ref[Results], i: int, best: BestHit):
        u = float(0.0)
        v = float(0.0)
        t = meet(search.points.records, slot, search.ray, search.slabs, search.t_min, u, v)
        primitive = search.points.primitive[slot]
        if wp.static(not nearest):
            if t >= search.t_min and t <= best.t:
                best = accept(hits, i, best, t, primitive, u, v)
        elif improves(t, primitive, search.t_min, best):
            best = BestHit(t, primitive, u, v)
        return best

    return step


@cache
def make_cloud_kernel(config: TraversalConfig) -> wp.Kernel:
    """The kernel that walks the tree; the triangle test of the config is one of `wrt.kernels.clouds.cloud_test.TESTS`."""
    width, any_hit, Results = max(config.width, 2), config.answer.rules.ends_at_first, config.answer.search.State
    near = points_near(TRIANGLE_TESTS[config.triangle_test].record.components, width)
    step, counting, Lanes = make_point_step(config), config.counters, lanes(width)

    @wp.func
    def visit(
        tree: WideNodes,
        child: int,
        search: wp.ref[CloudSearch],
        hits: wp.ref[Results],
        i: int,
        best: BestHit,
        work: wp.ref[Counters],
    ):
        block = bvh.first_block(child)
        count = bvh.leaf_triangles(child)
        unused = Lanes()
        if wp.static(counting):
            work.leaves += 1
            work.triangles += count
        while count > 0:
            mask = near(search.points.records, block, search.ray, unused, unused, unused)
            while mask != wp.uint32(0):
                lane = lowest_bit(mask)
                mask = mask & (mask - wp.uint32(1))
                best = step(search, block * wp.static(width) + lane, hits, i, best)
                if wp.static(any_hit):  # noqa: SIM102  (Warp evaluates both operands of `and`)
                    if best.primitive >= 0:
                        mask = wp.uint32(0)
                        count = 0
            block += 1
            count -= wp.static(width)
        return best

    walk_keys = make_key_walk(config, config.stack.levels, CloudSearch, visit)

    @wp.func
    def walk_cloud(tree: WideNodes, points: TriangleBlocks, ray: Ray, hits: wp.ref[Results], i: int, work: wp.ref[Counters]):
        search = begin_search(points, ray, tree.low, tree.high)
        return walk_keys(tree, 0, BoxRay(search.slabs, ray.t_min), search, hits, i, start(ray.t_max), work)

    return make_ray_kernel(config, WideNodes, walk_cloud)


@cache
def make_brute_cloud_kernel(config: TraversalConfig) -> wp.Kernel:
    """The kernel that decides about every point, without tree and filter."""
    step, Results, counting = make_point_step(config), config.answer.search.State, config.counters

    @wp.func
    def test_all(tree: AllTriangles, points: TriangleBlocks, ray: Ray, hits: wp.ref[Results], i: int, work: wp.ref[Counters]):
        search = begin_search(points, ray, tree.low, tree.high)
        best = start(ray.t_max)
        for slot in range(points.primitive.shape[0]):
            if points.primitive[slot] >= 0:
                best = step(search, slot, hits, i, best)
                if wp.static(counting):
                    work.triangles += 1
        return best

    return make_ray_kernel(config, AllTriangles, test_all)
