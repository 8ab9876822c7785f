"""Vertex culling at the leaves: culls triangles outside the packet's frustum (Reshetov 2007).

**Idea.** Along the packet's main axis, a ray passes through (s z, t z) at depth z, with slopes s and t in the packet's
intervals. No ray can hit a triangle whose three vertices lie outside the same one of the four planes that these intervals span.
W triangles are tested at a time, before any ray is.

**Differences from the paper.** The paper builds a transient frustum per leaf from the exits of the rays. Here the frustum is
that of the slopes, and it is never built: the watertight test's own expression for a sheared vertex, (x - o) - s (z - p), is
evaluated on intervals, where o is the point in which the ray crosses the plane z = p near the origins. Rays that share an
origin have the same o and p, and the bounded value is the very number that the test computes. If it is negative for three
vertices, the ray's point 0 is not in the triangle, to the bit. If origins differ, o is widened by the slack of
`wrt.kernels.simd.boxes`, as below. Triangles that begin behind the farthest of the best hits, or end before the rays begin, are
culled too. Packets with different main axes are not culled.

**Proof** for different origins: a vertex beyond a plane by the numbers computed here is beyond it, or on it, by those of the
test. Where that is in question, the sheared coordinate is at most a slack, so its last rounding, which keeps the sign, does not
count.

    u, R                     2^-24; reach of the ray
    s                        slope of the ray as computed, |s| <= 1: the same number in the test and here
    V, z, p                  vertex less origin; its depth, and that of the plane, which lies between origins

    the test: V_x, V_z, s V_z                             3 u R
    o: depth from the plane, product, difference          1 u R + 1 u R + 2 u R
    here: x - o, z - p, s (z - p)                         3 u R
    sum                                                   10 u R

The slack is 16 u R: six roundings are left. Searched by `vertices` of tests/bounds.

References: reshetov-2007; rahikainen-2013 (section 3.3).
"""

from functools import cache

import warp as wp

from wrt.kernels.traversal.packet.culling.culling_hooks import triangles_culled_by
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout


@cache
def cull_triangles(layout: PacketLayout) -> wp.Function:
    """`Culling.triangles`: packet x the vertices of the W triangles of a block."""
    return triangles_culled_by("packet_culling.h", f"return wrt::vertex_mask<{layout.width}>({layout.block}, bounds);")
