"""Inverse frustum culling: the planes of a box separate it from the packet (Reshetov, Soupikov and Hurley 2005).

**Problem.** The usual test, a box against the side planes of a frustum, fails to cull more of the boxes outside the frustum the
larger they are. It also needs the planes of a frustum, which rays without a shared origin do not have.

**Idea.** Exchange the roles. Intersect the rays with the planes of the box that are normal to the packet's main axis. Two
rectangles bound the points in which the rays enter and leave the box's extent along that axis. If both rectangles lie on the
same side of the box, so does everything between them, and no ray meets the box. Boxes that are kept although no ray meets them
lie near the edges of the frustum. At the leaves most of them are culled by two more tests: the packet misses if its least entry
into the extent along x is later than its greatest exit from the extent along y, or vice versa.

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

References:
    A. Reshetov, A. Soupikov, J. Hurley: Multi-level ray tracing algorithm. SIGGRAPH 2005.
    V. Rahikainen: On real-time ray tracing. MSc thesis, University of Tampere, 2013 (section 3.3).
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.box_lanes import NO_CHILD_CONSTANT
from wrt.kernels.traversal.packet.culling import interval_culling as interval
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout

exact_module(__name__)

MARGIN = 8.0
"""Widening of boxes and triangles against the frustum, in slacks (`wrt.kernels.simd.boxes.SLACK` of the farthest reach)."""

STEEPEST = 2.0**100
"""Greatest 1 / direction along the main axis. Within this bound, a component across it whose reciprocal overflows has a
negligible slope."""

FRAME = f"""
    const int common_axis = bounds.main_axes == 1 ? 0 : bounds.main_axes == 2 ? 1 : bounds.main_axes == 4 ? 2 : -1;
    // a main axis along which directions have both signs has NaN here
    bounds.frame = common_axis >= 0 && WRT_ABS(bounds.inverse_large.c[common_axis]) <= {STEEPEST!r}f ? common_axis : -1;
    if (bounds.frame < 0) return;
    const int z = common_axis, x = z == 2 ? 0 : z + 1, y = x == 2 ? 0 : x + 1;
    const bool back = bounds.backward.c[z];
    bounds.forward = back ? -1.0f : 1.0f;
    bounds.margin = {MARGIN!r}f * bounds.slack;
    bounds.near_plane = back ? bounds.origin_high.c[z] : bounds.origin_low.c[z];
"""
"""C++ that begins the set-up of a frustum: its axes and its start at the rearmost origin; returns if the packet has no
frustum."""

_START = """
    bounds.depth = INF;
    const float spread = bounds.origin_high.c[z] - bounds.origin_low.c[z];
    for (int a = 0; a < 2; ++a) {
        const int axis = a ? y : x;
        const float low = back ? -bounds.slope_high.c[a] : bounds.slope_low.c[a];
        const float high = back ? -bounds.slope_low.c[a] : bounds.slope_high.c[a];
        bounds.rise_low.c[a] = low;
        bounds.rise_high.c[a] = high;
        // a ray begins up to `spread` behind the near plane, and only from there on it rises
        bounds.side_low.c[a] = bounds.origin_low.c[axis] - (low > 0.0f ? low * spread : 0.0f);
        bounds.side_high.c[a] = bounds.origin_high.c[axis] - (high < 0.0f ? high * spread : 0.0f);
    }
"""

SIDES = """
    const int z = bounds.frame, x = z == 2 ? 0 : z + 1, y = x == 2 ? 0 : x + 1;
    const float near_plane = bounds.near_plane, forward = bounds.forward, end = bounds.depth, margin = bounds.margin;
    const float low_x = bounds.side_low.c[0], low_y = bounds.side_low.c[1];
    const float high_x = bounds.side_high.c[0], high_y = bounds.side_high.c[1];
    const float rise_low_x = bounds.rise_low.c[0], rise_low_y = bounds.rise_low.c[1];
    const float rise_high_x = bounds.rise_high.c[0], rise_high_y = bounds.rise_high.c[1];
    const float in_z = bounds.origin_in.c[z], out_z = bounds.origin_out.c[z];
    const float large = bounds.inverse_large.c[z], small = bounds.inverse_small.c[z];
    const float t_min = bounds.t_min, t_max = bounds.t_max;
    const bool back = forward < 0.0f;
