"""Areas by which the watertight test (`wrt.kernels.triangle.watertight.woop`) weighs the vertices of a triangle that it has
hit.

**Problem.** The signs of the areas are exact, so whether a triangle is hit is exact too. The position of the hit is not. The
areas of a needle, or of a triangle seen edge-on, are small differences of large products. Rounding these moves the weights, and
so t, by up to the length of the triangle. Code that assumes that a hit is near its triangle then loses it: leaves of a kd-tree
that list only the triangles that they meet (`wrt.builders.core.clip`), and packets that cull by vertices.

**Rule.** An area is the difference of two products. If the areas of a hit sum to less than `THIN` of the sum N of the
magnitudes of the first products, they are recomputed in float64, in which products of float32 numbers are exact and their
difference rounds once. In common scenes this concerns about one hit in a hundred.

**Bound.** A hit is at most 16 u R + 14 u D away, along each axis, from the point of its triangle that u and v tell.

    u        2^-24, the greatest relative error of a rounding
    R        largest distance along an axis of a vertex V from the origin, at most the ray's reach
    s        slope of the ray, |s| <= 1
    x, z     a coordinate of a sheared vertex across the ray; its depth
    x_i      the sheared vertices as computed; D: their extent, at most twice that of the triangle
    A_i, S   the exact areas of those, and their sum; of a hit they have one sign, so that sum |A_i| = |S|
    N, M     sums of the magnitudes of the first products, and of all six
    d_i      errors of the computed areas

The vertices:

    z = fl(V_z)                                 u |V_z| <= 1 u R
    fl(V_x)                                     u |V_x| <= 1 u R
    fl(s)                                       0.5 u, as |s| <= 1: 0.5 u R
    fl(s z)                                     1 u R
    x = fl(V_x - s z)                           |V_x - s z| <= 2 R: 2 u R
    x, against the exact s and the z above      <= 4.5 u R; with z's own error times s, 5.5 u R

The weights, of which sum A_i x_i = 0, as the ray is at 0:

    M <= 2 N + S                                a second product is a first one less an area
    M <= 9 S                                    as S >= N / 4, by the rule
    sum |d_i| <= u (M + S)                      two products and a difference each
    |sum d_i x_i| / S <= u D (M / S + 1)        <= 10 u D; of areas from float64, 1 u D
    the weights                                 two sums, a reciprocal and a product: 4 u D
    t                                           a depth and its product with an area, two sums; two sums of areas, a reciprocal,
                                                a product; 1 / direction and a product: 10 u R
    sum                                         15.5 u R + 14 u D

Half a rounding of R is left. It holds for areas and products with depths that are normal numbers: where S and S R are at least
2^-120, what underflows adds less than u (D + R) / 10. Smaller triangles are hit, but t, u and v may be any in the triangle and
its widened box. No search comes near the bound: hits are at most 5.5 u R away (`sheared` and `hits` of tests/bounds,
notebooks/records/2026-11-22-thin-triangles.md)."""

import warp as wp

THIN = wp.constant(0.25)
"""Ratio of the summed areas to N below which the sum has lost digits that matter. It enters the bound above as M / S <= 9."""


@wp.func
def area64(p: wp.vec3, q: wp.vec3):
    """Signed area p x q in float64; its sign is exact."""
    return wp.float64(p[0]) * wp.float64(q[1]) - wp.float64(p[1]) * wp.float64(q[0])


@wp.func
def exact_area(p: wp.vec3, q: wp.vec3):
    """Signed area p x q, rounded to float32. Its sign is exact, unless the area is so small that it rounds to 0."""
    return float(area64(p, q))


@wp.func
def precise_areas(a: wp.vec3, b: wp.vec3, c: wp.vec3, areas: wp.vec3):
    """The areas of a triangle that is hit: as given, or recomputed in float64 for a thin triangle if float32 can hold them."""
    size = (wp.abs(c[0] * b[1]) + wp.abs(a[0] * c[1])) + wp.abs(b[0] * a[1])
    result = wp.vec3(areas)
    if wp.abs((areas[0] + areas[1]) + areas[2]) < THIN * size:
        precise = wp.vec3(exact_area(c, b), exact_area(a, c), exact_area(b, a))
        if (precise[0] + precise[1]) + precise[2] != 0.0:
            result = precise
    return result
