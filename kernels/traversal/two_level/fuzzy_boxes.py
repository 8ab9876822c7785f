"""Trees of fuzzy boxes: clusters of triangles that move nearly rigidly, each with a tree in a space that moves along.

**Idea** (Guenther et al. 2006). The motion of a cluster is an affine motion shared by its triangles, plus a residual. In the
space that follows the affine map, the residual is small. Boxes around all positions of a triangle in that space over all
frames, the fuzzy boxes, form a tree that is built once. A frame is one map per cluster and the positions of the triangles. A
ray is transformed into the cluster's space to traverse its tree.

**Differences from the paper.** Triangles are not transformed: a leaf is tested in the scene, with the original ray. The hits
are therefore those of any other tree over the frame's triangles, to the bit, and there is no crack between neighbours in
different clusters.

**Why no hit is lost.** A fuzzy box encloses the image of the box of its triangle in the scene, not only the image of the
triangle. Boxes in the scene are widened by a slack (`wrt.kernels.simd.boxes`), a fraction of the reach there. The image of the
slack is at most the slack times the greatest row sum of the absolute values of the map (`Cluster.norm`). Boxes in the
cluster's space are widened by that amount and, as everywhere, by the same fraction of the reach in that space, which covers the
rounding of the transformed ray. The boxes on the path to a triangle are therefore entered no later than the triangle's own, and
everything that a walk skips lies beyond its best hit.

The upper tree is over the boxes of the clusters in the scene. It is walked like any other wide tree
(`wrt.kernels.traversal.single.key_walk`). The trees below are wide BVHs, too, or kd-trees as in the paper
(`wrt.kernels.traversal.two_level.linked_kdtrees`, without links). A triangle is in every leaf of a kd-tree that its fuzzy box
meets, and planes are widened as boxes are, so the argument above holds for cells.

References: guenther-2006-motion; guenther-2006-skinned.
"""

from functools import cache

import warp as wp

from wrt.kernels.answers.answer_kind import BestHit, start
from wrt.kernels.layout import bvh_nodes as bvh
from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.kdtree_nodes import MAX_TREE_DEPTH, KdNodes
from wrt.kernels.layout.ray_batch import HitBatch, Ray
from wrt.kernels.layout.unchecked import load_int
from wrt.kernels.simd.boxes import BoxRay, ray_slabs, reach
from wrt.kernels.traversal.leaf import Counters, begin_search, enter, leaf_search
from wrt.kernels.traversal.single.key_walk import make_key_walk
from wrt.kernels.traversal.single.single_bvh import make_leaf, make_leaf_loop
from wrt.kernels.traversal.single.single_kdtree import Cell
from wrt.kernels.traversal.single.single_kernel import make_ray_kernel
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.traversal.two_level.linked_kdtrees import LinkedNodes, make_cell_walk
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks


@wp.struct
class Cluster:
    """The space of a cluster in a frame, and its tree."""

    to_cluster: wp.mat33d
    """A point p relative to the scene's centre maps to to_cluster (p - origin) in the cluster's space."""
    origin: wp.vec3d
    norm: float
    """Greatest row sum of the absolute values of `to_cluster`."""
    root: int
    """Root of its tree among the nodes of all clusters."""
    low: wp.vec3
    """`low` and `high` bound its tree, in its own space."""
    high: wp.vec3


PARTS = {"bvh": WideNodes, "kdtree": LinkedNodes}
"""Struct of the clusters' trees for each kind."""


def fuzzy_nodes(kind: str) -> type:
    """The struct of the trees of a frame; kind: of the clusters' trees, key of `PARTS`."""

    class FuzzyNodes:
        top: WideNodes
        """Boxes of the clusters relative to the scene's centre; one cluster per leaf."""
        order: wp.array(dtype=int)
        """(leaves * width,) cluster of each leaf, at the first element of its block."""
        clusters: wp.array(dtype=Cluster)
        parts: PARTS[kind]
        """Trees of all clusters, each in its own space."""

    FuzzyNodes.__qualname__ = f"FuzzyNodes_{kind}"
    return wp.struct(FuzzyNodes)


