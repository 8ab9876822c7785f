"""The unit-triangle transformation (UTM): the point's coordinates are u and v.

Two rows of a matrix map points of the plane to u and v. The thesis first inverts the matrix of the three vertices, which is
singular for a plane through the origin, and then uses Baldwin and Weber's free vector: the column that is not needed is
(0, 0, 1), so each row has two factors and a constant, and the column's number is stored. These are the rows of
`wrt.kernels.triangle.support.axis_projection`. The difference from Baldwin and Weber's test is that u is compared before v is
computed.

References: pichler-2018; baldwin-weber-2016.
"""

from typing import Any

import warp as wp

from wrt.kernels.classics.triangle.ferko.record_part import Part
from wrt.kernels.triangle.support import axis_projection as projection
from wrt.kernels.triangle.support.axis_projection import permuted, permuted_lanes
from wrt.kernels.triangle.support.record_blocks import Corners

UnitRows = wp.types.vector(length=7, dtype=wp.float32)
"""Number of the omitted axis, and the rows of u and v."""


@wp.func
def derive_rows(corners: Corners):
    """The rows of u and v, without the plane's row."""
    all_rows = projection.derive_rows(corners, corners.a)
    rows = UnitRows()
    rows[0] = all_rows[0]
    for c in range(6):
        rows[1 + c] = all_rows[4 + c]
    return rows


UNIT_TRIANGLE = Part(("axis", "up", "uq", "u0", "vp", "vq", "v0"), derive_rows)


@wp.func
def in_unit_triangle(point: wp.vec3, own: Any, at: int):
    """(u, v) of a point of the plane. u is NaN if the point is outside."""
    outside = wp.vec2(wp.nan, 0.0)
    x = permuted(point, int(own[at]))
    u = (own[at + 1] * x[1] + own[at + 2] * x[2]) + own[at + 3]
    if not (u >= 0.0 and u <= 1.0):
        return outside
    v = (own[at + 4] * x[1] + own[at + 5] * x[2]) + own[at + 6]
    if not (v >= 0.0 and u + v <= 1.0):
        return outside
    return wp.vec2(u, v)


STEPS = (
    ("u is not from 0 to 1", permuted_lanes("p") + "const float u = (up * pp + uq * pq) + u0;", "(u >= 0.0f) & (u <= 1.0f)"),
    ("beyond the other two edges", "const float v = (vp * pp + vq * pq) + v0;", "(v >= 0.0f) & (u + v <= 1.0f)"),
)
"""The same as steps, after the point."""
