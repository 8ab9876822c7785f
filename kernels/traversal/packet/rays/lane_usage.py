"""Lane utilisation: the number of ray-triangle lanes tested, and the number that held a useful test."""

from functools import cache

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout


@cache
def active_lanes(layout: PacketLayout) -> wp.Function:
    """`wp.func(records, block, mask, packet, bounds) -> int`: pairs of a triangle in `mask` and a ray that meets its box."""

    @native.func_native("packet_leaves.h", f"return wrt::count_active({layout.packet}, bounds, {layout.block}, mask);")
    def count_active_lanes(
        records: wp.array(dtype=float),
        block: int,
        mask: wp.uint32,
        packet: wp.array(dtype=float),
        bounds: wp.ref[PacketBounds],
    ) -> int: ...

    return count_active_lanes


@cache
def lanes_tested(layout: PacketLayout) -> wp.Function:
    """`wp.func(bounds) -> int`: number of lanes that `test_block` processes per triangle, over all passes."""
    passes = "1" if layout.passes == 1 else "wrt::count_bits(bounds.passes & 7)"

    @native.func_native("lanes.h", f"return {layout.rays} * {passes};")
    def count_lanes(bounds: wp.ref[PacketBounds]) -> int: ...

    return count_lanes
