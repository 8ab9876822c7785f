"""Packet traversal of a wide BVH: P rays decide together where to go.

**Problem.** Neighbouring rays take almost the same way through a tree; one at a time, each pays for it in full.

**Idea.** The packet descends into a child if the culling (`wrt.kernels.packet`) cannot rule out that one of its rays meets
the child's box: one step for all rays, W children at a time. At a leaf the triangles that no ray can hit are culled, W at a
time, and only then are rays tested, W at a time against each triangle that is left (Wald et al. 2001 for rays in lanes;
Reshetov et al. 2005 for large packets). The rest of a level is dropped once its nearest child lies beyond the farthest of
the rays' best hits.

**Any rays.** Rays of a packet need not share an origin or signs. Where two axes or more have both signs, boxes bound
nothing worth having, and a packet whose rays have parted company (one in a hundred does, where neighbouring pixels see
different surfaces) may meet half of the scene: it gives up after `PATIENCE` steps a ray. Such packets are taken apart and
their rays go one by one (`single_bvh`).

References:
    I. Wald, P. Slusallek, C. Benthin, M. Wagner: Interactive rendering with coherent ray tracing. Eurographics 2001.
    A. Reshetov, A. Soupikov, J. Hurley: Multi-level ray tracing algorithm. SIGGRAPH 2005.
    I. Wald, S. Boulos, P. Shirley: Ray tracing deformable scenes using dynamic bounding volume hierarchies.
        ACM Transactions on Graphics 26(1), 2007.
    V. Rahikainen: On real-time ray tracing. MSc thesis, University of Tampere, 2013 (the survey).
"""

from functools import cache

import warp as wp

from wrt.kernels import bvh
from wrt.kernels.box_lanes import NO_CHILD, entry_of, nearest_child
from wrt.kernels.bvh import WideNodes
from wrt.kernels.lanes import count_bits
from wrt.kernels.memory import load_int, store_int
from wrt.kernels.packet import CULLINGS
from wrt.kernels.packet.block import test_block
from wrt.kernels.packet.bounds import PacketBounds
from wrt.kernels.packet.counting import active_lanes, lanes_a_triangle
from wrt.kernels.packet.layout import PacketLayout
from wrt.kernels.packet.load import load_packet
from wrt.kernels.packet.store import store_packet
from wrt.kernels.rays import HitBatch, RayBatch, load_ray, store_hit
from wrt.kernels.traversal.config import ANY, TraversalConfig
from wrt.kernels.traversal.leaf import Counters, start
from wrt.kernels.traversal.single_bvh import make_walk
from wrt.kernels.triangle.records import TriangleBlocks

wp.set_module_options({"enable_backward": False, "fuse_fp": False})


PATIENCE = 1
"""Steps a ray (nodes and leaves together) after which a packet is taken apart: by then its rays would be done alone."""


