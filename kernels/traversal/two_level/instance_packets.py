"""Two-level traversal for neighbouring rays: a packet traverses the tree of instances and the geometries below.

The upper tree is culled by intervals over the packet's rays (`wrt.kernels.traversal.packet.culling.interval_culling`), with the
slack that `wrt.kernels.traversal.two_level.instance_single` derives. At an instance all rays of the packet are transformed in
one loop, to the same bits as a single ray. They form a packet of the instance, which is traced as in a scene of one mesh: it is
culled, and split where its rays diverge. Its hits shorten the rays, and the packet's range, before the next instance.

**Cost.** Rays that miss the instance are transformed in vain, but nothing is sorted or listed, and the upper tree costs a
packet about as much as it costs a single ray.

References: see `wrt.kernels.traversal.packet.core.packet_bvh`.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout import bvh_nodes as bvh
from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.instance_maps import Placement, ray_environment, ray_mask
from wrt.kernels.layout.ray_batch import DIRECTION_LANES, HitBatch, RayBatch, load_ray
from wrt.kernels.layout.unchecked import load_int, store_int
from wrt.kernels.runtime.options import exact_module, specialised_kernel
from wrt.kernels.simd.box_lanes import NO_CHILD, entry_of, nearest_child
from wrt.kernels.simd.boxes import INFINITY
from wrt.kernels.simd.lanes import FOR_LANES
from wrt.kernels.traversal.leaf import CounterRows, Counters
from wrt.kernels.traversal.packet.core import occluder_cache as occluder
from wrt.kernels.traversal.packet.core import packet_bvh as packet
from wrt.kernels.traversal.packet.core.packet_kernel import packet_layout, packet_step, rays_per_item
from wrt.kernels.traversal.packet.culling.interval_culling import cull_boxes
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_load import load_packet
from wrt.kernels.traversal.packet.rays.ray_numbers import ray_at
from wrt.kernels.traversal.single.single_bvh import make_walk
from wrt.kernels.traversal.traversal_config import ANY, TraversalConfig
from wrt.kernels.traversal.two_level.instance_single import BvhPart, InstanceTree, root_of

exact_module(__name__)

NO_GROUP = wp.constant(-2)
"""No rays of a packet are left."""


@wp.struct
class InstanceBatch:
    """What the packets of a batch share: both levels of the scene, the rays, and memory for rays and hits in object space."""

    top: InstanceTree
    parts: wp.array(dtype=BvhPart)
    rays: RayBatch
    object_rays: RayBatch
    """Receives the rays of a packet in the space of an instance, from the packet's `slot` on."""
    object_hits: HitBatch
    """Receives their hits."""
    hits: HitBatch
    counters: CounterRows


@wp.struct
class PacketMemory:
    """Local memory of a run of packets, used by one packet after the other."""

    number: wp.array(dtype=int)
    """(P,) number of each ray in the batch."""
    bound: wp.array(dtype=float)
    """(P,) t of the best hit of each ray, or its t_max; -inf if it is invalid or done."""
    waiting: wp.array(dtype=float)
    """(P,) t_max of each ray whose environment is still to be traced; -inf for the others. Used with environments only."""
    packet: wp.array(dtype=float)
    """The packet (`wrt.kernels.traversal.packet.rays.packet_layout`), first of the scene, then of an instance."""
    walk: wp.array(dtype=int)
    """Memory for the walk through an instance."""


_SET = "memory.number = number; memory.bound = bound; memory.waiting = waiting; memory.packet = packet; memory.walk = walk;"


@wp.func_native(_SET)
def set_arrays(
    memory: wp.ref[PacketMemory],
    number: wp.array(dtype=int),
    bound: wp.array(dtype=float),
    waiting: wp.array(dtype=float),
    packet: wp.array(dtype=float),
    walk: wp.array(dtype=int),
):
    """Makes the struct use local arrays; Warp assigns them to no field of a struct."""
    ...


