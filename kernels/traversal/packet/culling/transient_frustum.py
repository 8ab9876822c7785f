"""Transient frusta: a frustum for each leaf, around the rays that are there (Reshetov 2007).

**Problem.** A packet that arrives at a leaf is not the one that set out: rays have found hits before it, shadow rays are
done, and others pass beside the leaf. The frustum of all rays is wider than need be.

**Idea.** At each leaf, cut the rays that meet its box, within what is left of their range, with the two planes of the box
across the main axis. Two rectangles bound these points; the frustum between them lives as long as the leaf is tested, and
drops the triangles whose vertices all lie beyond the same side (`side_planes`). Where no ray meets the box, the leaf is left;
where few do, they are named, and no frustum is made.

**What it costs.** A loop over the P rays at each leaf, which is what testing one triangle costs. Measured on bunny and dragon
with blocks of 16 triangles: the same speed as `vertex` in packets of 16, 1.0 to 1.4 times as fast in packets of 64, 1.3 to
2.9 times in packets of 256, most where origins differ. Of the triangles in the leaves it culls 49-88 % in views and 27-37 %
for shadow rays, where the paper, with hundreds of triangles in a leaf, culls more than 90 %.

**What we changed.** `vertex` is the same without the transient part, by the test's own numbers. Here the two planes are
those of the widened box, which holds all hits on the leaf's triangles. Nodes are culled by `interval`, and so is a packet
without a main axis.

References:
    A. Reshetov: Faster ray packets - triangle intersection through vertex culling.
        IEEE Symposium on Interactive Ray Tracing 2007.
    V. Rahikainen: On real-time ray tracing. MSc thesis, University of Tampere, 2013 (the survey), section 3.3.
"""

from functools import cache

import warp as wp

from wrt.kernels.simd.lanes import BITS
from wrt.kernels.traversal.packet.culling.inverse_frustum import FRAME
from wrt.kernels.traversal.packet.culling.ray_box_slabs import SHARED_ORIGIN, SLABS
from wrt.kernels.traversal.packet.culling.two_plane_frustum import POINTS_ON_PLANES
from wrt.kernels.traversal.packet.rays.lane_intervals import INTERVALS
from wrt.kernels.traversal.packet.rays.packet_bounds import FEW, PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

_MEETING = f"""
    const float* box = &boxes.data[(size_t)node * (6 * W)] + lane;
    const float low[3] = {{box[0], box[W], box[2 * W]}}, high[3] = {{box[3 * W], box[4 * W], box[5 * W]}};{SHARED_ORIGIN}
    int meets[P], met = 0;
    unsigned vector[P / W];
    for (int f = 0; f < P; f += W) {{
        WRT_FOR_LANES(i) {{
            const int k = f + i;
            float enter = t_min[k], leave = t[k];
{SLABS}
            meets[k] = ((enter <= leave) & (t[k] > -INF)) ? -1 : 0;
        }}
        vector[f / W] = wrt_bits(meets + f);
        met += wrt_count_bits(vector[f / W]);
    }}
    if (!met) return 0;
    if (met <= FEW) {{
        for (int f = 0, place = 0; f < P; f += W) {{
            for (unsigned bits = vector[f / W]; bits; bits &= bits - 1u) bounds.few.c[place++] = f + wrt_lowest_bit(bits);
        }}
        return met;
    }}
    if (bounds.frame < 0) return met;
    const int z = bounds.frame, x = z == 2 ? 0 : z + 1, y = x == 2 ? 0 : x + 1;
    const bool back = bounds.forward < 0.0f;
    bounds.near_plane = back ? high[z] + bounds.margin : low[z] - bounds.margin;
    bounds.depth = (high[z] - low[z]) + 2.0f * bounds.margin;
"""


@cache
def start(layout: PacketLayout) -> wp.Function:
    """`Culling.start`: finds the main axis."""

    @wp.func_native(layout.constants + FRAME)
    def transient_start(low: wp.vec3, high: wp.vec3, packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds]): ...

    return transient_start


@cache
def leaf(layout: PacketLayout) -> wp.Function:
    """`Culling.leaf`: the frustum of the rays that meet a leaf's box; 0 if none does."""
    points = POINTS_ON_PLANES.replace("WRT_COUNTS", "meets[k] != 0")

    few = f"    constexpr int FEW = {FEW};\n"

    @wp.func_native(layout.head + few + INTERVALS + BITS + _MEETING + points + "    return met;\n")
    def transient_frustum(
        boxes: wp.array(dtype=float), node: int, lane: int, packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds]
    ) -> int: ...

    return transient_frustum
