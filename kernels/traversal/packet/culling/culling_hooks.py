"""Default `start` and `leaf` functions for cullings that do not prepare packets or inspect rays at leaves."""

import warp as wp

from wrt.kernels.traversal.packet.rays.packet_bounds import MAX_FEW_RAYS, PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout


@wp.func_native("")
def _nothing(low: wp.vec3, high: wp.vec3, packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds]):
    """Does nothing: `load_packet` has computed all bounds."""
    ...


@wp.func_native(f"return {MAX_FEW_RAYS + 1};")
def _every_leaf(
    boxes: wp.array(dtype=float), node: int, lane: int, packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds]
) -> int:
    """Reports more than `MAX_FEW_RAYS` rays for every leaf."""
    ...


def no_start(layout: PacketLayout) -> wp.Function:
    """`Culling.start` that does nothing."""
    return _nothing


def no_leaf(layout: PacketLayout) -> wp.Function:
    """`Culling.leaf` that does nothing."""
    return _every_leaf