_TRANSFORM = """
    const double *m = &place.to_object.data[0][0];
    const double px = place.origin.c[0], py = place.origin.c[1], pz = place.origin.c[2];
    const double cx = rays.center.c[0], cy = rays.center.c[1], cz = rays.center.c[2];
    float* to_origin = (float*)(object_rays.origins.data + slot);
    float* to_direction = (float*)(object_rays.directions.data + slot);
    for (int k = 0; k < P; ++k) {
        const int i = number.data[k];
        wp::vec3 o = rays.origins.data[i * rays.origin_stride], d = rays.directions.data[i * rays.direction_stride];
        wrt_direction(d.c[0], d.c[1], d.c[2]);
        const double x = ((double)o.c[0] - cx) - px, y = ((double)o.c[1] - cy) - py, z = ((double)o.c[2] - cz) - pz;
        const double dx = d.c[0], dy = d.c[1], dz = d.c[2];
        for (int a = 0; a < 3; ++a) {
            to_origin[3 * k + a] = (float)((m[3 * a] * x + m[3 * a + 1] * y) + m[3 * a + 2] * z);
            to_direction[3 * k + a] = (float)((m[3 * a] * dx + m[3 * a + 1] * dy) + m[3 * a + 2] * dz);
        }
        object_rays.t_min.data[slot + k] = rays.t_min.data[i * rays.t_min_stride];
        object_rays.t_max.data[slot + k] = bound.data[k];
    }
"""


@cache
def transform_packet(packet_rays: int) -> wp.Function:
    """`wp.func(rays, number, bound, place, slot, object_rays)`: transforms P rays of a batch, by their numbers, to the space of
    an instance.

    The arithmetic is that of `wrt.kernels.layout.instance_maps.object_ray`. object_rays: receives the rays from `slot` on, from
    their t_min up to `bound`.
    """

    @wp.func_native(f"{FOR_LANES}    constexpr int P = {packet_rays};\n{DIRECTION_LANES}{_TRANSFORM}")
    def transform_packet_native(
        rays: RayBatch,
        number: wp.array(dtype=int),
        bound: wp.array(dtype=float),
        place: Placement,
        slot: int,
        object_rays: RayBatch,
    ): ...

    return transform_packet_native


@cache
def packet_loader(config: TraversalConfig) -> wp.Function:
    """`wp.func(batch, memory, begin, bounds)`: loads the packet at a place in the order of packets.

    bounds: receives the bounds of the packet, with the slack of the upper tree.
    """
    load, packet_rays = load_packet(packet_layout(config), slopes=False), config.packet.rays

    @wp.func
    def load_and_bound(batch: wp.ref[InstanceBatch], memory: wp.ref[PacketMemory], begin: int, bounds: wp.ref[PacketBounds]):
        size = wp.max(wp.max(wp.abs(batch.top.tree.low)), wp.max(wp.abs(batch.top.tree.high)))
        farthest = float(0.0)
        for k in range(packet_rays):
            memory.number[k] = ray_at(batch.rays, wp.min(begin + k, batch.rays.count - 1), packet_rays)
            memory.bound[k] = -INFINITY
            if begin + k < batch.rays.count:
                ray = load_ray(batch.rays, memory.number[k])
                if ray.valid:
                    memory.bound[k] = ray.t_max
                    farthest = wp.max(farthest, wp.max(wp.abs(ray.origin)))
        # each ray's reach in this box is at least `stretch` times its reach in the scene
        corner = batch.top.stretch * (size + farthest)
        load(batch.rays, begin, wp.vec3(-corner, -corner, -corner), wp.vec3(corner, corner, corner), memory.packet, bounds)

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
def merge_packet_hits(config: TraversalConfig) -> wp.Function:
    """`wp.func(batch, memory, placement, slot) -> t_max`: merges the hits of a packet in an instance.

    Shortens the rays, and returns the greatest t at which a hit still counts.
    """
    packet_rays, any_hit = config.packet.rays, config.query == ANY

    @wp.func
    def merge(batch: wp.ref[InstanceBatch], memory: wp.ref[PacketMemory], placement: Placement, slot: int):
        t_max = float(-INFINITY)
        for k in range(packet_rays):
            i = memory.number[k]
            if memory.bound[k] >= 0.0:
                if wp.static(any_hit):
                    if batch.object_hits.occluded[slot + k]:
                        batch.hits.occluded[i] = True
                        memory.bound[k] = -INFINITY
                elif batch.object_hits.primitive[slot + k] >= 0:
                    t = batch.object_hits.t[slot + k]
                    primitive = placement.first + batch.object_hits.primitive[slot + k]
                    if t < batch.hits.t[i] or (t == batch.hits.t[i] and primitive < batch.hits.primitive[i]):
                        batch.hits.t[i] = t
                        batch.hits.primitive[i] = primitive
                        batch.hits.uv[i] = batch.object_hits.uv[slot + k]
                        memory.bound[k] = t
                t_max = wp.max(t_max, memory.bound[k])
        return t_max

    return merge


