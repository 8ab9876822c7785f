"""No culling: every ray of the packet against every box and every triangle on the packet's path (Wald et al. 2001).

This is the baseline for the other cullings. A child is visited if any ray meets its box, in the order of the earliest entry of
any ray. The rays share only the decisions, the loads and the lanes.

The box test cannot stop at the first ray that meets the box. If the nearest child of a level lies beyond all best hits, the
rest of the level is dropped, and this needs the least entry of all rays.

References: wald-2001.
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout

exact_module(__name__)


@cache
def cull_boxes(layout: PacketLayout) -> wp.Function:
    """`Culling.boxes`: P rays x W child boxes; keys as in `wrt.kernels.simd.box_lanes.ray_boxes`, from the least entry of all
    rays."""

    @native.func_native(
        "packet_culling.h", f"return wrt::every_ray_keys({layout.box}, {layout.packet}, bounds, keys.data + first);"
    )
    def every_ray_boxes(
        boxes: wp.array(dtype=float),
        node: int,
        packet: wp.array(dtype=float),
        bounds: wp.ref[PacketBounds],
        keys: wp.array(dtype=int),
        first: int,
    ) -> int: ...

    return every_ray_boxes


@cache
def cull_triangles(layout: PacketLayout) -> wp.Function:
    """`Culling.triangles`: keeps all triangles of a block; unused lanes hold NaN and are dropped."""

    @native.func_native("packet_culling.h", f"return wrt::used_mask<{layout.width}>({layout.block});")
    def every_triangle(records: wp.array(dtype=float), block: int, bounds: wp.ref[PacketBounds]) -> wp.uint32: ...

    return every_triangle
