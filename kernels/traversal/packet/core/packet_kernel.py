"""The parts of packet traversal that do not depend on the tree: the kernel around a walk, and the test of a leaf.

An item of the kernel is a run of packets. Each is loaded, traversed as a whole, and stored. A packet that cannot be traversed
as a whole (directions with both signs along too many axes, or an abandoned traversal) is split if its rays have separate
origins (`wrt.kernels.traversal.packet.core.packet_splitting`). Rays that still cannot be traced together, and packets with a
shared origin, are traced one by one.
"""

from functools import cache
from typing import NamedTuple

import warp as wp

from wrt.kernels.answers.answer_kind import BestHit, improves, start
from wrt.kernels.layout.ray_batch import HitBatch, Ray, RayBatch, load_ray
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import specialised_kernel
from wrt.kernels.simd.lanes import count_bits
from wrt.kernels.traversal.leaf import CounterRows, Counters
from wrt.kernels.traversal.mailbox import MAILBOXES
from wrt.kernels.traversal.packet import CULLINGS, CullingTraits
from wrt.kernels.traversal.packet.core import packet_splitting
from wrt.kernels.traversal.packet.culling.back_faces import keep_front_faces
from wrt.kernels.traversal.packet.leaves.packet_block import active_lanes, lanes_tested, test_block
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout
from wrt.kernels.traversal.packet.rays.packet_load import finish_packet, load_packet
from wrt.kernels.traversal.packet.rays.packet_store import fetch_hits, finish_stores, store_packet
from wrt.kernels.traversal.packet.rays.ray_numbers import ray_at
from wrt.kernels.traversal.packet.rays.reversed_bounds import reverse_bounds
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks


def packet_layout(config: TraversalConfig) -> PacketLayout:
    """Memory layout of the packets of a config."""
    return PacketLayout(config.packet.rays, config.width, config.packet.shared_origin, config.triangle_test)


@wp.struct
class PacketMemory:
    """Memory of an item, in which it traces one packet after the other."""

    packet: wp.array(dtype=float)
    """The packet (`PacketLayout`)."""
    walk: wp.array(dtype=int)
    """What its walk needs."""


@wp.func
def packet_memory(packet: wp.array(dtype=float), walk: wp.array(dtype=int)):
    """A struct of arrays that a kernel has made: Warp lets only a function's arguments become fields."""
    memory = PacketMemory()
    memory.packet = packet
    memory.walk = walk
    return memory


@wp.struct
class PacketWork:
    """Work done for a packet so far, and where it is written when the packet is done."""

    counters: CounterRows
    done: Counters


RUN = 8
"""Packets per item, or more (`RayBatch.run`). They share its local memory, which Warp clears once per item
(notebooks/records/2026-11-21-packets.md)."""


def rays_per_item(config: TraversalConfig) -> int:
    """Rays of a run of packets; an item of the kernel is one or more runs (`RayBatch.run`)."""
    return RUN * config.packet.rays


@cache
def leaf_step(config: TraversalConfig) -> wp.Function:
    """`wp.func(triangles, block, count, packet, bounds, mailbox, work)`: tests the `count` triangles of a leaf, from a block
    on."""
    layout = packet_layout(config)
    cull_triangles = CULLINGS[config.packet.culling].triangles(layout)
    culling, keep_fronts = config.cull_backfaces, keep_front_faces(layout)
    test_triangles = test_block(layout, config.answer.rules.ends_at_first, culling)
    count_active, lanes_per_triangle = active_lanes(layout), lanes_tested(layout)
    filter_tested = MAILBOXES[config.mailbox].filter(config.width)
    width, counting = config.width, config.counters

    @wp.func
    def step(
        triangles: TriangleBlocks,
        first: int,
        count: int,
        packet: wp.array(dtype=float),
        bounds: wp.ref[PacketBounds],
        mailbox: wp.array(dtype=int),
        work: wp.ref[Counters],
    ):
        if wp.static(counting):
            work.leaves += 1
            work.culled += count
        block = int(first)
        rest = int(count)
        while rest > 0:
            kept = cull_triangles(triangles.records, block, bounds)
            if wp.static(culling):
                kept = kept & keep_fronts(triangles.records, block, bounds)
            mask = filter_tested(triangles.primitive, block, kept, mailbox)
            if wp.static(counting):
                used = wp.uint32((wp.uint32(1) << wp.uint32(wp.min(rest, wp.static(width)))) - wp.uint32(1))
                tested = count_bits(mask & used)
                avoided = count_bits(kept & used) - tested
                work.culled -= tested + avoided
                work.avoided += avoided
                work.triangles += tested
                work.lanes += tested * lanes_per_triangle(bounds)
                work.active += count_active(triangles.records, block, mask & used, packet, bounds)
            if mask != wp.uint32(0):
                test_triangles(triangles.records, triangles.primitive, block, mask, packet, bounds)
            block += 1
            rest -= wp.static(width)

    return step