@cache
def make_walk_packet(config: TraversalConfig) -> wp.Function:
    """`wp.func(tree, triangles, packet, bounds, work) -> bool`: traces one packet; False if it gave up."""
    layout = packet_layout(config)
    culling = CULLINGS[config.culling]
    cull_boxes, cull_triangles = culling.boxes(layout), culling.triangles(layout)
    start_packet, start_leaf = culling.start(layout), culling.leaf(layout)
    active_in, lanes_each = active_lanes(layout), lanes_a_triangle(layout)
    box_tests = config.width * (config.packet if culling.every_ray else 1)
    test_triangles = test_block(layout, config.query == ANY)
    nearest = nearest_child(config.width)
    width, counting = config.width, config.counters
    levels, row, patience = config.levels, config.levels * config.width, PATIENCE * config.packet

    @wp.func
    def walk(
        tree: WideNodes,
        triangles: TriangleBlocks,
        packet: wp.array(dtype=float),
        bounds: wp.ref[PacketBounds],
        work: wp.ref[Counters],
    ):
        keys = wp.zeros(shape=(row,), dtype=int)
        path = wp.zeros(shape=(levels,), dtype=int)
        level = int(0)
        steps = int(0)
        start_packet(tree.low, tree.high, packet, bounds)
        key = cull_boxes(tree.bounds, 0, packet, bounds, keys, 0)
        if wp.static(counting):
            work.nodes += 1
            work.boxes += wp.static(box_tests)
        while level >= 0:
            if entry_of(key, wp.static(width)) <= bounds.t_max:
                steps += 1
                lane = key & wp.static(width - 1)
                store_int(keys, level * wp.static(width) + lane, NO_CHILD)
                node = load_int(path, level)
                child = load_int(tree.child, node * wp.static(width) + lane)
                if child >= 0:
                    level += 1
                    store_int(path, level, child)
                    key = cull_boxes(tree.bounds, child, packet, bounds, keys, level * wp.static(width))
                    if wp.static(counting):
                        work.nodes += 1
                        work.boxes += wp.static(box_tests)
                else:
                    count = bvh.leaf_triangles(child)
                    block = bvh.first_block(child)
                    if wp.static(counting):
                        work.leaves += 1
                        work.culled += count
                    if start_leaf(tree.bounds, node, lane, packet, bounds) == 0:
                        count = 0
                    while count > 0:
                        mask = cull_triangles(triangles.records, block, bounds)
                        if wp.static(counting):
                            used = mask & ((wp.uint32(1) << wp.uint32(wp.min(count, wp.static(width)))) - wp.uint32(1))
                            tested = count_bits(used)
                            work.culled -= tested
                            work.triangles += tested
                            work.lanes += tested * lanes_each(bounds)
                            work.active += active_in(triangles.records, block, used, packet, bounds)
                        if mask != wp.uint32(0):
                            test_triangles(triangles.records, triangles.primitive, block, mask, packet, bounds)
                        block += 1
                        count -= wp.static(width)
                    key = nearest(keys, level * wp.static(width))
                level = wp.where(steps <= wp.static(patience), level, -1)
            else:
                level -= 1
                if level >= 0:
                    key = nearest(keys, level * wp.static(width))
        return steps <= wp.static(patience)

    return walk


def packet_layout(config: TraversalConfig) -> PacketLayout:
    """Where the packet's numbers are."""
    return PacketLayout(config.packet, config.width, config.shared_origin, config.triangle_test)


def rays_per_item(config: TraversalConfig) -> int:
    """An item of the kernel is a packet."""
    return config.packet


@cache
def make_kernel(config: TraversalConfig) -> wp.Kernel:
    """The kernel for one specialisation."""
    layout = packet_layout(config)
    load, store = load_packet(layout), store_packet(layout, config.query == ANY)
    walk_packet, walk_ray = make_walk_packet(config), make_walk(config)
    counting, any_hit, size, packet_rays = config.counters, config.query == ANY, layout.size, config.packet

    def packet_bvh(
        first: int,
        tree: WideNodes,
        triangles: TriangleBlocks,
        rays: RayBatch,
        hits: HitBatch,
        counters: wp.array(dtype=Counters),
    ):
        begin = (first + wp.tid()) * wp.static(packet_rays)
        packet = wp.zeros(shape=(size,), dtype=float)
        bounds = PacketBounds()
        load(rays, begin, tree.low, tree.high, packet, bounds)
        work = Counters()
        together = bool(bounds.mixed_axes < 2)
        if together and bounds.active > 0:
            together = walk_packet(tree, triangles, packet, bounds, work)
        if together:
            store(packet, rays.count, begin, hits)
            if wp.static(counting):
                counters[begin] = work
        else:
            for i in range(begin, wp.min(begin + wp.static(packet_rays), rays.count)):
                ray = load_ray(rays, i)
                best = start(ray.t_max)
                if ray.valid:
                    best = walk_ray(tree, triangles, ray, work)
                if wp.static(any_hit):
                    hits.occluded[i] = best.primitive >= 0
                else:
                    store_hit(hits, i, best.t, best.primitive, best.u, best.v)
                if wp.static(counting):
                    counters[i] = work
                    work = Counters()

    return wp.kernel(packet_bvh, module="unique", enable_backward=False, module_options={"fuse_fp": False})
