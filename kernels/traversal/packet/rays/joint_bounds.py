"""Bounds of several packets together, taken from the batch without loading a packet.

**Problem.** Where a packet meets nothing, mostly its neighbours do not either: the background of a view, surfaces that a light
reaches. Loading and bounding each of them costs more than the test of the root that all of them fail.

**Idea.** Bound the rays of some packets together, and test the root once. The extremes of origins and directions are found
where these lie in memory (kernels/native/packet_rows.h). The rest is derived from the ends of the intervals of origins,
directions and ends of rays; differences and quotients round monotonically, so they bound what each ray computes.

**Exactness.** Invalid rays may widen the intervals, NaN does not. A direction's negligible components count as 0
(`wrt.kernels.layout.ray_batch.usable_direction`); an end that may be negligible is moved to 0. Ends of rays are computed from
origins that are not relative to the scene's centre, so they are widened by `ENDS_ERROR` of the coordinates.

This is the tile of Reshetov et al. (2005), without a search below the root.

References: reshetov-2005.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.ray_batch import HitBatch, RayBatch
from wrt.kernels.runtime import native
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout, cpp


@cache
def join_packets(layout: PacketLayout, ends: bool) -> wp.Function:
    """`wp.func(rays, first, limit, low, high, bounds) -> int`: bounds the rays of the packets from ray `first` on, at most
    `limit` of them.

    Returns the number of packets: all of them that are whole and lie side by side in the batch; 0 if these are less than two,
    or on CUDA. low, high: bounds of the scene. ends: whether the ends of rays are bounded, too. The packet counts as not
    finished (`PacketBounds.finished`).
    """
    what = f"{layout.sizes}, {cpp(ends and not layout.shared_origin)}"

    @native.func_native("packet_rows.h", f"return wrt::join_packets<{what}>(rays, first, limit, low, high, bounds);")
    def join_packets_native(
        rays: RayBatch, first: int, limit: int, low: wp.vec3, high: wp.vec3, bounds: wp.ref[PacketBounds]
    ) -> int: ...

    return join_packets_native


@cache
def fetch_ahead(layout: PacketLayout) -> wp.Function:
    """`wp.func(rays, first, limit, hits)`: fetches into the caches where the closest hits of the packets after these will be
    written: without traversals in between, stores would wait for memory."""

    @native.func_native("packet_store.h", f"wrt::fetch_row<{layout.rays}, {layout.width}>(rays, first, limit, hits);")
    def fetch_ahead_native(rays: RayBatch, first: int, limit: int, hits: HitBatch): ...

    return fetch_ahead_native


@cache
def store_together(layout: PacketLayout, any_hit: bool, non_temporal: bool, occluded: bool = False) -> wp.Function:
    """`wp.func(rays, first, limit, hits)`: no ray of the packets has a hit that `join_packets` joins with this limit; or, of an
    any-hit query, all of them, if `occluded`.

    non_temporal: as in `wrt.kernels.traversal.packet.rays.packet_store.store_packet`.
    """
    what = f"{layout.rays}, {layout.width}, {cpp(any_hit)}, {cpp(non_temporal)}, {cpp(occluded)}"

    @native.func_native("packet_store.h", f"wrt::store_row<{what}>(rays, first, limit, hits);")
    def store_together_native(rays: RayBatch, first: int, limit: int, hits: HitBatch): ...

    return store_together_native
