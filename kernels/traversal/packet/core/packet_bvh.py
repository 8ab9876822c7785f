"""Packet traversal of a wide BVH: P rays decide together where to go.

**Problem.** Neighbouring rays take almost the same way through a tree; one at a time, each pays for it in full.

**Idea.** The packet descends into a child if the culling (`wrt.kernels.traversal.packet`) cannot rule out that one of its rays
meets the child's box: one step for all rays, W children at a time. At a leaf the triangles that no ray can hit are culled, W at
a time, and only then are rays tested, W at a time against each triangle that is left (Wald et al. 2001 for rays in lanes;
Reshetov et al. 2005 for large packets). The rest of a level is dropped once its nearest child lies beyond the farthest of
the rays' best hits. Where few rays meet a leaf, they are tested one by one (`few_rays`). Rays that ask for any hit begin
where the last packet ended (`wrt.kernels.traversal.packet.core.occluder_cache`).

**Any rays.** Rays of a packet need not share an origin or signs. Where all three axes have both signs, boxes bound
nothing worth having, and a packet whose rays have parted company (one in fifty does, where neighbouring pixels see
different surfaces) may meet half of the scene: it gives up after `PATIENCE` steps a ray. Such packets part where their
origins do (`wrt.kernels.traversal.packet.core.packet_splitting`); what does not stay together even then goes ray by ray
(`single_bvh`).

References:
    I. Wald, P. Slusallek, C. Benthin, M. Wagner: Interactive rendering with coherent ray tracing. Eurographics 2001.
    A. Reshetov, A. Soupikov, J. Hurley: Multi-level ray tracing algorithm. SIGGRAPH 2005.
    I. Wald, S. Boulos, P. Shirley: Ray tracing deformable scenes using dynamic bounding volume hierarchies.
        ACM Transactions on Graphics 26(1), 2007.
    V. Rahikainen: On real-time ray tracing. MSc thesis, University of Tampere, 2013 (the survey).
"""

from functools import cache

import warp as wp

from wrt.kernels.layout import bvh_nodes as bvh
from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.unchecked import CACHE_LINE, first_line, load_int, store_int
from wrt.kernels.simd.box_lanes import NO_CHILD, entry_of, nearest_child
from wrt.kernels.traversal.leaf import Counters
from wrt.kernels.traversal.mailbox import MAILBOXES
from wrt.kernels.traversal.packet import CULLINGS
from wrt.kernels.traversal.packet.core import occluder_cache as occluder
from wrt.kernels.traversal.packet.core.few_active_rays import few_step
from wrt.kernels.traversal.packet.core.packet_kernel import leaf_step, make_packet_kernel, packet_layout
from wrt.kernels.traversal.packet.rays.packet_bounds import FEW, PacketBounds
from wrt.kernels.traversal.single.single_bvh import make_walk
from wrt.kernels.traversal.traversal_config import ANY, TraversalConfig
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

MIXED_AXES = 2
"""Axes with both signs with which a packet is still walked together."""

PATIENCE = 3
"""Steps a ray (nodes and leaves together) after which a packet gives up: by then its rays would be done alone. (Shadow rays of
bunny, dragon and atrium: least time at 1.5 to 3, up to 3 % less than at 1.)"""


def walk_memory(config: TraversalConfig) -> int:
    """Ints of memory that a walk asks for: its mailbox; from a cache line on, a row of keys a level; the path's nodes."""
    return MAILBOXES[config.mailbox].size + CACHE_LINE + config.levels * (config.width + 1)


