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
active, is `wrt.kernels.traversal.packet.core.repacked_bvh`.
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.traversal.packet.rays.packet_bounding import bound_packet, bounding_head
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout

exact_module(__name__)

MAX_PARTS = 7
"""Greatest number of parts of a packet, including parts that are halved again; more are hardly ever needed
(notebooks/records/2026-11-21-packets.md)."""

WIDE = 3.0
"""How many times as far apart as usual the origins of a packet must be that is split before its traversal."""

LEAST_WIDE = 2.0**-7
"""Share of the scene's size that they must span."""

ADAPTION = 0.25
"""Weight of a packet in what is usual for those after it."""

DONE, SINGLE_RAY = -1, -2

_CONSTANTS = f"""
    constexpr int DONE = {DONE}, SINGLE_RAY = {SINGLE_RAY}, MAX_PARTS = {MAX_PARTS};
    int* of = (int*)part;
"""

_FINISH = """
    if (completed && number == 0) return 0;
    WRT_FOR(P, k) {
        const bool whole = number == 0, in = whole | (of[k] == number), over = (t[k] == -INF) | completed;
        of[k] = in ? (over ? DONE : number) : of[k];
        t[k] = in ? t[k] : kept[k];
    }
    if (completed) return 0;
    const wp::vec3 low = bounds.origin_low, high = bounds.origin_high;
    const float x = high.c[0] - low.c[0], y = high.c[1] - low.c[1], z = high.c[2] - low.c[2];
    const int axis = ((x >= y) & (x >= z)) ? 0 : y >= z ? 1 : 2;
    const float middle = low.c[axis] + 0.5f * (high.c[axis] - low.c[axis]);
    if (parts + 2 > MAX_PARTS || !((low.c[axis] < middle) & (middle < high.c[axis]))) {  // or no two rays of it start apart
        WRT_FOR(P, k) { of[k] = of[k] == number ? SINGLE_RAY : of[k]; }
        return 0;
    }
    const float* origin = axis == 0 ? origin_x : axis == 1 ? origin_y : origin_z;
    WRT_FOR(P, k) { of[k] = of[k] == number ? parts + (origin[k] < middle ? 0 : 1) : of[k]; }
    return 2;
"""

_ACTIVATE = """
    WRT_FOR(P, k) {
        kept[k] = t[k];
        t[k] = of[k] == number ? t[k] : -INF;
    }
    float lows[3], highs[3];
    const bool ranged = true;
"""


_IS_WIDE = """
    float extent = 0.0f, scene = 0.0f;
    for (int a = 0; a < 3; ++a) {
        extent += bounds.origin_high.c[a] - bounds.origin_low.c[a];
        scene += high.c[a] - low.c[a];
    }
    float& usual = packet.data[USUAL];
    const bool wide = usual > 0.0f && extent > WIDE * usual && extent > LEAST_WIDE * scene;
    if (first && !wide) usual = usual > 0.0f ? usual + ADAPTION * (extent - usual) : extent;
    return wide;
"""


@cache
def is_wide(layout: PacketLayout) -> wp.Function:
    """`wp.func(packet, bounds, low, high, first) -> bool`: whether the origins of a packet, or of a part of one, are far apart.

    Compared with what is usual in the item of the kernel, which the whole packets, `first`, determine. low, high: bounds of the
    scene.
    """
    constants = f"    constexpr float WIDE = {WIDE!r}f, LEAST_WIDE = {LEAST_WIDE!r}f, ADAPTION = {ADAPTION!r}f;\n"

    @native.func_native("lanes.h", f"{constants}    constexpr int USUAL = {layout.usual_extent};\n{_IS_WIDE}")
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
    bound = bound_packet(layout, slopes, ends=ends, loading=False)

    @native.func_native("lanes.h", layout.head + _CONSTANTS + bounding_head(layout, slopes) + _ACTIVATE + bound)
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

    @native.func_native("lanes.h", layout.head + _CONSTANTS + _FINISH)
    def finish_part_native(
        packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds], number: int, parts: int, completed: bool
    ) -> int: ...

    return finish_part_native


@cache
def count_single_rays(layout: PacketLayout) -> wp.Function:
    """`wp.func(packet) -> int`: number of rays of a split packet that are to be traced one by one."""
    count = "    int rays = 0;\n    WRT_FOR(P, k) { rays += of[k] == SINGLE_RAY ? 1 : 0; }\n    return rays;\n"

    @native.func_native("lanes.h", layout.head + _CONSTANTS + count)
    def count_single_rays_native(packet: wp.array(dtype=float)) -> int: ...

    return count_single_rays_native


@cache
def needs_single_ray(layout: PacketLayout) -> wp.Function:
    """`wp.func(packet, k) -> bool`: whether ray k of an abandoned packet is to be traced alone.

    With a shared origin this is every ray, because such packets are not split.
    """
    body = "    return true;\n" if layout.shared_origin else layout.head + _CONSTANTS + "    return of[k] == SINGLE_RAY;\n"

    @native.func_native("lanes.h", body)
    def needs_single_ray_native(packet: wp.array(dtype=float), k: int) -> bool: ...

    return needs_single_ray_native
