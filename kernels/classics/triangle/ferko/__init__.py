"""Ferko and Ferko 2015, implemented and measured by Pichler 2018: bounds, the plane, then a test in two dimensions.

**Problem.** Most tests of a ray and a triangle end in a miss. Which cheap comparisons detect a miss earliest?

**Idea.** Test the triangle's bounding sphere, intersect the plane, and test the point against the triangle's box or bounding
circle. Then continue in two dimensions, by one of two transformations:

    unit triangle   (UTM) to (0, 0), (1, 0), (0, 1): the point's coordinates are u and v   `unit_triangle`
    similarity      (SPTM) the longest edge to the x-axis. Three or four comparisons then prune the regions around the triangle,
                    in a fixed order or in each triangle's own order. That order follows the probability that a comparison
                    rejects, optionally weighted by the cost of the others   `similarity`, `pruning`

    hybrid          the unit triangle for the closest hit, which needs u and v; pruning for any-hit queries

**Data.** A plane (16 bytes) and the unit triangle's rows (28) or the similarity's (48); the order (4); the bounding circle
(16), which the sphere shares; the box (24). `VARIANTS` lists which steps each variant has.

**Departures.** The thesis compares t with the ray's range after the plane, or, which it found faster, compares t_max last. Here
the traversal compares t for all tests, after the test. The pruning variants of the thesis do not compute u and v, and its
images were wrong; here u and v are computed for points that pass. So the engine can use every variant, and the test suite can
compare them. The weights enter the order when records are built. The engine's boxes (`wrt.kernels.simd.boxes`) are those of the
triangles themselves, widened by rounding, and are tested last; the box step rejects first what they would reject last.

**Limits.** The rows of small triangles are multiplied by coordinates relative to the scene's centre, so precision drops with
the distance from it, as with all transformations. The test is not watertight: the rows of neighbours round independently. It
may report hits beside needles and triangles seen edge-on (not `accurate`).

References: pichler-2018 (After an unpublished outline by A. Ferko and M. Ferko, 2015.).
"""

from dataclasses import replace

from wrt.kernels.classics.triangle.ferko.variant import Variant, make_test
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
"""Steps of each test of the family. The probabilities assume that the point is in the circle, so the ordered variants test the
circle first. The thesis also tries them without the circle, with the order that makes the fewest comparisons."""

_ONE_EACH = {name: make_test(name, variant) for name, variant in VARIANTS.items()}

TESTS: dict[str, TriangleTest] = {
    **_ONE_EACH,
    "ferko_hybrid": replace(_ONE_EACH["ferko_utm"], name="ferko_hybrid", any_hit="ferko_prune3_no_circle"),
}
"""The family. The hybrid prunes with the variant that the thesis chose."""
