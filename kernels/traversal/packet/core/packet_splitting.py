"""Packets that part: rays with origins of their own that see different things go on in smaller packets (Boulos et al. 2008).

**Problem.** Neighbouring pixels see different surfaces at every silhouette, and rays that start there have nothing in common
but the light that they go to. Of the packets of shadow rays 2 % (bunny) to 10 % (large dragon) are like that: they meet half of
the scene and then give up, and their rays go one by one.

**Idea.** Halve the box of the packet's origins along its longest axis: what lies between two surfaces is mostly nothing, so the
middle tells them apart. Each half is a packet of its own, with bounds of its own, in the same place: the rays of the other are
not active meanwhile. A part that gives up is halved again, until there are `MOST_PARTS`; what is left then goes ray by ray.

**Data.** `part` is the number of the part that a ray is in; parts are made of parts, the whole being number 0. `DONE` are the
rays whose part was traced, and those that never were active; `ALONE` those that no part holds. `kept` is what a ray's t is,
while another part has the packet.

**What we changed.** The paper repacks rays by what they meet, after each bounce; here a packet is taken apart by where its
rays start, and only if its walk takes too long. What was hit until then is kept, and rays that need any hit are done with it.
Of 367 packets of the atrium's shadow rays that parted, 29 parts had to be halved again and none was left over. Giving up
sooner (1 to 3 steps a ray), or sooner where leaves are met in vain, made no difference.

References:
    S. Boulos, I. Wald, C. Benthin: Adaptive ray packet reordering. IEEE Symposium on Interactive Ray Tracing 2008.
"""

from functools import cache

import warp as wp

from wrt.kernels.traversal.packet.rays.packet_bounding import BOUND, bounding_head
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

MOST_PARTS = 7
"""Parts that a packet is ever made into, those included that were halved again."""

DONE, ALONE = -1, -2

_CONSTANTS = f"""
    constexpr int DONE = {DONE}, ALONE = {ALONE}, MOST_PARTS = {MOST_PARTS};
    int* of = (int*)part;
"""

_SETTLE = """
    if (together && number == 0) return 0;
    WRT_FOR(P, k) {
        const bool whole = number == 0, in = whole | (of[k] == number), over = (t[k] == -INF) | together;
        of[k] = in ? (over ? DONE : number) : of[k];
        t[k] = in ? t[k] : kept[k];
    }
    if (together) return 0;
    const wp::vec3 low = bounds.origin_low, high = bounds.origin_high;
    const float x = high.c[0] - low.c[0], y = high.c[1] - low.c[1], z = high.c[2] - low.c[2];
    const int axis = ((x >= y) & (x >= z)) ? 0 : y >= z ? 1 : 2;
    const float middle = low.c[axis] + 0.5f * (high.c[axis] - low.c[axis]);
    if (parts + 2 > MOST_PARTS || !((low.c[axis] < middle) & (middle < high.c[axis]))) {  // or no two rays of it start apart
        WRT_FOR(P, k) { of[k] = of[k] == number ? ALONE : of[k]; }
        return 0;
    }
    const float* origin = axis == 0 ? origin_x : axis == 1 ? origin_y : origin_z;
    WRT_FOR(P, k) { of[k] = of[k] == number ? parts + (origin[k] < middle ? 0 : 1) : of[k]; }
    return 2;
"""

_TAKE = """
    WRT_FOR(P, k) {
        kept[k] = t[k];
        t[k] = of[k] == number ? t[k] : -INF;
    }
    float lows[3], highs[3], slack0;
    const bool ranged = true;
"""


@cache
def take_part(layout: PacketLayout, slopes: bool = True) -> wp.Function:
    """`wp.func(packet, bounds, number)`: only rays of a part are active, and the bounds theirs; slopes: see `load_packet`."""

    @wp.func_native(layout.head + _CONSTANTS + bounding_head(layout, slopes) + _TAKE + BOUND)
    def take_part_native(packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds], number: int): ...

    return take_part_native


@cache
def settle_part(layout: PacketLayout) -> wp.Function:
    """`wp.func(packet, bounds, number, parts, together) -> int`: what becomes of a part that was walked; returns new parts.

    bounds: those of the part. If it stayed `together`, its rays are done. If not, it is halved, into the parts `parts` and
    `parts` + 1, or its rays go alone: where all start at one point, or there are parts enough. The t of all others is back.
    """

    @wp.func_native(layout.head + _CONSTANTS + _SETTLE)
    def settle_part_native(
        packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds], number: int, parts: int, together: bool
    ) -> int: ...

    return settle_part_native


@cache
def count_alone(layout: PacketLayout) -> wp.Function:
    """`wp.func(packet) -> int`: rays of a packet that parted that are to be traced on their own."""
    count = "    int rays = 0;\n    WRT_FOR(P, k) { rays += of[k] == ALONE ? 1 : 0; }\n    return rays;\n"

    @wp.func_native(layout.head + _CONSTANTS + count)
    def count_alone_native(packet: wp.array(dtype=float)) -> int: ...

    return count_alone_native


@cache
def goes_alone(layout: PacketLayout) -> wp.Function:
    """`wp.func(packet, k) -> bool`: whether ray k of a packet that could not stay together is to be traced on its own.

    All are where rays share an origin: such packets do not part.
    """
    body = "    return true;\n" if layout.shared_origin else layout.head + _CONSTANTS + "    return of[k] == ALONE;\n"

    @wp.func_native(body)
    def goes_alone_native(packet: wp.array(dtype=float), k: int) -> bool: ...

    return goes_alone_native
