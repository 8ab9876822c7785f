"""Intersection of a ray with the plane of a given triangle, as a kernel that Warp can differentiate.

**Problem.** The index of the first triangle that a ray hits is a step function of ray and vertices and has no useful
derivative. For a fixed triangle, the point of intersection is a smooth function of both. Gradient descent on measured ranges,
poses and shapes needs its derivatives.

**Idea.** The search is unchanged. The triangles that it finds are intersected once more by the formulas of Moeller and
Trumbore, which are short, and smooth as long as the ray is not in the plane:

    e1 = b - a, e2 = c - a, s = o - a, det = e1 . (d x e2),
    u = s . (d x e2) / det, v = d . (s x e1) / det, t = e2 . (s x e1) / det,
    position = o + t d, normal = (e1 x e2) / |e1 x e2|.

All arithmetic is float64, whatever the type of the arrays, so points far from the origin keep their precision. Warp derives the
adjoint. It accumulates gradients of shared inputs (vertices, a shared origin) with atomics; on the CPU these are only correct
on one thread.

**Limits.** The triangle is held fixed, so the derivatives do not include silhouettes: changes that arise because a ray moves
from one surface to another are missing. The derivatives grow as 1 / sine of the angle between ray and plane, like t itself.

References: moeller-trumbore-1997; li-2018 (for the part that is omitted here).
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime.options import specialised_kernel


def result_types(double: bool) -> tuple[type, type, type]:
    """Types of t, of uv, and of positions and normals; `double`: whether the results are float64."""
    return (wp.float64, wp.vec2d, wp.vec3d) if double else (wp.float32, wp.vec2, wp.vec3)


@wp.struct
class Edges:
    """A vertex of a triangle, and the edges there."""

    a: wp.vec3d
    edge1: wp.vec3d
    edge2: wp.vec3d
    winding: wp.float64
    """1, or -1 to turn the normal."""


@cache
def store_hit(double: bool) -> wp.Function:
    """`wp.func(i, origin, direction, triangle, t, uv, positions, normals)`: stores where ray i meets the plane of a triangle;
    nothing for a ray in that plane."""
    Scalar, Pair, Vector = result_types(double)

    @wp.func
    def store(
        i: int,
        origin: wp.vec3d,
        direction: wp.vec3d,
        triangle: Edges,
        t: wp.array(dtype=Scalar),
        uv: wp.array(dtype=Pair),
        positions: wp.array(dtype=Vector),
        normals: wp.array(dtype=Vector),
    ):
        edge1 = triangle.edge1
        edge2 = triangle.edge2
        across = wp.cross(direction, edge2)
        det = wp.dot(edge1, across)
        if det != wp.float64(0.0):
            s = origin - triangle.a
            q = wp.cross(s, edge1)
            at = wp.dot(edge2, q) / det
            t[i] = Scalar(at)
            uv[i] = Pair(Scalar(wp.dot(s, across) / det), Scalar(wp.dot(direction, q) / det))
            positions[i] = Vector(origin + at * direction)
            normals[i] = Vector(triangle.winding * wp.normalize(wp.cross(edge1, edge2)))

    return store


@cache
def make_gradient_kernel(Origin: type, Direction: type, Vertex: type, double: bool) -> wp.Kernel:
    """The kernel for arrays of these types, each vec3 or vec3d; `double`: whether the results are float64.

    A stride of 0 shares element 0 among all rays. The kernel does not write the results of rays that hit nothing.
    """
    Scalar, Pair, Vector = result_types(double)
    store = store_hit(double)

    def intersect_triangles(
        origins: wp.array(dtype=Origin),
        origin_stride: int,
        directions: wp.array(dtype=Direction),
        direction_stride: int,
        vertices: wp.array(dtype=Vertex),
        faces: wp.array(dtype=wp.vec3i),
        primitive: wp.array(dtype=int),
        t: wp.array(dtype=Scalar),
        uv: wp.array(dtype=Pair),
        positions: wp.array(dtype=Vector),
        normals: wp.array(dtype=Vector),
    ):
        i = wp.tid()
        if primitive[i] >= 0:
            face = faces[primitive[i]]
            triangle = Edges()
            triangle.a = wp.vec3d(vertices[face[0]])
            triangle.edge1 = wp.vec3d(vertices[face[1]]) - triangle.a
            triangle.edge2 = wp.vec3d(vertices[face[2]]) - triangle.a
            triangle.winding = wp.float64(1.0)
            origin = wp.vec3d(origins[i * origin_stride])
            direction = wp.vec3d(directions[i * direction_stride])
            store(i, origin, direction, triangle, t, uv, positions, normals)

    return specialised_kernel(intersect_triangles, gradients=True)
