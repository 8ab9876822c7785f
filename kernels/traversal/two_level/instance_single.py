"""Two-level traversal, one ray at a time: a tree of instances above the trees of their geometries.

The upper tree is a wide BVH over the boxes of the instances in the scene, one instance per leaf. It has a root for each
environment (`wrt.builders.bvh.instance_forest`), at which the rays of that environment start.
`wrt.kernels.traversal.single.key_walk` walks it like any other: nearest box first, and nothing beyond the best hit. At a leaf
the ray is transformed to the geometry's space (`wrt.kernels.layout.instance_maps`), and the geometry's own tree, of either
kind, is walked by the same function as in a scene of one mesh, with t_max at the best hit so far.

**The consistency rule on two levels.** A hit counts if the transformed ray meets the triangle's widened box
(`wrt.kernels.simd.boxes`), whose slack is a fraction of the reach in the geometry's space. In the scene the map stretches that
slack by at most the product of the norms of the map and of its inverse, where the norm is the greatest row sum of absolute
values. Twice that fraction of the reach in the scene (the factor 2 leaves room for the rounding of the transformed ray and of
the instance's box) is the slack of the upper tree's boxes, for the worst of all instances (`InstanceTree.slack_scale`). No
instance is therefore skipped, or entered too late, if its own tree finds a hit: the result is that of visiting every instance
in turn.

References: rubin-whitted-1980 (a hierarchy of spaces, rays transformed on the way down); wald-2003 (two levels of trees, of
    which only the upper is rebuilt).
"""

from functools import cache

import warp as wp

from wrt.kernels.answers.answer_kind import BestHit, start
from wrt.kernels.layout import bvh_nodes as bvh
from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.instance_maps import Placement, SceneRay, object_ray
from wrt.kernels.layout.kdtree_nodes import KdNodes
from wrt.kernels.layout.ray_batch import Ray
from wrt.kernels.layout.unchecked import load_int
from wrt.kernels.simd.boxes import BoxRay, ray_slabs, reach
from wrt.kernels.traversal.leaf import Counters
from wrt.kernels.traversal.single.key_walk import make_key_walk
from wrt.kernels.traversal.single.single_kernel import make_ray_kernel
from wrt.kernels.traversal.single.walk_table import WALKS
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks


@wp.struct
class InstanceTree:
    """The upper level."""

    tree: WideNodes
    """Boxes relative to the scene's centre; one instance per leaf."""
    order: wp.array(dtype=int)
    """(leaves * width,) instance of each leaf, at the first element of its block."""
    placements: wp.array(dtype=Placement)
    slack_scale: float
    """Factor of a ray's reach for the slack of the boxes."""
    extent: wp.array(dtype=float)
    """(7,) in place of the lowest and highest corner of all boxes and of `slack_scale`, if a graph updates them; else empty."""
    root: int
    """Node above all instances."""
    shared_root: int
    """Node above the instances of all environments; -1 if there are none."""
    environments: wp.array(dtype=int)
    """(E,) numbers of the environments with instances of their own, ascending."""
    roots: wp.array(dtype=int)
    """(E,) node above the instances that rays of each environment see."""
    lists: wp.array(dtype=int)
    """(E + 1,) `InstanceForest.lists`; empty if there are none."""


@wp.struct
class BvhPart:
    """A geometry with a BVH: tree and triangles."""

    tree: WideNodes
    triangles: TriangleBlocks


@wp.struct
class KdTreePart:
    """A geometry with a kd-tree: tree and triangles."""

    tree: KdNodes
    triangles: TriangleBlocks


PARTS = {"bvh": BvhPart, "kdtree": KdTreePart}
"""Struct of a geometry for each tree kind."""


@wp.func
def upper_slabs(top: InstanceTree, ray: Ray):
    """Prepares a ray of the scene for tests of the upper tree's boxes."""
    low = top.tree.low
    high = top.tree.high
    scale = top.slack_scale
    if top.extent.shape[0] > 0:
        low = wp.vec3(top.extent[0], top.extent[1], top.extent[2])
        high = wp.vec3(top.extent[3], top.extent[4], top.extent[5])
        scale = top.extent[6]
    return ray_slabs(ray.origin, ray.direction, scale * reach(ray.origin, low, high))


