"""Bounds of a triangle that are tested before the triangle itself: sphere, box and circle.

**Sphere and circle.** The smallest circle around a triangle has the longest edge as its diameter if the triangle is obtuse or
right, and passes through all three vertices if it is acute. In the triangle's own frame
(`wrt.kernels.classics.triangle.ferko.similarity`) its centre is (1/2, m) with m = max(0, (x^2 - x + y^2) / (2 y)): where the
second term is negative, the circumscribed circle is not the smallest. The sphere has the same centre and radius. The sphere
test compares the line's distance from the centre with the radius; the circle test asks whether the point at which the line
meets the plane lies in the circle.

**Box.** The point in the plane must lie in the triangle's box.

**Rounding.** A bound must not reject what the triangle test itself would accept. The line's distance from the sphere's centre
is computed from the cross product, not from |l|^2 - s^2 as in the thesis, which cancels for distant origins. The circle's
radius is widened by the rounding error of its centre, the box, whose faces touch the triangle, by that of the point, and the
sphere by that of the cross product. The error of t moves the point along the ray: from a great distance the circle and the
pruning use the point as computed, while the unit triangle projects it along an axis, so the two may differ at a vertex by that
error. The thesis also drops spheres behind the ray. Here a test sees the line, and the traversal applies the ray's range. Radii
are squared, so triangles shorter than 1e-18 are lost.

**Error in the printed form.** The derivation of the centre divides vectors by vectors; the system of equations at its end is
right.
"""

from typing import Any

import warp as wp

from wrt.kernels.classics.triangle.ferko.record_part import Part
from wrt.kernels.classics.triangle.ferko.similarity import Similarity, similarity
from wrt.kernels.triangle.support.record_blocks import Corners, corners_high, corners_low
from wrt.kernels.triangle.support.vectors import PlainRay, cross, crossed, dot, dotted, minus, three

Circle = wp.types.vector(length=4, dtype=wp.float32)
Box = wp.types.vector(length=6, dtype=wp.float32)

ROUNDINGS = wp.constant(1e-6)
"""Rounding error of a point, relative to the largest coordinate that occurs in its computation: about 16 units in the last
place."""


@wp.func
def circle_height(frame: Similarity):
    """y of the circle's centre in the triangle's own frame; its x is 1/2."""
    return wp.max(wp.float64(0.0), (frame.x * frame.x - frame.x + frame.y * frame.y) / (wp.float64(2.0) * frame.y))


@wp.func
def derive_circle(corners: Corners):
    """Centre and squared radius of the smallest circle."""
    frame = similarity(corners)
    half = wp.float64(0.5)
    height = circle_height(frame)
    centre = frame.origin + frame.edge * half + frame.up * height
    radius = wp.sqrt((half * half + height * height) * dot(frame.edge, frame.edge))
    size = wp.max(wp.abs(centre[0]), wp.max(wp.abs(centre[1]), wp.abs(centre[2]))) + radius
    widened = radius + wp.float64(ROUNDINGS) * size
    circle = Circle()
    for axis in range(3):
        circle[axis] = float(centre[axis])
    circle[3] = float(widened * widened)
    return circle


@wp.func
def derive_box(corners: Corners):
    """Lower and upper corner of the triangle's box."""
    low = corners_low(corners)
    high = corners_high(corners)
    return Box(low[0], low[1], low[2], high[0], high[1], high[2])


CIRCLE = Part(("mx", "my", "mz", "radius2"), derive_circle)
BOX = Part(("low_x", "low_y", "low_z", "high_x", "high_y", "high_z"), derive_box)


@wp.func
def largest(v: wp.vec3):
    """Largest absolute component."""
    x = wp.abs(v[0])
    y = wp.abs(v[1])
    z = wp.abs(v[2])
    xy = wp.where(x > y, x, y)
    return wp.where(xy > z, xy, z)


@wp.func
def meets_sphere(ray: PlainRay, own: Any, at: int):
    """Whether the line's distance from the centre is at most the radius. Uses (r + s)^2 <= 1.01 r^2 + 101 s^2."""
    d = ray.direction / largest(ray.direction)
    centre = three(own, at) - ray.origin
    moment = cross(centre, d)
    return dot(moment, moment) <= dot(d, d) * (1.01 * own[at + 3] + 1e-10 * dot(centre, centre))


@wp.func
def in_circle(point: wp.vec3, own: Any, at: int):
    """Whether a point of the plane lies in the circle."""
    away = point - three(own, at)
    return dot(away, away) <= own[at + 3]


@wp.func
def in_box(point: wp.vec3, t: float, ray: PlainRay, own: Any, at: int):
    """Whether the ray's point at t lies in the box."""
    slack = ROUNDINGS * (largest(ray.origin) + wp.abs(t) * largest(ray.direction))
    return (
        point[0] >= own[at] - slack
        and point[1] >= own[at + 1] - slack
        and point[2] >= own[at + 2] - slack
        and point[0] <= own[at + 3] + slack
        and point[1] <= own[at + 4] + slack
        and point[2] <= own[at + 5] + slack
    )


def largest_of(result: str, v: str) -> str:
    """C++ that declares the largest absolute component of a vector."""
    return f"""
        const float {result}_x = WRT_ABS({v}x), {result}_y = WRT_ABS({v}y), {result}_z = WRT_ABS({v}z);
        const float {result}_xy = {result}_x > {result}_y ? {result}_x : {result}_y;
        const float {result} = {result}_xy > {result}_z ? {result}_xy : {result}_z;
    """


SPHERE_STEP = (
    "beside the bounding sphere",
    f"""
        {largest_of("max_d", "d")}
        const float ex = dx / max_d, ey = dy / max_d, ez = dz / max_d;
        {minus("l", "m", "o")}{crossed("w", "l", "e")}
    """,
    f"{dotted('w', 'w')} <= {dotted('e', 'e')} * (1.01f * radius2 + 1e-10f * {dotted('l', 'l')})",
)
"""C++ for `meets_sphere`."""

CIRCLE_STEP = ("outside the bounding circle", minus("w", "p", "m"), f"{dotted('w', 'w')} <= radius2")
"""C++ for `in_circle`."""

BOX_STEP = (
    "outside the bounding box",
    f"""
        {largest_of("max_o", "o")}{largest_of("max_d", "d")}
        const float slack = 1e-6f * (max_o + WRT_ABS(t) * max_d);
    """,
    " & ".join(f"(p{a} >= low_{a} - slack) & (p{a} <= high_{a} + slack)" for a in "xyz"),
)
"""C++ for `in_box`."""
