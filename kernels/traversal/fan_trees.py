"""Trees with leaves of fans, one ray at a time: a wide BVH or a kd-tree over the boxes of triangle fans.

**Idea** (Galin and Akkouche 2005). A fan is the object that a leaf lists, in place of the triangle. Its box is larger than that
of a triangle, and its test cheaper than that of its triangles one by one (`wrt.kernels.traversal.fan_brute_force`).

**What a leaf costs.** Fans are tested one after the other by scalar code. Leaves of triangles test W at once, so the comparison
is with W = 1.

**Limits.** A fan's test does not decide edges at the rim exactly, so crossings are not counted.

References: galin-akkouche-2005.
"""

from functools import cache

import warp as wp

from wrt.kernels.answers.answer_kind import BestHit, start
from wrt.kernels.layout import bvh_nodes as bvh
from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.kdtree_nodes import MAX_TREE_DEPTH, KdNodes
from wrt.kernels.layout.ray_batch import HitBatch, Ray
from wrt.kernels.layout.unchecked import load_int
from wrt.kernels.simd.boxes import BoxRay, RaySlabs, ray_slabs, reach
from wrt.kernels.traversal.fan_brute_force import (
    EDGES,
    NORMALS,
    PLANES,
    VERTICES,
    VERTICES_NORMALS,
    FanSet,
    make_fan_step,
)
from wrt.kernels.traversal.leaf import Counters, Leaf, enter
from wrt.kernels.traversal.single.key_walk import make_key_walk
from wrt.kernels.traversal.single.single_kdtree import Cell
from wrt.kernels.traversal.single.single_kernel import make_ray_kernel
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.traversal.two_level.linked_kdtrees import LinkedNodes, make_cell_walk
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks


@wp.struct
class FanBvh:
    """A wide BVH over fans."""

    tree: WideNodes
    order: wp.array(dtype=int)
    """(blocks * width,) fans, leaf after leaf."""
    fans: FanSet


@wp.struct
class FanKdTree:
    """A kd-tree over fans."""

    tree: LinkedNodes
    """Without links."""
    order: wp.array(dtype=int)
    fans: FanSet


@wp.struct
class FanSearch:
    """What leaves need of the ray and the fans."""

    order: wp.array(dtype=int)
    fans: FanSet
    ray: Ray
    slabs: RaySlabs


@cache
def make_fan_loop(config: TraversalConfig, form: str) -> wp.Function:
    """`wp.func(search, slot, count, best, work) -> best`: tests the fans of a leaf; slot: place of the first in the order."""
    step, counting = make_fan_step(form), config.counters

    @wp.func
    def test_fans(search: wp.ref[FanSearch], slot: int, count: int, best: BestHit, work: wp.ref[Counters]):
        for place in range(slot, slot + count):
            fan = load_int(search.order, place)
            best = step(search.fans, fan, search.ray, search.slabs, best)
            if wp.static(counting):
                work.triangles += search.fans.first[fan + 1] - search.fans.first[fan] - 1
        if wp.static(counting):
            work.leaves += 1
        return best

    return test_fans


@cache
def make_fan_bvh_walk(config: TraversalConfig, form: str) -> wp.Function:
    """`wp.func(tree, triangles, ray, hits, i, work) -> best` for ray number i, which must be valid."""
    test_fans, width = make_fan_loop(config, form), config.width

    @wp.func
    def visit(
        tree: WideNodes,
        child: int,
        search: wp.ref[FanSearch],
        hits: wp.ref[HitBatch],
        i: int,
        best: BestHit,
        work: wp.ref[Counters],
    ):
        return test_fans(search, bvh.first_block(child) * wp.static(width), bvh.leaf_triangles(child), best, work)

    walk_keys = make_key_walk(config, config.stack.levels, FanSearch, visit)

    @wp.func
    def walk_fan_bvh(tree: FanBvh, triangles: TriangleBlocks, ray: Ray, hits: wp.ref[HitBatch], i: int, work: wp.ref[Counters]):
        search = FanSearch()
        search.order = tree.order
        search.fans = tree.fans
        search.ray = ray
        search.slabs = ray_slabs(ray.origin, ray.direction, reach(ray.origin, tree.fans.low, tree.fans.high))
        return walk_keys(tree.tree, 0, BoxRay(search.slabs, ray.t_min), search, hits, i, start(ray.t_max), work)

    return walk_fan_bvh


@cache
def make_fan_kdtree_walk(config: TraversalConfig, form: str) -> wp.Function:
    """The same through a kd-tree."""
    test_fans, width = make_fan_loop(config, form), config.width

    @wp.func
    def test_leaf(
        tree: KdNodes,
        leaf: Leaf,
        cells: wp.ref[RaySlabs],
        search: wp.ref[FanSearch],
        hits: wp.ref[HitBatch],
        i: int,
        best: BestHit,
        work: wp.ref[Counters],
    ):
        return test_fans(search, leaf.block * wp.static(width), leaf.count, best, work)

    walk_cells = make_cell_walk(config, MAX_TREE_DEPTH, FanSearch, test_leaf)

    @wp.func
    def walk_fan_kdtree(
        tree: FanKdTree, triangles: TriangleBlocks, ray: Ray, hits: wp.ref[HitBatch], i: int, work: wp.ref[Counters]
    ):
        search = FanSearch()
        search.order = tree.order
        search.fans = tree.fans
        search.ray = ray
        search.slabs = ray_slabs(ray.origin, ray.direction, reach(ray.origin, tree.fans.low, tree.fans.high))
        interval = enter(search.slabs, tree.tree.low, tree.tree.high, ray.t_min, ray.t_max)
        first = Cell()
        first.entry = interval[0]
        first.leave = interval[1]
        return walk_cells(tree.tree, first, search.slabs, search, hits, i, start(ray.t_max), work)

    return walk_fan_kdtree


FAN_TESTS = {
    VERTICES: "moeller_trumbore",
    VERTICES_NORMALS: "moeller_trumbore",
    EDGES: "moeller_trumbore",
    NORMALS: "moeller_trumbore",
    PLANES: "havel_herout",
}
"""The triangle test of which each form of fans (`FAN_FORMS`) is a variant."""

FAN_TREES = {"bvh": (FanBvh, make_fan_bvh_walk), "kdtree": (FanKdTree, make_fan_kdtree_walk)}
"""For each kind of tree its struct and the factory of its walk."""


@cache
def make_fan_tree_kernel(config: TraversalConfig, kind: str, form: str) -> wp.Kernel:
    """The kernel for one specialisation; kind: key in `FAN_TREES`; form: key in `FAN_FORMS`.

    Raises:
        ValueError: a query that counts crossings, or culling of back faces.
    """
    if not config.answer.nearest or config.cull_backfaces:
        raise ValueError("fans answer closest-hit and any-hit queries, of both sides; use wrt.Scene(scene.meshes) for others")
    if config.triangle_test != FAN_TESTS[form]:
        raise ValueError(f"fans in the form {form!r} have the triangle_test {FAN_TESTS[form]!r}; leave triangle_test out")
    Tree, make_walk = FAN_TREES[kind]
    return make_ray_kernel(config, Tree, make_walk(config, form))
