"""Convex polygons in the plane: hull, clipping, area. For the few boxes of a tree whose projection needs them.

A polygon is the first `count` points of a local array with room for MAX_CORNERS, counter-clockwise.

References:
    I. E. Sutherland, G. W. Hodgman: Reentrant polygon clipping. Communications of the ACM 17(1), 1974.
    A. M. Andrew: Another efficient algorithm for convex hulls in two dimensions. Information Processing Letters 9(5), 1979.
"""

import warp as wp

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

MAX_CORNERS = 40
"""The two chains of a hull of 20 points have at most 39, whatever rounding, overflow or NaN make of their turns; clipping
leaves at most so many in any case."""


@wp.func
def cross(a: wp.vec2, b: wp.vec2):
    """Twice the signed area of a triangle from the origin."""
    return a[0] * b[1] - a[1] * b[0]


@wp.func
def polygon_area(polygon: wp.array(dtype=wp.vec2), count: int):
    """Signed area, by the shoelace formula from the first corner, so that a small polygon far off keeps its digits."""
    twice = float(0.0)
    for i in range(2, count):
        twice += cross(polygon[i - 1] - polygon[0], polygon[i] - polygon[0])
    return 0.5 * twice


@wp.func
def clip(polygon: wp.array(dtype=wp.vec2), count: int, normal: wp.vec2, bound: float, clipped: wp.array(dtype=wp.vec2)):
    """Writes the part where normal . p <= bound; returns its number of corners (Sutherland and Hodgman 1974)."""
    kept = int(0)
    for i in range(count):
        here = polygon[i]
        after = polygon[wp.where(i + 1 < count, i + 1, 0)]
        inside = bound - wp.dot(normal, here)
        inside_after = bound - wp.dot(normal, after)
        if inside >= 0.0 and kept < MAX_CORNERS:
            clipped[kept] = here
            kept += 1
        if (inside >= 0.0) != (inside_after >= 0.0) and kept < MAX_CORNERS:
            clipped[kept] = here + (after - here) * (inside / (inside - inside_after))
            kept += 1
    return kept


@wp.func
def clip_to_window(polygon: wp.array(dtype=wp.vec2), count: int, half: wp.vec2):
    """Cuts a polygon off at the rectangle |x| <= half x, |y| <= half y, in place; returns its number of corners."""
    spare = wp.zeros(shape=(MAX_CORNERS,), dtype=wp.vec2)
    left = clip(polygon, count, wp.vec2(1.0, 0.0), half[0], spare)
    left = clip(spare, left, wp.vec2(-1.0, 0.0), half[0], polygon)
    left = clip(polygon, left, wp.vec2(0.0, 1.0), half[1], spare)
    return clip(spare, left, wp.vec2(0.0, -1.0), half[1], polygon)


@wp.func
def clip_to_polygon(polygon: wp.array(dtype=wp.vec2), count: int, other: wp.array(dtype=wp.vec2), sides: int):
    """Cuts a polygon off at another one's sides, in place; returns its number of corners."""
    spare = wp.zeros(shape=(MAX_CORNERS,), dtype=wp.vec2)
    left = int(count)
    for side in range(sides):
        begin = other[side]
        along = other[wp.where(side + 1 < sides, side + 1, 0)] - begin
        outward = wp.vec2(along[1], -along[0])
        left = clip(polygon, left, outward, wp.dot(outward, begin), spare)
        for i in range(left):
            polygon[i] = spare[i]
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
def add_corner(hull: wp.array(dtype=wp.vec2), corners: int, least: int, point: wp.vec2):
    """Continues a chain that turns left; at least `least` corners stay. Returns the number of corners."""
    left = int(corners)
    while left > least and cross(hull[left - 1] - hull[left - 2], point - hull[left - 2]) <= 0.0:
        left -= 1
    hull[left] = point
    return left + 1


@wp.func
def convex_hull(points: wp.array(dtype=wp.vec2), count: int, hull: wp.array(dtype=wp.vec2)):
    """Writes the convex hull of at most 20 points, which it sorts; returns its number of corners (Andrew 1979)."""
    sort_points(points, count)
    corners = int(0)
    for i in range(count):
        corners = add_corner(hull, corners, 1, points[i])
    lower = int(corners)
    for i in range(1, count):
        corners = add_corner(hull, corners, lower, points[count - 1 - i])
    return corners - wp.where(corners > 1, 1, 0)  # the last corner is the first one again
