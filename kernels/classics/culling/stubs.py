"""Functions of a `Culling` from lines of C++ that call kernels/native: what all cullings of this folder are made of.

The names of the arguments are those that the lines may use; `layout.box`, `layout.block` and `layout.packet` are made of them.
"""

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds


def bounds_set_by(header: str, code: str) -> wp.Function:
    """`Culling.start`: `wp.func(low, high, packet, bounds)`; low, high: bounds of the scene."""

    @native.func_native(header, code)
    def start(low: wp.vec3, high: wp.vec3, packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds]): ...

    return start


def boxes_culled_by(header: str, code: str) -> wp.Function:
    """`Culling.boxes`: `wp.func(boxes, node, packet, bounds, keys, first) -> least key`."""

    @native.func_native(header, code)
    def cull_boxes(
        boxes: wp.array(dtype=float),
        node: int,
        packet: wp.array(dtype=float),
        bounds: wp.ref[PacketBounds],
        keys: wp.array(dtype=int),
        first: int,
    ) -> int: ...

    return cull_boxes


def triangles_culled_by(header: str, code: str) -> wp.Function:
    """`Culling.triangles`: `wp.func(records, block, bounds) -> mask`."""

    @native.func_native(header, code)
    def cull_triangles(records: wp.array(dtype=float), block: int, bounds: wp.ref[PacketBounds]) -> wp.uint32: ...

    return cull_triangles
