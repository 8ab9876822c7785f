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

from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.traversal.packet.rays.packet_bounds import MAX_FEW_RAYS, PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout, cpp
from wrt.kernels.traversal.packet.rays.packet_load import bounding

exact_module(__name__)

MARGIN = 4.0
"""Widening of the intervals of entry points, in slacks: their rounding, half a slack, and that of hits and products (2)."""

LONGER = 1.0 + 2.0**-20
"""Factor on the rest of a ray beyond its entry, against rounding."""

SMALLEST_INVERSE = 2.0**-120
"""1 / direction below which a component of the direction is not recovered from it."""

GUARDS = f"""
static_assert(wrt::ENTRY_MARGIN == {MARGIN!r}f && wrt::LONGER == {LONGER!r}f);
static_assert(wrt::SMALLEST_INVERSE == {SMALLEST_INVERSE!r}f && wrt::MAX_FEW_RAYS == {MAX_FEW_RAYS});
"""
"""C++: the constants of repacking have these values."""


@cache
def list_rays(layout: PacketLayout) -> wp.Function:
    """`wp.func(boxes, node, lane, packet, bounds) -> int`: number of rays that meet the box in a lane of a node.

    They are listed in `bounds.few` if they are at most `MAX_FEW_RAYS`.
    """

    @native.func_native("packet_culling.h", f"return wrt::list_meeting({layout.box} + lane, {layout.packet}, bounds);")
    def list_meeting_rays(
        boxes: wp.array(dtype=float), node: int, lane: int, packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds]
    ) -> int: ...

    return list_meeting_rays


@cache
def gather_rays(layout: PacketLayout, inner: PacketLayout, moved: bool) -> wp.Function:
    """`wp.func(boxes, node, lane, packet, bounds, inner, numbers, first)`: copies the rays that meet a box to the packet
    `inner`, clipped to the box; `numbers` gets their numbers, from `first` on."""
    what = f"{cpp(moved)}, {len(layout.components)}"

    @native.func_native(
        "packet_parts.h",
        f"""
        const {layout.type} from(packet.data);
        const {inner.type} to(inner.data);
        wrt::gather_rays<{what}>({layout.box} + lane, from, bounds, to, numbers.data + first);""",
    )
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
    what = f"{bounding(layout, slopes)}, {cpp(moved)}"

    @native.func_native(
        "packet_parts.h", f"{GUARDS}wrt::bound_entries<{what}>({layout.box} + lane, {layout.packet}, outer, bounds);"
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
    name = "shorten_moved" if moved else f"shorten<{cpp(any_hit)}>"

    @native.func_native("packet_parts.h", f"wrt::{name}({layout.packet}, bounds);")
    def shorten_moved_rays(packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds]): ...

    return shorten_moved_rays


@cache
def scatter_rays(layout: PacketLayout, inner: PacketLayout) -> wp.Function:
    """`wp.func(packet, inner, numbers, first, count)`: copies the hits that the `count` rays of `inner` have found back."""

    @native.func_native(
        "packet_parts.h",
        f"wrt::scatter_rays({layout.packet}, {inner.type}(inner.data), numbers.data + first, count);",
    )
    def scatter_found_hits(
        packet: wp.array(dtype=float), inner: wp.array(dtype=float), numbers: wp.array(dtype=int), first: int, count: int
    ): ...

    return scatter_found_hits