@cache
def make_visit(config: TraversalConfig) -> wp.Function:
    """`wp.func(batch, memory, instance, slot, work) -> t_max`: traces the packet through one instance."""
    step = packet_step(config, WideNodes, packet.make_walk_packet(config), make_walk(config), packet.MIXED_AXES)
    cache_leaf = occluder.cache_leaf(packet_layout(config))
    transform, merge, packet_rays = transform_packet(config.packet.rays), merge_packet_hits(config), config.packet.rays

    @wp.func
    def visit(batch: wp.ref[InstanceBatch], memory: wp.ref[PacketMemory], instance: int, slot: int, work: wp.ref[Counters]):
        placement = batch.top.placements[instance]
        part = batch.parts[placement.geometry]
        transform(batch.rays, memory.number, memory.bound, placement, slot, batch.object_rays)
        if batch.rays.mask.shape[0] > 0:
            for k in range(packet_rays):
                if (placement.mask & ray_mask(batch.rays, memory.number[k])) == wp.uint32(0):
                    batch.object_rays.t_max[slot + k] = -INFINITY
        batch.object_rays.count = slot + wp.static(packet_rays)
        cache_leaf(memory.packet, 0)  # the last packet's leaf is in another instance's tree
        step(
            part.tree,
            part.tree,
            part.triangles,
            batch.object_rays,
            slot,
            memory.packet,
            memory.walk,
            batch.object_hits,
            batch.counters,
            work,
        )
        return merge(batch, memory, placement, slot)

    return visit


@cache
def make_kernel(config: TraversalConfig, levels: int) -> wp.Kernel:
    """The kernel for one specialisation. An item is a run of packets.

    levels: greatest number of inner nodes on a path of the upper tree.
    """
    load_and_bound, visit, cull = packet_loader(config), make_visit(config), cull_boxes(packet_layout(config))
    next_root = next_group(config)
    width, packet_rays, size, run = config.width, config.packet.rays, packet_layout(config).size, rays_per_item(config)
    row, nearest = levels * config.width, nearest_child(config.width)

    def packets_through_instances(
        first: int,
        block: int,
        top: InstanceTree,
        parts: wp.array(dtype=BvhPart),
        rays: RayBatch,
        object_rays: RayBatch,
        object_hits: HitBatch,
        hits: HitBatch,
        counters: CounterRows,
    ):
        batch = InstanceBatch()
        batch.top = top
        batch.parts = parts
        batch.rays = rays
        batch.object_rays = object_rays
        batch.object_hits = object_hits
        batch.hits = hits
        batch.counters = counters
        number = wp.zeros(shape=(packet_rays,), dtype=int)
        bound = wp.zeros(shape=(packet_rays,), dtype=float)
        waiting = wp.zeros(shape=(packet_rays,), dtype=float)
        room = wp.zeros(shape=(size,), dtype=float)
        walk = wp.zeros(shape=(wp.static(packet.walk_memory(config)),), dtype=int)
        memory = PacketMemory()
        set_arrays(memory, number, bound, waiting, room, walk)
        keys = wp.zeros(shape=(row,), dtype=int)
        path = wp.zeros(shape=(levels,), dtype=int)
        work = Counters()
        slot = (first + wp.tid()) * wp.static(run)
        end = wp.min(slot + wp.static(run), rays.count - block)
        while slot < end:
            bounds = PacketBounds()
            load_and_bound(batch, memory, block + slot, bounds)
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
                            bounds.t_max = visit(batch, memory, instance, slot, work)
                            key = nearest(keys, level * wp.static(width))
                    else:
                        level -= 1
                        if level >= 0:
                            key = nearest(keys, level * wp.static(width))
                turn += 1
                root = next_root(batch, memory, turn, bounds)
            slot += wp.static(packet_rays)

    return specialised_kernel(packets_through_instances)
