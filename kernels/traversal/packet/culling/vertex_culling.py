"""Vertex culling at the leaves: culls triangles outside the packet's frustum (Reshetov 2007).

**Idea.** Along the packet's main axis, a ray passes through (s z, t z) at depth z, with slopes s and t in the packet's
intervals. No ray can hit a triangle whose three vertices lie outside the same one of the four planes that these intervals span.
W triangles are tested at a time, before any ray is.

**Differences from the paper.** The paper builds a transient frustum per leaf from the exits of the rays. Here the frustum is
that of the slopes, and it is never built: the watertight test's own expression for a sheared vertex, (x - o) - s (z - p), is
evaluated on intervals, where o is the point in which the ray crosses the plane z = p near the origins. Rays that share an
origin have the same o and p, and the bounded value is the very number that the test computes. If it is negative for three
vertices, the ray's point 0 is not in the triangle, to the bit. If origins differ, o changes the rounding by a few units in the
last place of the ray's reach; o is widened by the slack of `wrt.kernels.simd.boxes`, which is several times as much. This also
covers every other test that is accurate to within the slack. Triangles that begin behind the farthest of the best hits, or end
before the rays begin, are culled too. Packets with different main axes are not culled.

References:
    A. Reshetov: Faster ray packets - triangle intersection through vertex culling. IEEE Symposium on Interactive Ray Tracing
        2007.
    V. Rahikainen: On real-time ray tracing. MSc thesis, University of Tampere, 2013 (section 3.3).
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout

exact_module(__name__)

_TRIANGLES = """
    if (bounds.main_axes & (bounds.main_axes - 1)) return (1u << W) - 1u;
    const int z = bounds.main_axes == 1 ? 0 : bounds.main_axes == 2 ? 1 : 2, x = z == 2 ? 0 : z + 1, y = x == 2 ? 0 : x + 1;
    const float* r = &records.data[(size_t)block * (RECORD * W)];
    const float plane = bounds.plane, x_low = bounds.through_low.c[0], y_low = bounds.through_low.c[1];
    const float x_high = bounds.through_high.c[0], y_high = bounds.through_high.c[1];
    const float s0 = bounds.slope_low.c[0], s1 = bounds.slope_high.c[0];
    const float t0 = bounds.slope_low.c[1], t1 = bounds.slope_high.c[1];
    const float in_z = bounds.origin_in.c[z], out_z = bounds.origin_out.c[z];
    const float large = bounds.inverse_large.c[z], small = bounds.inverse_small.c[z];
    const float t_min = bounds.t_min, t_max = bounds.t_max;
    const bool back = bounds.backward.c[z];
    int kept[W];
    WRT_FOR_LANES(i) {
        const float az = r[z * W + i], bz = r[(3 + z) * W + i], cz = r[(6 + z) * W + i];
        float least = az < bz ? az : bz, most = az > bz ? az : bz;
        least = least < cz ? least : cz; most = most > cz ? most : cz;
        float d = (back ? most : least) - in_z, e = d * large, f = d * small; e = f < e ? f : e;
        const bool late = e > t_max;
        d = (back ? least : most) - out_z; e = d * large; f = d * small; e = f > e ? f : e;
        const bool early = e < t_min;
        // whether some vertex is not beyond each side; false for NaN, so that unused lanes are culled
        bool left = false, right = false, below = false, above = false;
        for (int k = 0; k < 3; ++k) {
            const float vx = r[(3 * k + x) * W + i], vy = r[(3 * k + y) * W + i], vz = r[(3 * k + z) * W + i];
            const float depth = vz - plane;
            float p = depth * s0, q = depth * s1;
            left = left | ((vx - x_low) - (p < q ? p : q) >= 0.0f);
            right = right | ((vx - x_high) - (p > q ? p : q) <= 0.0f);
            p = depth * t0; q = depth * t1;
            below = below | ((vy - y_low) - (p < q ? p : q) >= 0.0f);
            above = above | ((vy - y_high) - (p > q ? p : q) <= 0.0f);
        }
        kept[i] = (left & right & below & above & !late & !early) ? -1 : 0;
    }
    return wrt::bits<W>(kept);
"""


@cache
def cull_triangles(layout: PacketLayout) -> wp.Function:
    """`Culling.triangles`: packet x the vertices of the W triangles of a block."""

    @native.func_native("lanes.h", f"{layout.constants}{_TRIANGLES}")
    def vertex_culling(records: wp.array(dtype=float), block: int, bounds: wp.ref[PacketBounds]) -> wp.uint32: ...

    return vertex_culling
