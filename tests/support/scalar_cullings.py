"""Scalar reference forms of the culling loops, in plain Warp.

The native loops process W triangles of a block, or W child boxes, at a time. The functions here apply the same arithmetic to
one of them and are written for reading. No query calls them; tests compare them to the loops bit for bit. The module of each
culling explains why its decisions are conservative.

The form for triangles is a `wp.func(bounds, corners) -> bool`: whether the rays of `bounds` must be tested against the
triangle. The corners of an unused lane are NaN.
"""

import warp as wp

from wrt.kernels.classics.culling.corner_rays import MARGIN
from wrt.kernels.layout.ray_batch import TINY
from wrt.kernels.traversal.packet.core.packet_cells import enter_slab
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.triangle.support.record_blocks import Corners, corners_high, corners_low

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

CORNER_MARGIN = wp.constant(MARGIN)


@wp.func
def is_used(corners: Corners):
    """Whether a lane holds a triangle."""
    return corners.a[0] == corners.a[0]


@wp.func
def corner(corners: Corners, number: int):
    """Vertex 0, 1 or 2."""
    return wp.where(number == 0, corners.a, wp.where(number == 1, corners.b, corners.c))


@wp.func
def across(v: wp.vec3, axis: int):
    """Components of a vector along the two axes that follow a main axis, in cyclic order."""
    following = wp.where(axis == 2, 0, axis + 1)
    return wp.vec2(v[following], v[wp.where(following == 2, 0, following + 1)])


@wp.func
def lesser(a: wp.vec2, b: wp.vec2):
    """Componentwise minimum of numbers that are not NaN."""
    return wp.vec2(wp.where(a[0] < b[0], a[0], b[0]), wp.where(a[1] < b[1], a[1], b[1]))


@wp.func
def greater(a: wp.vec2, b: wp.vec2):
    """Componentwise maximum of numbers that are not NaN."""
    return wp.vec2(wp.where(a[0] > b[0], a[0], b[0]), wp.where(a[1] > b[1], a[1], b[1]))


@wp.func
def main_axis(bounds: PacketBounds):
    """The main axis of all rays; -1 if they differ."""
    axis = wp.where(bounds.main_axes == 1, 0, wp.where(bounds.main_axes == 2, 1, 2))
    return wp.where((bounds.main_axes & (bounds.main_axes - 1)) == 0, axis, -1)


@wp.func
def out_of_range(bounds: PacketBounds, axis: int, low: wp.vec3, high: wp.vec3):
    """Whether all rays leave the box's extent along an axis before their range begins, or enter it after their best hits."""
    slab = enter_slab(bounds, axis, low, high)
    return slab[0] > bounds.t_max or slab[1] < bounds.t_min


@wp.func
def every_ray_keeps(bounds: PacketBounds, corners: Corners):
    """`wrt.kernels.classics.culling.every_ray`: keeps every triangle."""
    return is_used(corners)


@wp.func
def interval_keeps(bounds: PacketBounds, corners: Corners):
    """`wrt.kernels.traversal.packet.culling.interval_culling`: whether some ray may be in the triangle's box along all three
    axes at the same t."""
    low = corners_low(corners)
    high = corners_high(corners)
    entry = float(bounds.t_min)
    leave = float(bounds.t_max)
    for axis in range(3):
        slab = enter_slab(bounds, axis, low, high)
        entry = wp.where(slab[0] > entry, slab[0], entry)
        leave = wp.where(slab[1] < leave, slab[1], leave)
    return entry <= leave and is_used(corners)


@wp.func
def vertex_keeps(bounds: PacketBounds, corners: Corners):
    """`wrt.kernels.traversal.packet.culling.vertex_culling`: whether on each side at least one vertex, sheared by the extreme
    slope, is not outside."""
    z = main_axis(bounds)
    if z < 0:
        return True
    left = bool(False)
    right = bool(False)
    below = bool(False)
    above = bool(False)
    for number in range(3):
        vertex = corner(corners, number)
        depth = vertex[z] - bounds.plane
        drift = depth * bounds.slope_low
        other = depth * bounds.slope_high
        to_low = (across(vertex, z) - bounds.through_low) - lesser(drift, other)
        to_high = (across(vertex, z) - bounds.through_high) - greater(drift, other)
        left = left or to_low[0] >= 0.0
        below = below or to_low[1] >= 0.0
        right = right or to_high[0] <= 0.0
        above = above or to_high[1] <= 0.0
    inside = left and right and below and above
    return inside and not out_of_range(bounds, z, corners_low(corners), corners_high(corners))


