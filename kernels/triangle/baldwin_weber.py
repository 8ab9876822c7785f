"""Baldwin & Weber 2016: move the ray to where the triangle is the unit triangle.

**Problem.** A transformation that takes a triangle to the one with vertices (0, 0), (1, 0), (0, 1) makes the test trivial, but
its twelve numbers are many to keep and to multiply with.

**Idea.** Where the transformation takes the third axis is free: no point of the plane is moved by it. If it is that of the
normal's largest component, one column of the matrix becomes (0, 0, 1): nine numbers and the column's index are left, and two
multiplications less a row. The third row gives t; the first two, applied to the point at t, give u and v.

**Data.** Nine floats and the index, 40 bytes: `wrt.kernels.triangle.support.axis_projection`. Found from another side, they are
the ten numbers of Wald's projection, and the arithmetic is the same; what differs is how the end is compared. The point of the
paper is how little memory a transformation needs, and that no case has to be told apart.

**Departures.** The comparison of t with the ray's range, the paper's first exit, is left to the caller, so there is one exit.
The paper has code for each index; on vectors it selects components, as Wald's does. The hypotenuse belongs to the triangle.

**Limits.** As Wald's: less precise far from the centre of the scene, not watertight.

References:
    D. Baldwin, M. Weber: Fast ray-triangle intersections by coordinate transformation.
        Journal of Computer Graphics Techniques 5(3), 2016.
"""

import warp as wp

from wrt.kernels.triangle.support.axis_projection import PLANE_HIT, ROW_NAMES, RowsOfPlane, derive_rows, plane_hit
from wrt.kernels.triangle.support.lane_form import DIRECTION, ORIGIN, LaneForm, Step
from wrt.kernels.triangle.support.record_blocks import Record
from wrt.kernels.triangle.support.triangle_contract import TriangleTest
from wrt.kernels.triangle.support.vectors import PlainRay, miss, prepare

wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@wp.func
def intersect(ray: PlainRay, rows: RowsOfPlane):
    """One ray, one triangle: (t, u, v), t NaN if the ray's line misses. u, v weigh the vertices b and c."""
    hit = plane_hit(ray.origin, ray.direction, rows)
    if hit[1] >= 0.0 and hit[2] >= 0.0 and hit[1] + hit[2] <= 1.0:
        return hit
    return miss()


LANES = LaneForm(
    ray=(*ORIGIN, *DIRECTION),
    triangle=ROW_NAMES,
    steps=(
        Step(
            exit="the line meets the plane beside the triangle",
            code=PLANE_HIT,
            passes="(u >= 0.0f) & (v >= 0.0f) & (u + v <= 1.0f)",
        ),
    ),
)
"""A t that is not finite makes u and v infinite or NaN, and the sum of what is infinite is not at most 1."""

TEST = TriangleTest(
    name="baldwin_weber",
    paper="Baldwin, Weber: Fast ray-triangle intersections by coordinate transformation (2016)",
    record=Record(10, derive_rows),
    ray_state=PlainRay,
    prepare=prepare,
    intersect=intersect,
    lanes=LANES,
)
