"""Packets of a wide BVH that are answered together, before any of them is loaded.

Where a packet meets nothing, mostly its neighbours do not either. After some packets in succession that have met no leaf, the
kernel (`wrt.kernels.traversal.packet.core.packet_kernel`) asks for the next ones together: they are bounded as one
(`wrt.kernels.traversal.packet.rays.joint_bounds`), and if no box of the root is left, none of them has a hit.

Where the last occluder alone has occluded a packet of an any-hit query, mostly it occludes the next ones, too. They are tested
together against its triangles (`wrt.kernels.traversal.packet.leaves.covering_triangle`).
"""

from functools import cache

import warp as wp

from wrt.kernels.layout import bvh_nodes as bvh
from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.ray_batch import HitBatch, RayBatch
from wrt.kernels.layout.unchecked import first_line, load_int
from wrt.kernels.simd.box_lanes import entry_of
from wrt.kernels.traversal.mailbox import MAILBOXES
from wrt.kernels.traversal.packet import CULLINGS
from wrt.kernels.traversal.packet.core.packet_kernel import packet_layout, reverses_bounds
from wrt.kernels.traversal.packet.leaves import occluder_cache as occluder
from wrt.kernels.traversal.packet.leaves.covering_triangle import covered_packets
from wrt.kernels.traversal.packet.rays.joint_bounds import fetch_ahead, join_packets, store_together
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.reversed_bounds import reverse_bounds
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks

MISSED = 2
"""Packets in succession that have met no leaf, after which the next ones are tested together."""

JOINED = 4
"""Greatest number of packets that are tested together (notebooks/records/2026-11-26-joined-packets.md)."""


@cache
def root_misses(config: TraversalConfig) -> wp.Function:
    """`wp.func(tree, rays, begin, limit, packet, memory) -> int`: the number of packets from ray `begin` on, at most
    `limit`, that together miss all boxes of the root; 0 if they may meet one, or do not lie side by side (`joint_bounds`)."""
    layout, width, reverses = packet_layout(config), config.width, reverses_bounds(config, True)
    join, reverse = join_packets(layout, reverses), reverse_bounds(layout)
    cull_boxes = CULLINGS[config.packet.culling].boxes(layout)
    mailbox_size = MAILBOXES[config.mailbox].size

    @wp.func
    def misses(
        tree: wp.ref[WideNodes],
        rays: wp.ref[RayBatch],
        begin: int,
        limit: int,
        packet: wp.array(dtype=float),
        memory: wp.array(dtype=int),
    ):
        bounds = PacketBounds()
        packets = join(rays, begin, limit, tree.low, tree.high, bounds)
        if packets > 0:
            if wp.static(reverses):
                reverse(tree.low, tree.high, bounds)
            key = cull_boxes(tree.bounds, 0, packet, bounds, memory, first_line(memory, wp.static(mailbox_size)))
            if entry_of(key, wp.static(width)) <= bounds.t_max:
                packets = 0
        return packets

    return misses


@cache
def joined_misses(config: TraversalConfig) -> wp.Function:
    """`wp.func(tree, rays, begin, end, packet, memory, hits) -> int`: tests the next packets together, at most `JOINED` of
    those up to ray `end`, and stores that they have no hits if none can have one.

    Returns their number; 0 if they have to be traced.
    """
    layout, packet_rays = packet_layout(config), config.packet.rays
    store = store_together(layout, config.answer.rules.ends_at_first, config.packet.non_temporal)
    count_misses, fetch = root_misses(config), fetch_ahead(layout)
    fetches = not config.answer.rules.ends_at_first and not config.packet.non_temporal

    @wp.func
    def miss_together(
        tree: wp.ref[WideNodes],
        rays: wp.ref[RayBatch],
        begin: int,
        end: int,
        packet: wp.array(dtype=float),
        memory: wp.array(dtype=int),
        hits: wp.ref[HitBatch],
    ):
        limit = wp.min((end - begin) // wp.static(packet_rays), wp.static(JOINED))
        if wp.static(fetches):
            fetch(rays, begin, limit, hits)
        packets = count_misses(tree, rays, begin, limit, packet, memory)
        if packets > 0:
            store(rays, begin, packets, hits)
        return packets

    return miss_together


@cache
def joined_occlusion(config: TraversalConfig) -> wp.Function:
    """`wp.func(tree, triangles, rays, begin, end, leaf, hits) -> int`: tests whether a triangle of a leaf covers the next
    packets, at most `JOINED` of those up to ray `end`, and stores that they are occluded if one does.

    Returns their number; 0 if they have to be traced. leaf: as in `wrt.kernels.traversal.packet.leaves.occluder_cache`.
    """
    layout, packet_rays, width = packet_layout(config), config.packet.rays, config.width
    covered, store = covered_packets(layout), store_together(layout, True, False, occluded=True)

    @wp.func
    def occlude_together(
        tree: wp.ref[WideNodes],
        triangles: wp.ref[TriangleBlocks],
        rays: wp.ref[RayBatch],
        begin: int,
        end: int,
        leaf: int,
        hits: wp.ref[HitBatch],
    ):
        child = load_int(tree.child, leaf - 1)
        blocks = (bvh.leaf_triangles(child) + wp.static(width - 1)) // wp.static(width)
        limit = wp.min((end - begin) // wp.static(packet_rays), wp.static(JOINED))
        packets = covered(rays, begin, limit, triangles.records, bvh.first_block(child), blocks)
        if packets > 0:
            store(rays, begin, packets, hits)
        return packets

    return occlude_together


def may_cover(config: TraversalConfig) -> bool:
    """Whether packets may be occluded together."""
    certain = TRIANGLE_TESTS[config.triangle_test].packet_form.certain
    return config.answer.rules.ends_at_first and certain and not config.cull_backfaces


@cache
def answer_together(config: TraversalConfig) -> wp.Function:
    """`wp.func(tree, triangles, rays, left, packet, memory, hits, missed) -> int`: the number of packets from ray `left[0]`
    on whose results it stores, up to ray `left[1]`; 0 if the next one has to be traced.

    missed: packets in succession that have met no leaf; 0 again if the next ones may meet one.
    """
    misses, layout, covering = joined_misses(config), packet_layout(config), may_cover(config)
    occlusion = joined_occlusion(config) if covering else None
    covering_leaf, wait = occluder.covering_leaf(layout), occluder.wait_for_packets(layout, JOINED)

    @wp.func
    def answer(
        tree: wp.ref[WideNodes],
        triangles: wp.ref[TriangleBlocks],
        rays: wp.ref[RayBatch],
        left: wp.vec2i,
        packet: wp.array(dtype=float),
        memory: wp.array(dtype=int),
        hits: wp.ref[HitBatch],
        missed: wp.ref[int],
    ):
        packets = int(0)
        if missed >= wp.static(MISSED):
            packets = misses(tree, rays, left[0], left[1], packet, memory, hits)
            missed = wp.where(packets == 0, 0, missed)
        elif wp.static(covering):
            leaf = covering_leaf(packet)
            if leaf > 0:
                packets = occlusion(tree, triangles, rays, left[0], left[1], leaf, hits)
                if packets == 0:
                    wait(packet)
        return packets

    return answer