TREES = {kind: fuzzy_nodes(kind) for kind in PARTS}
"""Struct of the trees of a frame for each kind of the clusters' trees."""


@wp.func
def cluster_slabs(cluster: Cluster, ray: Ray, far: float):
    """The ray in a cluster's space, for tests of its fuzzy boxes; far: reach of the ray in the scene."""
    origin = wp.vec3(cluster.to_cluster * (wp.vec3d(ray.origin) - cluster.origin))
    direction = wp.vec3(cluster.to_cluster * wp.vec3d(ray.direction))
    return ray_slabs(origin, direction, reach(origin, cluster.low, cluster.high) + cluster.norm * far)


@cache
def fuzzy_search(triangle_test: str, kind: str) -> type:
    """The struct of the search state that visits to clusters need; kind: key of `TREES`."""

    class FuzzySearch:
        tree: TREES[kind]
        ray: Ray
        far: float
        leaf: leaf_search(triangle_test)

    FuzzySearch.__qualname__ = f"FuzzySearch_{triangle_test}_{kind}"
    return wp.struct(FuzzySearch)


@cache
def make_visit(config: TraversalConfig, kind: str) -> wp.Function:
    """`wp.func(tree, child, search, hits, i, best, work) -> best`: visits a leaf of the upper tree, for `make_key_walk`."""
    FuzzySearch, LeafSearch = fuzzy_search(config.triangle_test, kind), leaf_search(config.triangle_test)
    width, in_boxes = max(config.width, 2), kind == "bvh"
    if in_boxes:
        walk_below = make_key_walk(config, config.stack.levels, LeafSearch, make_leaf(config))
    else:
        walk_below = make_cell_walk(config, MAX_TREE_DEPTH, LeafSearch, make_leaf_loop(config, KdNodes))

    @wp.func
    def visit(
        tree: WideNodes,
        child: int,
        search: wp.ref[FuzzySearch],
        hits: wp.ref[HitBatch],
        i: int,
        best: BestHit,
        work: wp.ref[Counters],
    ):
        cluster = search.tree.clusters[load_int(search.tree.order, bvh.first_block(child) * wp.static(width))]
        slabs = cluster_slabs(cluster, search.ray, search.far)
        if wp.static(in_boxes):
            seen = BoxRay(slabs, search.ray.t_min)
            best = walk_below(search.tree.parts, cluster.root, seen, search.leaf, hits, i, best, work)
        else:
            interval = enter(slabs, cluster.low, cluster.high, search.ray.t_min, best.t)
            first = Cell()
            first.node = cluster.root
            first.entry = interval[0]
            first.leave = interval[1]
            best = walk_below(search.tree.parts, first, slabs, search.leaf, hits, i, best, work)
        return best

    return visit


@cache
def make_fuzzy_walk(config: TraversalConfig, kind: str) -> wp.Function:
    """`wp.func(tree, triangles, ray, hits, i, work) -> best` for ray number i, which must be valid."""
    Tree, FuzzySearch = TREES[kind], fuzzy_search(config.triangle_test, kind)
    begin = begin_search(config.triangle_test)
    walk_keys = make_key_walk(config, config.stack.levels, FuzzySearch, make_visit(config, kind))

    @wp.func
    def walk_fuzzy_boxes(
        tree: Tree, triangles: TriangleBlocks, ray: Ray, hits: wp.ref[HitBatch], i: int, work: wp.ref[Counters]
    ):
        far = reach(ray.origin, tree.top.low, tree.top.high)
        slabs = ray_slabs(ray.origin, ray.direction, far)
        search = FuzzySearch()
        search.tree = tree
        search.ray = ray
        search.far = far
        search.leaf = begin(triangles, ray, slabs)
        return walk_keys(tree.top, 0, BoxRay(slabs, ray.t_min), search, hits, i, start(ray.t_max), work)

    return walk_fuzzy_boxes


@cache
def make_fuzzy_kernel(config: TraversalConfig, kind: str = "bvh") -> wp.Kernel:
    """The kernel for one specialisation; kind: of the clusters' trees, key of `TREES`."""
    return make_ray_kernel(config, TREES[kind], make_fuzzy_walk(config, kind))
