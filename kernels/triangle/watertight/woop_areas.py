"""Areas by which the watertight test (`wrt.kernels.triangle.watertight.woop`) weighs the vertices of a triangle that it has
hit.

**Problem.** The signs of the areas are exact, so whether a triangle is hit is exact too. The position of the hit is not. The
areas of a needle, or of a triangle seen edge-on, are small differences of large products. Rounding these moves the weights, and
so t, by up to the length of the triangle. Code that assumes that a hit is near its triangle then loses it: leaves of a kd-tree
that list only the triangles that they meet (`wrt.builders.core.clip`), and packets that cull by vertices.

**Rule.** An area is the difference of two products. If the areas of a hit sum to less than `THIN` of the sum N of the
magnitudes of the first products, they are recomputed in float64, in which products of float32 numbers are exact and their
difference rounds once. In common scenes this concerns about one hit in a hundred.

**Bound.** u = 2^-24, R is the ray's reach, D the extent of the sheared triangle, at most twice that of the triangle. A
coordinate of a sheared vertex has an error of 6 u R: one rounding each of two differences, a shear and a product, and one of a
difference of up to 2 R. Let x_i be the vertices as computed, A_i their exact areas, S the sum of these and M that of all six
products: M <= 2 N + S, as no area is larger than S. The ray meets that triangle, sum A_i x_i = 0. Computed areas have errors
d_i with sum |d_i| <= u (M + S), so that they miss it by |sum d_i x_i| / S <= u D (M / S + 1) <= 10 u D. Rounding the weights
adds 4 u D, and the ten roundings of t 10 u R. A hit is at most 16 u R + 14 u D away from its triangle. Measured errors are
below that (notebooks/records/2026-11-22-thin-triangles.md)."""

import warp as wp

from wrt.kernels.runtime.options import exact_module

exact_module(__name__)

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
