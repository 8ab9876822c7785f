"""Closest hits of a batch of rays in float64 by persistent threads: `wrt.kernels.answers.exact_hit` in the walk of
`wrt.kernels.traversal.persistent`, on one level and on two."""

from functools import cache
from typing import Any

import warp as wp

from wrt.kernels.layout.binary_nodes import BinaryNodes, BinaryPart, PackedTriangles
from wrt.kernels.layout.ray_batch import RayBatch
from wrt.kernels.query.exact_closest import ExactHits, ExactRays
from wrt.kernels.query.instance_exact import ExactGeometry
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import specialised_kernel
from wrt.kernels.traversal.persistent.next_ray import NextRay
from wrt.kernels.traversal.persistent.persistent_bvh import BLOCK, FETCH, KEEP, STEPS, upper_places
from wrt.kernels.traversal.two_level.instance_single import InstanceTree

BLOCKS = 10
"""Blocks of a multiprocessor: arithmetic in float64 takes twice the registers of other queries."""


@wp.struct
class ExactInstances:
    """What instances are tested with in float64."""

    geometries: wp.array(dtype=ExactGeometry)
    center: wp.vec3d
    """Of the scene."""


@cache
def make_binary_exact_kernel(levels: int) -> wp.Kernel:
    """The kernel for a tree of two children a node; levels: greatest number of inner nodes on a path."""
    space = "wrt::wide_tree(tree, triangles, exact.mesh)"
    return make_exact_kernel((BinaryNodes, PackedTriangles, ExactGeometry), space, levels + 1)


@cache
def make_binary_exact_instance_kernel(levels: int) -> wp.Kernel:
    """The same through instances; levels: of both levels."""
    space = "wrt::wide_instances(tree, triangles, exact.geometries)"
    return make_exact_kernel((InstanceTree, wp.array(dtype=BinaryPart), ExactInstances), space, levels + upper_places(levels))


def make_exact_kernel(types: tuple[Any, Any, type], space: str, places: int) -> wp.Kernel:
    """The kernel for a space of `persistent.h`, of `tree`, `triangles` and `exact`; types: theirs; places: of the stack."""
    Tree, Triangles, Exact = types
    snippet = f"""
        const auto own = wrt::wide_rays(rays, seen, exact.center);
        const auto walks = wrt::walks_of<{places}, wrt::WideAnswer, false, false, false>({space}, own, hits, hits, hits);
        wrt::walk_rays<{FETCH}, {KEEP}, {STEPS}, false>(walks, next.number.data, next.threads, i);
    """

    @native.func_native("persistent.h", snippet)
    def walk(
        tree: Tree,
        triangles: Triangles,
        exact: Exact,
        seen: RayBatch,
        rays: ExactRays,
        hits: ExactHits,
        next: NextRay,
        i: int,
    ): ...

    def binary_exact_hits(
        first: int,
        tree: Tree,
        triangles: Triangles,
        exact: Exact,
        seen: RayBatch,
        rays: ExactRays,
        hits: ExactHits,
        next: NextRay,
    ):
        walk(tree, triangles, exact, seen, rays, hits, next, first + wp.tid())

    return specialised_kernel(binary_exact_hits, bounds=(BLOCK, BLOCKS))