@cache
def visit_leaf(config: TraversalConfig) -> wp.Function:
    """`wp.func(tree, triangles, node, lane, packet, bounds, mailbox, work)`: the leaf that is a lane of a node."""
    culling, width = CULLINGS[config.culling], config.width
    start_leaf, looks_at_leaves = culling.leaf(packet_layout(config)), culling.needs_boxes
    test_leaf, test_few = leaf_step(config), few_step(config)

    @wp.func
    def visit(
        tree: wp.ref[WideNodes],
        triangles: wp.ref[TriangleBlocks],
        node: int,
        lane: int,
        packet: wp.array(dtype=float),
        bounds: wp.ref[PacketBounds],
        mailbox: wp.array(dtype=int),
        work: wp.ref[Counters],
    ):
        child = load_int(tree.child, node * wp.static(width) + lane)
        first = bvh.first_block(child)
        count = bvh.leaf_triangles(child)
        meet = start_leaf(tree.bounds, node, lane, packet, bounds)
        if meet > wp.static(FEW):
            test_leaf(triangles, first, count, packet, bounds, mailbox, work)
        elif wp.static(looks_at_leaves):
            test_few(triangles, first, count, meet, packet, bounds, work)

    return visit


@cache
def make_walk_packet(config: TraversalConfig) -> wp.Function:
    """`wp.func(tree, triangles, packet, memory, bounds, work) -> bool`: traces one packet; False if it gave up."""
    culling, layout = CULLINGS[config.culling], packet_layout(config)
    cull_boxes, visit, nearest = culling.boxes(layout), visit_leaf(config), nearest_child(config.width)
    box_tests = config.width * (config.packet if culling.every_ray else 1)
    remembered = MAILBOXES[config.mailbox].size
    last_leaf, keep_leaf, any_hit = occluder.last_leaf(layout), occluder.keep_leaf(layout), config.query == ANY
    width, counting = config.width, config.counters
    row, patience = config.levels * config.width, PATIENCE * config.packet

    @wp.func
    def walk(
        tree: wp.ref[WideNodes],
        triangles: wp.ref[TriangleBlocks],
        packet: wp.array(dtype=float),
        memory: wp.array(dtype=int),
        bounds: wp.ref[PacketBounds],
        work: wp.ref[Counters],
    ):
        for i in range(wp.static(remembered)):
            store_int(memory, i, 0)
        keys = first_line(memory, wp.static(remembered))
        path = keys + wp.static(row)
        store_int(memory, path, 0)
        steps = int(0)
        leaf = int(0)
        if wp.static(any_hit):
            leaf = last_leaf(packet)
            if leaf > 0:
                node = (leaf - 1) // wp.static(width)
                visit(tree, triangles, node, (leaf - 1) % wp.static(width), packet, bounds, memory, work)
        key = int(NO_CHILD)
        level = int(-1)
        if bounds.t_max >= 0.0:
            key = cull_boxes(tree.bounds, 0, packet, bounds, memory, keys)
            level = wp.where(entry_of(key, wp.static(width)) <= bounds.t_max, 0, -1)
            if wp.static(counting):
                work.nodes += 1
                work.boxes += wp.static(box_tests)
        while level >= 0:
            if entry_of(key, wp.static(width)) <= bounds.t_max:
                steps += 1
                lane = key & wp.static(width - 1)
                store_int(memory, keys + level * wp.static(width) + lane, NO_CHILD)
                node = load_int(memory, path + level)
                child = load_int(tree.child, node * wp.static(width) + lane)
                if child >= 0:
                    level += 1
                    store_int(memory, path + level, child)
                    key = cull_boxes(tree.bounds, child, packet, bounds, memory, keys + level * wp.static(width))
                    if wp.static(counting):
                        work.nodes += 1
                        work.boxes += wp.static(box_tests)
                else:
                    visit(tree, triangles, node, lane, packet, bounds, memory, work)
                    leaf = node * wp.static(width) + lane + 1
                    key = nearest(memory, keys + level * wp.static(width))
                level = wp.where(steps <= wp.static(patience), level, -1)
            else:
                level -= 1
                if level >= 0:
                    key = nearest(memory, keys + level * wp.static(width))
        if wp.static(any_hit):
            keep_leaf(packet, wp.where(bounds.t_max < 0.0, leaf, 0))
        return steps <= wp.static(patience)

    return walk


@cache
def make_kernel(config: TraversalConfig) -> wp.Kernel:
    """The kernel for one specialisation."""
    return make_packet_kernel(config, WideNodes, make_walk_packet(config), make_walk(config), MIXED_AXES, walk_memory(config))
