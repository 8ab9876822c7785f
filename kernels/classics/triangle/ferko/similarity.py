"""The similarity-preserving transformation: a triangle in its own plane, its longest edge on the x-axis from 0 to 1.

**Definition.** A' = (0, 0) and B' = (1, 0) are the ends of the longest edge, C' = (x, y) is the third vertex, with y > 0 and
x >= 1/2. The transformation keeps angles and ratios of lengths, so the regions around the triangle that the comparisons cut off
keep their shares of the bounding circle. `wrt.kernels.classics.triangle.ferko.pruning` computes these shares.

**Computation.** The thesis multiplies a translation, three rotations, a scaling and two mirrorings: y, if C' came out below the
axis; x, if it came out left of 1/2, because the comparison with the left edge is the cheaper one. The product has a short form.
With e = B - A and n = e x (C - A), a point P of the plane has x = (P - A) . e / |e|^2 and y = (P - A) . (n x e) / (|n| |e|^2).
C is above the axis by construction, as (n x e) . (C - A) = |n|^2; and mirroring x exchanges A and B. Two cases that the
rotations must exclude, because they would divide by zero, do not arise.

**Errors in the printed form.** Mirroring y negates the second *row* of the matrix; the print negates the first column. A
triangle is acute if C' lies outside the circle over the longest edge, (x - 1/2)^2 + y^2 > 1/4. The print tests y > 1/2, which
classifies the acute triangle with C' = (0.9, 0.4) as obtuse.

References: pichler-2018.
"""

from typing import Any

import warp as wp

from wrt.kernels.classics.triangle.ferko.record_part import Part
from wrt.kernels.triangle.support.record_blocks import Corners
from wrt.kernels.triangle.support.vectors import cross, dot, three


@wp.struct
class Similarity:
    """A triangle's own frame, in float64."""

    first: int
    """Number of the vertex that becomes A' = (0, 0)."""
    second: int
    """Number of the vertex that becomes B' = (1, 0)."""
    origin: wp.vec3d
    """A."""
    edge: wp.vec3d
    """B - A."""
    up: wp.vec3d
    """A vector in the plane, perpendicular to the edge, towards C, with the edge's length."""
    x: wp.float64
    """C' = (x, y)."""
    y: wp.float64


@wp.func
def vertex(corners: Corners, number: int):
    """Vertex 0, 1 or 2 in float64."""
    return wp.vec3d(wp.where(number == 0, corners.a, wp.where(number == 1, corners.b, corners.c)))


@wp.func
def similarity(corners: Corners):
    """The frame of a triangle. Of equally long edges the first one counts. Not finite for a triangle without area."""
    ab = wp.length_sq(vertex(corners, 1) - vertex(corners, 0))
    bc = wp.length_sq(vertex(corners, 2) - vertex(corners, 1))
    ca = wp.length_sq(vertex(corners, 0) - vertex(corners, 2))
    start = wp.where(ab >= bc and ab >= ca, 0, wp.where(bc >= ca, 1, 2))
    end = wp.where(start == 2, 0, start + 1)
    edge = vertex(corners, end) - vertex(corners, start)
    along = dot(vertex(corners, 3 - start - end) - vertex(corners, start), edge) / dot(edge, edge)
    mirrored = along < wp.float64(0.5)

    frame = Similarity()
    frame.first = wp.where(mirrored, end, start)
    frame.second = wp.where(mirrored, start, end)
    frame.origin = vertex(corners, frame.first)
    frame.edge = vertex(corners, frame.second) - frame.origin
    leg = vertex(corners, 3 - start - end) - frame.origin
    normal = cross(frame.edge, leg)
    frame.up = cross(normal, frame.edge) / wp.sqrt(dot(normal, normal))
    frame.x = dot(leg, frame.edge) / dot(frame.edge, frame.edge)
    frame.y = wp.sqrt(dot(normal, normal)) / dot(frame.edge, frame.edge)
    return frame


SimilarityRows = wp.types.vector(length=12, dtype=wp.float32)


@wp.func
def derive_rows(corners: Corners):
    """Two rows of the matrix with their constants, C', and the numbers of the vertices that become A' and B'."""
    frame = similarity(corners)
    scale = wp.float64(1.0) / dot(frame.edge, frame.edge)
    rows = SimilarityRows()
    for axis in range(3):
        rows[axis] = float(frame.edge[axis] * scale)
        rows[4 + axis] = float(frame.up[axis] * scale)
    rows[3] = float(-dot(frame.origin, frame.edge) * scale)
    rows[7] = float(-dot(frame.origin, frame.up) * scale)
    rows[8] = float(frame.x)
    rows[9] = float(frame.y)
    rows[10] = float(frame.first)
    rows[11] = float(frame.second)
    return rows


SIMILARITY = Part(
    names=("sxx", "sxy", "sxz", "sx0", "syx", "syy", "syz", "sy0", "apex_x", "apex_y", "from_vertex", "to_vertex"),
    derive=derive_rows,
)


@wp.func
def in_plane(point: wp.vec3, own: Any, at: int):
    """The point Q of the triangle's own frame for a point of its plane. The rows begin at `own[at]`."""
    rx = three(own, at)
    ry = three(own, at + 4)
    return wp.vec2(dot(rx, point) + own[at + 3], dot(ry, point) + own[at + 7])


@wp.func
def weights(q: wp.vec2, own: Any, at: int):
    """(u, v), the weights of the vertices 1 and 2, of a point Q. The thesis does not compute them."""
    of_third = q[1] / own[at + 9]
    of_second = q[0] - own[at + 8] * of_third
    of_first = (1.0 - of_second) - of_third
    u = wp.where(own[at + 10] == 1.0, of_first, wp.where(own[at + 11] == 1.0, of_second, of_third))
    v = wp.where(own[at + 10] == 2.0, of_first, wp.where(own[at + 11] == 2.0, of_second, of_third))
    return wp.vec2(u, v)


IN_PLANE = """
    const float qx = ((sxx * px + sxy * py) + sxz * pz) + sx0, qy = ((syx * px + syy * py) + syz * pz) + sy0;
"""
"""C++ for `in_plane`."""

WEIGHTS = """
    const float of_third = qy / apex_y, of_second = qx - apex_x * of_third, of_first = (1.0f - of_second) - of_third;
    const float u = from_vertex == 1.0f ? of_first : to_vertex == 1.0f ? of_second : of_third;
    const float v = from_vertex == 2.0f ? of_first : to_vertex == 2.0f ? of_second : of_third;
"""
"""C++ for `weights`."""
