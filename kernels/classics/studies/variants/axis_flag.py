"""Shevtsov, Soupikov and Kapustin's test with its flag of axis-aligned triangles: for measurements.

**Idea.** The plane of a triangle that is parallel to a coordinate plane is x_k = n. The two other components of its normal are
zero, and the determinant and the distance to the plane, sums of three terms, become one term each: eight operations fewer.

**Data.** The record of `wrt.kernels.classics.triangle.shevtsov`. The flag is that both components are zero, so it takes no
memory.

**Where it is read.** Once per triangle: a packet takes one of two loops over its rays, and the scalar form one of two branches.
The W triangles of a block differ in their flags, so `block_test` is that of the test without the flag.

**The same bits.** The terms left out are zeros. They could change nothing but the sign of a zero. A determinant of zero is a
miss; and n is never -0, so n minus a zero of either sign is the same.

**Limits.** It saves time where most triangles are aligned (notebooks/records/2026-11-23-axis-variants.md).

References: shevtsov-2007-triangle.
"""

from dataclasses import dataclass, replace

import warp as wp

from wrt.kernels.classics.triangle import shevtsov
from wrt.kernels.classics.triangle.published import in_steps
from wrt.kernels.classics.triangle.shevtsov import FlatTriangle, weigh
from wrt.kernels.triangle.support.axis_projection import permuted, permuted_lanes
from wrt.kernels.triangle.support.lane_form import LaneForm
from wrt.kernels.triangle.support.vectors import PlainRay


@wp.func
def intersect(ray: PlainRay, flat: FlatTriangle):
    """One ray, one triangle: (t, u, v); t is NaN if the ray's line misses. u and v weigh the vertices b and c."""
    o = permuted(ray.origin, int(flat[0]))
    d = permuted(ray.direction, int(flat[0]))
    det = d[0]
    ahead = flat[3] - o[0]
    if flat[1] != 0.0 or flat[2] != 0.0:
        det = (d[0] + flat[1] * d[1]) + flat[2] * d[2]
        ahead = flat[3] - ((o[0] + flat[1] * o[1]) + flat[2] * o[2])
    return weigh(flat, o, d, det, ahead)


@dataclass(frozen=True)
class FlaggedForm(LaneForm):
    """A form with cheaper steps for some triangles.

    Attributes:
        flag: C++ condition over the names of the triangle.
        flagged: the form for triangles that meet it; its steps keep the same names.
    """

    flag: str = "false"
    flagged: LaneForm | None = None

    def packet_loops(self) -> str:
        """C++: the loops of either form."""
        return f"if ({self.flag}) {{ {self.flagged.packet_loops()} }} else {{ {super().packet_loops()} }}\n"


GENERAL = shevtsov.TEST.lanes
ALIGNED = replace(
    GENERAL,
    steps=in_steps(
        (
            GENERAL.steps[0].exit,
            f"""
                {permuted_lanes("o")}{permuted_lanes("d")}
                const float det = dk, ahead = n0 - ok;
                {shevtsov.WEIGHTS}
            """,
            shevtsov.SIGNS,
        ),
        shevtsov.DIVISION,
    ),
)
"""The lane loops for aligned triangles only."""

TEST = replace(
    shevtsov.TEST,
    name="shevtsov_flag",
    intersect=intersect,
    lanes=FlaggedForm(
        ray=GENERAL.ray, triangle=GENERAL.triangle, steps=GENERAL.steps, flag="np == 0.0f && nq == 0.0f", flagged=ALIGNED
    ),
)