@cache
def load_hit(layout: PacketLayout) -> wp.Function:
    """`wp.func(packet, k, best)`: the best hit so far of an active ray of a packet."""

    @native.func_native("packet_parts.h", f"wrt::load_hit({layout.packet}, k, best);")
    def load_hit_native(packet: wp.array(dtype=float), k: int, best: wp.ref[BestHit]): ...

    return load_hit_native


@cache
def ray_continuation(config: TraversalConfig, Tree: type, walk_ray: wp.Function) -> wp.Function:
    """`wp.func(tree, triangles, packet, k, ray, hits, i, work) -> best`: traces ray k of a packet, a valid one, up to its best
    hit so far; walk_ray: see `trace_single_rays`."""
    load, any_hit = load_hit(packet_layout(config)), config.answer.rules.ends_at_first

    @wp.func
    def continue_ray(
        tree: wp.ref[Tree],
        triangles: wp.ref[TriangleBlocks],
        packet: wp.array(dtype=float),
        k: int,
        ray: Ray,
        hits: wp.ref[HitBatch],
        i: int,
        work: wp.ref[Counters],
    ):
        best = BestHit()
        load(packet, k, best)
        ray.t_max = best.t
        if wp.static(any_hit):
            if best.primitive < 0:
                best = walk_ray(tree, triangles, ray, hits, i, work)
        else:
            found = walk_ray(tree, triangles, ray, hits, i, work)
            if found.primitive >= 0 and improves(found.t, found.primitive, ray.t_min, best):
                best = found
        return best

    return continue_ray


@cache
def trace_single_rays(config: TraversalConfig, Tree: type, walk_ray: wp.Function) -> wp.Function:
    """`wp.func(tree, triangles, rays, begin, packet, hits, work)`: traces the rays of the packet at `begin` one by one.

    These are all of its rays, or those for which `packet_splitting.needs_single_ray` is true. They keep what the packet has
    found, and search up to there. walk_ray: `wp.func(tree, triangles, ray, hits, i, work) -> best`. `work` is the work done for
    the packet so far; it is added to that of the first ray.
    """
    store, counting, packet_rays = config.answer.stored.store, config.counters, config.packet.rays
    needs_single_ray = packet_splitting.needs_single_ray(packet_layout(config))
    continue_ray = ray_continuation(config, Tree, walk_ray)

    @wp.func
    def trace(
        tree: wp.ref[Tree],
        triangles: wp.ref[TriangleBlocks],
        rays: wp.ref[RayBatch],
        begin: int,
        packet: wp.array(dtype=float),
        hits: wp.ref[HitBatch],
        work: wp.ref[PacketWork],
    ):
        for place in range(begin, wp.min(begin + wp.static(packet_rays), rays.count)):
            if not needs_single_ray(packet, place - begin):
                continue
            i = ray_at(rays, place, wp.static(packet_rays))
            ray = load_ray(rays, i)
            best = start(ray.t_max)
            if ray.valid:
                best = continue_ray(tree, triangles, packet, place - begin, ray, hits, i, work.done)
            store(hits, i, best)
            if wp.static(counting):
                work.counters.rows[place] = work.done
                work.done = Counters()

    return trace


def reverses_bounds(config: TraversalConfig, reversible: bool) -> bool:
    """Whether packets may be bounded as seen from the ends of their rays; reversible: as in `packet_step`."""
    occlusion = config.answer.rules.ends_at_first and not config.packet.shared_origin
    return reversible and CullingTraits.REVERSIBLE in CULLINGS[config.packet.culling].traits and occlusion


