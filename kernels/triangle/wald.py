"""Wald 2004: Badouel's projection with all per-triangle values precomputed.

**Problem.** Badouel's test (`wrt.kernels.classics.triangle.badouel`) recomputes the triangle's normal, its main axis and the
area of its projection for every ray.

**Idea.** Divide the plane's equation by the normal's main component, and write both barycentric coordinates as linear functions
of the two other coordinates of the point at which the line meets the plane. One division and ten multiplications remain.

**Data.** Ten floats, 40 bytes: the axis, and three rows of three (`wrt.kernels.triangle.support.axis_projection`).

**Integer comparisons.** Waechter compares bit patterns as unsigned integers. The patterns of the numbers from 0 to 1 are the
smallest, up to that of 1; negative numbers, NaN and infinities are larger. So `bits(x) <= bits(1)` means 0 <= x <= 1, and u, v
and u + v take one such comparison each instead of u >= 0, v >= 0, u + v <= 1. (Only -0 would be misclassified; the constants of
the rows are chosen so that no sum is -0.) Waechter found that this saves time in scalar code on a Pentium 4, whose vector units
lacked the comparison. On current vector units it is as fast as the comparison of floats in
`wrt.kernels.classics.triangle.baldwin_weber` (notebooks/records/2026-11-21-triangle-tests.md). The remaining advantage is that
NaN needs no special case.

**Departures.** The caller compares t with the ray's range. Rows are computed in float64, then rounded.

**Limits.** The constants of the rows grow with the triangle's distance from the centre of the scene over its size, and so does
their rounding: hits are less precise than those of tests that subtract a vertex first. The test is not watertight. In vector
code, triangles of several main axes run in one loop, so the axis costs selects instead of a jump.

References: wald-2004; waechter-2004; badouel-1990.
"""

import warp as wp

from wrt.kernels.triangle.support.axis_projection import PLANE_HIT, ROW_NAMES, RowsOfPlane, derive_rows, plane_hit
from wrt.kernels.triangle.support.lane_form import DIRECTION, ORIGIN, LaneForm, Step
from wrt.kernels.triangle.support.record_blocks import Record
from wrt.kernels.triangle.support.triangle_contract import TriangleTest
from wrt.kernels.triangle.support.vectors import PlainRay, miss, prepare

BITS_OF_ONE = 0x3F800000


@wp.func_native(f"return __builtin_bit_cast(unsigned, x) <= {BITS_OF_ONE}u;")
def in_unit_interval(x: float) -> bool:
    """Whether 0 <= x <= 1. Wrong only for -0."""


@wp.func
def intersect(ray: PlainRay, rows: RowsOfPlane):
    """One ray, one triangle: (t, u, v); t is NaN if the ray's line misses. u and v weigh the vertices b and c."""
    hit = plane_hit(ray.origin, ray.direction, rows)
    if in_unit_interval(hit[1]) and in_unit_interval(hit[2]) and in_unit_interval(hit[1] + hit[2]):
        return hit
    return miss()


LANES = LaneForm(
    ray=(*ORIGIN, *DIRECTION),
    triangle=ROW_NAMES,
    steps=(
        Step(
            exit="the line meets the plane beside the triangle",
            code=PLANE_HIT
            + """
                const unsigned bits_u = __builtin_bit_cast(unsigned, u), bits_v = __builtin_bit_cast(unsigned, v);
                const unsigned bits_sum = __builtin_bit_cast(unsigned, u + v);
            """,
            passes=" & ".join(f"({bits} <= {BITS_OF_ONE}u)" for bits in ("bits_u", "bits_v", "bits_sum")),
        ),
    ),
)

TEST = TriangleTest(
    name="wald",
    paper="Wald: Realtime ray tracing and interactive global illumination (2004)",
    record=Record(10, derive_rows),
    ray_state=PlainRay,
    prepare=prepare,
    intersect=intersect,
    lanes=LANES,
)
