"""A tree of fuzzy boxes: clusters of triangles that move nearly as one, each with a tree in a space that moves along.

**Idea (Guenther et al. 2006).** What a cluster does is an affine motion that its triangles share, and a rest. In the space that
the affine maps carry along, the rest is small: boxes around all that a triangle does there in all frames, fuzzy boxes, hold a
tree that is built once. A frame is a map for each cluster, and where the triangles are. A ray is brought into the cluster's
space to walk its tree.

**What we changed.** Triangles are not brought there: a leaf is tested in the scene, with the ray as it is. So the hits are
those of any other tree over the frame's triangles, to the bit, and neighbours in different clusters have no crack between them.

**Why none is lost.** A fuzzy box encloses the image of the box of its triangle in the scene, not of the triangle alone. Boxes
in the scene are widened by a slack (`wrt.kernels.boxes`), a share of the reach there; its image is at most the slack times the
greatest sum of a row's absolute values of the map (`Cluster.stretch`). Boxes in the cluster's space are widened by that and,
as anywhere, by the same share of the reach in there, which covers the rounding of the ray on its way. So the boxes on the way
to a triangle are entered no later than the triangle's own, and what a walk skips lies beyond its best hit.

The upper tree, over the boxes of the clusters in the scene, and the trees below share one row of keys a level, as in
`wrt.kernels.traversal.single_bvh`.

References:
    J. Guenther, H. Friedrich, I. Wald, H.-P. Seidel, P. Slusallek: Ray tracing animated scenes using motion decomposition.
        Computer Graphics Forum 25(3) (Eurographics 2006).
    J. Guenther, H. Friedrich, H.-P. Seidel, P. Slusallek: Interactive ray tracing of skinned animations. The Visual Computer
        22(9), 2006.
"""

from functools import cache

import warp as wp

from wrt.kernels import bvh
from wrt.kernels.box_lanes import NO_CHILD, entry_of, nearest_child, ray_boxes
from wrt.kernels.boxes import RaySlabs, ray_slabs, reach
from wrt.kernels.bvh import WideNodes
from wrt.kernels.memory import load_int, store_int
from wrt.kernels.rays import HitBatch, Ray, RayBatch, load_ray
from wrt.kernels.traversal.config import ANY, TraversalConfig
from wrt.kernels.traversal.leaf import Counters, start, store_best
from wrt.kernels.traversal.single_bvh import make_leaf
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.records import TriangleBlocks

wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@wp.struct
class Cluster:
    """Where a cluster's space is in a frame."""

    to_own: wp.mat33d
    """A point p relative to the scene's centre goes to to_own (p - origin)."""
    origin: wp.vec3d
    stretch: float
    """Greatest sum of a row's absolute values of `to_own`."""
    root: int
    """Its tree's in the nodes of all clusters."""
    low: wp.vec3
    """Its tree's box, in its own space."""
    high: wp.vec3


@wp.struct
class FuzzyNodes:
    """The trees of a frame."""

    top: WideNodes
    """Boxes of the clusters relative to the scene's centre; a leaf has one."""
    order: wp.array(dtype=int)
    """(leaves * width,) the cluster of each leaf, first of its block."""
    clusters: wp.array(dtype=Cluster)
    parts: WideNodes
    """Trees of all clusters, each in its own space."""


@wp.func
def own_slabs(cluster: Cluster, ray: Ray, far: float):
    """The ray in a cluster's space, for tests of its fuzzy boxes; far: the reach in the scene."""
    origin = wp.vec3(cluster.to_own * (wp.vec3d(ray.origin) - cluster.origin))
    direction = wp.vec3(cluster.to_own * wp.vec3d(ray.direction))
    return ray_slabs(origin, direction, reach(origin, cluster.low, cluster.high) + cluster.stretch * far)


@cache
def make_walk(config: TraversalConfig) -> wp.Function:
    """`wp.func(tree, triangles, ray, hits, i, work) -> best` for ray number i, a valid one."""
    prepare = TRIANGLE_TESTS[config.triangle_test].prepare
    test_leaf, test_boxes, nearest = make_leaf(config), ray_boxes(config.width), nearest_child(config.width)
    width, counting, any_hit = config.width, config.counters, config.query == ANY
    levels, row = config.levels, config.levels * config.width

    @wp.func
    def walk(tree: FuzzyNodes, triangles: TriangleBlocks, ray: Ray, hits: wp.ref[HitBatch], i: int, work: wp.ref[Counters]):
        best = start(ray.t_max)
        far = reach(ray.origin, tree.top.low, tree.top.high)
        slabs = ray_slabs(ray.origin, ray.direction, far)
        own = RaySlabs()
        state = prepare(ray.origin, ray.direction)
        keys = wp.zeros(shape=(row,), dtype=int)
        path = wp.zeros(shape=(levels,), dtype=int)
        level = int(0)
        entered = int(-1)  # level of the root of the cluster that the walk is in
        key = test_boxes(tree.top.bounds, 0, slabs, ray.t_min, best.t, keys, 0)
        if wp.static(counting):
            work.nodes += 1
            work.boxes += wp.static(width)
        while level >= 0:
            if entry_of(key, wp.static(width)) <= best.t:
                lane = key & wp.static(width - 1)
                store_int(keys, level * wp.static(width) + lane, NO_CHILD)
                at = load_int(path, level) * wp.static(width) + lane
                child = int(0)
                if entered >= 0:
                    child = load_int(tree.parts.child, at)
                else:
                    child = load_int(tree.top.child, at)
                    if child < 0:
                        cluster = tree.clusters[load_int(tree.order, bvh.first_block(child) * wp.static(width))]
                        own = own_slabs(cluster, ray, far)
                        child = cluster.root
                        entered = level + 1
                if child >= 0:
                    level += 1
                    store_int(path, level, child)
                    if entered >= 0:
                        key = test_boxes(tree.parts.bounds, child, own, ray.t_min, best.t, keys, level * wp.static(width))
                    else:
                        key = test_boxes(tree.top.bounds, child, slabs, ray.t_min, best.t, keys, level * wp.static(width))
                    if wp.static(counting):
                        work.nodes += 1
                        work.boxes += wp.static(width)
                else:
                    best = test_leaf(tree.parts, triangles, child, state, slabs, ray.t_min, hits, i, best, work)
                    key = nearest(keys, level * wp.static(width))
                    if wp.static(any_hit):
                        level = wp.where(best.primitive < 0, level, -1)
            else:
                level -= 1
                if level < entered:
                    entered = -1
                if level >= 0:
                    key = nearest(keys, level * wp.static(width))
        return best

    return walk


@cache
def make_kernel(config: TraversalConfig) -> wp.Kernel:
    """The kernel for one specialisation."""
    walk, store, counting = make_walk(config), store_best(config), config.counters

    def single_ray_fuzzy(
        first: int,
        tree: FuzzyNodes,
        triangles: TriangleBlocks,
        rays: RayBatch,
        hits: HitBatch,
        counters: wp.array(dtype=Counters),
    ):
        i = first + wp.tid()
        ray = load_ray(rays, i)
        best = start(ray.t_max)
        work = Counters()
        if ray.valid:
            best = walk(tree, triangles, ray, hits, i, work)
        store(hits, i, best)
        if wp.static(counting):
            counters[i] = work

    return wp.kernel(single_ray_fuzzy, module="unique", enable_backward=False, module_options={"fuse_fp": False})
