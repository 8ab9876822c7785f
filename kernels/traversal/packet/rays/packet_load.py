"""Loads rays into a packet and computes its bounds, with the arithmetic of `load_ray`, `ray_slabs` and the test's `prepare`.

Many packets meet no leaf: of views those of the background, of shadow rays those whose light nothing hides. Divisions, slopes
and what else only tests need are left until the first leaf (`finish_packet`). Bounds take the ends of the directions, as
division is monotone.

**Tiles** are tested only as a whole, so their rays, of any number, are not loaded into a packet (`bound_rays`). A packet takes
the interval of 1 / direction over its rays. A tile takes the intervals of directions and origins and derives the rest from
their ends. Quotients, products and differences round monotonically, so the ends still bound the values that each ray computes.
This costs a minimum and a maximum per component and ray, and no division.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.ray_batch import FARTHEST, NEGLIGIBLE, SHORTEST, RayBatch
from wrt.kernels.runtime import native
from wrt.kernels.simd.boxes import SLACK
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout, cpp

GUARDS = f"""
static_assert(wrt::SLACK == {SLACK!r}f && wrt::NEGLIGIBLE == {NEGLIGIBLE!r}f);
static_assert(wrt::SHORTEST == {SHORTEST!r}f && wrt::FARTHEST == {FARTHEST!r}f);
"""
"""C++: the constants of packets have their values."""


def bounding(layout: PacketLayout, slopes: bool, later: bool = False, ends: bool = False) -> str:
    """The type, in C++, of what is bounded: see `load_packet`."""
    return f"wrt::Bounding<{layout.passes}, {cpp(slopes)}, {cpp(later)}, {cpp(ends)}>"


@cache
def load_packet(layout: PacketLayout, slopes: bool = True, later: bool = False, ends: bool = False) -> wp.Function:
    """`wp.func(rays, first, low, high, packet, bounds)`: loads P rays of a batch (`ray_numbers`); low, high: bounds of the
    scene.

    slopes: whether slopes are bounded (`CullingTraits.SLOPES`). later: leaves values that only the triangle test reads to
    `finish_packet`; not with slopes. ends: bounds the ends of rays, too (`PacketBounds.end_low`). Invalid rays and places
    beyond the end of the batch are inactive: their t is -inf, which no hit improves.
    """
    what = bounding(layout, slopes, later, ends)

    @native.func_native(
        f"packet_load.h {layout.headers}",
        f"""{GUARDS}
        {layout.own} {layout.state}
        wrt::load_packet<{what}>(own, rays, first, low, high, bounds, {layout.prepare});""",
    )
    def load_packet_native(
        rays: RayBatch,
        first: int,
        low: wp.vec3,
        high: wp.vec3,
        packet: wp.array(dtype=float),
        bounds: wp.ref[PacketBounds],
    ): ...

    return load_packet_native


@cache
def finish_packet(layout: PacketLayout) -> wp.Function:
    """`wp.func(low, high, packet, bounds)`: computes what `load_packet` left for later, unless that is done; low, high: as
    there."""

    @native.func_native(
        f"packet_load.h {layout.headers}",
        f"""
        {layout.own} {layout.state}
        wrt::finish_packet<{layout.passes}>(own, low, high, bounds, {layout.prepare});""",
    )
    def finish_packet_native(low: wp.vec3, high: wp.vec3, packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds]): ...

    return finish_packet_native


RUN = 64
"""Rays that are loaded at a time."""


@native.func_native("packet_load.h", f"wrt::bound_rays<{RUN}>(rays, first, count, low, high, bounds);")
def bound_rays(rays: RayBatch, first: int, count: int, low: wp.vec3, high: wp.vec3, bounds: wp.ref[PacketBounds]):
    """Bounds of the rays first .. first + count - 1 of a batch, clipped to its end; low, high: bounds of the scene.

    If no ray is active, only `bounds.active` is set.
    """
