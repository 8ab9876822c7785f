"""Two-level traversal for neighbouring rays: a packet traverses the tree of instances and the geometries below.

The upper tree is culled by intervals over the packet's rays (`wrt.kernels.traversal.packet.culling.interval_culling`), with the
slack that `wrt.kernels.traversal.two_level.instance_single` derives. At an instance all rays of the packet are transformed in
lanes (`wrt.kernels.traversal.two_level.instance_rays`), to the same bits as a single ray. They form a packet of the instance,
which is traced as in a scene of one mesh: it is culled, and split where its rays diverge. Its hits shorten the rays, and the
packet's range, before the next instance.

**Cost.** Rays that miss the instance are transformed in vain, but nothing is sorted or listed, and the upper tree costs a
packet about as much as it costs a single ray.

References: see `wrt.kernels.traversal.packet.core.packet_bvh`.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout import bvh_nodes as bvh
from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.instance_maps import Placement, object_ray, ray_environment
from wrt.kernels.layout.ray_batch import HitBatch, Ray, RayBatch
from wrt.kernels.layout.unchecked import load_int, store_int
from wrt.kernels.runtime.options import specialised_kernel
from wrt.kernels.simd.box_lanes import NO_CHILD, entry_of, nearest_child
from wrt.kernels.simd.boxes import INFINITY
from wrt.kernels.traversal.leaf import Counters
from wrt.kernels.traversal.packet import CULLINGS, CullingTraits
from wrt.kernels.traversal.packet.core import packet_bvh as packet
from wrt.kernels.traversal.packet.core import packet_splitting
from wrt.kernels.traversal.packet.core.packet_kernel import packet_layout, ray_continuation, rays_per_item, trace_packet
from wrt.kernels.traversal.packet.culling.interval_culling import cull_boxes
from wrt.kernels.traversal.packet.leaves import occluder_cache as occluder
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_load import load_packet
from wrt.kernels.traversal.single.single_bvh import make_bvh_walk
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.traversal.two_level.instance_rays import (
    ROWS,
    PacketMemory,
    is_active,
    keep_ranges,
    keep_rays,
    load_instance,
    merge_hits,
    set_arrays,
    store_candidate,
    store_rays,
)
from wrt.kernels.traversal.two_level.instance_single import BvhPart, InstanceTree, root_of

NO_GROUP = wp.constant(-2)
"""No rays of a packet are left."""


@wp.struct
class InstanceBatch:
    """What the packets of a batch share: both levels of the scene, the rays and their hits."""

    top: InstanceTree
    parts: wp.array(dtype=BvhPart)
    rays: RayBatch
    hits: HitBatch


@cache
def packet_loader(config: TraversalConfig) -> wp.Function:
    """`wp.func(batch, memory, begin, bounds)`: loads the packet at a place in the order of packets.

    bounds: receives the bounds of the packet, with the slack of the upper tree.
    """
    layout = packet_layout(config)
    keep, load, keep_bounds = keep_rays(layout), load_packet(layout, slopes=False), keep_ranges(layout)

    @wp.func
    def load_and_bound(batch: wp.ref[InstanceBatch], memory: wp.ref[PacketMemory], begin: int, bounds: wp.ref[PacketBounds]):
        size = wp.max(wp.max(wp.abs(batch.top.tree.low)), wp.max(wp.abs(batch.top.tree.high)))
        farthest = keep(batch.rays, begin, memory)
        # each ray's reach in this box is at least `slack_scale` times its reach in the scene
        corner = batch.top.slack_scale * (size + farthest)
        load(batch.rays, begin, wp.vec3(-corner, -corner, -corner), wp.vec3(corner, corner, corner), memory.packet, bounds)
        keep_bounds(memory)

    return load_and_bound


@cache
def next_group(config: TraversalConfig) -> wp.Function:
    """`wp.func(batch, memory, turn, bounds) -> root`: the node at which the next rays of a packet start that have the same
    environment; `NO_GROUP` if none is left. The other rays are inactive meanwhile. Neighbours mostly share their environment,
    so that a packet has one group.
    """
    packet_rays = config.packet.rays

    @wp.func
    def next_root(batch: wp.ref[InstanceBatch], memory: wp.ref[PacketMemory], turn: int, bounds: wp.ref[PacketBounds]):
        if batch.rays.environment.shape[0] == 0:
            return wp.where(turn == 0 and bounds.active > 0, batch.top.root, NO_GROUP)
        root = int(-1)
        while root == -1:  # rays of environments without instances miss
            chosen = int(-2)
            bounds.t_max = -INFINITY
            for k in range(packet_rays):
                if turn == 0:
                    memory.waiting[k] = memory.bound[k]
                memory.bound[k] = -INFINITY
                if memory.waiting[k] >= 0.0:
                    environment = ray_environment(batch.rays, memory.number[k])
                    if chosen == -2:
                        chosen = environment
                    if environment == chosen:
                        memory.bound[k] = memory.waiting[k]
                        memory.waiting[k] = -INFINITY
                        bounds.t_max = wp.max(bounds.t_max, memory.bound[k])
            root = NO_GROUP
            if chosen != -2:
                root = root_of(batch.top, chosen)
            turn += 1
        return root

    return next_root


@cache
def trace_left_rays(config: TraversalConfig) -> wp.Function:
    """`wp.func(batch, memory, placement, part, work)`: traces the rays of a packet in an instance that could not be traced
    together, one by one."""
    layout = packet_layout(config)
    needs_single_ray, active = packet_splitting.needs_single_ray(layout), is_active(layout)
    continue_ray = ray_continuation(config, WideNodes, make_bvh_walk(config))
    store, packet_rays = store_candidate(layout, config.answer.rules.ends_at_first), config.packet.rays
    own_origins = 0 if config.packet.shared_origin else 1

    @wp.func
    def trace(
        batch: wp.ref[InstanceBatch],
        memory: wp.ref[PacketMemory],
        placement: Placement,
        part: wp.ref[BvhPart],
        work: wp.ref[Counters],
    ):
        for k in range(packet_rays):
            if needs_single_ray(memory.packet, k) and active(memory, k):
                at = k * wp.static(own_origins)
                ray = Ray()
                ray.direction = wp.vec3(
                    memory.scene[k], memory.scene[k + wp.static(packet_rays)], memory.scene[k + wp.static(2 * packet_rays)]
                )
                ray.t_min = memory.scene[k + wp.static(3 * packet_rays)]
                origin = wp.vec3d(
                    memory.origin[at],
                    memory.origin[at + wp.static(packet_rays)],
                    memory.origin[at + wp.static(2 * packet_rays)],
                )
                ray = object_ray(placement, origin, ray, ray.t_max)
                i = memory.number[k]
                best = continue_ray(part.tree, part.triangles, memory.packet, k, ray, batch.hits, i, work)
                store(memory, k, best)

    return trace


@cache
def make_visit(config: TraversalConfig) -> wp.Function:
    """`wp.func(batch, memory, instance, work) -> t_max`: traces the packet through one instance."""
    layout = packet_layout(config)
    load = load_instance(layout, CullingTraits.SLOPES in CULLINGS[config.packet.culling].traits)
    trace = trace_packet(config, WideNodes, packet.make_packet_bvh_walk(config), packet.MIXED_AXES)
    forget_extent = packet_splitting.forget_extent(layout)
    cache_leaf, trace_left, merge = (
        occluder.cache_leaf(layout),
        trace_left_rays(config),
        merge_hits(layout, config.answer.rules.ends_at_first),
    )

    @wp.func
    def visit(batch: wp.ref[InstanceBatch], memory: wp.ref[PacketMemory], instance: int, work: wp.ref[Counters]):
        placement = batch.top.placements[instance]
        part = batch.parts[placement.geometry]
        bounds = PacketBounds()
        load(memory, batch.rays, placement, part.tree.low, part.tree.high, bounds)
        cache_leaf(memory.packet, 0, False)  # the last packet's leaf is in another instance's tree
        forget_extent(memory.packet)
        if not trace(part.tree, part.tree, part.triangles, memory.packet, memory.walk, bounds, work):
            trace_left(batch, memory, placement, part, work)
        return merge(memory, placement.first)

    return visit


@cache
def make_instance_packet_kernel(config: TraversalConfig, levels: int) -> wp.Kernel:
    """The kernel for one specialisation. An item is a run of packets.

    levels: greatest number of inner nodes on a path of the upper tree.
    """
    load_and_bound, visit, cull = packet_loader(config), make_visit(config), cull_boxes(packet_layout(config))
    next_root, store = next_group(config), store_rays(packet_layout(config), config.answer.rules.ends_at_first)
    width, packet_rays, size, run = config.width, config.packet.rays, packet_layout(config).size, rays_per_item(config)
    row, nearest = levels * config.width, nearest_child(config.width)

    def packets_through_instances(
        first: int,
        top: InstanceTree,
        parts: wp.array(dtype=BvhPart),
        rays: RayBatch,
        hits: HitBatch,
    ):
        batch = InstanceBatch()
        batch.top = top
        batch.parts = parts
        batch.rays = rays
        batch.hits = hits
        number = wp.zeros(shape=(packet_rays,), dtype=int)
        bound = wp.zeros(shape=(packet_rays,), dtype=float)
        waiting = wp.zeros(shape=(packet_rays,), dtype=float)
        scene = wp.zeros(shape=(wp.static(len(ROWS) * packet_rays),), dtype=float)
        origin = wp.zeros(shape=(wp.static(3 * packet_rays),), dtype=wp.float64)
        room = wp.zeros(shape=(size,), dtype=float)
        walk = wp.zeros(shape=(wp.static(packet.walk_memory(config)),), dtype=int)
        memory = PacketMemory()
        set_arrays(memory, number, bound, waiting, scene, origin, room, walk)
        keys = wp.zeros(shape=(row,), dtype=int)
        path = wp.zeros(shape=(levels,), dtype=int)
        work = Counters()
        begin = (first + wp.tid()) * wp.static(run)
        end = wp.min(begin + wp.static(run), rays.count)
        while begin < end:
            bounds = PacketBounds()
            load_and_bound(batch, memory, begin, bounds)
            turn = int(0)
            root = next_root(batch, memory, turn, bounds)
            while root >= 0:
                level = int(0)
                store_int(path, 0, root)
                key = cull(top.tree.bounds, root, memory.packet, bounds, keys, 0)
                while level >= 0:
                    if entry_of(key, wp.static(width)) <= bounds.t_max:
                        lane = key & wp.static(width - 1)
                        store_int(keys, level * wp.static(width) + lane, NO_CHILD)
                        child = load_int(top.tree.child, load_int(path, level) * wp.static(width) + lane)
                        if child >= 0:
                            level += 1
                            store_int(path, level, child)
                            key = cull(top.tree.bounds, child, memory.packet, bounds, keys, level * wp.static(width))
                        else:
                            instance = load_int(top.order, bvh.first_block(child) * wp.static(width))
                            bounds.t_max = visit(batch, memory, instance, work)
                            key = nearest(keys, level * wp.static(width))
                    else:
                        level -= 1
                        if level >= 0:
                            key = nearest(keys, level * wp.static(width))
                turn += 1
                root = next_root(batch, memory, turn, bounds)
            store(memory, rays, begin, hits)
            begin += wp.static(packet_rays)

    return specialised_kernel(packets_through_instances)
