"""Two-plane frustum culling for rays without a shared origin (Overbeck, Ramamoorthi and Mark 2008).

**Problem.** If rays start at different points, separate intervals of origins and slopes lose the correlation between them.
Shadow rays start anywhere on a surface and converge at the light, but a frustum of extreme origins and extreme slopes widens
towards the light.

**Idea.** Two planes normal to the packet's main axis bound all rays: a near one behind all origins, a far one behind the scene.
Each ray crosses both, and two rectangles bound the points. The volume between corresponding sides of the rectangles is a
frustum around all rays: at every depth a ray is a weighted mean of its own two points, and therefore between the means of the
extremes.

**Data.** The lines of `PacketBounds`, as in `inverse_frustum`: side is the near rectangle, rise is the difference of the two
rectangles divided by the depth. The set-up intersects P rays with two planes, once per packet; the other cullings do not have
this cost.

**Differences from the paper.** Boxes are culled as in `inverse_frustum`; triangles are culled if their three vertices lie
outside the same side (`side_planes`). If the scene ends soon after the origins, the far plane is moved to at least half of the
reach, so that extending a side backward magnifies its rounding at most five times. If all rays share an origin, the near
rectangle is that point. A packet without a main axis is culled by `interval_culling`.

References:
    R. Overbeck, R. Ramamoorthi, W. R. Mark: Large ray packets for real-time Whitted ray tracing. IEEE Symposium on Interactive
        Ray Tracing 2008.
    V. Rahikainen: On real-time ray tracing. MSc thesis, University of Tampere, 2013 (section 3.3).
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.boxes import SLACK
from wrt.kernels.traversal.packet.culling.inverse_frustum import FRAME
from wrt.kernels.traversal.packet.rays.lane_intervals import INTERVALS
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout

exact_module(__name__)

POINTS_ON_PLANES = """
    const float near_plane = bounds.near_plane, forward = bounds.forward, depth = bounds.depth;
    const float x0 = bounds.origin_low.c[0], y0 = bounds.origin_low.c[1], z0 = bounds.origin_low.c[2];
    WRT_INTERVAL(near_x); WRT_INTERVAL(near_y); WRT_INTERVAL(far_x); WRT_INTERVAL(far_y);
    WRT_FOR(P, k) {
        const float o0 = SHARED ? x0 : origin_x[k], o1 = SHARED ? y0 : origin_y[k], o2 = SHARED ? z0 : origin_z[k];
        // chosen as numbers: a loop with pointers chosen at run time would not be vectorised
        const float ox = z == 0 ? o1 : z == 1 ? o2 : o0, oy = z == 0 ? o2 : z == 1 ? o0 : o1;
        const float oz = z == 0 ? o0 : z == 1 ? o1 : o2;
        const bool counts = WRT_COUNTS;
        const float rise_x = slope_x[k] * forward, rise_y = slope_y[k] * forward, begin = (oz - near_plane) * forward;
        WRT_WIDEN(near_x, ox - rise_x * begin, counts) WRT_WIDEN(far_x, ox + rise_x * (depth - begin), counts)
        WRT_WIDEN(near_y, oy - rise_y * begin, counts) WRT_WIDEN(far_y, oy + rise_y * (depth - begin), counts)
    }
    bounds.side_low = wp::vec2(wrt_value(near_x_low), wrt_value(near_y_low));
    bounds.side_high = wp::vec2(wrt_value(near_x_high), wrt_value(near_y_high));
    bounds.rise_low = wp::vec2((wrt_value(far_x_low) - bounds.side_low.c[0]) / depth,
                               (wrt_value(far_y_low) - bounds.side_low.c[1]) / depth);
    bounds.rise_high = wp::vec2((wrt_value(far_x_high) - bounds.side_high.c[0]) / depth,
                                (wrt_value(far_y_high) - bounds.side_high.c[1]) / depth);
"""
"""C++ that sets the frustum, between two planes, of the rays selected by `WRT_COUNTS`."""

_START = f"""
    const float scene_end = ((back ? low : high).c[z] - bounds.near_plane) * bounds.forward + bounds.margin;
    const float least_depth = bounds.slack * {0.5 / SLACK!r}f;  // half of the reach
    bounds.depth = scene_end > least_depth ? scene_end : least_depth;
"""


@cache
def start(layout: PacketLayout) -> wp.Function:
    """`Culling.start`: sets up the frustum between the rearmost origin and the end of the scene."""
    points = POINTS_ON_PLANES.replace("WRT_COUNTS", "t[k] > -INF")

    @native.func_native("lanes.h", layout.head + INTERVALS + FRAME + _START + points)
    def two_plane_frustum(low: wp.vec3, high: wp.vec3, packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds]): ...

    return two_plane_frustum
