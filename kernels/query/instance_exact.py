"""The closest hit in float64 through instances: rays are mapped to each geometry in float64, and rounded there.

`wrt.kernels.answers.exact_hit` explains how a float32 tree finds the hit of brute force in float64. On two levels the
exact ray is mapped in float64. Its rounding to float32 in the geometry's space, and that of the vertices there, are the ones
which the slack of the geometry's boxes covers. The boxes of instances have their slack for the rounding of the ray in the scene
(`wrt.kernels.traversal.two_level.instance_single`). The vertices are those that the caller gave. So the hit is that of brute
force in float64 over all instances, with rays that are mapped by the inverses of their transforms. A map of condition number c
costs the digits of c.
"""

from functools import cache

import warp as wp

from wrt.kernels.answers.answer_kind import BestHit, start
from wrt.kernels.answers.exact_hit import ExactSearch
from wrt.kernels.layout import bvh_nodes as bvh
from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.instance_maps import object_ray, ray_environment, ray_mask
from wrt.kernels.layout.ray_batch import Ray, RayBatch, is_direction, usable_direction
from wrt.kernels.layout.unchecked import load_int
from wrt.kernels.query.exact_closest import ExactHits, ExactMesh, ExactRays, rounded_ray, search_for, store_exact
from wrt.kernels.query.hit_attributes import SceneMesh, geometry_of
from wrt.kernels.runtime.options import exact_kernel, specialised_kernel
from wrt.kernels.simd.boxes import BoxRay
from wrt.kernels.traversal.leaf import Counters
from wrt.kernels.traversal.single.key_walk import make_key_walk
from wrt.kernels.traversal.single.walk_table import WALKS
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.traversal.two_level.instance_single import PARTS, InstanceTree, root_of, upper_slabs


@wp.struct
class ExactGeometry:
    """Triangles shared by instances, in float64, as the caller gave them."""

    mesh: ExactMesh
    center: wp.vec3d
    """What the geometry's tree is relative to."""


@cache
def exact_search(kind: str) -> type:
    """The struct of the search state that visits to instances need; kind: a key of `PARTS`."""

    class ExactInstanceSearch:
        top: InstanceTree
        parts: wp.array(dtype=PARTS[kind])
        geometries: wp.array(dtype=ExactGeometry)
        center: wp.vec3d
        ray: Ray
        mask: wp.uint32

    ExactInstanceSearch.__qualname__ = f"ExactInstanceSearch_{kind}"
    return wp.struct(ExactInstanceSearch)


@cache
def make_visit(config: TraversalConfig, kind: str) -> wp.Function:
    """`wp.func(tree, child, search, exact, i, best, work) -> best`: visits a leaf of the upper tree, for `make_key_walk`."""
    Search, walk, width = exact_search(kind), WALKS[kind][1](config), max(config.width, 2)

    @wp.func
    def visit(
        tree: WideNodes,
        child: int,
        search: wp.ref[Search],
        exact: wp.ref[ExactSearch],
        i: int,
        best: BestHit,
        work: wp.ref[Counters],
    ):
        placement = search.top.placements[load_int(search.top.order, bvh.first_block(child) * wp.static(width))]
        if (placement.mask & search.mask) != wp.uint32(0):
            shifted = exact.origin - search.center
            ray = object_ray(placement, shifted, search.ray, best.t)
            own = ExactSearch()
            own.direction = placement.to_object * exact.direction
            ray.direction = usable_direction(wp.vec3(own.direction))
            if ray.valid and is_direction(ray.direction):
                part = search.parts[placement.geometry]
                geometry = search.geometries[placement.geometry]
                own.origin = placement.to_object * (shifted - placement.origin) + geometry.center
                own.t_min = exact.t_min
                own.t = exact.t
                own.vertices = geometry.mesh.vertices
                own.faces = geometry.mesh.faces
                own.primitive = -1
                walk(part.tree, part.triangles, ray, own, i, work)
                primitive = placement.first + own.primitive
                nearer = own.t < exact.t or exact.primitive < 0 or primitive < exact.primitive
                if own.primitive >= 0 and nearer:
                    exact.t = own.t
                    exact.primitive = primitive
                    exact.u = own.u
                    exact.v = own.v
                    best.primitive = primitive
                    best.t = wp.min(best.t, wp.float32(own.t))
        return best

    return visit


