"""Interval culling, and each ray of a packet against the boxes of leaves.

**Problem.** Bounds of a whole packet also reach leaves that none of its rays reach. Of shadow rays, which start on a surface,
only few reach many of the leaves that their packet visits.

**Idea.** Before a leaf is tested, count the rays that meet its box within their remaining range. If none does, the leaf is
skipped; if few do, they are listed and tested one by one (`wrt.kernels.traversal.packet.core.few_active_rays`). This is the
first half of `transient_frustum`. The other half, a frustum around these rays, saves less than it costs where pairs of rays and
triangles are filtered (notebooks/records/2026-11-23-edge-functions.md).

References: reshetov-2007; wald-2007-deformable (rays against boxes until one meets).
"""

from functools import cache

import warp as wp

from wrt.kernels.traversal.packet.culling.culling_hooks import leaves_inspected_by
from wrt.kernels.traversal.packet.rays.packet_bounds import MAX_FEW_RAYS
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout


@cache
def leaf(layout: PacketLayout) -> wp.Function:
    """`Culling.leaf`: counts the rays that meet a leaf's box."""
    check = f"static_assert(wrt::MAX_FEW_RAYS == {MAX_FEW_RAYS});"
    return leaves_inspected_by(
        "packet_culling.h", f"{check}\nreturn wrt::list_meeting({layout.box} + lane, {layout.packet}, bounds);"
    )
