"""Two tests at leaves after inverse frustum culling: entries along one axis against exits along another (Reshetov 2005).

**Problem.** Culling by a frustum keeps boxes that no ray meets, and at a leaf this costs a test of every triangle.

**Idea.** A ray misses a box if it enters the box's slab along one axis after it has left that along another. All rays of a
packet do so if the least of their entries along y is beyond the greatest of their exits along x, or the other way round.
Reshetov, Soupikov and Hurley compare x and y, across the axis of the view; here all three pairs of axes are compared.

The entries and exits are the numbers of the rays' own box tests, so no hit is lost (`wrt.kernels.simd.boxes`, the consistency
rule). Boxes and triangles are culled as by `inverse_frustum`.

**Cost.** One loop over the P rays per leaf, as for transient frusta, which use it for more.

References:
    A. Reshetov, A. Soupikov, J. Hurley: Multi-level ray tracing algorithm. SIGGRAPH 2005.
    V. Rahikainen: On real-time ray tracing. MSc thesis, University of Tampere, 2013 (section 3.3).
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.traversal.packet.rays.lane_intervals import INTERVALS
from wrt.kernels.traversal.packet.rays.packet_bounds import MAX_FEW_RAYS, PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout
from wrt.kernels.traversal.packet.rays.ray_box_slabs import SHARED_ORIGIN

exact_module(__name__)

_SEPARATED = f"""
    const float* box = &boxes.data[(size_t)node * (6 * W)] + lane;{SHARED_ORIGIN}
    float first[3], last[3];
    for (int a = 0; a < 3; ++a) {{
        const float low = box[a * W], high = box[(3 + a) * W];
        const float* inverse = a == 0 ? inverse_x : a == 1 ? inverse_y : inverse_z;
        const float* origin = a == 0 ? origin_x : a == 1 ? origin_y : origin_z;
        WRT_INTERVAL(entry); WRT_INTERVAL(leave);
        WRT_FOR(P, k) {{
            const float i = inverse[k], o = SHARED ? origin0[a] : origin[k], wide = SHARED ? slack0 : slack[k];
            const bool back = i < 0.0f, counts = t[k] > -INF;
            const float step = back ? -wide : wide;
            float in = ((back ? high : low) - (o + step)) * i, out = ((back ? low : high) - (o - step)) * i;
            in = in == in ? in : -INF; out = out == out ? out : INF;  // 0 * inf bounds nothing
            WRT_WIDEN(entry, in, counts) WRT_WIDEN(leave, out, counts)
        }}
        first[a] = wrt_value(entry_low); last[a] = wrt_value(leave_high);
    }}
    for (int a = 0; a < 3; ++a) {{
        const int b = a == 2 ? 0 : a + 1;
        if ((first[a] > last[b]) | (first[b] > last[a])) return 0;
    }}
    return {MAX_FEW_RAYS + 1};
"""


@cache
def leaf(layout: PacketLayout) -> wp.Function:
    """`Culling.leaf`: 0 if the rays as a whole pass beside a leaf's box, else more than `MAX_FEW_RAYS`."""

    @native.func_native("lanes.h", layout.head + INTERVALS + _SEPARATED)
    def entry_behind_exit(
        boxes: wp.array(dtype=float), node: int, lane: int, packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds]
    ) -> int: ...

    return entry_behind_exit
