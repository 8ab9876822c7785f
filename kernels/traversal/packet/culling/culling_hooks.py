"""Functions of a `Culling` from lines of C++ that call kernels/native, and those of cullings that do not prepare packets or
inspect rays at leaves.

The names of the arguments are those that the lines may use; `layout.box`, `layout.block` and `layout.packet` are made of them.
"""

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.traversal.packet.rays.packet_bounds import MAX_FEW_RAYS, PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout


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


def leaves_inspected_by(header: str, code: str) -> wp.Function:
    """`Culling.leaf`: `wp.func(boxes, node, lane, packet, bounds) -> number of rays`, of which more than `MAX_FEW_RAYS` are not
    counted."""

    @native.func_native(header, code)
    def leaf(
        boxes: wp.array(dtype=float), node: int, lane: int, packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds]
    ) -> int: ...

    return leaf


@wp.func_native("")
def _nothing(low: wp.vec3, high: wp.vec3, packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds]):
    """Does nothing: `load_packet` has computed all bounds."""


@wp.func_native(f"return {MAX_FEW_RAYS + 1};")
def _every_leaf(
    boxes: wp.array(dtype=float), node: int, lane: int, packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds]
) -> int:
    """Reports more than `MAX_FEW_RAYS` rays for every leaf."""


def no_start(layout: PacketLayout) -> wp.Function:
    """`Culling.start` that does nothing."""
    return _nothing


def no_leaf(layout: PacketLayout) -> wp.Function:
    """`Culling.leaf` that does nothing."""
    return _every_leaf
