"""A packet against the cells of a kd-tree: the interval of t in which any of its rays may be inside.

The interval (entry, leave) of a cell contains those of all rays: no ray enters earlier and no ray leaves later, as computed by
`wrt.kernels.traversal.single.single_kdtree`. Both ends come from the same expressions, evaluated on the ends of the packet's
intervals (`wrt.kernels.traversal.packet.culling.interval_culling` explains why this bounds the rounded values too, and the
effect of a NaN).

**Both signs along the plane's axis.** For rays with positive direction the left child is near, for rays with negative direction
the right child. No child is left by all rays where they enter the other, but one of the two can sometimes be excluded. Assume
that the plane is to the right of every origin. No ray with negative direction reaches it. The others reach it no sooner than
the fastest of them, with the least 1 / direction, from the rightmost origin. If that t is after the end of the cell, no ray
enters the right child. A packet whose directions straddle an axis of the scene therefore need not visit both children at every
plane.
"""

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds


@native.func_native(
    "packet_cells.h",
    """const wrt::Crossed crossed = wrt::cross_plane(bounds, axis, position, entry, leave);
    return wp::vec3(crossed.turn, crossed.near_leave, crossed.far_enter);""",
)
def cross_plane(bounds: wp.ref[PacketBounds], axis: int, position: float, entry: float, leave: float) -> wp.vec3:
    """`wrt.kernels.simd.boxes.cross_plane` for all rays of a packet that is in a cell from `entry` to `leave`.

    Returns (negative if the right child comes first, t at which the last ray leaves the first child, t at which the first ray
    enters the second). The first child is skipped if it is left before `entry`, the second if it is entered after `leave`. With
    both signs, the first child is the one in the direction of the faster rays.
    """


@wp.func
def enter_slab(bounds: PacketBounds, axis: int, low: wp.vec3, high: wp.vec3):
    """(entry, leave) of a box's extent along an axis, over all rays; NaN, which gives no bound, if the directions have both
    signs."""
    back = bounds.backward[axis] != 0
    large = bounds.inverse_large[axis]
    small = bounds.inverse_small[axis]
    to_near = wp.where(back, high[axis], low[axis]) - bounds.origin_in[axis]
    to_far = wp.where(back, low[axis], high[axis]) - bounds.origin_out[axis]
    near = wp.where(to_near * small < to_near * large, to_near * small, to_near * large)
    far = wp.where(to_far * small > to_far * large, to_far * small, to_far * large)
    return wp.vec2(near, far)


@wp.func
def enter_box(bounds: PacketBounds, low: wp.vec3, high: wp.vec3):
    """(entry, leave) of a box: the part of the packet's range in which any ray may be inside; empty if entry > leave.

    This is the scalar form, in plain Warp, of the loop over W boxes in `wrt.kernels.traversal.packet.culling.interval_culling`;
    tests compare the two bit for bit.
    """
    entry = float(bounds.t_min)
    leave = float(bounds.t_max)
    for axis in range(3):
        slab = enter_slab(bounds, axis, low, high)
        entry = wp.where(slab[0] > entry, slab[0], entry)
        leave = wp.where(slab[1] < leave, slab[1], leave)
        ahead = (low[axis] - (bounds.origin_high[axis] + bounds.slack)) * bounds.forward_small[axis]
        entry = wp.where(ahead > entry, ahead, entry)
        behind = (high[axis] - (bounds.origin_low[axis] - bounds.slack)) * bounds.backward_small[axis]
        entry = wp.where(behind > entry, behind, entry)
    return wp.vec2(entry, leave)
