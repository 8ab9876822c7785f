"""Two tests at leaves after inverse frustum culling: entries along one axis against exits along another (Reshetov 2005).

**Problem.** Culling by a frustum keeps boxes that no ray meets, and at a leaf this costs a test of every triangle.

**Idea.** A ray misses a box if it enters the box's slab along one axis after it has left that along another. All rays of a
packet do so if the least of their entries along y is beyond the greatest of their exits along x, or the other way round.
Reshetov, Soupikov and Hurley compare x and y, across the axis of the view; here all three pairs of axes are compared.

The entries and exits are the numbers of the rays' own box tests, so no hit is lost (`wrt.kernels.simd.boxes`, the consistency
rule). Boxes and triangles are culled as by `inverse_frustum`.

**Cost.** One loop over the P rays per leaf, as for transient frusta, which use it for more.

References: reshetov-2005; rahikainen-2013 (section 3.3).
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.traversal.packet.rays.packet_bounds import MAX_FEW_RAYS, PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout


@cache
def leaf(layout: PacketLayout) -> wp.Function:
    """`Culling.leaf`: 0 if the rays as a whole pass beside a leaf's box, else more than `MAX_FEW_RAYS`."""

    @native.func_native(
        "packet_frusta.h",
        f"return wrt::enters_behind_exit({layout.box} + lane, {layout.packet}, bounds) ? 0 : {MAX_FEW_RAYS + 1};",
    )
    def entry_behind_exit(
        boxes: wp.array(dtype=float), node: int, lane: int, packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds]
    ) -> int: ...

    return entry_behind_exit
