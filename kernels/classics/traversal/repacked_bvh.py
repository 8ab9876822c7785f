"""Packets that are made again when less than half of their rays are active (Boulos, Wald and Benthin 2008), on a wide BVH.

**Problem.** The deeper a packet gets, the fewer of its rays meet a node, but every step still costs lanes for all of them, and
the bounds of all of them decide.

**Idea.** Count the rays that meet each child. If less than half of the packet does, these rays move to a packet of half the
size, which walks the child's subtree and may be repacked in turn, down to one vector; then the hits are copied back.

**Steps**, at a child of a node:

1. `list_rays`: how many of the packet's rays meet its box. If none does, it is skipped.
2. `repack_rays`, if less than half do (`MAX_USE`): they are copied to a packet of half the size, their ranges clipped to
   [entry, exit] of the box. By the consistency rule (`wrt.kernels.simd.boxes`) every hit below has a t within it. Its bounds
   are made from the points where the rays enter the box, and count t from there: `kept` holds the t of the entry, and
   `bounds.t_min` is 0. Entry points are rounded, so their intervals are widened by `MARGIN` slacks. A box that a ray enters at
   t is then entered by the bounds no later than t minus the entry. With a shared origin the bounds are exact without moving.
3. The smaller packet walks the subtree; `scatter_rays` copies its hits back, and `shorten_rays` the end of the bounds.

**Differences from the paper.** The paper moves the origins of rays; ours keep them for triangle tests, and only bounds are made
from the entry points, so hits are the same to the bit. Sizes are halved, so that loops have fixed lengths. Rays of several
packets are not joined. Because every child is tested against every ray, diverging packets need no other remedy: no packet is
abandoned, split (`packet_splitting`) or traced ray by ray, except at leaves that few rays meet (`few_active_rays`).

**Limits.** The count costs P lanes per child visited, which coherent packets do not need. Figures:
notebooks/records/2026-11-22-bounces.md.

References: boulos-2008; rahikainen-2013 (section 3.2).
"""

from dataclasses import replace
from functools import cache

import warp as wp

from wrt.kernels.layout import bvh_nodes as bvh
from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.ray_batch import HitBatch, RayBatch
from wrt.kernels.layout.unchecked import CACHE_LINE, first_line, load_int, store_int
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import specialised_kernel
from wrt.kernels.simd.box_lanes import NO_CHILD, entry_of, nearest_child
from wrt.kernels.traversal.leaf import CounterRows, Counters
from wrt.kernels.traversal.packet import CULLINGS, CullingTraits
from wrt.kernels.traversal.packet.core.few_active_rays import few_rays_step
from wrt.kernels.traversal.packet.core.packet_kernel import leaf_step, packet_layout
from wrt.kernels.traversal.packet.rays.packet_bounds import MAX_FEW_RAYS, PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout, cpp
from wrt.kernels.traversal.packet.rays.packet_load import bounding, load_packet
from wrt.kernels.traversal.packet.rays.packet_store import store_packet
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks

MAX_USE = wp.constant(0.5)
"""Share of active rays below which a packet is made again (Boulos et al. 2008)."""

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
def repack_rays(layout: PacketLayout, inner: PacketLayout, slopes: bool, moved: bool) -> wp.Function:
    """`wp.func(boxes, at, packet, outer, inner, numbers, first, bounds)`: copies the rays that meet a box to the packet
    `inner`, clipped to the box, and bounds them, with their origins moved to the box.

    at: node and lane of the box. outer: bounds of the packet. numbers: gets the numbers of the rays, from `first` on. bounds:
    of `inner`."""
    copied, bounded = f"{cpp(moved)}, {len(layout.components)}", f"{bounding(inner, slopes)}, {cpp(moved)}"

    @native.func_native(
        "packet_parts.h",
        f"""{GUARDS}
        const int node = at[0], lane = at[1];
        const {layout.type} from(packet.data);
        const {inner.type} to(inner.data);
        wrt::gather_rays<{copied}>({layout.box} + lane, from, outer, to, numbers.data + first);
        wrt::bound_entries<{bounded}>({layout.box} + lane, to, outer, bounds);""",
    )
    def repack(
        boxes: wp.array(dtype=float),
        at: wp.vec2i,
        packet: wp.array(dtype=float),
        outer: wp.ref[PacketBounds],
        inner: wp.array(dtype=float),
        numbers: wp.array(dtype=int),
        first: int,
        bounds: wp.ref[PacketBounds],
    ): ...

    return repack


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
        "packet_parts.h", f"wrt::scatter_rays({layout.packet}, {inner.type}(inner.data), numbers.data + first, count);"
    )
    def scatter_found_hits(
        packet: wp.array(dtype=float), inner: wp.array(dtype=float), numbers: wp.array(dtype=int), first: int, count: int
    ): ...

    return scatter_found_hits