@cache
def trace_parts(config: TraversalConfig, Tree: type, trace_unsplit: wp.Function, ends: bool, later: bool) -> wp.Function:
    """`wp.func(tree, below, triangles, packet, memory, bounds, work) -> bool`: traces a packet, split if necessary.

    False if some rays are still to be traced one by one (`packet_splitting.needs_single_ray`). trace_unsplit: the same for a
    packet that is not to be split. ends: whether it needs the bounds of the ends of rays. later: as in `packet_step`.
    """
    layout = packet_layout(config)
    is_wide, finish_loading = packet_splitting.is_wide(layout), finish_packet(layout)
    activate = packet_splitting.activate_part(layout, CullingTraits.SLOPES in CULLINGS[config.packet.culling].traits, ends)
    finish, count_single_rays = packet_splitting.finish_part(layout), packet_splitting.count_single_rays(layout)

    @wp.func
    def trace(
        tree: wp.ref[Tree],
        below: wp.ref[Tree],
        triangles: wp.ref[TriangleBlocks],
        packet: wp.array(dtype=float),
        memory: wp.array(dtype=int),
        bounds: wp.ref[PacketBounds],
        work: wp.ref[Counters],
    ):
        abandoned = bool(False)
        parts = int(1)
        number = int(0)
        while number < parts:
            if number > 0:
                activate(packet, bounds, number)
            splits = bounds.active > 0 and parts + 2 <= wp.static(packet_splitting.MAX_PARTS)
            completed = bool(False)
            if splits and is_wide(packet, bounds, tree.low, tree.high, number == 0):
                if wp.static(later):
                    finish_loading(tree.low, tree.high, packet, bounds)
            else:
                completed = trace_unsplit(tree, below, triangles, packet, memory, bounds, work)
            abandoned = abandoned or not completed
            parts += finish(packet, bounds, number, parts, completed)
            number += 1
        return not abandoned or count_single_rays(packet) == 0

    return trace


@cache
def trace_packet(
    config: TraversalConfig,
    Tree: type,
    walk_packet: wp.Function,
    mixed_axes: int,
    reversible: bool = False,
    later: bool = False,
) -> wp.Function:
    """`wp.func(tree, below, triangles, packet, memory, bounds, work) -> bool`: traces a packet that is loaded, split if
    necessary.

    False if some rays are still to be traced one by one (`packet_splitting.needs_single_ray`). Arguments as in `packet_step`.
    """
    layout, culling = packet_layout(config), CULLINGS[config.packet.culling]
    start_packet, finish = culling.start(layout), finish_packet(layout)
    reverses = reverses_bounds(config, reversible)
    reverse = reverse_bounds(layout) if reverses else None

    @wp.func
    def trace_unsplit(
        tree: wp.ref[Tree],
        below: wp.ref[Tree],
        triangles: wp.ref[TriangleBlocks],
        packet: wp.array(dtype=float),
        memory: wp.array(dtype=int),
        bounds: wp.ref[PacketBounds],
        work: wp.ref[Counters],
    ):
        completed = bounds.active == 0 or bounds.mixed_axes <= wp.static(mixed_axes)
        if completed and bounds.active > 0:
            start_packet(tree.low, tree.high, packet, bounds)
            if wp.static(reverses):
                reverse(tree.low, tree.high, bounds)
            completed = walk_packet(below, triangles, packet, memory, bounds, work)
        if wp.static(later) and not completed:  # its rays are traced in parts, or one by one
            finish(tree.low, tree.high, packet, bounds)
        return completed

    return trace_unsplit if config.packet.shared_origin else trace_parts(config, Tree, trace_unsplit, reverses, later)


