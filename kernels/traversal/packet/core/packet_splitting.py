"""Packet splitting: a packet whose rays diverge continues as smaller packets.

**Problem.** Neighbouring pixels see different surfaces at every silhouette, and secondary rays that start there have little in
common. A few percent of the packets of shadow rays are like that. They would visit half of the scene before their traversal is
abandoned and their rays are traced one by one.

**Idea.** Halve the box of the packet's origins along its longest axis. The space between two surfaces is mostly empty, so the
middle separates them. Each half is a packet with its own bounds, in the same memory; the rays of the other half are inactive
meanwhile. A part whose traversal is abandoned is halved again, up to `MAX_PARTS` parts; the remaining rays are then traced one
by one.

**Data.** `part` is the number of the part that contains a ray; parts are split from parts, and the whole packet is number 0.
`DONE` marks rays whose part has been traced and rays that were never active; `SINGLE_RAY` marks rays to be traced one by
one. `kept` stores the t of a ray while another part is active.

**When.** A packet is split before its traversal if its origins are far farther apart than those of the packets before it
(`is_wide`), otherwise if the traversal takes too long. Hits that were found until then are kept, and any-hit rays that have one
are done (figures: notebooks/records/2026-11-21-packets.md, notebooks/records/2026-11-26-joined-packets.md).

**Source.** This reaction is ours. That of Boulos et al. (2008), packets made again where less than half of their rays are
active, is `wrt.kernels.classics.traversal.repacked_bvh`.
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout
from wrt.kernels.traversal.packet.rays.packet_load import bounding

MAX_PARTS = 7
"""Greatest number of parts of a packet, including parts that are halved again; more are hardly ever needed
(notebooks/records/2026-11-21-packets.md)."""

WIDE = 3.0
"""How many times as far apart as usual the origins of a packet must be that is split before its traversal."""

MIN_WIDE = 2.0**-7
"""Share of the scene's size that they must span."""

ADAPTION = 0.25
"""Weight of a packet in what is usual for those after it."""

DONE, SINGLE_RAY = -1, -2

GUARDS = f"""
static_assert(wrt::DONE == {DONE} && wrt::SINGLE_RAY == {SINGLE_RAY} && wrt::MAX_PARTS == {MAX_PARTS});
static_assert(wrt::WIDE == {WIDE!r}f && wrt::MIN_WIDE == {MIN_WIDE!r}f && wrt::ADAPTION == {ADAPTION!r}f);
"""
"""C++: the constants of splitting have these values."""


@cache
def is_wide(layout: PacketLayout) -> wp.Function:
    """`wp.func(packet, bounds, low, high, first) -> bool`: whether the origins of a packet, or of a part of one, are far apart.

    Compared with what is usual in the item of the kernel, which the whole packets, `first`, determine. low, high: bounds of the
    scene.
    """
    usual = f"packet.data[{layout.usual_extent}]"

    @native.func_native("packet_parts.h", f"{GUARDS}return wrt::is_wide({usual}, bounds, low, high, first);")
    def is_wide_native(
        packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds], low: wp.vec3, high: wp.vec3, first: bool
    ) -> bool: ...

    return is_wide_native


@cache
def forget_extent(layout: PacketLayout) -> wp.Function:
    """`wp.func(packet)`: nothing is usual any more, as the next origins are in another space."""

    @native.func_native("lanes.h", f"packet.data[{layout.usual_extent}] = 0.0f;")
    def forget_extent_native(packet: wp.array(dtype=float)): ...

    return forget_extent_native


@cache
def activate_part(layout: PacketLayout, slopes: bool = True, ends: bool = False) -> wp.Function:
    """`wp.func(packet, bounds, number)`: makes the rays of a part the active ones, and computes their bounds; slopes, ends: see
    `load_packet`."""
    what = bounding(layout, slopes, ends=ends)

    @native.func_native("packet_parts.h", f"wrt::activate_part<{what}>({layout.packet}, bounds, number);")
    def activate_part_native(packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds], number: int): ...

    return activate_part_native


@cache
def finish_part(layout: PacketLayout) -> wp.Function:
    """`wp.func(packet, bounds, number, parts, completed) -> int`: ends a part after its traversal; returns the number of new
    parts.

    bounds: those of the part. If the traversal was `completed`, the rays of the part are done. Otherwise the part is halved
    into the parts `parts` and `parts` + 1; if all its rays start at one point, or there are too many parts, its rays are
    marked `SINGLE_RAY`. The t of all other rays is restored.
    """

    @native.func_native(
        "packet_parts.h", f"{GUARDS}return wrt::finish_part({layout.packet}, bounds, number, parts, completed);"
    )
    def finish_part_native(
        packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds], number: int, parts: int, completed: bool
    ) -> int: ...

    return finish_part_native


@cache
def count_single_rays(layout: PacketLayout) -> wp.Function:
    """`wp.func(packet) -> int`: number of rays of a split packet that are to be traced one by one."""

    @native.func_native("packet_parts.h", f"return wrt::count_single_rays({layout.packet});")
    def count_single_rays_native(packet: wp.array(dtype=float)) -> int: ...

    return count_single_rays_native


@cache
def needs_single_ray(layout: PacketLayout) -> wp.Function:
    """`wp.func(packet, k) -> bool`: whether ray k of an abandoned packet is to be traced alone.

    With a shared origin this is every ray, because such packets are not split.
    """
    body = "true" if layout.shared_origin else f"{layout.packet}.part[k] == wrt::SINGLE_RAY"

    @native.func_native("packet_parts.h", f"return {body};")
    def needs_single_ray_native(packet: wp.array(dtype=float), k: int) -> bool: ...

    return needs_single_ray_native