@wp.func
def side_planes_keep(bounds: PacketBounds, corners: Corners):
    """`wrt.kernels.traversal.packet.culling.side_planes`: whether no side of the frustum has all three vertices outside."""
    z = bounds.frame
    if z < 0:
        return interval_keeps(bounds, corners)
    left = bool(True)
    right = bool(True)
    below = bool(True)
    above = bool(True)
    for number in range(3):
        vertex = corner(corners, number)
        depth = (vertex[z] - bounds.near_plane) * bounds.forward
        place = across(vertex, z)
        low = bounds.side_low + bounds.rise_low * depth
        high = bounds.side_high + bounds.rise_high * depth
        left = left and place[0] < low[0] - bounds.margin
        below = below and place[1] < low[1] - bounds.margin
        right = right and place[0] > high[0] + bounds.margin
        above = above and place[1] > high[1] + bounds.margin
    beside = left or right or below or above
    return is_used(corners) and not (beside or out_of_range(bounds, z, corners_low(corners), corners_high(corners)))


@wp.func
def beside_frustum(bounds: PacketBounds, low: wp.vec3, high: wp.vec3):
    """Whether the two rectangles in which the frustum intersects the box's extent along the main axis lie on one side of the
    box."""
    z = bounds.frame
    near = (wp.where(bounds.forward < 0.0, high[z], low[z]) - bounds.near_plane) * bounds.forward - bounds.margin
    far = (wp.where(bounds.forward < 0.0, low[z], high[z]) - bounds.near_plane) * bounds.forward + bounds.margin
    near = wp.where(near > 0.0, near, 0.0)
    far = wp.where(far > 0.0, far, 0.0)
    near = wp.where(near < bounds.depth, near, bounds.depth)
    far = wp.where(far < bounds.depth, far, bounds.depth)
    rays_low = lesser(bounds.side_low + bounds.rise_low * near, bounds.side_low + bounds.rise_low * far)
    rays_high = greater(bounds.side_high + bounds.rise_high * near, bounds.side_high + bounds.rise_high * far)
    box_low = across(low, z)
    box_high = across(high, z)
    beside = bool(False)
    for axis in range(2):
        beside = beside or rays_low[axis] - bounds.margin > box_high[axis]
        beside = beside or rays_high[axis] + bounds.margin < box_low[axis]
    return beside


@wp.func
def enter_frustum(bounds: PacketBounds, low: wp.vec3, high: wp.vec3):
    """(entry, leave) of a box, as `wrt.kernels.traversal.packet.core.packet_cells.enter_box`, for a packet with a frustum:
    along the main axis only."""
    slab = enter_slab(bounds, bounds.frame, low, high)
    entry = wp.where(slab[0] > bounds.t_min, slab[0], bounds.t_min)
    leave = wp.where(slab[1] < bounds.t_max, slab[1], bounds.t_max)
    return wp.vec2(entry, wp.where(beside_frustum(bounds, low, high), -wp.inf, leave))


@wp.func
def frustum_keeps(bounds: PacketBounds, corners: Corners):
    """`wrt.kernels.classics.culling.inverse_frustum`: whether the triangle's box passes the test of `interval` and is
    not outside the frustum."""
    if not interval_keeps(bounds, corners):
        return False
    return bounds.frame < 0 or not beside_frustum(bounds, corners_low(corners), corners_high(corners))


@wp.func
def across_size(bounds: PacketBounds, p: wp.vec3, z: int):
    """Greatest sum of the absolute coordinates of a vertex, sheared by the slopes of a corner ray."""
    a = across(p, z) - bounds.slope_low * p[z]
    b = across(p, z) - bounds.slope_high * p[z]
    return wp.max(wp.abs(a[0]), wp.abs(b[0])) + wp.max(wp.abs(a[1]), wp.abs(b[1]))


@wp.func
def corner_rays_keep(bounds: PacketBounds, corners: Corners):
    """`wrt.kernels.classics.culling.corner_rays`: whether the four corner rays may pass all three edges on the same
    side.

    This applies to rays from one point; rays with separate origins are culled as in `interval`.
    """
    if not interval_keeps(bounds, corners):
        return False
    z = main_axis(bounds)
    if z < 0:
        return True
    front = bool(True)
    back = bool(True)
    for number in range(3):
        p = corner(corners, number) - bounds.origin_low
        q = corner(corners, wp.where(number == 2, 0, number + 1)) - bounds.origin_low
        size = across_size(bounds, p, z) + across_size(bounds, q, z)
        margin = CORNER_MARGIN * bounds.slack * (size + 4.0 * bounds.slack) + TINY
        some_front = bool(False)
        some_back = bool(False)
        for which in range(4):
            slope = wp.vec2(
                wp.where((which & 1) == 0, bounds.slope_low[0], bounds.slope_high[0]),
                wp.where((which & 2) == 0, bounds.slope_low[1], bounds.slope_high[1]),
            )
            a = across(p, z) - slope * p[z]
            b = across(q, z) - slope * q[z]
            area = a[0] * b[1] - a[1] * b[0]
            some_front = some_front or not area < -margin
            some_back = some_back or not area > margin
        front = front and some_front
        back = back and some_back
    return front or back
