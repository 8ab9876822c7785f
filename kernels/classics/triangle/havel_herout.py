"""Havel and Herout 2010: three planes in space, no projection.

**Problem.** Wald's and Shevtsov's tests project onto a coordinate plane, so a triangle's record says which components of the
ray to use: a table look-up in scalar code, selects in vector code.

**Idea.** Stay in three dimensions. Besides the triangle's own plane, use two planes through its edges along the normal, whose
scaled distances are u and v directly. The division comes last, as in Shevtsov's test: everything is multiplied by the
determinant.

**Steps.**

1. Once per triangle: N = (b - a) x (c - a) and N . a; N_u = ((c - a) x N) / |N|^2 and N_v = (N x (b - a)) / |N|^2, with
   constants that make both 0 at a.
2. det = D . N, and t' = N . a - O . N, which is t times det.
3. P' = det O + t' D, the point times det; u' = P' . N_u + det n_u and v' likewise.
4. Exit: u', v' and det - u' - v' do not all have the sign of det. t, u and v are divided by det.

**Cost.** 36 operations up to the exit, 5 more for a hit.

**Data.** Three planes of four floats, 48 bytes. The test consists of dot products, for which the paper uses an SSE4
instruction. Here each lane has its own triangle or ray, so no instruction across lanes is needed.

**Departures.** The planes are computed in float64, then rounded. The triangle's own plane is scaled by a power of two, which
rounds nothing, so that the products stay in the range of float32 at any size. (Equation 2.14 in Rahikainen 2013 lacks
parentheses: the normal of the plane of u is ((c - a) x N) / |N|^2.) The caller compares t with the ray's range. The exits after
u and after v are joined into one, which is faster with lanes (notebooks/records/2026-11-21-triangle-tests.md).

**Limits.** The distances of the planes are measured from the centre of the scene and round accordingly: the test is less
precise than one that subtracts a vertex first. It is not watertight.

References: havel-herout-2010; rahikainen-2013.
"""

import warp as wp

from wrt.kernels.classics.triangle import shevtsov
from wrt.kernels.classics.triangle.published import published
from wrt.kernels.triangle.support.record_blocks import Corners, Record
from wrt.kernels.triangle.support.vectors import PlainRay, cross, dot, dotted, largest, names, scale_to_one, three

ThreePlanes = wp.types.vector(length=12, dtype=wp.float32)
"""Normals and constants of three planes: the triangle's, N . x = n; u = N_u . x + n_u; v = N_v . x + n_v."""


@wp.func
def derive(corners: Corners, origin: wp.vec3):
    """Planes of a triangle. A triangle without area has planes that are not finite."""
    a = wp.vec3d(corners.a)
    edge_b = wp.vec3d(corners.b) - a
    edge_c = wp.vec3d(corners.c) - a
    normal = cross(edge_b, edge_c)
    to_normal = scale_to_one(largest(normal))
    area = dot(normal, normal)
    across_b = cross(edge_c, normal)
    across_c = cross(normal, edge_b)
    planes = ThreePlanes()
    for axis in range(3):
        planes[axis] = float(normal[axis] * to_normal)
        planes[4 + axis] = float(across_b[axis] / area)
        planes[8 + axis] = float(across_c[axis] / area)
    planes[3] = float(dot(normal, a) * to_normal)
    planes[7] = float(-dot(across_b, a) / area)
    planes[11] = float(-dot(across_c, a) / area)
    return planes


@wp.func
def intersect(ray: PlainRay, planes: ThreePlanes):
    """One ray, one triangle: (t, u, v); t is NaN if the ray's line misses. u and v weigh the vertices b and c."""
    normal = three(planes, 0)
    det = dot(ray.direction, normal)
    ahead = planes[3] - dot(ray.origin, normal)
    point = det * ray.origin + ahead * ray.direction
    u = dot(point, three(planes, 4)) + det * planes[7]
    v = dot(point, three(planes, 8)) + det * planes[11]
    return shevtsov.divide(u, v, (det - u) - v, det, ahead)


TEST = published(
    "havel_herout",
    intersect,
    (
        "the line passes beside the triangle",
        f"""
            const float det = {dotted("d", "n")}, ahead = n0 - {dotted("o", "n")};
            const float px = det * ox + ahead * dx, py = det * oy + ahead * dy, pz = det * oz + ahead * dz;
            const float du = {dotted("p", "m")} + det * m0, dv = {dotted("p", "w")} + det * w0, dw = (det - du) - dv;
        """,
        shevtsov.SIGNS,
    ),
    shevtsov.DIVISION,
    record=Record(12, derive),
    names=(*names("n"), "n0", *names("m"), "m0", *names("w"), "w0"),
)
