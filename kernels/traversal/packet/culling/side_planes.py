"""Vertex culling against the packet's frustum: a triangle is culled if its three vertices lie outside the same side plane.

Each side plane of a frustum along a main axis contains one of the other axes, so the side of a vertex follows from its position
along one axis and a line over its depth (Reshetov 2007). In equation 3.3 of Rahikainen (2013) this comparison is the bracket.
The first factor there has the sign of y01 - y00, and the bracket identifies the inside only if that sign is known. The vertices
must be outside by the margin of `inverse_frustum`: the error of the line, plus the distance at which an `accurate` triangle
test may find a hit beside a triangle.

References: reshetov-2007; rahikainen-2013 (section 3.3, equations 3.2 and 3.3).
"""

from functools import cache

import warp as wp

from wrt.kernels.traversal.packet.culling.culling_hooks import triangles_culled_by
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout


@cache
def cull_triangles(layout: PacketLayout) -> wp.Function:
    """`Culling.triangles`: frustum of the packet x the vertices of the W triangles of a block."""
    return triangles_culled_by("packet_frusta.h", f"return wrt::side_mask<{layout.width}>({layout.block}, bounds);")
