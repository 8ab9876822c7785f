"""Dammertz and Keller's test: no plane, no edges; the triangle is divided until its box is as small as float32 can tell.

**Idea.** The hit is searched in object space, not along the ray. A ray that meets the triangle's box is tested against the
boxes of the four triangles between vertices and midpoints of edges, and so on. What is left in the end is a box of the size
of a rounding, and the hit is in it, however far away the ray begins.

**Departures.** The paper was not at hand; this follows the outlines in Pichler 2018 and Woop, Benthin and Wald 2013. Division
ends where the box is no larger than the slack of the box test (`wrt.kernels.simd.boxes.SLACK` of the ray's reach), which is a
few roundings, or after `MOST` levels. t is that of the last triangle's middle, projected on the ray; u and v are its weights.

**Limits.** Neighbours divide a shared edge at the same points, and boxes are widened, so no ray passes between them. Instead,
rays are hit that pass beside the triangle by less than the slack. A test takes some 20 levels with four boxes each. A ray in
the plane of the triangle but beside it may visit every box along a line.

References: dammertz-keller-2006; pichler-2018; woop-2013.
"""

from dataclasses import dataclass

import warp as wp

from wrt.kernels.simd.boxes import SLACK, ray_slabs, reach, slab_interval
from wrt.kernels.triangle.support.record_blocks import VERTICES, Corners, Record, corners_high, corners_low
from wrt.kernels.triangle.support.vectors import PlainRay, dot, miss, prepare

MAX_LEVEL = 24
"""Levels: each halves the edges, and float32 has 24 digits."""

SIZE = 3 * MAX_LEVEL + 1
"""Triangles that wait: each level leaves three."""


@wp.struct
class Part:
    """A triangle that waits."""

    corners: Corners
    u: float
    """Weights of its first vertex."""
    v: float
    size: float
    """Of its weights; below 0: upside down."""
    level: float


@wp.func
def middle(p: wp.vec3, q: wp.vec3):
    """Midpoint of an edge, the same from both of its sides."""
    return 0.5 * p + 0.5 * q


@wp.func
def intersect(ray: PlainRay, corners: Corners):
    """One ray, one triangle: (t, u, v); t is NaN if the ray's line misses. u and v weigh the vertices b and c."""
    distance = reach(ray.origin, corners_low(corners), corners_high(corners))
    slabs = ray_slabs(ray.origin, ray.direction, distance)
    smallest = SLACK * distance
    square = dot(ray.direction, ray.direction)
    if not (square > 0.0 and distance < wp.inf):
        return miss()
    waiting = wp.zeros(shape=(SIZE,), dtype=Part)
    waiting[0] = Part(corners, 0.0, 0.0, 1.0, 0.0)
    count = int(1)
    while count > 0:
        count -= 1
        part = waiting[count]
        here = part.corners
        low = corners_low(here)
        high = corners_high(here)
        span = slab_interval(slabs, low, high)
        if span[0] <= span[1]:
            side = high - low
            if wp.max(side[0], wp.max(side[1], side[2])) <= smallest or part.level >= float(wp.static(MAX_LEVEL)):
                centre = (here.a + here.b + here.c) / 3.0
                third = part.size / 3.0
                return wp.vec3(dot(centre - ray.origin, ray.direction) / square, part.u + third, part.v + third)
            half = 0.5 * part.size
            below = part.level + 1.0
            ab = middle(here.a, here.b)
            bc = middle(here.b, here.c)
            ca = middle(here.c, here.a)
            waiting[count] = Part(Corners(here.a, ab, ca), part.u, part.v, half, below)
            waiting[count + 1] = Part(Corners(ab, here.b, bc), part.u + half, part.v, half, below)
            waiting[count + 2] = Part(Corners(ca, bc, here.c), part.u, part.v + half, half, below)
            waiting[count + 3] = Part(Corners(bc, ca, ab), part.u + half, part.v + half, -half, below)
            count += 4
    return miss()


@dataclass(frozen=True)
class ScalarTest:
    """A test of one ray and one triangle, with neither lanes nor traversals; attributes as those of a `TriangleTest`."""

    name: str
    paper: str
    record: Record
    ray_state: type
    prepare: wp.Function
    intersect: wp.Function


TEST = ScalarTest(
    name="dammertz_keller",
    paper="Dammertz, Keller: Improving ray tracing precision by object space intersection computation (2006)",
    record=VERTICES,
    ray_state=PlainRay,
    prepare=prepare,
    intersect=intersect,
)
