"""Vertex culling against the packet's frustum: a triangle is culled if its three vertices lie outside the same side plane.

Each side plane of a frustum along a main axis contains one of the other axes, so the side of a vertex follows from its position
along one axis and a line over its depth (Reshetov 2007). In equation 3.3 of Rahikainen (2013) this comparison is the bracket.
The first factor there has the sign of y01 - y00, and the bracket identifies the inside only if that sign is known. The vertices
must be outside by the margin of `inverse_frustum`: the error of the line, plus the distance at which an `accurate` triangle
test may find a hit beside a triangle.

References:
    A. Reshetov: Faster ray packets - triangle intersection through vertex culling. IEEE Symposium on Interactive Ray Tracing
        2007.
    V. Rahikainen: On real-time ray tracing. MSc thesis, University of Tampere, 2013 (section 3.3, equations 3.2 and 3.3).
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.traversal.packet.culling import interval_culling as interval
from wrt.kernels.traversal.packet.culling.inverse_frustum import SIDES
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout

exact_module(__name__)

_TRIANGLES = f"""
    if (bounds.frame < 0) {{{interval.TRIANGLES}}}
    const float* r = &records.data[(size_t)block * (RECORD * W)];{SIDES}
    const bool rear = large < 0.0f;  // not `back`: the range may be seen from the rays' ends (`reversed_bounds`)
    int kept[W];
    WRT_FOR_LANES(i) {{
        const float az = r[z * W + i], bz = r[(3 + z) * W + i], cz = r[(6 + z) * W + i];
        float least = az < bz ? az : bz, most = az > bz ? az : bz;
        least = least < cz ? least : cz; most = most > cz ? most : cz;
        float d = (rear ? most : least) - in_z, e = d * large, f = d * small; e = f < e ? f : e;
        const bool late = e > t_max;
        d = (rear ? least : most) - out_z; e = d * large; f = d * small; e = f > e ? f : e;
        const bool early = e < t_min;
        bool left = true, right = true, below = true, above = true;
        for (int k = 0; k < 3; ++k) {{
            const float vx = r[(3 * k + x) * W + i], vy = r[(3 * k + y) * W + i];
            const float depth = (r[(3 * k + z) * W + i] - near_plane) * forward;
            left = left & (vx < (low_x + rise_low_x * depth) - margin);
            right = right & (vx > (high_x + rise_high_x * depth) + margin);
            below = below & (vy < (low_y + rise_low_y * depth) - margin);
            above = above & (vy > (high_y + rise_high_y * depth) + margin);
        }}
        // an unused lane holds NaN, which is beyond nothing: it is told by its first vertex
        kept[i] = (!(left | right | below | above | late | early) & (r[i] == r[i])) ? -1 : 0;
    }}
    return wrt::bits<W>(kept);
"""


@cache
def cull_triangles(layout: PacketLayout) -> wp.Function:
    """`Culling.triangles`: frustum of the packet x the vertices of the W triangles of a block."""

    @native.func_native("lanes.h", f"{layout.constants}{_TRIANGLES}")
    def beyond_a_side(records: wp.array(dtype=float), block: int, bounds: wp.ref[PacketBounds]) -> wp.uint32: ...

    return beyond_a_side
