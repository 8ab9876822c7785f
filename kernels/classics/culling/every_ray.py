"""No culling: every ray of the packet against every box and every triangle on the packet's path (Wald et al. 2001).

**Problem.** How much do bounds of a packet save? Without them all rays are tested.

**Steps.** A child is visited if any ray meets its box, in the order of the earliest entry of any ray. At a leaf all rays are
tested against all triangles. The rays share only the decisions, the loads and the lanes.

**Differences from the paper.** The box test does not stop at the first ray that meets the box. If the nearest child of a level
lies beyond all best hits, the rest of the level is dropped, and this needs the least entry of all rays.

**Cost.** P / W tests in lanes for each child, where bounds take one for all W children. It is the baseline for other cullings.

References: wald-2001.
"""

from functools import cache

import warp as wp

from wrt.kernels.traversal.packet.culling.culling_hooks import boxes_culled_by, triangles_culled_by
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout


@cache
def cull_boxes(layout: PacketLayout) -> wp.Function:
    """P rays x W child boxes; keys as in `wrt.kernels.simd.box_lanes.ray_boxes`, from the least entry of all rays."""
    call = f"return wrt::every_ray_keys({layout.box}, {layout.packet}, bounds, keys.data + first);"
    return boxes_culled_by("packet_culling.h", call)


@cache
def cull_triangles(layout: PacketLayout) -> wp.Function:
    """Keeps all triangles of a block; unused lanes hold NaN and are dropped."""
    return triangles_culled_by("packet_culling.h", f"return wrt::used_mask<{layout.width}>({layout.block});")
