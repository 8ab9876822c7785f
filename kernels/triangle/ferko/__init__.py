"""Ferko & Ferko 2015, implemented and measured by Pichler 2018: bounds, the plane, then a test in two dimensions.

**Problem.** Most tests of a ray and a triangle end in a miss. Which cheap comparisons find that out earliest?

**Idea.** A sphere around the triangle; the point in which the line meets the plane; the triangle's box, or its bounding
circle; and then two dimensions, by one of two transformations:

    unit triangle   (UTM) to (0, 0), (1, 0), (0, 1): the point's coordinates are u and v   `unit_triangle`
    similarity      (SPTM) the longest edge to the x-axis; comparisons then prune what lies around the triangle, three or four,
                    each triangle's own order by the probability that a comparison rejects, weighted by what the others cost,
                    or not   `similarity`, `pruning`, `regions`

    hybrid          the unit triangle for the closest hit, which needs u and v; pruning where any hit will do

**Data.** A plane (16 bytes) and the unit triangle's rows (28) or the similarity's (48); the order (4); the bounding circle
(16), which the sphere shares; the box (24). `VARIANTS` names what is switched on in each.

**Departures.** The paper compares t with the ray's range at the plane, and (what it found faster) t_max after the rest; here
that is the traversal's business for all tests, after the test. It does not compute u and v when it prunes, and its pictures
were wrong; here they are computed of what passes. So the engine can use every variant, and tests can compare them. The weights
go into the order at build. The engine's boxes (`wrt.kernels.simd.boxes`) are those of the triangles themselves, widened by
rounding, and asked after the test: what the box step finds first they would find last.

**Limits.** Coordinates relative to the scene's centre are multiplied with the rows of small triangles, so precision is lost
far from it, as with all transformations. Not watertight: rows of neighbours round on their own. Triangles seen edge-on and
needles may be hit beside (not `accurate`).

References:
    A. Ferko, M. Ferko: unpublished outline of a fast ray-triangle intersection, 2015.
    L. Pichler: Fast ray-triangle intersection. Diploma thesis, 2018.
"""

from dataclasses import replace

from wrt.kernels.triangle.ferko.variant import Variant, make_test
from wrt.kernels.triangle.support.triangle_contract import TriangleTest

VARIANTS: dict[str, Variant] = {
    "ferko_utm": Variant(),
    "ferko_utm_bounds": Variant(sphere=True, box=True, circle=True),
    "ferko_prune3": Variant(fold=3),
    "ferko_prune3_probability": Variant(fold=3, circle=True, ordered=True),
    "ferko_prune3_weights": Variant(fold=3, circle=True, ordered=True, weighted=True),
    "ferko_prune3_no_circle": Variant(fold=3, ordered=True, weighted=True),
    "ferko_prune4": Variant(fold=4),
    "ferko_prune4_probability": Variant(fold=4, circle=True, ordered=True),
    "ferko_prune4_weights": Variant(fold=4, circle=True, ordered=True, weighted=True),
    "ferko_prune4_no_circle": Variant(fold=4, ordered=True),
}
"""What each test of the family asks. The probabilities suppose that the point is in the circle, so those variants ask that
first; the paper tries them without it, too, with the order that makes the fewest comparisons."""

_ONE_EACH = tuple(make_test(name, variant) for name, variant in VARIANTS.items())

TESTS: tuple[TriangleTest, ...] = (*_ONE_EACH, replace(_ONE_EACH[0], name="ferko_hybrid", any_hit="ferko_prune3_no_circle"))
"""The family. The hybrid prunes by the variant that the paper chose."""
