"""Packet traversal of a wide BVH: P rays traverse the tree together.

**Problem.** Neighbouring rays take almost the same path through a tree, and each single ray pays the full cost of it.

**Idea.** The packet descends into a child unless the culling (`wrt.kernels.traversal.packet`) proves that none of its rays
meets the child's box: one step for all rays, W children at a time. At a leaf the triangles that no ray can hit are culled, W at
a time, and only then are rays tested, W at a time against each remaining triangle (Wald et al. 2001 for rays in lanes; Reshetov
et al. 2005 for large packets). The rest of a level is dropped once its nearest child lies beyond the farthest of the rays' best
hits. Leaves that few rays meet are tested ray by ray (`few_active_rays`). Any-hit packets start at the leaf that occluded the
last packet (`wrt.kernels.traversal.packet.leaves.occluder_cache`).

**Diverging rays.** Rays of a packet need not share an origin or signs. If the directions have both signs along all three axes,
the bounds of boxes are useless. A packet whose rays have diverged, because neighbouring pixels see different surfaces, may
visit half of the scene. Packets whose origins are far apart are split before their traversal, others if it is abandoned after
`MAX_STEPS_PER_RAY` steps per ray (`wrt.kernels.traversal.packet.core.packet_splitting`). Rays that still diverge are traced one
by one (`single_bvh`), and so are those of a packet from one point, after `MAX_STEPS_UNSPLIT` steps per ray. All keep the hits
found until then.

**Packets that meet nothing.** Values that only the triangle test reads are computed at a packet's first leaf
(`wrt.kernels.traversal.packet.rays.packet_load`). After two packets without a leaf, the next ones are tested against the root
together, and after one that the last occluder alone has occluded, against that
(`wrt.kernels.traversal.packet.core.joined_packets`).

References: wald-2001; reshetov-2005; wald-2007-deformable; rahikainen-2013 (section 3.2).
"""

from functools import cache

import warp as wp

from wrt.kernels.layout import bvh_nodes as bvh
from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.unchecked import CACHE_LINE, first_line, load_int, store_int
from wrt.kernels.runtime import native
from wrt.kernels.simd.box_lanes import NO_CHILD, NO_CHILD_CONSTANT, entry_of, nearest_child
from wrt.kernels.traversal.leaf import Counters
from wrt.kernels.traversal.mailbox import MAILBOXES
from wrt.kernels.traversal.packet import CULLINGS, CullingTraits
from wrt.kernels.traversal.packet.core.few_active_rays import few_rays_step
from wrt.kernels.traversal.packet.core.joined_packets import answer_together
from wrt.kernels.traversal.packet.core.packet_kernel import PacketWalk, leaf_step, make_packet_kernel, packet_layout
from wrt.kernels.traversal.packet.culling.culling_hooks import no_start
from wrt.kernels.traversal.packet.leaves import occluder_cache as occluder
from wrt.kernels.traversal.packet.rays.packet_bounds import MAX_FEW_RAYS, PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout
from wrt.kernels.traversal.packet.rays.packet_load import finish_packet
from wrt.kernels.traversal.single.single_bvh import make_bvh_walk
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks

MIXED_AXES = 2
"""Greatest number of axes with both signs for which a packet is traversed as a whole."""

MIN_FETCHED = 1 << 21
"""Floats of the scene's records from which packets fetch the children of a node before they visit them, for closest hits: about
the second-level cache of a core (notebooks/records/2026-11-23-edge-functions.md)."""

MAX_STEPS_PER_RAY = 3
"""Steps per ray (nodes and leaves) after which the traversal of a packet that can be split is abandoned
(notebooks/records/2026-11-21-packets.md)."""

MAX_STEPS_UNSPLIT = 10
"""The same for rays from one point, which cannot be split: about the cost of tracing them one by one
(notebooks/records/2026-11-23-scans.md)."""


def walk_memory(config: TraversalConfig) -> int:
    """Ints of local memory that a walk needs: its mailbox; a row of keys per level, aligned to a cache line; the nodes of the
    path."""
    return MAILBOXES[config.mailbox].size + CACHE_LINE + config.stack.levels * (config.width + 1)


def finishes_later(config: TraversalConfig) -> bool:
    """Whether the rays of a packet are prepared for tests at its first leaf: those that nothing else needs prepared."""
    culling = CULLINGS[config.packet.culling]
    return not culling.traits & (CullingTraits.EVERY_RAY | CullingTraits.SLOPES) and culling.start is no_start


@cache
def fetch_kept(layout: PacketLayout) -> wp.Function:
    """`wp.func(tree, triangles, node, keys, first)`: fetches the children of a node that culling has kept into the caches, of
    leaves the first block; `keys`, from `first` on, are those of `Culling.boxes`."""
    code = f"wrt::fetch_kept<{layout.width}, {layout.record}>(tree, triangles, node, keys.data + first);"

    @native.func_native("packet_culling.h", f"static_assert(wrt::NO_CHILD == {NO_CHILD_CONSTANT});\n{code}")
    def fetch(tree: wp.ref[WideNodes], triangles: wp.ref[TriangleBlocks], node: int, keys: wp.array(dtype=int), first: int): ...

    return fetch


