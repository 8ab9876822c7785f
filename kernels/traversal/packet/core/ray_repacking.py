"""Moves the rays of a packet that are still active into a smaller one, and its results back.

The rays keep the numbers that triangle tests read, so the hits stay the same to the bit. What is moved and clipped is their
range, and the origins from which the smaller packet's bounds are made:

* the range of a ray is clipped to [entry, exit] of the box. By the consistency rule (`wrt.kernels.simd.boxes`) every hit below
  has a t within it;
* bounds are made from the points where the rays enter the box, and count t from there: `kept` holds the t of the entry, and
  `bounds.t_min` is 0. Entry points are rounded, so their intervals are widened by `MARGIN` slacks. A box that a ray enters at t
  is then entered by the bounds no later than t minus the entry. With a shared origin the bounds are exact without moving.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.unchecked import CACHE_LINE
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.traversal.packet.leaves.packet_block import SHORTEN
from wrt.kernels.traversal.packet.rays.packet_bounding import bound_packet, bounding_head
from wrt.kernels.traversal.packet.rays.packet_bounds import MAX_FEW_RAYS, PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout
from wrt.kernels.traversal.packet.rays.ray_box_slabs import SHARED_ORIGIN, SLABS

exact_module(__name__)

MARGIN = 4.0
"""Widening of the intervals of entry points, in slacks: their rounding, half a slack, and that of hits and products (2)."""

LONGER = 1.0 + 2.0**-20
"""Factor on the rest of a ray beyond its entry, against rounding."""

SMALLEST_INVERSE = 2.0**-120
"""1 / direction below which a component of the direction is not recovered from it."""

_SLABS = f"""
    const float* box = &boxes.data[(size_t)node * (6 * W)] + lane;
    const float low[3] = {{box[0], box[W], box[2 * W]}}, high[3] = {{box[3 * W], box[4 * W], box[5 * W]}};{SHARED_ORIGIN}
    float begin[P], end[P];
    int meets[P], met = 0;
    unsigned vector[P / W];
    for (int f = 0; f < P; f += W) {{
        WRT_FOR_LANES(i) {{
            const int k = f + i;
            float enter = t_min[k], leave = t[k];
{SLABS}
            begin[k] = enter; end[k] = leave;
            meets[k] = ((enter <= leave) & (t[k] > -INF)) ? -1 : 0;
        }}
        vector[f / W] = wrt::bits<W>(meets + f);
        met += wrt::count_bits(vector[f / W]);
    }}
"""

_LIST = f"""
    if (met <= {MAX_FEW_RAYS}) for (int f = 0, place = 0; f < P; f += W) {{
        for (unsigned bits = vector[f / W]; bits; bits &= bits - 1u) bounds.few.c[place++] = f + wrt::lowest_bit(bits);
    }}
    return met;
"""

_GATHER = """
    float* to = inner.data + INNER_FIRST;
    int* from = &numbers.data[first];
    int n = 0;
    for (int f = 0; f < P; f += W) {
        for (unsigned bits = vector[f / W]; bits; bits &= bits - 1u) from[n++] = f + wrt::lowest_bit(bits);
    }
    for (int k = n; k < Q; ++k) from[k] = from[0];  // places without a ray hold another's numbers
    for (int c = 0; c < COMPONENTS; ++c) {
        const float* row = rows + c * P;
        WRT_FOR(Q, k) to[c * Q + k] = row[from[k]];
    }
    WRT_FOR(Q, k) {
        const int own = from[k];
        const bool farther = t[own] > end[own];
        to[START * Q + k] = begin[own];
        to[T * Q + k] = k < n ? (farther ? end[own] : t[own]) : -INF;
        to[FOUND * Q + k] = farther ? __builtin_bit_cast(float, -1) : primitive[own];
        if (MOVED) to[KEPT * Q + k] = begin[own];
    }
"""

_MOVE = f"""
    const float* box = &boxes.data[(size_t)node * (6 * W)] + lane;
    const float wide = {MARGIN!r}f * bounds.slack;
    for (int a = 0; a < 3; ++a) {{
        const float* inverse = a == 0 ? inverse_x : a == 1 ? inverse_y : inverse_z;
        const float* origin = a == 0 ? origin_x : a == 1 ? origin_y : origin_z;
        WRT_INTERVAL(entry);
        int lost = 0;
        WRT_FOR(P, k) {{
            const bool counts = t[k] >= -0.0f;
            lost |= (counts & (WRT_ABS(inverse[k]) < {SMALLEST_INVERSE!r}f)) ? 1 : 0;
            WRT_WIDEN(entry, origin[k] + kept[k] * (1.0f / inverse[k]), counts)
        }}
        const float from = lost ? box[a * W] : wrt_value(entry_low), to = lost ? box[(3 + a) * W] : wrt_value(entry_high);
        const bool back = bounds.backward.c[a] != 0;
        bounds.origin_low.c[a] = from - wide; bounds.origin_high.c[a] = to + wide;
        bounds.origin_in.c[a] = back ? from - wide : to + wide;
        bounds.origin_out.c[a] = back ? to + wide : from - wide;
    }}
    bounds.t_min = 0.0f;
