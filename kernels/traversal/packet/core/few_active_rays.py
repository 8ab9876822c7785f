"""Leaves that few rays of a packet meet: each of these rays is tested against W triangles at a time.

**Problem.** If triangles are as small as pixels, only a few rays of a packet of 32 meet the box of a typical leaf, and often
none does. A triangle that is tested by the packet occupies 32 lanes for them.

**Idea.** Put rays or triangles into the lanes, whichever are more. At most `MAX_FEW_RAYS` rays
(`wrt.kernels.traversal.packet.rays.packet_bounds`) are taken out of the packet and tested like single rays, by `block_step`:
one vector per 16 triangles, and no frustum before it. Figures: notebooks/records/2026-11-22-leaf-rays.md.
"""

from dataclasses import replace
from functools import cache

import warp as wp

from wrt.kernels.answers.answer_kind import BestHit
from wrt.kernels.runtime import native
from wrt.kernels.simd.boxes import RaySlabs
from wrt.kernels.traversal.leaf import Counters, block_step
from wrt.kernels.traversal.packet.core.packet_kernel import packet_layout
from wrt.kernels.traversal.packet.leaves.packet_block import active_lanes
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout, cpp
from wrt.kernels.traversal.traversal_config import SingleConfig, TraversalConfig
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks


@cache
def extract_ray(layout: PacketLayout) -> wp.Function:
    """`wp.func(packet, bounds, place, ray, slabs, best) -> t_min`: a ray of `bounds.few` in the form that `block_step`
    needs."""
    test = TRIANGLE_TESTS[layout.triangle_test]
    RayState = test.ray_state

    @native.func_native(
        f"packet_parts.h {layout.headers}",
        f"""
        {layout.own} {layout.names} const int k = bounds.few.c[place];
        {test.packet_form.ray}
        return wrt::extract_ray(own, shared, k, slabs, best);""",
    )
    def extract_ray_native(
        packet: wp.array(dtype=float),
        bounds: wp.ref[PacketBounds],
        place: int,
        ray: wp.ref[RayState],
        slabs: wp.ref[RaySlabs],
        best: wp.ref[BestHit],
    ) -> float: ...

    return extract_ray_native


@cache
def store_ray(layout: PacketLayout, any_hit: bool) -> wp.Function:
    """`wp.func(packet, bounds, place, best)`: stores the hit of a ray of `bounds.few` in the packet."""

    @native.func_native(
        "packet_parts.h",
        f"""
        {layout.own}
        wrt::store_hit<{cpp(any_hit)}>(own, bounds.few.c[place], best);
        wrt::shorten<{cpp(any_hit)}>(own, bounds);""",
    )
    def store_ray_native(packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds], place: int, best: wp.ref[BestHit]): ...

    return store_ray_native


@wp.func_native("bounds.few.c[place] = ray;")
def store_few_ray(bounds: wp.ref[PacketBounds], place: int, ray: int):
    """Stores the number of a ray in `bounds.few`, for `few_rays_step`."""


@cache
def count_few_rays(config: TraversalConfig) -> wp.Function:
    """`wp.func(triangles, first, count, ray_count, packet, bounds, work)`: counts the work of the next `few_rays_step`."""
    count_active, width = active_lanes(packet_layout(config)), config.width

    @wp.func
    def count_work(
        triangles: TriangleBlocks,
        first: int,
        count: int,
        ray_count: int,
        packet: wp.array(dtype=float),
        bounds: wp.ref[PacketBounds],
        work: wp.ref[Counters],
    ):
        if ray_count == 0:
            work.culled += count
        else:
            work.triangles += count
            block = int(first)
            rest = int(count)
            while rest > 0:
                used = wp.uint32((wp.uint32(1) << wp.uint32(wp.min(rest, wp.static(width)))) - wp.uint32(1))
                work.lanes += ray_count * wp.static(width)
                work.active += count_active(triangles.records, block, used, packet, bounds)
                block += 1
                rest -= wp.static(width)

    return count_work


@cache
def few_rays_step(config: TraversalConfig) -> wp.Function:
    """`wp.func(triangles, first, count, ray_count, packet, bounds, work)`: tests the rays of `bounds.few` against a leaf.

    Their number is `ray_count`. The leaf has `count` triangles, from block `first` on.
    """
    layout, any_hit = packet_layout(config), config.answer.rules.ends_at_first
    extract, store, count_work = extract_ray(layout), store_ray(layout, any_hit), count_few_rays(config)
    RayState = TRIANGLE_TESTS[config.triangle_test].ray_state
    test_block = block_step(replace(config, single=SingleConfig()))
    width, counting = config.width, config.counters

    @wp.func
    def step(
        triangles: TriangleBlocks,
        first: int,
        count: int,
        ray_count: int,
        packet: wp.array(dtype=float),
        bounds: wp.ref[PacketBounds],
        work: wp.ref[Counters],
    ):
        if wp.static(counting):
            work.leaves += 1
            count_work(triangles, first, count, ray_count, packet, bounds, work)
        for place in range(ray_count):
            ray = RayState()
            slabs = RaySlabs()
            best = BestHit()
            t_min = extract(packet, bounds, place, ray, slabs, best)
            primitive = best.primitive
            block = int(first)
            rest = int(count)
            while rest > 0:
                best = test_block(triangles, block, ray, slabs, t_min, best)
                block += 1
                rest -= wp.static(width)
                if wp.static(any_hit):
                    rest = wp.where(best.primitive < 0, rest, 0)
            if best.primitive != primitive:
                store(packet, bounds, place, best)

    return step
