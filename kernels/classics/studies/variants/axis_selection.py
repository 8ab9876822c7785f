"""Ways to find the two axes that follow a triangle's main axis, in Wald's test: for measurements.

    selects   `wrt.kernels.triangle.wald`: comparisons and selections, in lanes of the coordinates themselves
    table     {0, 1, 2, 0, 1}[k + 1] and [k + 2] (Wald 2004)
    modulo    (k + 1) % 3 and (k + 2) % 3
    shifts    (1 << k) & 3 for the next axis, and the same again for the one after it (Waechter 2004: bit shifts remove the
              dependency on the table)

All but `selects` then read coordinates of the ray by number, from memory. The arithmetic is the same, and so are the bits.

The survey (Rahikainen 2013) does not print Waechter's shifts; 1 << k is 1, 2, 4, whose two lowest bits are 1, 2, 0.

References: wald-2004; waechter-2004; rahikainen-2013.
"""

from dataclasses import replace

import warp as wp

from wrt.kernels.triangle import wald
from wrt.kernels.triangle.support.axis_projection import PLANE_HIT, RowsOfPlane, permuted_lanes
from wrt.kernels.triangle.support.triangle_contract import TriangleTest
from wrt.kernels.triangle.support.vectors import PlainRay, miss

AXES = {
    "table": ("constexpr int after[5] = {0, 1, 2, 0, 1};", "after[axis_k + 1]", "after[axis_k + 2]"),
    "modulo": ("", "(int)((unsigned)(axis_k + 1) % 3u)", "(int)((unsigned)(axis_k + 2) % 3u)"),
    "shifts": ("", "(1 << axis_k) & 3", "(1 << axis_p) & 3"),
}
"""C++ of each way: what goes before, and the axes p and q for `axis_k`."""


def _numbers(way: str) -> str:
    """C++ that declares axis_k, axis_p and axis_q for the float `axis`."""
    before, p, q = AXES[way]
    return f"{before} const int axis_k = (int)axis, axis_p = {p}, axis_q = {q};\n"


def _read(vector: str, x: str, y: str, z: str) -> str:
    """C++ that declares the components k, p and q of a vector, read by number."""
    parts = ", ".join(f"{vector}{name} = {vector}_of[axis_{name}]" for name in "kpq")
    return f"const float {vector}_of[3] = {{{x}, {y}, {z}}}; const float {parts};\n"


def _scalar(way: str) -> wp.Function:
    """`intersect` of Wald's test with one of the ways."""

    @wp.func_native(f"""
        {_numbers(way)}
        const float* o = (const float*)&origin;
        const float* d = (const float*)&direction;
        const float t = (rows.c[3] - ((o[axis_k] + rows.c[1] * o[axis_p]) + rows.c[2] * o[axis_q]))
            / ((d[axis_k] + rows.c[1] * d[axis_p]) + rows.c[2] * d[axis_q]);
        const float x = o[axis_p] + t * d[axis_p], y = o[axis_q] + t * d[axis_q];
        return wp::vec3(t, (rows.c[4] * x + rows.c[5] * y) + rows.c[6], (rows.c[7] * x + rows.c[8] * y) + rows.c[9]);
    """)
    def plane_hit(origin: wp.vec3, direction: wp.vec3, rows: wp.ref[RowsOfPlane], axis: float) -> wp.vec3: ...

    @wp.func
    def intersect(ray: PlainRay, rows: RowsOfPlane):
        hit = plane_hit(ray.origin, ray.direction, rows, rows[0])
        if wald.in_unit_interval(hit[1]) and wald.in_unit_interval(hit[2]) and wald.in_unit_interval(hit[1] + hit[2]):
            return hit
        return miss()

    return intersect


def _test(way: str) -> TriangleTest:
    """Wald's test with one of the ways."""
    (step,) = wald.LANES.steps
    selects = f"{permuted_lanes('o')}{permuted_lanes('d')}"
    if selects not in PLANE_HIT or PLANE_HIT not in step.code:
        raise AssertionError("Wald's lanes no longer begin with `permuted_lanes`")
    code = step.code.replace(selects, f"{_numbers(way)}{_read('o', 'ox', 'oy', 'oz')}{_read('d', 'dx', 'dy', 'dz')}")
    lanes = replace(wald.LANES, steps=(replace(step, code=code),))
    return replace(wald.TEST, name=f"wald_{way}", intersect=_scalar(way), lanes=lanes)


SELECTIONS: dict[str, TriangleTest] = {"selects": wald.TEST} | {way: _test(way) for way in AXES}
"""Wald's test with each way."""