"""

_SHORTEN_MOVED = f"""
    int most = (int)0x80000000;
    WRT_FOR(P, k) {{
        const float rest = (t[k] - kept[k]) * {LONGER!r}f + 0.0f;
        const int bits = t[k] >= -0.0f ? __builtin_bit_cast(int, rest) : (int)0x80000000;
        most = bits > most ? bits : most;
    }}
    bounds.t_max = most < 0 ? -INF : __builtin_bit_cast(float, most);
"""

_SCATTER = """
    const float* from = inner.data + INNER_FIRST;
    for (int k = 0; k < count; ++k) {
        const int own = numbers.data[first + k], found = __builtin_bit_cast(int, from[FOUND * Q + k]);
        if (found < 0 || found == ((const int*)primitive)[own]) continue;
        t[own] = from[T * Q + k]; primitive[own] = from[FOUND * Q + k];
        u[own] = from[U * Q + k]; v[own] = from[V * Q + k];
    }
"""


def _constants(layout: PacketLayout, inner: PacketLayout, moved: bool = False) -> str:
    """C++ constants: rays of the smaller packet `inner`, where its components begin, and the rows of those that change."""
    rows = {"START": "t_min", "T": "t", "FOUND": "primitive", "U": "u", "V": "v", "KEPT": "kept"}
    names = layout.components
    text = "".join(f"    constexpr int {name} = {names.index(row) if row in names else 0};\n" for name, row in rows.items())
    text += f"    constexpr int Q = {inner.rays}, COMPONENTS = {len(names)};\n"
    text += f"    const size_t INNER_FIRST = -((size_t)inner.data / 4) & {CACHE_LINE - 1};\n"
    return text + f"    constexpr bool MOVED = {str(moved).lower()};\n"


@cache
def list_rays(layout: PacketLayout) -> wp.Function:
    """`wp.func(boxes, node, lane, packet, bounds) -> int`: number of rays that meet the box in a lane of a node.

    They are listed in `bounds.few` if they are at most `MAX_FEW_RAYS`.
    """

    @native.func_native("lanes.h", layout.head + _SLABS + _LIST)
    def list_meeting_rays(
        boxes: wp.array(dtype=float), node: int, lane: int, packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds]
    ) -> int: ...

    return list_meeting_rays


@cache
def gather_rays(layout: PacketLayout, inner: PacketLayout, moved: bool) -> wp.Function:
    """`wp.func(boxes, node, lane, packet, bounds, inner, numbers, first)`: copies the rays that meet a box to the packet
    `inner`, clipped to the box; `numbers` gets their numbers, from `first` on."""

    @native.func_native("lanes.h", layout.head + _constants(layout, inner, moved) + _SLABS + _GATHER)
    def gather_meeting_rays(
        boxes: wp.array(dtype=float),
        node: int,
        lane: int,
        packet: wp.array(dtype=float),
        bounds: wp.ref[PacketBounds],
        inner: wp.array(dtype=float),
        numbers: wp.array(dtype=int),
        first: int,
    ): ...

    return gather_meeting_rays


@cache
def bound_entries(layout: PacketLayout, slopes: bool, moved: bool) -> wp.Function:
    """`wp.func(boxes, node, lane, packet, outer, bounds)`: bounds of a packet that `gather_rays` filled, its origins moved to
    the box; outer: the bounds of the packet that it was taken from."""
    shared = """
    float lows[3], highs[3];
    for (int a = 0; a < 3; ++a) { lows[a] = outer.origin_low.c[a]; highs[a] = outer.origin_high.c[a]; }
    const bool ranged = true;
"""
    if layout.shared_origin:
        shared += "    const float slack0 = outer.slack;\n"
    move = _MOVE + _SHORTEN_MOVED if moved else ""

    @native.func_native(
        "lanes.h", layout.head + bounding_head(layout, slopes) + shared + bound_packet(layout, slopes, loading=False) + move
    )
    def bound_moved_rays(
        boxes: wp.array(dtype=float),
        node: int,
        lane: int,
        packet: wp.array(dtype=float),
        outer: wp.ref[PacketBounds],
        bounds: wp.ref[PacketBounds],
    ): ...

    return bound_moved_rays


@cache
def shorten_rays(layout: PacketLayout, moved: bool, any_hit: bool) -> wp.Function:
    """`wp.func(packet, bounds)`: sets `bounds.t_max` after rays have found hits."""
    any_hit_constant = f"    constexpr bool ANY_HIT = {str(any_hit).lower()};\n"

    @native.func_native("lanes.h", layout.head + any_hit_constant + (_SHORTEN_MOVED if moved else SHORTEN))
    def shorten_moved_rays(packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds]): ...

    return shorten_moved_rays


@cache
def scatter_rays(layout: PacketLayout, inner: PacketLayout) -> wp.Function:
    """`wp.func(packet, inner, numbers, first, count)`: copies the hits that the `count` rays of `inner` have found back."""

    @native.func_native("lanes.h", layout.head + _constants(layout, inner) + _SCATTER)
    def scatter_found_hits(
        packet: wp.array(dtype=float), inner: wp.array(dtype=float), numbers: wp.array(dtype=int), first: int, count: int
    ): ...

    return scatter_found_hits
