"""Shevtsov, Soupikov and Kapustin 2007: Wald's projection, Pluecker's inside test, the division last.

**Problem.** Wald's test divides before it knows whether the triangle is hit. Most triangles are not.

**Idea.** Multiply everything by the determinant, the rate at which the ray approaches the plane. The point at which the ray
meets the plane, relative to a vertex and times the determinant, is a sum of products, and so are the barycentric coordinates
times the determinant. The ray hits if these and the remainder of the determinant have the same sign: Pluecker's condition. Only
a hit divides.

**Steps**, in the coordinates k (the normal's main axis), p and q:

1. det = d_k + n_p d_p + n_q d_q, and t' = n - (o_k + n_p o_p + n_q o_q), which is t times det.
2. D_p = t' d_p - det (a_p - o_p) and D_q likewise: the point relative to vertex a, times det.
3. u' = c_q D_p - c_p D_q and v' = b_p D_q - b_q D_p. Exit: u', v' and det - u' - v' do not all have the sign of det.
4. t, u and v are divided by det.

**Cost.** 25 operations up to the exit, 5 more for a hit.

**Data.** Ten floats, 40 bytes: the two other components of the normal over its main one, and the plane's distance over the
same; two coordinates of a vertex; two of each of two edges, over the normal's main component; the axis.

**Departures.** The paper's flag for triangles perpendicular to an axis, whose plane is simpler, is omitted: it saves nothing in
scenes (`wrt.kernels.classics.studies.variants.axis_flag`). The equations are those printed as (2.13) in Rahikainen 2013, and
they are correct. The record is computed in float64, then rounded.

**Limits.** All lanes divide at once, so dividing last saves nothing with lanes; a single step is faster
(notebooks/records/2026-11-21-triangle-tests.md). The inside test is relative to a vertex, which is precise. t is less precise,
because the plane's distance is measured from the centre of the scene. The test is not watertight.

References: shevtsov-2007-triangle; rahikainen-2013.
"""

import warp as wp

from wrt.kernels.classics.triangle.published import FINITE, published
from wrt.kernels.triangle.support.axis_projection import main_axis, next_axis, permuted, permuted_lanes
from wrt.kernels.triangle.support.record_blocks import Corners, Record
from wrt.kernels.triangle.support.vectors import PlainRay, cross, miss

FlatTriangle = wp.types.vector(length=10, dtype=wp.float32)
"""k; n_p, n_q, n: the plane x_k + n_p x_p + n_q x_q = n; a_p, a_q of vertex a; b_p, b_q of the edge b - a and c_p, c_q of the
edge c - a, both over the normal's component k."""


@wp.func
def derive(corners: Corners, origin: wp.vec3):
    """Record of a triangle. A triangle without area has components that are not finite."""
    a = wp.vec3d(corners.a)
    edge_b = wp.vec3d(corners.b) - a
    edge_c = wp.vec3d(corners.c) - a
    normal = cross(edge_b, edge_c)
    k = main_axis(normal)
    p = next_axis(k)
    q = next_axis(p)
    flat = FlatTriangle()
    flat[0] = float(k)
    flat[1] = float(normal[p] / normal[k])
    flat[2] = float(normal[q] / normal[k])
    flat[3] = float(a[k] + (normal[p] * a[p] + normal[q] * a[q]) / normal[k]) + 0.0  # + 0.0 turns -0 into 0
    flat[4] = corners.a[p]
    flat[5] = corners.a[q]
    flat[6] = float(edge_b[p] / normal[k])
    flat[7] = float(edge_b[q] / normal[k])
    flat[8] = float(edge_c[p] / normal[k])
    flat[9] = float(edge_c[q] / normal[k])
    return flat


@wp.func
def divide(u: float, v: float, w: float, det: float, ahead: float):
    """(t, u, v) from these numbers times det; t is NaN if u, v and w do not have the sign of det, or t is not finite."""
    if not ((u >= 0.0 and v >= 0.0 and w >= 0.0 and det > 0.0) or (u <= 0.0 and v <= 0.0 and w <= 0.0 and det < 0.0)):
        return miss()
    scale = 1.0 / det
    t = ahead * scale
    if t - t != 0.0:
        return miss()
    return wp.vec3(t, u * scale, v * scale)


@wp.func
def weigh(flat: FlatTriangle, o: wp.vec3, d: wp.vec3, det: float, ahead: float):
    """(t, u, v) of a permuted ray, with t = ahead / det; t is NaN if the line misses the triangle or is parallel to it."""
    x = ahead * d[1] - det * (flat[4] - o[1])
    y = ahead * d[2] - det * (flat[5] - o[2])
    u = flat[9] * x - flat[8] * y
    v = flat[6] * y - flat[7] * x
    return divide(u, v, det - (u + v), det, ahead)


@wp.func
def intersect(ray: PlainRay, flat: FlatTriangle):
    """One ray, one triangle: (t, u, v); t is NaN if the ray's line misses. u and v weigh the vertices b and c."""
    o = permuted(ray.origin, int(flat[0]))
    d = permuted(ray.direction, int(flat[0]))
    det = (d[0] + flat[1] * d[1]) + flat[2] * d[2]
    ahead = flat[3] - ((o[0] + flat[1] * o[1]) + flat[2] * o[2])
    return weigh(flat, o, d, det, ahead)


WEIGHTS = """
    const float x = ahead * dp - det * (ap - op), y = ahead * dq - det * (aq - oq);
    const float du = cq * x - cp * y, dv = bp * y - bq * x, dw = det - (du + dv);
"""
"""The first steps of `weigh` in C++."""

WEIGHTS = """
    const float x = ahead * dp - det * (ap - op), y = ahead * dq - det * (aq - oq);
    const float du = cq * x - cp * y, dv = bp * y - bq * x, dw = det - (du + dv);
"""
"""C++ for `weigh` up to the exit."""

SIGNS = (
    "((du >= 0.0f) & (dv >= 0.0f) & (dw >= 0.0f) & (det > 0.0f)) | ((du <= 0.0f) & (dv <= 0.0f) & (dw <= 0.0f) & (det < 0.0f))"
)
DIVISION = (
    "the line is parallel to the triangle",
    "const float scale = 1.0f / det, t = ahead * scale, u = du * scale, v = dv * scale;",
    FINITE,
)
"""C++ for `divide`."""

TEST = published(
    "shevtsov",
    intersect,
    (
        "the line passes beside the triangle",
        f"""
            {permuted_lanes("o")}{permuted_lanes("d")}
            const float det = (dk + np * dp) + nq * dq, ahead = n0 - ((ok + np * op) + nq * oq);
            {WEIGHTS}
        """,
        SIGNS,
    ),
    DIVISION,
    record=Record(10, derive),
    names=("axis", "np", "nq", "n0", "ap", "aq", "bp", "bq", "cp", "cq"),
)