@cache
def packet_step(
    config: TraversalConfig,
    Tree: type,
    walk_packet: wp.Function,
    walk_ray: wp.Function,
    mixed_axes: int,
    reversible: bool = False,
    later: bool = False,
) -> wp.Function:
    """`wp.func(tree, below, triangles, rays, begin, memory, hits, work) -> bool`: traces the packet at `begin`. False if it met
    no leaf, as far as that is known (`later`).

    below: the tree, or the subtree that contains all hits of the packet.

    Args:
        config: the specialisation.
        Tree: struct of the tree.
        walk_packet: `wp.func(tree, triangles, packet, memory, bounds, work) -> bool`: traces one packet; False if its traversal
            was abandoned.
        walk_ray: `wp.func(tree, triangles, ray, hits, i, work) -> best`: traces one valid ray.
        mixed_axes: greatest number of axes with both signs for which a packet is traversed as a whole.
        reversible: whether the walk may see the rays from their ends (`reversed_bounds`).
        later: whether `finish_packet` is called before the first leaf.
    """
    layout, parts, culling = packet_layout(config), not config.packet.shared_origin, CULLINGS[config.packet.culling]
    load = load_packet(layout, CullingTraits.SLOPES in culling.traits, later, reverses_bounds(config, reversible))
    store, fetch = store_packet(layout, config.answer.rules.ends_at_first, config.packet.non_temporal), fetch_hits(layout)
    fetches = not config.answer.rules.ends_at_first and not config.packet.non_temporal
    single_rays, counting = trace_single_rays(config, Tree, walk_ray), config.counters
    trace = trace_packet(config, Tree, walk_packet, mixed_axes, reversible, later)

    @wp.func
    def step(
        tree: wp.ref[Tree],
        below: wp.ref[Tree],
        triangles: wp.ref[TriangleBlocks],
        rays: wp.ref[RayBatch],
        begin: int,
        memory: wp.ref[PacketMemory],
        hits: wp.ref[HitBatch],
        work: wp.ref[PacketWork],
    ):
        bounds = PacketBounds()
        if wp.static(fetches):
            fetch(rays, begin, hits)
        load(rays, begin, tree.low, tree.high, memory.packet, bounds)
        completed = trace(tree, below, triangles, memory.packet, memory.walk, bounds, work.done)
        tested = not wp.static(later) or bounds.finished != 0
        if completed or wp.static(parts):  # left-over rays are stored again when they are traced
            store(memory.packet, rays, begin, hits, not tested)
        if not completed:
            single_rays(tree, triangles, rays, begin, memory.packet, hits, work)
        elif wp.static(counting):
            work.counters.rows[begin] = work.done
            work.done = Counters()
        return tested

    return step


class PacketWalk(NamedTuple):
    """The walks of a kernel for packets.

    Attributes:
        packet, ray, mixed_axes, reversible, later: `walk_packet`, `walk_ray` and the others as in `packet_step`.
        memory_size: ints of memory for a walk.
    """

    packet: wp.Function
    ray: wp.Function
    mixed_axes: int
    memory_size: int
    reversible: bool = False
    later: bool = False


@cache
def make_packet_kernel(
    config: TraversalConfig, Tree: type, walk: PacketWalk, answer_together: wp.Function | None = None
) -> wp.Kernel:
    """The kernel for one specialisation.

    Args:
        config: the specialisation.
        Tree: struct of the tree.
        walk: how it is walked.
        answer_together: `wp.func(tree, triangles, rays, left, packet, memory, hits, missed) -> packets`: the number of packets
            from ray `left[0]` on whose results it stores, up to ray `left[1]`; 0 if the next one has to be traced. `missed` is
            the number of packets in succession that have met no leaf. None not to ask.
    """
    step = packet_step(config, Tree, walk.packet, walk.ray, walk.mixed_axes, walk.reversible, walk.later)
    memory_size = walk.memory_size
    packet_rays, size, non_temporal = config.packet.rays, packet_layout(config).size, config.packet.non_temporal
    joining = answer_together is not None

    def packet_traversal(
        first: int,
        tree: Tree,
        triangles: TriangleBlocks,
        rays: RayBatch,
        hits: HitBatch,
        counters: CounterRows,
    ):
        packet = wp.zeros(shape=(size,), dtype=float)
        walk_memory = wp.zeros(shape=(memory_size,), dtype=int)
        memory = packet_memory(packet, walk_memory)
        work = PacketWork()
        work.counters = counters
        begin = (first + wp.tid()) * rays.run
        end = wp.min(begin + rays.run, rays.count)
        missed = int(0)
        while begin < end:
            packets = int(0)
            if wp.static(joining):
                packets = answer_together(tree, triangles, rays, wp.vec2i(begin, end), packet, walk_memory, hits, missed)
            if packets == 0:
                work.done = Counters()
                tested = step(tree, tree, triangles, rays, begin, memory, hits, work)
                missed = wp.where(tested, 0, missed + 1)
                packets = 1
            begin += packets * wp.static(packet_rays)
        if wp.static(non_temporal):
            finish_stores()

    return specialised_kernel(packet_traversal)
