"""The outline of a box as an influence area sees it, and the overlap of two projections within the area's window.

The corners on the outline follow from the eye's position relative to the box: along each axis below, beside or above it. A
table lists them for all 27 cases (`SILHOUETTES`). It is generated from the definition: an edge is on the outline if one of its
two faces is visible and the other is not. The outline of a box that the near plane cuts is the convex hull of the remaining
part: corners behind the plane have no projection, and the points where the plane cuts edges are new corners.

References: schmalstieg-tobler-1999; falcone-2024 (sections 5.4.1 and 5.4.2, appendices A.9 and A.10).
"""

from itertools import product

import numpy as np
import warp as wp

from wrt.kernels.influence.polygons import MAX_CORNERS, clip_to_polygon, clip_to_window, convex_hull, polygon_area
from wrt.kernels.influence.view import AreaView, direction_at, project, to_view_space


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
    ...


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
