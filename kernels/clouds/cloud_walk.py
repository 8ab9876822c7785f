"""The kernels that trace rays through a cloud, one ray at a time: by a walk of its BVH, and by brute force, the judge."""

from functools import cache

import warp as wp

from wrt.kernels.answers.answer_kind import BestHit, improves, start
from wrt.kernels.clouds.cloud_test import PointLine, line_of, meet_point, points_near
from wrt.kernels.layout import bvh_nodes as bvh
from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.ray_batch import Ray
from wrt.kernels.simd.lanes import lowest_bit
from wrt.kernels.traversal.leaf import Counters
from wrt.kernels.traversal.single.key_walk import make_key_walk
from wrt.kernels.traversal.single.single_kernel import make_ray_kernel
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks


@wp.struct
class CloudTree:
    """A wide BVH over points."""

    nodes: WideNodes
    records: wp.array(dtype=float)
    """(blocks * components * width,) points, leaf after leaf."""
    primitive: wp.array(dtype=int)
    """(blocks * width,) their numbers; -1 in unused lanes."""


@wp.struct
class CloudSearch:
    """What leaves need of the ray and the points."""

    line: PointLine
    records: wp.array(dtype=float)
    primitive: wp.array(dtype=int)


@wp.func
def begin_search(tree: CloudTree, ray: Ray):
    """The search of a ray."""
    search = CloudSearch()
    search.line = line_of(ray, tree.nodes.low, tree.nodes.high)
    search.records = tree.records
    search.primitive = tree.primitive
    return search


@cache
def make_point_step(config: TraversalConfig, components: int) -> wp.Function:
    """`wp.func(search, slot, hits, i, best) -> best`: decides about the point in a slot."""
    meet, nearest, accept = meet_point(max(config.width, 2), components), config.answer.nearest, config.answer.search.accept
    Results = config.answer.search.State

    @wp.func
    def step(search: wp.ref[CloudSearch], slot: int, hits: wp.ref[Results], i: int, best: BestHit):
        u = float(0.0)
        v = float(0.0)
        t = meet(search.records, slot, search.line, u, v)
        primitive = search.primitive[slot]
        if wp.static(not nearest):
            if t >= search.line.t_min and t <= best.t:
                best = accept(hits, i, best, t, primitive, u, v)
        elif improves(t, primitive, search.line.t_min, best):
            best.t = t
            best.primitive = primitive
            best.u = u
            best.v = v
        return best

    return step


@cache
def make_cloud_kernel(config: TraversalConfig, components: int) -> wp.Kernel:
    """The kernel that walks the tree; components: `SPHERE` or `DISC`."""
    width, any_hit, Results = max(config.width, 2), config.answer.rules.ends_at_first, config.answer.search.State
    step, near, counting = make_point_step(config, components), points_near(width, components), config.counters

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
        if wp.static(counting):
            work.leaves += 1
            work.triangles += count
        while count > 0:
            mask = near(search.records, block, search.line)
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
    def walk_cloud(tree: CloudTree, triangles: TriangleBlocks, ray: Ray, hits: wp.ref[Results], i: int, work: wp.ref[Counters]):
        search = begin_search(tree, ray)
        return walk_keys(tree.nodes, 0, search.line.slabs, ray.t_min, search, hits, i, start(ray.t_max), work)

    return make_ray_kernel(config, CloudTree, walk_cloud)


@cache
def make_brute_cloud_kernel(config: TraversalConfig, components: int) -> wp.Kernel:
    """The kernel that decides about every point, without tree and filter."""
    step, Results, counting = make_point_step(config, components), config.answer.search.State, config.counters

    @wp.func
    def test_all(tree: CloudTree, triangles: TriangleBlocks, ray: Ray, hits: wp.ref[Results], i: int, work: wp.ref[Counters]):
        search = begin_search(tree, ray)
        best = start(ray.t_max)
        for slot in range(tree.primitive.shape[0]):
            if tree.primitive[slot] >= 0:
                best = step(search, slot, hits, i, best)
                if wp.static(counting):
                    work.triangles += 1
        return best

    return make_ray_kernel(config, CloudTree, test_all)