@cache
def visit_leaf(config: TraversalConfig, later: bool) -> wp.Function:
    """`wp.func(tree, triangles, node, lane, packet, bounds, mailbox, work)`: visits the leaf in a lane of a node.

    later: whether the rays may still have to be prepared for tests (`finish_packet`).
    """
    culling, width = CULLINGS[config.packet.culling], config.width
    count_rays, counts_rays = culling.leaf(packet_layout(config)), culling.needs_boxes
    test_leaf, test_few = leaf_step(config), few_rays_step(config)
    finish = finish_packet(packet_layout(config))

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
        if wp.static(later) and bounds.finished == 0:
            finish(tree.low, tree.high, packet, bounds)
        ray_count = count_rays(tree.bounds, node, lane, packet, bounds)
        if ray_count > wp.static(MAX_FEW_RAYS):
            test_leaf(triangles, first, count, packet, bounds, mailbox, work)
        elif wp.static(counts_rays):
            test_few(triangles, first, count, ray_count, packet, bounds, work)

    return visit


@cache
def make_packet_bvh_walk(config: TraversalConfig) -> wp.Function:
    """`wp.func(tree, triangles, packet, memory, bounds, work) -> bool`: traces one packet; False if its traversal was
    abandoned."""
    culling, layout = CULLINGS[config.packet.culling], packet_layout(config)
    cull_boxes, visit, nearest = culling.boxes(layout), visit_leaf(config, finishes_later(config)), nearest_child(config.width)
    fetch = fetch_kept(layout)
    box_tests = config.width * (config.packet.rays if CullingTraits.EVERY_RAY in culling.traits else 1)
    mailbox_size = MAILBOXES[config.mailbox].size
    cached_leaf, cache_leaf = occluder.cached_leaf(layout), occluder.cache_leaf(layout)
    width, counting, any_hit = config.width, config.counters, config.answer.rules.ends_at_first
    row = config.stack.levels * config.width
    max_steps = (MAX_STEPS_UNSPLIT if config.packet.shared_origin else MAX_STEPS_PER_RAY) * config.packet.rays

    @wp.func
    def walk_packet_bvh(
        tree: wp.ref[WideNodes],
        triangles: wp.ref[TriangleBlocks],
        packet: wp.array(dtype=float),
        memory: wp.array(dtype=int),
        bounds: wp.ref[PacketBounds],
        work: wp.ref[Counters],
    ):
        for i in range(wp.static(mailbox_size)):
            store_int(memory, i, 0)
        fetching = wp.static(not any_hit) and triangles.records.shape[0] >= wp.static(MIN_FETCHED)
        keys = first_line(memory, wp.static(mailbox_size))
        path = keys + wp.static(row)
        store_int(memory, path, 0)
        steps = int(0)
        leaf = int(0)
        if wp.static(any_hit):
            leaf = cached_leaf(packet)
            if leaf > 0:
                node = (leaf - 1) // wp.static(width)
                visit(tree, triangles, node, (leaf - 1) % wp.static(width), packet, bounds, memory, work)
        at_once = bounds.t_max < 0.0
        key = int(NO_CHILD)
        level = int(-1)
        if bounds.t_max >= 0.0:
            key = cull_boxes(tree.bounds, 0, packet, bounds, memory, keys)
            if fetching:
                fetch(tree, triangles, 0, memory, keys)
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
                    if fetching:
                        fetch(tree, triangles, child, memory, keys + level * wp.static(width))
                    if wp.static(counting):
                        work.nodes += 1
                        work.boxes += wp.static(box_tests)
                else:
                    visit(tree, triangles, node, lane, packet, bounds, memory, work)
                    leaf = node * wp.static(width) + lane + 1
                    key = nearest(memory, keys + level * wp.static(width))
                level = wp.where(steps <= wp.static(max_steps), level, -1)
            else:
                level -= 1
                if level >= 0:
                    key = nearest(memory, keys + level * wp.static(width))
        if wp.static(any_hit):
            cache_leaf(packet, wp.where(bounds.t_max < 0.0, leaf, 0), at_once)
        return steps <= wp.static(max_steps)

    return walk_packet_bvh


@cache
def make_packet_bvh_kernel(config: TraversalConfig) -> wp.Kernel:
    """The kernel for one specialisation."""
    later = finishes_later(config)
    walk = PacketWalk(make_packet_bvh_walk(config), make_bvh_walk(config), MIXED_AXES, walk_memory(config), True, later)
    return make_packet_kernel(config, WideNodes, walk, answer_together(config) if later and not config.counters else None)
