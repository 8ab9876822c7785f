"""Packets that are tested against the root of a wide BVH together.

Where a packet meets nothing, mostly its neighbours do not either. After some packets in succession that have met no leaf, the
kernel (`wrt.kernels.traversal.packet.core.packet_kernel`) asks for the next ones together: they are bounded as one
(`wrt.kernels.traversal.packet.rays.joint_bounds`), and if no box of the root is left, none of them has a hit.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.ray_batch import HitBatch, RayBatch
from wrt.kernels.layout.unchecked import first_line
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.box_lanes import entry_of
from wrt.kernels.traversal.mailbox import MAILBOXES
from wrt.kernels.traversal.packet import CULLINGS
from wrt.kernels.traversal.packet.core.packet_kernel import packet_layout, reverses_bounds
from wrt.kernels.traversal.packet.rays.joint_bounds import fetch_ahead, join_packets, store_misses
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.reversed_bounds import reverse_bounds
from wrt.kernels.traversal.traversal_config import ANY, TraversalConfig

exact_module(__name__)

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
    store = store_misses(layout, config.query == ANY, config.packet.non_temporal)
    count_misses, fetch = root_misses(config), fetch_ahead(layout)
    fetches = config.query != ANY and not config.packet.non_temporal

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