def halved(config: TraversalConfig) -> TraversalConfig | None:
    """The config of packets of half the size; None if they would be less than a vector or not of whole vectors."""
    rays = config.packet.rays // 2
    fits = rays >= config.width and rays % config.width == 0
    return replace(config, packet=replace(config.packet, rays=rays)) if fits else None


def level_memory(config: TraversalConfig) -> int:
    """Ints of memory that the walk of packets of one size needs: a row of keys per level, the path, and numbers of rays."""
    size = config.stack.levels * (config.width + 1) + config.packet.rays
    return -(-size // CACHE_LINE) * CACHE_LINE


def walk_memory(config: TraversalConfig) -> int:
    """Ints of local memory that the walks of all sizes need, aligned to a cache line."""
    inner = halved(config)
    return level_memory(config) + (walk_memory(inner) if inner else CACHE_LINE)


@cache
def make_leaf(config: TraversalConfig, moved: bool) -> wp.Function:
    """`wp.func(tree, triangles, at, packet, bounds, memory, work)`: tests the leaf at a node and lane that some rays meet.

    at: node, lane, and number of these rays.
    """
    layout, culling = packet_layout(config), CULLINGS[config.packet.culling]
    inspect, test_leaf, test_few = culling.leaf(layout), leaf_step(config), few_rays_step(config)
    shorten = shorten_rays(layout, moved, config.answer.rules.ends_at_first)

    @wp.func
    def visit(
        tree: wp.ref[WideNodes],
        triangles: wp.ref[TriangleBlocks],
        at: wp.vec3i,
        packet: wp.array(dtype=float),
        bounds: wp.ref[PacketBounds],
        memory: wp.array(dtype=int),
        work: wp.ref[Counters],
    ):
        node, lane, met = at[0], at[1], at[2]
        child = load_int(tree.child, node * wp.static(config.width) + lane)
        first = bvh.first_block(child)
        count = bvh.leaf_triangles(child)
        if met > wp.static(MAX_FEW_RAYS):
            inspect(tree.bounds, node, lane, packet, bounds)
            test_leaf(triangles, first, count, packet, bounds, memory, work)
        else:
            test_few(triangles, first, count, met, packet, bounds, work)
        if wp.static(moved):
            shorten(packet, bounds)

    return visit


@cache
def make_descent(config: TraversalConfig, inner: TraversalConfig) -> wp.Function:
    """`wp.func(tree, triangles, at, packet, memory, base, bounds, work)`: a smaller packet of the rays that meet a child walks
    it; at: as for leaves.
    """
    layout, small, culling = packet_layout(config), packet_layout(inner), CULLINGS[config.packet.culling]
    moved = moves_origins(config)
    repack, scatter = repack_rays(layout, small, CullingTraits.SLOPES in culling.traits, moved), scatter_rays(layout, small)
    start, walk = culling.start(small), make_walk(inner, moved)
    size, numbers, step = small.size, config.stack.levels * (config.width + 1), level_memory(config)

    @wp.func
    def descend(
        tree: wp.ref[WideNodes],
        triangles: wp.ref[TriangleBlocks],
        at: wp.vec3i,
        packet: wp.array(dtype=float),
        memory: wp.array(dtype=int),
        base: int,
        bounds: wp.ref[PacketBounds],
        work: wp.ref[Counters],
    ):
        smaller = wp.zeros(shape=(size,), dtype=float)
        own = PacketBounds()
        node, lane, met = at[0], at[1], at[2]
        child = load_int(tree.child, node * wp.static(config.width) + lane)
        repack(tree.bounds, wp.vec2i(node, lane), packet, bounds, smaller, memory, base + wp.static(numbers), own)
        start(tree.low, tree.high, smaller, own)
        walk(tree, triangles, smaller, memory, base + wp.static(step), child, own, work)
        scatter(packet, smaller, memory, base + wp.static(numbers), met)

    return descend


def moves_origins(config: TraversalConfig) -> bool:
    """Whether the bounds of repacked packets begin at their entry points; not with one origin, nor without bounds."""
    return not config.packet.shared_origin and CullingTraits.EVERY_RAY not in CULLINGS[config.packet.culling].traits


@cache
def make_walk(config: TraversalConfig, moved: bool) -> wp.Function:
    """`wp.func(tree, triangles, packet, memory, base, start, bounds, work)`: walks the subtree of the inner node `start`.

    moved: whether the packet's bounds begin at entry points. base: start of the walk's memory.
    """
    culling, layout, inner = CULLINGS[config.packet.culling], packet_layout(config), halved(config)
    cull_boxes, nearest, list_meeting = culling.boxes(layout), nearest_child(config.width), list_rays(layout)
    visit, shorten = make_leaf(config, moved), shorten_rays(layout, moved, config.answer.rules.ends_at_first)
    descend = make_descent(config, inner) if inner else visit  # without smaller packets, never called
    repacks, smaller = inner is not None, inner.packet.rays if inner else 0
    width, counting, row = config.width, config.counters, config.stack.levels * config.width
    box_tests = config.width * (config.packet.rays if CullingTraits.EVERY_RAY in culling.traits else 1)

    @wp.func
    def walk(
        tree: wp.ref[WideNodes],
        triangles: wp.ref[TriangleBlocks],
        packet: wp.array(dtype=float),
        memory: wp.array(dtype=int),
        base: int,
        start: int,
        bounds: wp.ref[PacketBounds],
        work: wp.ref[Counters],
    ):
        path = base + wp.static(row)
        max_met = int(float(bounds.active) * MAX_USE)
        store_int(memory, path, start)
        key = cull_boxes(tree.bounds, start, packet, bounds, memory, base)
        level = wp.where(entry_of(key, wp.static(width)) <= bounds.t_max, 0, -1)
        if wp.static(counting):
            work.nodes += 1
            work.boxes += wp.static(box_tests)
        while level >= 0:
            if entry_of(key, wp.static(width)) <= bounds.t_max:
                lane = key & wp.static(width - 1)
                store_int(memory, base + level * wp.static(width) + lane, NO_CHILD)
                node = load_int(memory, path + level)
                child = load_int(tree.child, node * wp.static(width) + lane)
                met = list_meeting(tree.bounds, node, lane, packet, bounds)
                descends = met > 0 and child >= 0
                if wp.static(counting):
                    work.boxes += wp.static(config.packet.rays)
                if wp.static(repacks):  # noqa: SIM102 - decided when the kernel is made
                    if descends and met < max_met and met <= wp.static(smaller):
                        descend(tree, triangles, wp.vec3i(node, lane, met), packet, memory, base, bounds, work)
                        shorten(packet, bounds)
                        descends = False
                if descends:
                    level += 1
                    store_int(memory, path + level, child)
                    key = cull_boxes(tree.bounds, child, packet, bounds, memory, base + level * wp.static(width))
                    if wp.static(counting):
                        work.nodes += 1
                        work.boxes += wp.static(box_tests)
                else:
                    if met > 0 and child < 0:
                        visit(tree, triangles, wp.vec3i(node, lane, met), packet, bounds, memory, work)
                    key = nearest(memory, base + level * wp.static(width))
            else:
                level -= 1
                if level >= 0:
                    key = nearest(memory, base + level * wp.static(width))

    return walk


@cache
def make_repacked_bvh_kernel(config: TraversalConfig) -> wp.Kernel:
    """The kernel for one specialisation."""
    layout, culling = packet_layout(config), CULLINGS[config.packet.culling]
    load = load_packet(layout, CullingTraits.SLOPES in culling.traits)
    store = store_packet(layout, config.answer.rules.ends_at_first)
    start, walk = culling.start(layout), make_walk(config, False)
    packet_rays, size, memory_size, counting = config.packet.rays, layout.size, walk_memory(config), config.counters

    def repacked_packets(
        first: int, tree: WideNodes, triangles: TriangleBlocks, rays: RayBatch, hits: HitBatch, counters: CounterRows
    ):
        packet = wp.zeros(shape=(size,), dtype=float)
        memory = wp.zeros(shape=(memory_size,), dtype=int)
        base = first_line(memory, 0)
        begin = (first + wp.tid()) * rays.run
        end = wp.min(begin + rays.run, rays.count)
        while begin < end:
            work = Counters()
            bounds = PacketBounds()
            load(rays, begin, tree.low, tree.high, packet, bounds)
            if bounds.active > 0:
                start(tree.low, tree.high, packet, bounds)
                walk(tree, triangles, packet, memory, base, 0, bounds, work)
            store(packet, rays, begin, hits, False)
            if wp.static(counting):
                counters.rows[begin] = work
            begin += wp.static(packet_rays)

    return specialised_kernel(repacked_packets)
