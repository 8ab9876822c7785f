"""Closest hits of a batch of rays in float64: the single-ray walks with the test of
`wrt.kernels.answers.exact_hit`."""

from functools import cache

import warp as wp

from wrt.kernels.answers.exact_hit import ExactSearch
from wrt.kernels.layout.ray_batch import FARTHEST, HitBatch, checked_ray, store_hit
from wrt.kernels.runtime.options import exact_kernel, specialised_kernel
from wrt.kernels.traversal.leaf import Counters
from wrt.kernels.traversal.single.walk_table import WALKS
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks


@wp.struct
class ExactRays:
    """N rays in float64, as the caller gave them. A stride of 0 shares element 0 among all rays, 1 gives each ray its own."""

    origins: wp.array(dtype=wp.vec3d)
    directions: wp.array(dtype=wp.vec3d)
    t_min: wp.array(dtype=wp.float64)
    t_max: wp.array(dtype=wp.float64)
    origin_stride: int
    direction_stride: int
    t_min_stride: int
    t_max_stride: int


@wp.struct
class ExactMesh:
    """All triangles of a scene in float64, as the caller gave them."""

    vertices: wp.array(dtype=wp.vec3d)
    """In the caller's coordinates."""
    faces: wp.array(dtype=wp.vec3i)


@wp.struct
class ExactHits:
    """Hits of N rays."""

    rounded: HitBatch
    """The hits, rounded to float32."""
    t: wp.array(dtype=wp.float64)
    """inf for a miss."""
    uv: wp.array(dtype=wp.vec2d)
    """Weights of the triangle's second and third vertex; 0 for a miss."""


@wp.func
def search_for(rays: ExactRays, mesh: ExactMesh, i: int):
    """The initial search state of ray number `i`."""
    search = ExactSearch()
    search.origin = rays.origins[i * rays.origin_stride]
    search.direction = rays.directions[i * rays.direction_stride]
    search.t_min = rays.t_min[i * rays.t_min_stride]
    search.t = wp.min(rays.t_max[i * rays.t_max_stride], wp.float64(FARTHEST))
    search.vertices = mesh.vertices
    search.faces = mesh.faces
    search.primitive = -1
    return search


@wp.func
def rounded_ray(search: ExactSearch, center: wp.vec3d):
    """The ray of a search in float32, relative to the scene's centre."""
    origin, direction = wp.vec3(search.origin - center), wp.vec3(search.direction)
    ray = checked_ray(origin, direction, wp.float32(search.t_min), wp.float32(search.t))
    ray.valid = ray.valid and search.t_min >= wp.float64(0.0)
    return ray


@wp.func
def store_exact(hits: ExactHits, i: int, search: ExactSearch):
    """Stores the hit of ray i."""
    t = search.t
    if search.primitive < 0:
        t = wp.float64(wp.inf)
    hits.t[i] = t
    hits.uv[i] = wp.vec2d(search.u, search.v)
    store_hit(hits.rounded, i, wp.float32(t), search.primitive, wp.float32(search.u), wp.float32(search.v))


@cache
def make_exact_kernel(kind: str, config: TraversalConfig) -> wp.Kernel:
    """The kernel for a kind of tree (a key in `WALKS`) and a config that asks for the closest hit in float64."""
    Tree, make_walk = WALKS[kind]
    walk = make_walk(config)

    def exact_hits(
        first: int,
        tree: Tree,
        triangles: TriangleBlocks,
        mesh: ExactMesh,
        center: wp.vec3d,
        rays: ExactRays,
        hits: ExactHits,
    ):
        i = first + wp.tid()
        search = search_for(rays, mesh, i)
        ray = rounded_ray(search, center)
        if ray.valid:
            work = Counters()
            walk(tree, triangles, ray, search, i, work)
        store_exact(hits, i, search)

    return specialised_kernel(exact_hits)


@wp.func
def exact_corners(mesh: ExactMesh, primitive: int):
    """(3, 3) vertices of a triangle, one per row."""
    face = mesh.faces[primitive]
    return wp.matrix_from_rows(mesh.vertices[face[0]], mesh.vertices[face[1]], mesh.vertices[face[2]])


@exact_kernel
def exact_positions(
    first: int,
    mesh: ExactMesh,
    primitive: wp.array(dtype=int),
    uv: wp.array(dtype=wp.vec2d),
    positions: wp.array(dtype=wp.vec3d),
):
    """Writes the point (1 - u - v) a + u b + v c of a hit; NaN for a miss. Item: a ray."""
    i = first + wp.tid()
    nan = wp.float64(wp.nan)
    point = wp.vec3d(nan, nan, nan)
    if primitive[i] >= 0:
        corners = exact_corners(mesh, primitive[i])
        a = wp.vec3d(corners[0])
        point = a + (uv[i][0] * (wp.vec3d(corners[1]) - a) + uv[i][1] * (wp.vec3d(corners[2]) - a))
    positions[i] = point


@exact_kernel
def exact_normals(first: int, mesh: ExactMesh, primitive: wp.array(dtype=int), normals: wp.array(dtype=wp.vec3d)):
    """Writes the unit normal of the hit triangle by its winding; 0 for a miss and for a degenerate triangle. Item: a ray."""
    i = first + wp.tid()
    normal = wp.vec3d()
    if primitive[i] >= 0:
        corners = exact_corners(mesh, primitive[i])
        a = wp.vec3d(corners[0])
        normal = wp.normalize(wp.cross(wp.vec3d(corners[1]) - a, wp.vec3d(corners[2]) - a))
    normals[i] = normal