"""
"""C++ that loads the frustum into local variables."""

_SEPARATE = """
        float d0 = (near_z - near_plane) * forward - margin, d1 = (far_z - near_plane) * forward + margin;
        d0 = d0 > 0.0f ? d0 : 0.0f; d1 = d1 > 0.0f ? d1 : 0.0f;
        d0 = d0 < end ? d0 : end; d1 = d1 < end ? d1 : end;
        float e, f;
        e = low_x + rise_low_x * d0; f = low_x + rise_low_x * d1; const float rays_x0 = (e < f ? e : f) - margin;
        e = high_x + rise_high_x * d0; f = high_x + rise_high_x * d1; const float rays_x1 = (e > f ? e : f) + margin;
        e = low_y + rise_low_y * d0; f = low_y + rise_low_y * d1; const float rays_y0 = (e < f ? e : f) - margin;
        e = high_y + rise_high_y * d0; f = high_y + rise_high_y * d1; const float rays_y1 = (e > f ? e : f) + margin;
        const bool beside = (rays_x0 > box_x1) | (rays_x1 < box_x0) | (rays_y0 > box_y1) | (rays_y1 < box_y0);
"""

_BOXES = f"""
    if (bounds.frame < 0) {{{interval.BOXES}}}
    const float* box = &boxes.data[(size_t)node * (6 * W)];{SIDES}
    int* key = &keys.data[first];
    int least = NO_CHILD;
    WRT_FOR_LANES(i) {{
        const float box_x0 = box[x * W + i], box_y0 = box[y * W + i], box_z0 = box[z * W + i];
        const float box_x1 = box[(3 + x) * W + i], box_y1 = box[(3 + y) * W + i], box_z1 = box[(3 + z) * W + i];
        const float near_z = back ? box_z1 : box_z0, far_z = back ? box_z0 : box_z1;
        {_SEPARATE}
        float enter = t_min, leave = t_max, d, p, q;
        d = near_z - in_z; p = d * large; q = d * small; q = q < p ? q : p; enter = q > enter ? q : enter;
        d = far_z - out_z; p = d * large; q = d * small; q = q > p ? q : p; leave = q < leave ? q : leave;
        int k = (__builtin_bit_cast(int, enter) & -W) | i;
        k = ((enter <= leave) & !beside) ? k : NO_CHILD;
        key[i] = k;
        least = k < least ? k : least;
    }}
    return least;
"""

_TRIANGLES = f"""
    const unsigned met = [&]() -> unsigned {{{interval.TRIANGLES}}}();  // the two tests at a leaf
    if (bounds.frame < 0 || !met) return met;
    const float* r = &records.data[(size_t)block * (RECORD * W)];{SIDES}
    int kept[W];
    WRT_FOR_LANES(i) {{
        float lows[3], highs[3];
        for (int a = 0; a < 3; ++a) {{
            const int axis = a == 0 ? x : a == 1 ? y : z;
            const float p = r[axis * W + i], q = r[(3 + axis) * W + i], s = r[(6 + axis) * W + i];
            float least = p < q ? p : q, most = p > q ? p : q;
            lows[a] = least < s ? least : s; highs[a] = most > s ? most : s;
        }}
        const float box_x0 = lows[0], box_y0 = lows[1], box_x1 = highs[0], box_y1 = highs[1];
        const float near_z = back ? highs[2] : lows[2], far_z = back ? lows[2] : highs[2];
        {_SEPARATE}
        kept[i] = beside ? 0 : -1;
    }}
    return wrt::bits<W>(kept) & met;
"""


@cache
def start(layout: PacketLayout) -> wp.Function:
    """`Culling.start`: sets up the frustum from the packet's origins and slopes."""

    @native.func_native("lanes.h", layout.constants + FRAME + _START)
    def slope_frustum(low: wp.vec3, high: wp.vec3, packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds]): ...

    return slope_frustum


@cache
def cull_boxes(layout: PacketLayout) -> wp.Function:
    """`Culling.boxes`: frustum of the packet x W child boxes; keys as in `wrt.kernels.simd.box_lanes.ray_boxes`."""

    @native.func_native("lanes.h", f"{layout.constants}    constexpr int NO_CHILD = {NO_CHILD_CONSTANT};{_BOXES}")
    def frustum_boxes(
        boxes: wp.array(dtype=float),
        node: int,
        packet: wp.array(dtype=float),
        bounds: wp.ref[PacketBounds],
        keys: wp.array(dtype=int),
        first: int,
    ) -> int: ...

    return frustum_boxes


@cache
def cull_triangles(layout: PacketLayout) -> wp.Function:
    """`Culling.triangles`: frustum of the packet x the boxes of the W triangles of a block."""

    @native.func_native("lanes.h", f"{layout.constants}{_TRIANGLES}")
    def frustum_triangles(records: wp.array(dtype=float), block: int, bounds: wp.ref[PacketBounds]) -> wp.uint32: ...

    return frustum_triangles
