"""The outline of a box as an influence area sees it, and the overlap of two projections within the area's window.

The corners on the outline follow from the eye's position relative to the box: along each axis below, beside or above it. A
table lists them for all 27 cases (`SILHOUETTES`). It is generated from the definition: an edge is on the outline if one of its
two faces is visible and the other is not. The outline of a box that the near plane cuts is the convex hull of the remaining
part: corners behind the plane have no projection, and the points where the plane cuts edges are new corners.

**Polygons** are for the few boxes of a tree that the fast expressions do not cover: hull, clipping, area. A polygon is the
first `count` points of a local array with room for MAX_CORNERS, counter-clockwise.

References: schmalstieg-tobler-1999; falcone-2024 (sections 5.4.1 and 5.4.2, appendices A.9 and A.10); sutherland-hodgman-1974;
    andrew-1979.
"""

from itertools import product

import numpy as np
import warp as wp

from wrt.kernels.influence.view import AreaView, direction_at, project, to_view_space

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


def _outline(signs: tuple[int, ...]) -> list[int]:
    """Corners of the outline of a box, counter-clockwise, seen in a direction with these signs. 0: the eye is between the two
    faces of that axis."""
    if signs == (0, 0, 0):
        return []

    def is_front_facing(axis: int, end: int) -> bool:
        return signs[axis] == (-1 if end else 1)

    edges = {c: [] for c in range(8)}
    for axis, corner in product(range(3), range(8)):
        if not corner >> axis & 1:
            faces = [is_front_facing(other, corner >> other & 1) for other in range(3) if other != axis]
            if faces[0] != faces[1]:
                edges[corner].append(corner | 1 << axis)
                edges[corner | 1 << axis].append(corner)
    start = next(c for c in range(8) if edges[c])
    loop = [start, edges[start][0]]
    while loop[-1] != start:
        loop.append(next(c for c in edges[loop[-1]] if c != loop[-2]))
    loop.pop()
    return loop if _turns_left(loop, signs) else loop[::-1]


def _turns_left(loop: list[int], signs: tuple[int, ...]) -> bool:
    """Whether the corners run counter-clockwise, with right = forward x up as in `AreaView`."""
    corners = np.array([[c >> axis & 1 for axis in range(3)] for c in loop], dtype=float)
    normal = np.cross(corners, np.roll(corners, -1, axis=0)).sum(axis=0)
    return float(normal @ np.array(signs)) < 0.0


def _packed(loop: list[int]) -> int:
    """Number of corners in bits 0 to 2; corner i in the 3 bits from bit 3 + 3 i on."""
    return len(loop) | sum(corner << 3 + 3 * i for i, corner in enumerate(loop))


SILHOUETTES = tuple(_packed(_outline(signs[::-1])) for signs in product((-1, 0, 1), repeat=3))
"""Outlines, indexed by (s_x + 1) + 3 (s_y + 1) + 9 (s_z + 1), packed by `_packed`. s = 1: seen from below the axis, -1:
above."""


@wp.func_native(f"""
    const int table[27] = {{{", ".join(map(str, SILHOUETTES))}}};
    return table[index];
""")
def silhouette(index: int) -> int:
    """Entry of `SILHOUETTES`."""


@wp.func
def corner_of(low: wp.vec3, high: wp.vec3, index: int):
    """Corner of a box. Bit a of the index selects the upper end along axis a."""
    return wp.vec3(
        wp.where((index & 1) != 0, high[0], low[0]),
        wp.where((index & 2) != 0, high[1], low[1]),
        wp.where((index & 4) != 0, high[2], low[2]),
    )


@wp.func
def side_of(view: AreaView, low: wp.vec3, high: wp.vec3):
    """Index of a box into `SILHOUETTES`."""
    below = direction_at(view, low)
    above = direction_at(view, high)
    index = int(0)
    factor = int(1)
    for axis in range(3):
        index += factor * wp.where(below[axis] > 0.0, 2, wp.where(above[axis] < 0.0, 0, 1))
        factor *= 3
    return index


@wp.func
def min_depth(view: AreaView, low: wp.vec3, high: wp.vec3):
    """Depth of the nearest corner of a box."""
    nearest = wp.vec3(
        wp.where(view.forward[0] > 0.0, low[0], high[0]),
        wp.where(view.forward[1] > 0.0, low[1], high[1]),
        wp.where(view.forward[2] > 0.0, low[2], high[2]),
    )
    return wp.dot(view.forward, nearest - view.eye)


@wp.func
def cut_corners(view: AreaView, low: wp.vec3, high: wp.vec3, points: wp.array(dtype=wp.vec2)):
    """Projections of the corners of the part of a box behind the near plane; returns their number, at most 20."""
    count = int(0)
    for c in range(8):
        here = to_view_space(view, corner_of(low, high, c))
        kept = here[2] >= view.near
        if kept:
            points[count] = project(view, here)
            count += 1
        for axis in range(3):
            if (c >> axis) & 1 == 0:
                there = to_view_space(view, corner_of(low, high, c | (1 << axis)))
                if kept != (there[2] >= view.near):
                    cut = here + (there - here) * ((view.near - here[2]) / (there[2] - here[2]))
                    points[count] = project(view, wp.vec3(cut[0], cut[1], wp.where(view.radial, view.near, 1.0)))
                    count += 1
    return count


@wp.func
def projected_hull(view: AreaView, low: wp.vec3, high: wp.vec3, hull: wp.array(dtype=wp.vec2)):
    """Writes the projection of a box, not clipped to the window; returns its number of corners, 0 if it has no projection."""
    if min_depth(view, low, high) >= view.near:
        entry = silhouette(side_of(view, low, high))
        count = entry & 7
        for i in range(count):
            hull[i] = project(view, to_view_space(view, corner_of(low, high, (entry >> (3 + 3 * i)) & 7)))
        return count
    points = wp.zeros(shape=(MAX_CORNERS,), dtype=wp.vec2)
    found = cut_corners(view, low, high, points)
    return convex_hull(points, found, hull)


@wp.func
def visible_hull(view: AreaView, low: wp.vec3, high: wp.vec3, hull: wp.array(dtype=wp.vec2)):
    """Writes the part of a box's projection within the window; returns its number of corners."""
    return clip_to_window(hull, projected_hull(view, low, high, hull), view.half)


@wp.func
def shared_area(view: AreaView, low: wp.vec3, high: wp.vec3, other_low: wp.vec3, other_high: wp.vec3):
    """Area of the overlap of the projections of two boxes within the window: the measure of the rays that meet both."""
    one = wp.zeros(shape=(MAX_CORNERS,), dtype=wp.vec2)
    other = wp.zeros(shape=(MAX_CORNERS,), dtype=wp.vec2)
    corners = visible_hull(view, low, high, one)
    sides = visible_hull(view, other_low, other_high, other)
    if sides < 3:
        return 0.0
    return wp.abs(polygon_area(one, clip_to_polygon(one, corners, other, sides)))
