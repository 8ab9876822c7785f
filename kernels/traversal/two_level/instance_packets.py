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
from wrt.kernels.layout.instance_maps import Placement, ray_mask
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
from wrt.kernels.traversal.two_level.instance_single import BvhPart, InstanceTree

exact_module(__name__)

_TRANSFORM = """
    const double *m = &place.to_object.data[0][0];
    const double px = place.origin.c[0], py = place.origin.c[1], pz = place.origin.c[2];
    const double cx = rays.center.c[0], cy = rays.center.c[1], cz = rays.center.c[2];
    float* to_origin = (float*)(own.origins.data + slot);
    float* to_direction = (float*)(own.directions.data + slot);
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
        own.t_min.data[slot + k] = rays.t_min.data[i * rays.t_min_stride];
        own.t_max.data[slot + k] = bound.data[k];
    }
"""


@cache
def transform_packet(packet_rays: int) -> wp.Function:
    """`wp.func(rays, number, bound, place, slot, own)`: transforms P rays of a batch, by their numbers, to the space of an
    instance.

    The arithmetic is that of `wrt.kernels.layout.instance_maps.object_ray`. own: receives the rays from `slot` on, from their
    t_min up to `bound`.
    """

    @wp.func_native(f"{FOR_LANES}    constexpr int P = {packet_rays};\n{DIRECTION_LANES}{_TRANSFORM}")
    def transform_packet_native(
        rays: RayBatch,
        number: wp.array(dtype=int),
        bound: wp.array(dtype=float),
        place: Placement,
        slot: int,
        own: RayBatch,
    ): ...

    return transform_packet_native


@cache
def make_begin(config: TraversalConfig) -> wp.Function:
    """`wp.func(top, rays, begin, number, bound, room, bounds)`: loads the packet at a place in the order of packets.

    number, bound: receive the number of each ray and its t_max, -inf if it is invalid. bounds: receives the bounds of the
    packet, with the slack of the upper tree.
    """
    load, packet_rays = load_packet(packet_layout(config), slopes=False), config.packet.rays

    @wp.func
    def start_packet(
        top: InstanceTree,
        rays: RayBatch,
        begin: int,
        number: wp.array(dtype=int),
        bound: wp.array(dtype=float),
        room: wp.array(dtype=float),
        bounds: wp.ref[PacketBounds],
    ):
        size = wp.max(wp.max(wp.abs(top.tree.low)), wp.max(wp.abs(top.tree.high)))
        farthest = float(0.0)
        for k in range(packet_rays):
            number[k] = ray_at(rays, wp.min(begin + k, rays.count - 1), packet_rays)
            bound[k] = -INFINITY
            if begin + k < rays.count:
                ray = load_ray(rays, number[k])
                if ray.valid:
                    bound[k] = ray.t_max
                    farthest = wp.max(farthest, wp.max(wp.abs(ray.origin)))
        # each ray's reach in this box is at least `stretch` times its reach in the scene
        corner = top.stretch * (size + farthest)
        load(rays, begin, wp.vec3(-corner, -corner, -corner), wp.vec3(corner, corner, corner), room, bounds)

    return start_packet


@cache
def make_take(config: TraversalConfig) -> wp.Function:
    """`wp.func(placement, found, slot, number, bound, hits) -> t_max`: merges the hits of a packet in an instance, from `slot`
    on.

    Shortens the rays, and returns the greatest t at which a hit still counts.
    """
    packet_rays, any_hit = config.packet.rays, config.query == ANY

    @wp.func
    def take(
        placement: Placement,
        found: HitBatch,
        slot: int,
        number: wp.array(dtype=int),
        bound: wp.array(dtype=float),
        hits: HitBatch,
    ):
        t_max = float(-INFINITY)
        for k in range(packet_rays):
            i = number[k]
            if bound[k] >= 0.0:
                if wp.static(any_hit):
                    if found.occluded[slot + k]:
                        hits.occluded[i] = True
                        bound[k] = -INFINITY
                elif found.primitive[slot + k] >= 0:
                    t = found.t[slot + k]
                    primitive = placement.first + found.primitive[slot + k]
                    if t < hits.t[i] or (t == hits.t[i] and primitive < hits.primitive[i]):
                        hits.t[i] = t
                        hits.primitive[i] = primitive
                        hits.uv[i] = found.uv[slot + k]
                        bound[k] = t
                t_max = wp.max(t_max, bound[k])
        return t_max

    return take


