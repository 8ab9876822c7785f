"""Baldwin and Weber 2016: transform the ray into the space in which the triangle is the unit triangle.

**Problem.** A transformation that maps a triangle to (0, 0), (1, 0), (0, 1) makes the test trivial, but its twelve numbers cost
memory and multiplications.

**Idea.** The image of the third axis is a free choice, because it moves no point of the plane. If that axis is the one of the
normal's largest component, one column of the matrix becomes (0, 0, 1). Nine numbers and the column's index remain, and each row
needs two multiplications fewer. The third row gives t. The first two rows, applied to the point at t, give u and v.

**Steps.**

1. Once per triangle: the axis k of the normal's largest component; the rows of the inverse of (b - a, c - a, axis k, a).
2. The third row, for the plane: t = (n - o_k - n_p o_p - n_q o_q) / (d_k + n_p d_p + n_q d_q).
3. The point's coordinates p and q at t; the first two rows map them to u and v.
4. u >= 0, v >= 0, u + v <= 1.

**Cost.** 23 operations, one of them a division.

**Data.** Nine floats and the index, 40 bytes: `wrt.kernels.triangle.support.axis_projection`. These are the ten numbers of
Wald's projection, and the arithmetic is the same; only the final comparisons differ. The paper's contribution is that a
transformation needs so little memory and no case distinction.

**Departures.** The caller compares t with the ray's range, the paper's first exit, so one exit remains. The paper has separate
code for each index; the vector form selects components instead, like Wald's test. The hypotenuse belongs to the triangle.

**Limits.** Those of Wald's test: less precise far from the centre of the scene, and not watertight.

References: baldwin-weber-2016.
"""

import warp as wp

from wrt.kernels.classics.triangle.published import INSIDE, published
from wrt.kernels.triangle.support.axis_projection import PLANE_HIT, ROW_NAMES, RowsOfPlane, derive_rows, plane_hit
from wrt.kernels.triangle.support.record_blocks import Record
from wrt.kernels.triangle.support.vectors import PlainRay, miss


@wp.func
def intersect(ray: PlainRay, rows: RowsOfPlane):
    """One ray, one triangle: (t, u, v); t is NaN if the ray's line misses. u and v weigh the vertices b and c."""
    hit = plane_hit(ray.origin, ray.direction, rows)
    if hit[1] >= 0.0 and hit[2] >= 0.0 and hit[1] + hit[2] <= 1.0:
        return hit
    return miss()


TEST = published(
    "baldwin_weber",
    intersect,
    ("the line meets the plane beside the triangle", PLANE_HIT, INSIDE),
    record=Record(10, derive_rows),
    names=ROW_NAMES,
)
"""If t is not finite, u and v are infinite or NaN, and their sum is not at most 1."""
