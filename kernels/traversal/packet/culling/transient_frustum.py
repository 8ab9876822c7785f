"""Transient frusta: a frustum per leaf around the rays that reach it (Reshetov 2007).

**Problem.** The rays that reach a leaf are fewer than those of the packet: some have found nearer hits, shadow rays are done,
others pass beside the leaf. The frustum of all rays is wider than necessary.

**Idea.** At each leaf, intersect the rays that meet its box, within their remaining range, with the two planes of the box that
are normal to the main axis. Two rectangles bound these points. The frustum between them is used while the leaf is tested; it
culls the triangles whose vertices all lie outside the same side (`side_planes`). If no ray meets the box, the leaf is skipped;
if few do, they are listed and no frustum is made.

**Cost.** One loop over the P rays per leaf, the cost of testing one triangle. It pays for packets of 64 rays and more, most if
origins differ (notebooks/records/2026-11-21-packets.md).

**Differences from the paper.** `vertex` is the same without the transient frustum, evaluated with the test's own numbers. Here
the two planes are those of the widened box, which contains all hits on the leaf's triangles. Nodes are culled by
`interval_culling`, and so is a packet without a main axis.

References: reshetov-2007; rahikainen-2013 (section 3.3).
"""

from functools import cache

import warp as wp

from wrt.kernels.traversal.packet.culling.culling_hooks import bounds_set_by, leaves_inspected_by
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout


@cache
def start(layout: PacketLayout) -> wp.Function:
    """`Culling.start`: determines the main axis."""
    return bounds_set_by("packet_frusta.h", "wrt::find_frame(bounds);")


@cache
def leaf(layout: PacketLayout) -> wp.Function:
    """`Culling.leaf`: sets the frustum of the rays that meet a leaf's box; returns 0 if none does."""
    return leaves_inspected_by(
        "packet_frusta.h", f"return wrt::set_transient_frustum({layout.box} + lane, {layout.packet}, bounds);"
    )