@cache
def make_visit(config: TraversalConfig) -> wp.Function:
    """`wp.func(top, parts, instance, rays, number, bound, room, memory, own, slot, found, hits, counters, work) -> t_max`.

    Traces the packet through one instance. own, found: receive its transformed rays and their hits, from `slot` on.
    """
    step = packet_step(config, WideNodes, packet.make_walk_packet(config), make_walk(config), packet.MIXED_AXES)
    keep_leaf = occluder.keep_leaf(packet_layout(config))
    transform, take, packet_rays = transform_packet(config.packet.rays), make_take(config), config.packet.rays

    @wp.func
    def visit(
        top: InstanceTree,
        parts: wp.array(dtype=BvhPart),
        instance: int,
        rays: RayBatch,
        number: wp.array(dtype=int),
        bound: wp.array(dtype=float),
        room: wp.array(dtype=float),
        memory: wp.array(dtype=int),
        own: RayBatch,
        slot: int,
        found: HitBatch,
        hits: HitBatch,
        counters: CounterRows,
        work: wp.ref[Counters],
    ):
        placement = top.placements[instance]
        part = parts[placement.geometry]
        transform(rays, number, bound, placement, slot, own)
        if rays.mask.shape[0] > 0:
            for k in range(packet_rays):
                if (placement.mask & ray_mask(rays, number[k])) == wp.uint32(0):
                    own.t_max[slot + k] = -INFINITY
        batch = own
        batch.count = slot + wp.static(packet_rays)
        keep_leaf(room, 0)  # the last packet's leaf is in another instance's tree
        step(part.tree, part.tree, part.triangles, batch, slot, room, memory, found, counters, work)
        return take(placement, found, slot, number, bound, hits)

    return visit


@cache
def make_kernel(config: TraversalConfig, levels: int) -> wp.Kernel:
    """The kernel for one specialisation. An item is a run of packets.

    levels: greatest number of inner nodes on a path of the upper tree.
    """
    begin_packet, visit, cull = make_begin(config), make_visit(config), cull_boxes(packet_layout(config))
    width, packet_rays, size, run = config.width, config.packet.rays, packet_layout(config).size, rays_per_item(config)
    row, nearest = levels * config.width, nearest_child(config.width)

    def packets_through_instances(
        first: int,
        block: int,
        top: InstanceTree,
        parts: wp.array(dtype=BvhPart),
        rays: RayBatch,
        own: RayBatch,
        found: HitBatch,
        hits: HitBatch,
        counters: CounterRows,
    ):
        room = wp.zeros(shape=(size,), dtype=float)
        memory = wp.zeros(shape=(wp.static(packet.walk_memory(config)),), dtype=int)
        number = wp.zeros(shape=(packet_rays,), dtype=int)
        bound = wp.zeros(shape=(packet_rays,), dtype=float)
        keys = wp.zeros(shape=(row,), dtype=int)
        path = wp.zeros(shape=(levels,), dtype=int)
        work = Counters()
        slot = (first + wp.tid()) * wp.static(run)
        end = wp.min(slot + wp.static(run), rays.count - block)
        while slot < end:
            bounds = PacketBounds()
            begin_packet(top, rays, block + slot, number, bound, room, bounds)
            level = wp.where(bounds.active > 0, 0, -1)
            key = cull(top.tree.bounds, 0, room, bounds, keys, 0)
            while level >= 0:
                if entry_of(key, wp.static(width)) <= bounds.t_max:
                    lane = key & wp.static(width - 1)
                    store_int(keys, level * wp.static(width) + lane, NO_CHILD)
                    child = load_int(top.tree.child, load_int(path, level) * wp.static(width) + lane)
                    if child >= 0:
                        level += 1
                        store_int(path, level, child)
                        key = cull(top.tree.bounds, child, room, bounds, keys, level * wp.static(width))
                    else:
                        instance = load_int(top.order, bvh.first_block(child) * wp.static(width))
                        bounds.t_max = visit(
                            top, parts, instance, rays, number, bound, room, memory, own, slot, found, hits, counters, work
                        )
                        key = nearest(keys, level * wp.static(width))
                else:
                    level -= 1
                    if level >= 0:
                        key = nearest(keys, level * wp.static(width))
            slot += wp.static(packet_rays)

    return specialised_kernel(packets_through_instances)
