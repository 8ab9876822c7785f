"""What most cullings need not do: get a packet ready for its walk, and look at its rays again at each leaf."""

import warp as wp

from wrt.kernels.traversal.packet.rays.packet_bounds import FEW, PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout

wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@wp.func_native("")
def _nothing(low: wp.vec3, high: wp.vec3, packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds]):
    """The bounds that `load_packet` made are all that is needed."""
    ...


@wp.func_native(f"return {FEW + 1};")
def _every_leaf(
    boxes: wp.array(dtype=float), node: int, lane: int, packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds]
) -> int:
    """More than few rays may meet the leaf."""
    ...


def no_start(layout: PacketLayout) -> wp.Function:
    """`Culling.start` that does nothing."""
    return _nothing


def no_leaf(layout: PacketLayout) -> wp.Function:
    """`Culling.leaf` that does nothing."""
    return _every_leaf