@cache
def make_exact_instance_kernel(config: TraversalConfig, kind: str, levels: int) -> wp.Kernel:
    """The kernel for a config that asks for the closest hit in float64; arguments as in
    `wrt.kernels.traversal.two_level.instance_single.make_instance_kernel`."""
    Part, Search = PARTS[kind], exact_search(kind)
    walk_keys = make_key_walk(config, levels, Search, make_visit(config, kind))

    def exact_hits_instances(
        first: int,
        top: InstanceTree,
        parts: wp.array(dtype=Part),
        geometries: wp.array(dtype=ExactGeometry),
        center: wp.vec3d,
        seen: RayBatch,
        rays: ExactRays,
        hits: ExactHits,
    ):
        i = first + wp.tid()
        exact = search_for(rays, geometries[0].mesh, i)
        ray = rounded_ray(exact, center)
        root = root_of(top, ray_environment(seen, i))
        if ray.valid and root >= 0:
            search = Search()
            search.top = top
            search.parts = parts
            search.geometries = geometries
            search.center = center
            search.ray = ray
            search.mask = ray_mask(seen, i)
            slabs = upper_slabs(top, ray)
            work = Counters()
            walk_keys(top.tree, root, BoxRay(slabs, ray.t_min), search, exact, i, start(ray.t_max), work)
        store_exact(hits, i, exact)

    return specialised_kernel(exact_hits_instances)


@wp.struct
class ExactCorners:
    """A triangle in the scene, relative to its centre."""

    a: wp.vec3d
    b: wp.vec3d
    c: wp.vec3d
    winding: wp.float64
    """1, or -1 for a triangle that its instance mirrors."""


@wp.func
def exact_corners_of(scene: SceneMesh, geometries: wp.array(dtype=ExactGeometry), primitive: int):
    """Triangle number `primitive` of the scene."""
    placement = scene.placements[geometry_of(scene, primitive)]
    geometry = geometries[placement.geometry]
    face = geometry.mesh.faces[primitive - placement.first]
    corners = ExactCorners()
    corners.a = placement.to_scene * (geometry.mesh.vertices[face[0]] - geometry.center) + placement.origin
    corners.b = placement.to_scene * (geometry.mesh.vertices[face[1]] - geometry.center) + placement.origin
    corners.c = placement.to_scene * (geometry.mesh.vertices[face[2]] - geometry.center) + placement.origin
    corners.winding = wp.where(wp.determinant(placement.to_scene) < wp.float64(0.0), wp.float64(-1.0), wp.float64(1.0))
    return corners


@exact_kernel
def exact_positions(
    first: int,
    scene: SceneMesh,
    geometries: wp.array(dtype=ExactGeometry),
    primitive: wp.array(dtype=int),
    uv: wp.array(dtype=wp.vec2d),
    positions: wp.array(dtype=wp.vec3d),
):
    """Writes the point (1 - u - v) a + u b + v c of a hit; NaN for a miss. Item: a ray."""
    i = first + wp.tid()
    nan = wp.float64(wp.nan)
    point = wp.vec3d(nan, nan, nan)
    if primitive[i] >= 0:
        at = exact_corners_of(scene, geometries, primitive[i])
        point = scene.center + (at.a + (uv[i][0] * (at.b - at.a) + uv[i][1] * (at.c - at.a)))
    positions[i] = point


@exact_kernel
def exact_normals(
    first: int,
    scene: SceneMesh,
    geometries: wp.array(dtype=ExactGeometry),
    primitive: wp.array(dtype=int),
    normals: wp.array(dtype=wp.vec3d),
):
    """Writes the unit normal of the hit triangle, outward for mirrored instances, too; 0 for a miss and for a degenerate
    triangle. Item: a ray."""
    i = first + wp.tid()
    normal = wp.vec3d()
    if primitive[i] >= 0:
        at = exact_corners_of(scene, geometries, primitive[i])
        normal = at.winding * wp.normalize(wp.cross(at.b - at.a, at.c - at.a))
    normals[i] = normal
