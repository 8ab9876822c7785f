"""The closest point of a given triangle, as a kernel that Warp can differentiate.

**Problem.** Which triangle is nearest to a point, and what of it is nearest, are step functions of the point and the vertices.

**Idea.** Both are held fixed. The closest point is then smooth: the foot of the perpendicular on a plane, the foot on the line
of an edge, or a vertex. All arithmetic is float64, and Warp derives the adjoint. It accumulates gradients of shared vertices
with atomics; on the CPU these are only correct on one thread.

**Limits.** The derivative of the distance is right wherever there is one. Where two triangles are at the same distance, that of
the chosen one is given, and 0 at a distance of 0. Derivatives of positions jump where the feature changes.
"""

from functools import cache

import warp as wp

from wrt.kernels.query.hit_gradients import result_types
from wrt.kernels.runtime.options import specialised_kernel


@wp.func
def foot_on_line(p: wp.vec3d, q: wp.vec3d, r: wp.vec3d):
    """The point of the line through q and r that is nearest to p."""
    e = r - q
    return q + (wp.dot(p - q, e) / wp.dot(e, e)) * e


@wp.func
def closest_on(p: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, uv: wp.vec2, feature: int):
    """The closest point of a triangle, on the plane, line or vertex that weights and feature say."""
    if feature == 2:
        n = wp.cross(b - a, c - a)
        return p - (wp.dot(n, p - a) / wp.dot(n, n)) * n
    if feature == 1:
        if uv[1] == 0.0:
            return foot_on_line(p, a, b)
        if uv[0] == 0.0:
            return foot_on_line(p, a, c)
        return foot_on_line(p, b, c)
    if uv[0] == 1.0:
        return b
    if uv[1] == 1.0:
        return c
    return a


@cache
def make_point_gradient_kernel(Point: type, Vertex: type, double: bool) -> wp.Kernel:
    """The kernel for arrays of these types, each vec3 or vec3d; `double`: whether the results are float64.

    Item: one of `per` triangles of a point. Results of points that found nothing are not written.
    """
    Scalar, _, Vector = result_types(double)

    def closest_on_triangles(
        points: wp.array(dtype=Point),
        per: int,
        vertices: wp.array(dtype=Vertex),
        faces: wp.array(dtype=wp.vec3i),
        primitive: wp.array(dtype=int),
        uv: wp.array(dtype=wp.vec2),
        feature: wp.array(dtype=wp.int8),
        distances: wp.array(dtype=Scalar),
        positions: wp.array(dtype=Vector),
    ):
        i = wp.tid()
        if primitive[i] >= 0:
            face = faces[primitive[i]]
            a = wp.vec3d(vertices[face[0]])
            b = wp.vec3d(vertices[face[1]])
            c = wp.vec3d(vertices[face[2]])
            point = wp.vec3d(points[i / per])
            at = closest_on(point, a, b, c, uv[i], int(feature[i]))
            apart = point - at
            square = wp.dot(apart, apart)
            positions[i] = Vector(at)
            if square > wp.float64(0.0):
                distances[i] = Scalar(wp.sqrt(square))
            else:
                distances[i] = Scalar(0.0)

    return specialised_kernel(closest_on_triangles, gradients=True)