@wp.func
def root_of(top: InstanceTree, environment: int):
    """The node at which rays of an environment start; -1 if they see no instance."""
    root = top.root
    if environment >= 0:
        root = top.shared_root
        low = int(0)
        high = top.environments.shape[0]
        if environment < high and load_int(top.environments, environment) == environment:  # as where none is left out
            return load_int(top.roots, environment)
        while high - low > 1:
            middle = (low + high) / 2
            if load_int(top.environments, middle) <= environment:
                low = middle
            else:
                high = middle
        if high > low and load_int(top.environments, low) == environment:
            root = load_int(top.roots, low)
    return root


@cache
def join_answers(config: TraversalConfig) -> wp.Function:
    """`wp.func(first, found, t_min, hits, i, best) -> best`: joins what a walk found in an instance, whose triangles are
    numbered from `first` on, and what was found before."""
    answer = config.answer
    join, renumber = answer.instances.join, answer.instances.renumber
    lists, Results = bool(answer.stored.listed), answer.search.State

    @wp.func
    def join_found(first: int, found: BestHit, t_min: float, hits: wp.ref[Results], i: int, best: BestHit):
        if wp.static(lists):
            renumber(hits, i, found.primitive + 1, first)
        return join(found, first, t_min, best)

    return join_found


@cache
def instance_search(kind: str) -> type:
    """The struct of the search state that visits to instances need; kind: tree kind of the geometries, a key of `PARTS`."""

    class InstanceSearch:
        top: InstanceTree
        parts: wp.array(dtype=PARTS[kind])
        seen: SceneRay

    InstanceSearch.__qualname__ = f"InstanceSearch_{kind}"
    return wp.struct(InstanceSearch)


@cache
def make_visit(config: TraversalConfig, kind: str) -> wp.Function:
    """`wp.func(tree, child, search, hits, i, best, work) -> best`: visits a leaf of the upper tree, for `make_key_walk`."""
    InstanceSearch, walk, join = instance_search(kind), WALKS[kind][1](config), join_answers(config)
    width = max(config.width, 2)  # children per node of the upper tree
    within, Results = config.answer.instances.within, config.answer.search.State
    numbered = within is not None

    @wp.func
    def visit(
        tree: WideNodes,
        child: int,
        search: wp.ref[InstanceSearch],
        hits: wp.ref[Results],
        i: int,
        best: BestHit,
        work: wp.ref[Counters],
    ):
        placement = search.top.placements[load_int(search.top.order, bvh.first_block(child) * wp.static(width))]
        if (placement.mask & search.seen.mask) != wp.uint32(0):
            object_space_ray = object_ray(placement, search.seen.origin, search.seen.ray, best.t)
            if object_space_ray.valid:
                part = search.parts[placement.geometry]
                if wp.static(numbered):
                    own = within(placement.first, hits)
                    found = walk(part.tree, part.triangles, object_space_ray, own, i, work)
                    best = join(placement.first, found, search.seen.ray.t_min, hits, i, best)
                else:
                    found = walk(part.tree, part.triangles, object_space_ray, hits, i, work)
                    best = join(placement.first, found, search.seen.ray.t_min, hits, i, best)
        return best

    return visit


@cache
def make_instance_walk(config: TraversalConfig, kind: str, levels: int) -> wp.Function:
    """`wp.func(top, parts, seen, hits, i, work) -> best` for a valid ray, `SceneRay`.

    Args:
        config: the specialisation of the walks through geometries.
        kind: tree kind of the geometries, a key of `PARTS`.
        levels: greatest number of inner nodes on a path of the upper tree.
    """
    Part, InstanceSearch, Results = PARTS[kind], instance_search(kind), config.answer.search.State
    walk_keys = make_key_walk(config, levels, InstanceSearch, make_visit(config, kind))

    @wp.func
    def walk_instances(
        top: InstanceTree,
        parts: wp.array(dtype=Part),
        seen: SceneRay,
        hits: wp.ref[Results],
        i: int,
        work: wp.ref[Counters],
    ):
        ray = seen.ray
        best = start(ray.t_max)
        root = root_of(top, seen.environment)
        if root < 0:
            return best
        slabs = upper_slabs(top, ray)
        search = InstanceSearch()
        search.top = top
        search.parts = parts
        search.seen = seen
        return walk_keys(top.tree, root, BoxRay(slabs, ray.t_min), search, hits, i, best, work)

    return walk_instances


@cache
def make_instance_kernel(config: TraversalConfig, kind: str, levels: int) -> wp.Kernel:
    """The kernel for one specialisation; arguments as in `make_instance_walk`."""
    return make_ray_kernel(config, InstanceTree, make_instance_walk(config, kind, levels), wp.array(dtype=PARTS[kind]))
