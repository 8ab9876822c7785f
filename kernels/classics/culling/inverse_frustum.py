"""Inverse frustum culling: the planes of a box separate it from the packet (Reshetov, Soupikov and Hurley 2005).

**Problem.** The usual test, a box against the side planes of a frustum, fails to cull more of the boxes outside the frustum the
larger they are. It also needs the planes of a frustum, which rays without a shared origin do not have.

**Idea.** Exchange the roles. Intersect the rays with the planes of the box that are normal to the packet's main axis. Two
rectangles bound the points in which the rays enter and leave the box's extent along that axis. If both rectangles lie on the
same side of the box, so does everything between them, and no ray meets the box. Boxes that are kept although no ray meets them
lie near the edges of the frustum. At the leaves most of them are culled by two more tests: the packet misses if its least entry
into the extent along x is later than its greatest exit from the extent along y, or vice versa.

**Steps.**

1. `start`, once per packet: along both axes across the main one, two lines over the depth between which all rays are.
2. A box is entered at its near plane and left at its far one: the lines give a rectangle at each of the two depths.
3. It is culled if both rectangles lie beyond the same side of it, else its key is the entry along the main axis.
4. `cull_triangles`, at a leaf: the same for the box of each triangle.

**Data.** A `PacketBounds` frustum: a depth along the main axis, and along each of the other two axes two lines over the depth,
side + rise * depth, between which all rays are. Here the lines follow from the intervals of origins and slopes: the rectangle
of the origins at the start, widened by the extreme slopes.

**Differences from the paper.** The tree is a BVH, so a box is tested as a whole, not one plane per step. Children are ordered
by the entry along the main axis, by interval arithmetic. At a leaf the box of each triangle is tested in the same way, and the
two further tests, for all three pairs of axes, are those of `interval_culling`. A packet has no frustum, and is culled by
`interval_culling`, if the main axes of its rays or their signs along it differ, or if a direction is so short that 1 /
direction may overflow.

**Why the hits do not change.** The ray of a hit meets the triangle's own widened box (`wrt.kernels.simd.boxes`). The computed
entries and exits have a t in common, and each is rounded three times, so at this t the ray is, in exact arithmetic, within
slack + 4 u reach of the box along every axis (u = 2^-24; the slack is 16 u reach; the reach of a ray is the distance of the
farthest corner of the scene). The lines are computed from slopes and origins with errors of at most about 40 u reach where they
are extended most. `MARGIN` is 128 u reach; boxes are widened by it. No ray exists before its origin, so none is at a depth
below 0, and no hit is behind the scene: boxes are clipped at both ends.

References: reshetov-2005; rahikainen-2013 (section 3.3).
"""

from functools import cache

import warp as wp

from wrt.kernels.traversal.packet.culling.culling_hooks import bounds_set_by, boxes_culled_by, triangles_culled_by
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout

MARGIN = 8.0
"""Widening of boxes and triangles against the frustum, in slacks (`wrt.kernels.simd.boxes.SLACK` of the farthest reach)."""

STEEPEST = 2.0**100
"""Greatest 1 / direction along the main axis. Within this bound, a component across it whose reciprocal overflows has a
negligible slope."""

GUARDS = f"static_assert(wrt::FRUSTUM_MARGIN == {MARGIN!r}f && wrt::STEEPEST_INVERSE == {STEEPEST!r}f);"
"""C++: the constants of frusta have these values."""


@cache
def start(layout: PacketLayout) -> wp.Function:
    """Sets up the frustum from the packet's origins and slopes."""
    return bounds_set_by("packet_frusta.h", f"{GUARDS}\nwrt::set_slope_frustum(bounds);")


@cache
def cull_boxes(layout: PacketLayout) -> wp.Function:
    """Frustum of the packet x W child boxes; keys as in `wrt.kernels.simd.box_lanes.ray_boxes`."""
    call = f"return wrt::frustum_keys<{layout.width}>({layout.box}, bounds, keys.data + first);"
    return boxes_culled_by("packet_frusta.h", call)


@cache
def cull_triangles(layout: PacketLayout) -> wp.Function:
    """Frustum of the packet x the boxes of the W triangles of a block."""
    return triangles_culled_by("packet_frusta.h", f"return wrt::frustum_mask<{layout.width}>({layout.block}, bounds);")
