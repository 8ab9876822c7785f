"""Culling by interval arithmetic: one slab test for all rays of a packet (Boulos, Wald and Shirley 2006).

The near plane along an axis is entered at (plane - origin) * inverse. Over intervals of origins and of inverses with one sign,
the least value occurs at the end of the origins that is closest to the plane, and at one of the two ends of the inverses. The
same holds for the far plane. If the product is 0 * inf, the undefined value must not give a bound. The comparisons are written
so that the NaN, which only the farther end of the inverses can produce first, is passed on and then ignored.

**Both signs along an axis.** The slab gives no bound in this case. But a box in front of all origins is reached only by rays
with positive direction, no sooner than by the fastest of them, with the least 1 / direction. The same holds for a box behind
all origins and rays with negative direction. Packets along the two lines of a picture where a component changes its sign need
this bound; without it they visit a large part of all nodes (notebooks/records/2026-11-21-packets.md).

References: boulos-2006; rahikainen-2013 (section 3.3).
"""

from functools import cache

import warp as wp

from wrt.kernels.traversal.packet.culling.culling_hooks import boxes_culled_by, triangles_culled_by
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout


@cache
def cull_boxes(layout: PacketLayout) -> wp.Function:
    """`Culling.boxes`: packet x W child boxes; keys as in `wrt.kernels.simd.box_lanes.ray_boxes`."""
    code = f"return wrt::interval_keys<{layout.width}>({layout.box}, bounds, keys.data + first);"
    return boxes_culled_by("packet_culling.h", code)


@cache
def cull_triangles(layout: PacketLayout) -> wp.Function:
    """`Culling.triangles`: packet x the boxes of the W triangles of a block."""
    return triangles_culled_by("packet_culling.h", f"return wrt::interval_mask<{layout.width}>({layout.block}, bounds);")
