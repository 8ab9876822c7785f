"""Projection of a triangle along the main axis of its normal: two coordinates of a point in its plane decide whether it is
inside.

A triangle's projection onto a coordinate plane keeps its barycentric coordinates. The projection along the normal's largest
component keeps most of its area. That axis is `k`; the other two, in cyclic order, are `p` and `q`.

There are two representations. `RowsOfPlane` holds three linear functions (the plane, u and v) with their constants;
`wrt.kernels.classics.triangle.shevtsov` holds a vertex and two edges instead.
"""

from typing import Any

import warp as wp

from wrt.kernels.triangle.support.record_blocks import Corners
from wrt.kernels.triangle.support.vectors import cross

RowsOfPlane = wp.types.vector(length=10, dtype=wp.float32)
"""k (0.0, 1.0 or 2.0); n_p, n_q, n: the plane x_k + n_p x_p + n_q x_q = n; then u_p, u_q, u_0 and v_p, v_q, v_0: a point of the
plane has u = u_p x_p + u_q x_q + u_0, and v likewise."""

ROW_NAMES = ("axis", "np", "nq", "n0", "up", "uq", "u0", "vp", "vq", "v0")
"""Names of these ten floats in the steps of a `LaneForm`."""


@wp.func
def main_axis(normal: Any):
    """Axis of the component with the largest magnitude, the earlier one if two are equal; 2 for NaN."""
    x = wp.abs(normal[0])
    y = wp.abs(normal[1])
    z = wp.abs(normal[2])
    return wp.where(x >= y and x >= z, 0, wp.where(y >= z, 1, 2))


@wp.func
def next_axis(axis: int):
    """The next axis in the cyclic order x, y, z."""
    return wp.where(axis == 2, 0, axis + 1)


@wp.func
def derive_rows(corners: Corners, origin: wp.vec3):
    """The rows of a triangle, computed in float64 and then rounded. Some are not finite for a triangle without area."""
    a = wp.vec3d(corners.a)
    edge_b = wp.vec3d(corners.b) - a
    edge_c = wp.vec3d(corners.c) - a
    normal = cross(edge_b, edge_c)
    k = main_axis(normal)
    p = next_axis(k)
    q = next_axis(p)
    height = normal[k]
    rows = RowsOfPlane()
    rows[0] = float(k)
    rows[1] = float(normal[p] / height)
    rows[2] = float(normal[q] / height)
    rows[3] = float(a[k] + (normal[p] * a[p] + normal[q] * a[q]) / height)
    rows[4] = float(edge_c[q] / height)
    rows[5] = float(-edge_c[p] / height)
    rows[6] = float((edge_c[p] * a[q] - edge_c[q] * a[p]) / height) + 0.0  # + 0.0 turns -0 into 0, so no sum with it is -0
    rows[7] = float(-edge_b[q] / height)
    rows[8] = float(edge_b[p] / height)
    rows[9] = float((edge_b[q] * a[p] - edge_b[p] * a[q]) / height) + 0.0
    return rows


@wp.func
def permuted(v: wp.vec3, axis: int):
    """Components of a vector along k = `axis`, p and q."""
    p = next_axis(axis)
    return wp.vec3(v[axis], v[p], v[next_axis(p)])


@wp.func
def plane_hit(origin: wp.vec3, direction: wp.vec3, rows: RowsOfPlane):
    """(t, u, v) at which the line meets the plane of a triangle; some are not finite if the line is parallel to it."""
    o = permuted(origin, int(rows[0]))
    d = permuted(direction, int(rows[0]))
    t = (rows[3] - ((o[0] + rows[1] * o[1]) + rows[2] * o[2])) / ((d[0] + rows[1] * d[1]) + rows[2] * d[2])
    x = o[1] + t * d[1]
    y = o[2] + t * d[2]
    return wp.vec3(t, (rows[4] * x + rows[5] * y) + rows[6], (rows[7] * x + rows[8] * y) + rows[9])


def permuted_lanes(vector: str) -> str:
    """C++ that declares the components k, p and q of a vector for the float `axis`, like `permuted`."""
    parts = []
    for name, (if_x, if_y, if_z) in zip("kpq", ("xyz", "yzx", "zxy"), strict=True):
        choice = f"axis == 0.0f ? {vector}{if_x} : axis == 1.0f ? {vector}{if_y} : {vector}{if_z}"
        parts.append(f"{vector}{name} = {choice}")
    return f"const float {', '.join(parts)};\n"


PLANE_HIT = f"""
    {permuted_lanes("o")}{permuted_lanes("d")}
    const float t = (n0 - ((ok + np * op) + nq * oq)) / ((dk + np * dp) + nq * dq);
    const float x = op + t * dp, y = oq + t * dq;
    const float u = (up * x + uq * y) + u0, v = (vp * x + vq * y) + v0;
"""
"""C++ for `plane_hit`, over `ROW_NAMES`."""
