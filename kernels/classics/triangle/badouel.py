"""Badouel 1990: intersect the plane, then test the point in the projected triangle.

**Problem.** The barycentric coordinates of a point in space are two unknowns in three equations.

**Idea.** Intersect the plane first. Then drop one coordinate, that of the normal's largest component. The projection along it
keeps most of the triangle's area and preserves barycentric coordinates, and leaves two equations for two unknowns.

**Steps.**

1. N = (b - a) x (c - a), and t = -N . (o - a) / N . D: the plane.
2. The axis of the largest of |N_x|, |N_y|, |N_z| is left out; p and q are the other two.
3. h = (o - a) + t D, of which p and q are needed: the point. Cramer's rule gives u and v, whose determinant is N's component.
4. u >= 0, v >= 0, u + v <= 1.

**Cost.** 43 operations, three of them divisions, all before the only exit.

**Data.** The three vertices. The normal and its main axis are computed for every ray. Wald's test (`wrt.kernels.triangle.wald`)
is the same test with these values precomputed.

**Departures.** The caller compares t with the ray's range, which is the published test's first exit. The point is taken
relative to vertex a from the start, so that its rounding does not grow with the distance from the centre of the scene. The
determinant of the two equations is the normal's component itself. Rahikainen 2013 prints two forms that differ by a sign and by
the edge that is called `b`. Here u weighs vertex b and v weighs vertex c.

**Limits.** Not watertight: neighbours round u and v apart.

References: badouel-1990; wald-2004; rahikainen-2013.
"""

import warp as wp

from wrt.kernels.classics.triangle.published import INSIDE, published
from wrt.kernels.triangle.support.axis_projection import main_axis, permuted, permuted_lanes
from wrt.kernels.triangle.support.record_blocks import Corners
from wrt.kernels.triangle.support.vectors import PlainRay, cross, crossed, dot, dotted, minus, miss


@wp.func
def intersect(ray: PlainRay, corners: Corners):
    """One ray, one triangle: (t, u, v); t is NaN if the ray's line misses. u and v weigh the vertices b and c."""
    edge_b = corners.b - corners.a
    edge_c = corners.c - corners.a
    normal = cross(edge_b, edge_c)
    s = ray.origin - corners.a
    t = (0.0 - dot(normal, s)) / dot(normal, ray.direction)
    axis = main_axis(normal)
    n = permuted(normal, axis)
    b = permuted(edge_b, axis)
    c = permuted(edge_c, axis)
    h = permuted(s, axis) + t * permuted(ray.direction, axis)
    u = (c[2] * h[1] - c[1] * h[2]) / n[0]
    v = (b[1] * h[2] - b[2] * h[1]) / n[0]
    if u >= 0.0 and v >= 0.0 and u + v <= 1.0:
        return wp.vec3(t, u, v)
    return miss()


TEST = published(
    "badouel",
    intersect,
    (
        "the line meets the plane beside the triangle",
        f"""
            {minus("e1", "b", "a")}{minus("e2", "c", "a")}{crossed("n", "e1", "e2")}{minus("s", "o", "a")}
            const float t = (0.0f - {dotted("n", "s")}) / {dotted("n", "d")};
            const float size_x = WRT_ABS(nx), size_y = WRT_ABS(ny), size_z = WRT_ABS(nz);
            const float axis = ((size_x >= size_y) & (size_x >= size_z)) ? 0.0f : size_y >= size_z ? 1.0f : 2.0f;
            {permuted_lanes("n")}{permuted_lanes("e1")}{permuted_lanes("e2")}{permuted_lanes("s")}{permuted_lanes("d")}
            const float x = sp + t * dp, y = sq + t * dq;
            const float u = (e2q * x - e2p * y) / nk, v = (e1p * y - e1q * x) / nk;
        """,
        INSIDE,
    ),
)
"""If t is not finite, u or v is NaN or infinite, or both coordinates of the point are 0 times infinity, which is NaN as
well."""
