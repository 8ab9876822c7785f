"""Interval culling, and each ray of a packet against the boxes of leaves.

**Problem.** Bounds of a whole packet also reach leaves that none of its rays reach. Of shadow rays, which start on a surface,
only few reach many of the leaves that their packet visits.

**Idea.** Before a leaf is tested, count the rays that meet its box within their remaining range. If none does, the leaf is
skipped; if few do, they are listed and tested one by one (`wrt.kernels.traversal.packet.core.few_active_rays`). This is the
first half of `transient_frustum`. The other half, a frustum around these rays, saves less than it costs where pairs of rays and
triangles are filtered (notebooks/records/2026-11-23-edge-functions.md).

References:
    A. Reshetov: Faster ray packets - triangle intersection through vertex culling. IEEE Symposium on Interactive Ray Tracing
        2007.
    I. Wald, S. Boulos, P. Shirley: Ray tracing deformable scenes using dynamic bounding volume hierarchies. ACM Transactions on
        Graphics 26(1), 2007 (rays against boxes until one meets).
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.traversal.packet.rays.packet_bounds import MAX_FEW_RAYS, PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout
from wrt.kernels.traversal.packet.rays.ray_box_slabs import SHARED_ORIGIN, SLABS

exact_module(__name__)

MEETING_HEAD = f"    constexpr int MAX_FEW_RAYS = {MAX_FEW_RAYS};\n"
"""C++ for the head of a function that contains `MEETING`, after `PacketLayout.head`."""

MEETING = f"""
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
        vector[f / W] = wrt::bits<W>(meets + f);
        met += wrt::count_bits(vector[f / W]);
    }}
    if (!met) return 0;
    if (met <= MAX_FEW_RAYS) {{
        for (int f = 0, place = 0; f < P; f += W) {{
            for (unsigned bits = vector[f / W]; bits; bits &= bits - 1u) bounds.few.c[place++] = f + wrt::lowest_bit(bits);
        }}
        return met;
    }}
"""
"""C++: counts the rays that meet the box in a lane of a node, as `met`, and marks them in `meets`; returns if they are few."""


@cache
def leaf(layout: PacketLayout) -> wp.Function:
    """`Culling.leaf`: counts the rays that meet a leaf's box."""

    @native.func_native("lanes.h", layout.head + MEETING_HEAD + MEETING + "    return met;\n")
    def leaf_rays(
        boxes: wp.array(dtype=float), node: int, lane: int, packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds]
    ) -> int: ...

    return leaf_rays
