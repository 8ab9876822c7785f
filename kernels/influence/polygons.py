"""Convex polygons in the plane: hull, clipping, area. Used for the few boxes of a tree that the fast expressions do not cover.

A polygon is the first `count` points of a local array with room for MAX_CORNERS, counter-clockwise.

References: sutherland-hodgman-1974; andrew-1979.
"""

import warp as wp

MAX_CORNERS = 40
"""The two chains of a hull of 20 points have at most 39 corners, even if rounding, overflow or NaN corrupt the turn tests.
Clipping stops at this number too."""


@wp.func
def cross(a: wp.vec2, b: wp.vec2):
    """Twice the signed area of a triangle from the origin."""
    return a[0] * b[1] - a[1] * b[0]


@wp.func
def polygon_area(polygon: wp.array(dtype=wp.vec2), count: int):
    """Signed area by the shoelace formula relative to the first corner, so that a small distant polygon keeps its digits."""
    twice = float(0.0)
    for i in range(2, count):
        twice += cross(polygon[i - 1] - polygon[0], polygon[i] - polygon[0])
    return 0.5 * twice


@wp.func
def clip(polygon: wp.array(dtype=wp.vec2), count: int, normal: wp.vec2, bound: float, spare: wp.array(dtype=wp.vec2)):
    """Keeps the part where normal . p <= bound; returns its number of corners (Sutherland and Hodgman 1974)."""
    kept = int(0)
    for i in range(count):
        here = polygon[i]
        after = polygon[wp.where(i + 1 < count, i + 1, 0)]
        inside = bound - wp.dot(normal, here)
        inside_after = bound - wp.dot(normal, after)
        if inside >= 0.0 and kept < MAX_CORNERS:
            spare[kept] = here
            kept += 1
        if (inside >= 0.0) != (inside_after >= 0.0) and kept < MAX_CORNERS:
            spare[kept] = here + (after - here) * (inside / (inside - inside_after))
            kept += 1
    for i in range(kept):
        polygon[i] = spare[i]
    return kept


@wp.func
def clip_to_window(polygon: wp.array(dtype=wp.vec2), count: int, half: wp.vec2):
    """Clips a polygon to the rectangle |x| <= half x, |y| <= half y; returns its number of corners."""
    spare = wp.zeros(shape=(MAX_CORNERS,), dtype=wp.vec2)
    left = int(count)
    side = int(0)
    while side < 4:  # a loop that Warp does not unroll, because many kernels compile this code
        sign = wp.where(side < 2, 1.0, -1.0)
        across = side % 2 == 0
        normal = wp.vec2(wp.where(across, sign, 0.0), wp.where(across, 0.0, sign))
        left = clip(polygon, left, normal, wp.where(across, half[0], half[1]), spare)
        side += 1
    return left


@wp.func
def clip_to_polygon(polygon: wp.array(dtype=wp.vec2), count: int, other: wp.array(dtype=wp.vec2), sides: int):
    """Clips a polygon to another one; returns its number of corners."""
    spare = wp.zeros(shape=(MAX_CORNERS,), dtype=wp.vec2)
    left = int(count)
    for side in range(sides):
        begin = other[side]
        along = other[wp.where(side + 1 < sides, side + 1, 0)] - begin
        outward = wp.vec2(along[1], -along[0])
        left = clip(polygon, left, outward, wp.dot(outward, begin), spare)
    return left


@wp.func
def sort_points(points: wp.array(dtype=wp.vec2), count: int):
    """Sorts a few points by x, then by y."""
    for i in range(1, count):
        point = points[i]
        at = int(i)
        while at > 0 and (points[at - 1][0] > point[0] or (points[at - 1][0] == point[0] and points[at - 1][1] > point[1])):
            points[at] = points[at - 1]
            at -= 1
        points[at] = point


@wp.func
def convex_hull(points: wp.array(dtype=wp.vec2), count: int, hull: wp.array(dtype=wp.vec2)):
    """Writes the convex hull of at most 20 points, which it sorts; returns its number of corners (Andrew 1979)."""
    sort_points(points, count)
    corners = int(0)
    kept = int(1)  # corners that stay: one of the lower chain; then, for the upper chain, the whole lower chain
    for i in range(2 * count - 1):
        point = points[wp.where(i < count, i, 2 * count - 2 - i)]
        while corners > kept and cross(hull[corners - 1] - hull[corners - 2], point - hull[corners - 2]) <= 0.0:
            corners -= 1
        hull[corners] = point
        corners += 1
        if i == count - 1:
            kept = corners
    return corners - wp.where(corners > 1, 1, 0)  # the last corner is the first one again
