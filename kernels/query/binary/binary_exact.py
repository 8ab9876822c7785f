"""Closest hits of a batch of rays in float64 by persistent threads: `wrt.kernels.answers.exact_hit` in the walk of
`wrt.kernels.traversal.persistent`, on one level and on two."""

from functools import cache

import warp as wp

from wrt.kernels.layout.binary_nodes import BinaryNodes, BinaryPart, PackedTriangles
from wrt.kernels.layout.ray_batch import RayBatch
from wrt.kernels.query.exact_closest import ExactHits, ExactRays
from wrt.kernels.query.instance_exact import ExactGeometry
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import specialised_kernel
from wrt.kernels.traversal.persistent.next_ray import NextRay
from wrt.kernels.traversal.persistent.persistent_bvh import BLOCK, FETCH, KEEP, STEPS
from wrt.kernels.traversal.two_level.instance_single import InstanceTree

BLOCKS = 10
"""Blocks of a multiprocessor: arithmetic in float64 takes twice the registers of other queries."""


@wp.struct
class ExactInstances:
    """What instances are tested with in float64."""

    geometries: wp.array(dtype=ExactGeometry)
    center: wp.vec3d
    """Of the scene."""


def walk_snippet(space: str, places: int) -> str:
    """The walk of all rays on CUDA, and of ray i on the CPU, through a space of `persistent.h`; places: of the stack."""
    return f"""
        const auto own = wrt::wide_rays(rays, seen, exact.center);
        const auto walks = wrt::walks_of<{places}, wrt::WideAnswer, false, false, false>({space}, own, hits, hits, hits);
        wrt::walk_rays<{FETCH}, {KEEP}, {STEPS}, false>(walks, next.number.data, next.threads, i);
    """


@cache
def make_binary_exact_kernel(levels: int) -> wp.Kernel:
    """The kernel for a tree of two children a node; levels: greatest number of inner nodes on a path."""

    @native.func_native("persistent.h", walk_snippet("wrt::wide_tree(tree, triangles, exact.mesh)", levels + 1))
    def walk(
        tree: BinaryNodes,
        triangles: PackedTriangles,
        exact: ExactGeometry,
        seen: RayBatch,
        rays: ExactRays,
        hits: ExactHits,
        next: NextRay,
        i: int,
    ): ...

    def binary_exact_hits(
        first: int,
        tree: BinaryNodes,
        triangles: PackedTriangles,
        exact: ExactGeometry,
        seen: RayBatch,
        rays: ExactRays,
        hits: ExactHits,
        next: NextRay,
    ):
        walk(tree, triangles, exact, seen, rays, hits, next, first + wp.tid())

    return specialised_kernel(binary_exact_hits, bounds=(BLOCK, BLOCKS))


@cache
def make_binary_exact_instance_kernel(levels: int) -> wp.Kernel:
    """The same through instances; levels: of both levels."""
    space, places = "wrt::wide_instances(top, parts, exact.geometries)", 2 * levels + 2

    @native.func_native("persistent.h", walk_snippet(space, places))
    def walk(
        top: InstanceTree,
        parts: wp.array(dtype=BinaryPart),
        exact: ExactInstances,
        seen: RayBatch,
        rays: ExactRays,
        hits: ExactHits,
        next: NextRay,
        i: int,
    ): ...

    def binary_exact_instances(
        first: int,
        top: InstanceTree,
        parts: wp.array(dtype=BinaryPart),
        exact: ExactInstances,
        seen: RayBatch,
        rays: ExactRays,
        hits: ExactHits,
        next: NextRay,
    ):
        walk(top, parts, exact, seen, rays, hits, next, first + wp.tid())

    return specialised_kernel(binary_exact_instances, bounds=(BLOCK, BLOCKS))
