"""The nearest point of a triangle, in plain Warp: the operations, and the bits, of kernels/native/nearest_on_triangle.h.

`wrt.kernels.points` has the formulas and the bounds of their rounding. Vertices are relative to the point.
"""

import warp as wp

from wrt.kernels.simd.boxes import INFINITY

FLAT = wp.constant(0.0009765625)
"""A triangle whose doubled area squared is less than this part of its edges' product has its weights computed in float64."""

FACE_SHARE, FACE_SLACK = wp.constant(1.000003814697265625), wp.constant(3.637978807091713e-12)
"""A foot on the face is nearer than all edges, so it is taken although rounding makes it farther, by no more than this part of
its squared distance and this part of that of the triangle's first vertex."""

MIN_AREA, MAX_AREA = wp.constant(1e-30), wp.constant(1e30)
"""The same for areas outside of this range, in which float32 keeps all digits."""


@wp.struct
class OnTriangle:
    """The nearest point of a triangle."""

    square: float
    """Its squared distance."""
    u: float
    """Weight of the triangle's second vertex."""
    v: float
    """Weight of the third one."""
    feature: int
    """Dimension of what it is on: 0 for a vertex, 1 for an edge, 2 for the face."""


@wp.func
def dot(p: wp.vec3, q: wp.vec3):
    """Dot product."""
    return (p[0] * q[0] + p[1] * q[1]) + p[2] * q[2]


@wp.func
def cross(p: wp.vec3, q: wp.vec3):
    """Cross product."""
    return wp.vec3(p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0])


@wp.func
def moved(p: wp.vec3, t: float, e: wp.vec3):
    """p + t e."""
    return wp.vec3(p[0] + t * e[0], p[1] + t * e[1], p[2] + t * e[2])


@wp.func
def nearest_on_edge(p: wp.vec3, q: wp.vec3):
    """(squared distance, weight of p, weight of q, place from the nearer end) of the nearest point between p and q."""
    d = q - p
    second = dot(q, q) < dot(p, p)
    base = wp.vec3(p)
    e = wp.vec3(d)
    if second:
        base = q
        e = wp.vec3(-d[0], -d[1], -d[2])
    t = (0.0 - dot(base, e)) / dot(e, e)
    place = float(0.0)
    if t > 0.0:
        place = wp.where(t < 1.0, t, 1.0)
    at = moved(base, place, e)
    rest = 1.0 - place
    return wp.vec4(dot(at, at), wp.where(second, place, rest), wp.where(second, rest, place), place)


@wp.func
def foot_on_plane(a: wp.vec3, ab: wp.vec3, ac: wp.vec3):
    """Weights of b and c at the foot of the perpendicular on the plane, and 1 if they are not to be trusted."""
    n = cross(ab, ac)
    area = dot(n, n)
    sure = area >= FLAT * (dot(ab, ab) * dot(ac, ac)) and area > MIN_AREA and area < MAX_AREA
    return wp.vec3(dot(n, cross(ac, a)) / area, dot(n, cross(a, ab)) / area, wp.where(sure, 0.0, 1.0))


@wp.func
def exact_foot(a: wp.vec3, ab: wp.vec3, ac: wp.vec3):
    """The same in float64."""
    p = wp.vec3d(a)
    b = wp.vec3d(ab)
    c = wp.vec3d(ac)
    nx = b[1] * c[2] - b[2] * c[1]
    ny = b[2] * c[0] - b[0] * c[2]
    nz = b[0] * c[1] - b[1] * c[0]
    area = (nx * nx + ny * ny) + nz * nz
    v = (nx * (c[1] * p[2] - c[2] * p[1]) + ny * (c[2] * p[0] - c[0] * p[2])) + nz * (c[0] * p[1] - c[1] * p[0])
    w = (nx * (p[1] * b[2] - p[2] * b[1]) + ny * (p[2] * b[0] - p[0] * b[2])) + nz * (p[0] * b[1] - p[1] * b[0])
    return wp.vec3(float(v / area), float(w / area), 0.0)


@wp.func
def square_of_foot(a: wp.vec3, ab: wp.vec3, ac: wp.vec3, foot: wp.vec3):
    """Squared distance of the foot if it is inside the face; inf if not."""
    at = moved(moved(a, foot[0], ab), foot[1], ac)
    square = float(INFINITY)
    if foot[0] > 0.0 and foot[1] > 0.0 and foot[0] + foot[1] < 1.0:
        square = dot(at, at)
    return square


@wp.func
def nearest_on_triangle(a: wp.vec3, b: wp.vec3, c: wp.vec3):
    """The nearest point of the triangle to the origin."""
    found = OnTriangle()
    ab = nearest_on_edge(a, b)
    bc = nearest_on_edge(b, c)
    ca = nearest_on_edge(c, a)
    found.square = ab[0]
    found.u = ab[2]
    found.v = 0.0
    place = ab[3]
    if bc[0] < found.square:
        found.square = bc[0]
        found.u = bc[1]
        found.v = bc[2]
        place = bc[3]
    if ca[0] < found.square:
        found.square = ca[0]
        found.u = 0.0
        found.v = ca[1]
        place = ca[3]
    found.feature = wp.where(place > 0.0 and place < 1.0, 1, 0)
    e1 = b - a
    e2 = c - a
    foot = foot_on_plane(a, e1, e2)
    if foot[2] != 0.0:
        foot = exact_foot(a, e1, e2)
    square = square_of_foot(a, e1, e2, foot)
    if square <= found.square * FACE_SHARE + dot(a, a) * FACE_SLACK:
        found.square = square
        found.u = foot[0]
        found.v = foot[1]
        found.feature = 2
    return found
