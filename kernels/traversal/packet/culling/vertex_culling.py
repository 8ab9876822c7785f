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

References: reshetov-2007; rahikainen-2013 (section 3.3).
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout

exact_module(__name__)


@cache
def cull_triangles(layout: PacketLayout) -> wp.Function:
    """`Culling.triangles`: packet x the vertices of the W triangles of a block."""

    @native.func_native("packet_culling.h", f"return wrt::vertex_mask<{layout.width}>({layout.block}, bounds);")
    def vertex_culling(records: wp.array(dtype=float), block: int, bounds: wp.ref[PacketBounds]) -> wp.uint32: ...

    return vertex_culling
