"""The rays of a packet in a cell of a kd-tree: one interval of t per ray, in lanes; a plane splits those of all rays at a time.

The intervals are two more components of the packet, in a separate array: `entry` of the P rays, then `leave`. A ray that is not
in the cell has an empty interval. The formulas per ray are those of `wrt.kernels.traversal.single.single_kdtree`.
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout

exact_module(__name__)


@cache
def enter_cell(layout: PacketLayout) -> wp.Function:
    """`wp.func(packet, bounds, low, high, cells) -> int`: computes the intervals in a box; returns the number of rays inside.

    The intervals are clipped to the rays' ranges and best hits.
    """

    @native.func_native("packet_cells.h", f"return wrt::enter_cell({layout.packet}, bounds, low, high, cells.data);")
    def enter_cell_native(
        packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds], low: wp.vec3, high: wp.vec3, cells: wp.array(dtype=float)
    ) -> int: ...

    return enter_cell_native


@cache
def split_cell(layout: PacketLayout) -> wp.Function:
    """`wp.func(packet, bounds, axis, position, cells) -> bits`: moves to a child.

    Bit 0: the child is the right one. Bit 1: both must be visited; the move is then to the child that is near for the majority
    of the rays that visit both.
    """

    @native.func_native("packet_cells.h", f"return wrt::split_cell({layout.packet}, bounds, axis, position, cells.data);")
    def split_cell_native(
        packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds], axis: int, position: float, cells: wp.array(dtype=float)
    ) -> int: ...

    return split_cell_native
