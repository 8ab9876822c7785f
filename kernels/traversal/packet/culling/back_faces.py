"""Back-face culling for whole packets: triangles that turn their back to all of their rays.

A ray comes from the front if the product of its direction and the triangle's normal is negative
(`wrt.kernels.traversal.leaf.comes_from_front`). Over an interval of directions, the least product along each axis is at one of
the ends, and the sum of the three is not greater than the sum of any ray: rounding is monotone. Where it is not negative, no
ray comes from the front. The other triangles are tested, and each hit by itself.

References: benthin-wald-2009; rahikainen-2013 (section 2.3).
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout


@cache
def keep_front_faces(layout: PacketLayout) -> wp.Function:
    """`wp.func(records, block, bounds) -> mask` of the triangles of a block whose front some ray may see."""

    @native.func_native("packet_culling.h", f"return wrt::front_mask<{layout.width}>({layout.block}, bounds);")
    def keep_front_faces_native(records: wp.array(dtype=float), block: int, bounds: wp.ref[PacketBounds]) -> wp.uint32: ...

    return keep_front_faces_native
