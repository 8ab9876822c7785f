"""Omnidirectional packets on a kd-tree (Reshetov 2006): packets of any directions, each ray with its own interval.

**Problem.** Packets that decide by one interval need rays with similar directions. Secondary rays are not similar, and
splitting packets until their rays are leaves lanes idle.

**Idea.** Every ray keeps its own interval of t in the current cell, in lanes. At a plane all intervals are split at once, each
by the sign of its own direction, and a child is visited if the part of some ray is not empty. Near and far differ from ray to
ray, so the order of the children is right for some rays only. A cell that lies behind the best hits of all its rays therefore
does not end the search; the search continues with the next cell on the stack.

**The order.** Of the rays that visit both children, the majority decides which child comes first. This rule is ours: Rahikainen
(2013), the source of this file, does not give the rule of the paper.

**Leaves.** If more than `MAX_FEW_RAYS` rays of the packet have reached a leaf, W rays are tested against a triangle at a time;
otherwise each ray is tested against W triangles at a time (`few_active_rays`). The lanes are filled in both cases.

**Differences from the paper.** A cell on the stack is its node and its box, not P intervals. When it is popped, the intervals
are computed from the box, clipped to the current best hits. The size of the stack does not depend on the packet. Rays with
equal signs need no special case, and no ray is traced alone.

**Limits.** If rays have nothing in common, a packet visits the cells of all its rays, and most lanes are idle;
`wrt.kernels.traversal.lockstep.lockstep_kernel` is faster there. Figures: notebooks/records/2026-11-21-kdtree-packets.md.

References: reshetov-2006; rahikainen-2013 (chapter 5).
"""

from functools import cache

import warp as wp

from wrt.kernels.classics.traversal.lane_cells import enter_cell, split_cell
from wrt.kernels.layout import kdtree_nodes as kdtree
from wrt.kernels.layout.kdtree_nodes import LEAF, MAX_TREE_DEPTH, KdNodes, child_high, child_low
from wrt.kernels.layout.ray_batch import HitBatch, RayBatch
from wrt.kernels.layout.unchecked import load_float, load_int, store_int
from wrt.kernels.runtime.options import exact_module, specialised_kernel
from wrt.kernels.traversal.leaf import CounterRows, Counters
from wrt.kernels.traversal.mailbox import MAILBOXES
from wrt.kernels.traversal.packet import CULLINGS, CullingTraits
from wrt.kernels.traversal.packet.core.few_active_rays import few_rays_step, store_few_ray
from wrt.kernels.traversal.packet.core.packet_kernel import leaf_step, packet_layout
from wrt.kernels.traversal.packet.rays.packet_bounds import MAX_FEW_RAYS, PacketBounds
from wrt.kernels.traversal.packet.rays.packet_load import load_packet
from wrt.kernels.traversal.packet.rays.packet_store import store_packet
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks

exact_module(__name__)


def rays_per_item(config: TraversalConfig) -> int:
    """Rays of a packet; an item of the kernel is one packet."""
    return config.packet.rays


@cache
def make_omnidirectional_kernel(config: TraversalConfig) -> wp.Kernel:
    """The kernel for one specialisation."""
    layout = packet_layout(config)
    load, store = (
        load_packet(layout, CullingTraits.SLOPES in CULLINGS[config.packet.culling].traits),
        store_packet(layout, config.answer.ends_at_first),
    )
    enter, split = enter_cell(layout), split_cell(layout)
    packet_leaf_step, few_rays_leaf_step = leaf_step(config), few_rays_step(config)
    counting, size_of_packet, P = config.counters, layout.size, config.packet.rays
    cell_floats, memory = 2 * P, MAILBOXES[config.mailbox].size

    def omnidirectional(
        first: int,
        tree: KdNodes,
        triangles: TriangleBlocks,
        rays: RayBatch,
        hits: HitBatch,
        counters: CounterRows,
    ):
        begin = (first + wp.tid()) * wp.static(P)
        packet = wp.zeros(shape=(size_of_packet,), dtype=float)
        cells = wp.zeros(shape=(cell_floats,), dtype=float)
        bounds = PacketBounds()
        load(rays, begin, tree.low, tree.high, packet, bounds)
        work = Counters()
        mailbox = wp.zeros(shape=(memory,), dtype=int)
        stack_node = wp.zeros(shape=(MAX_TREE_DEPTH,), dtype=int)
        stack_low = wp.zeros(shape=(MAX_TREE_DEPTH,), dtype=wp.vec3)
        stack_high = wp.zeros(shape=(MAX_TREE_DEPTH,), dtype=wp.vec3)
        size = int(0)
        at = int(0)
        low = wp.vec3(tree.low)
        high = wp.vec3(tree.high)
        searching = bool(bounds.active > 0)
        if searching:
            searching = enter(packet, bounds, low, high, cells) > 0
        while searching:
            node = kdtree.load_node(tree.nodes, at)
            axis = kdtree.split_axis(node)
            if axis != LEAF:
                if wp.static(counting):
                    work.nodes += 1
                position = kdtree.split_position(node)
                sides = split(packet, bounds, axis, position, cells)
                right = kdtree.right_child(node)
                go_right = (sides & 1) != 0
                if (sides & 2) != 0:
                    store_int(stack_node, size, wp.where(go_right, at + 1, right))
                    stack_low[size] = child_low(low, axis, position, not go_right)
                    stack_high[size] = child_high(high, axis, position, not go_right)
                    size += 1
                low = child_low(low, axis, position, go_right)
                high = child_high(high, axis, position, go_right)
                at = wp.where(go_right, right, at + 1)
            else:
                count = kdtree.leaf_triangles(node)
                if count > 0:
                    ray_count = int(0)
                    for k in range(wp.static(P)):
                        if load_float(cells, k) <= load_float(cells, wp.static(P) + k):
                            store_few_ray(bounds, wp.min(ray_count, wp.static(MAX_FEW_RAYS - 1)), k)
                            ray_count += 1
                    if ray_count > wp.static(MAX_FEW_RAYS):
                        packet_leaf_step(triangles, kdtree.first_block(node), count, packet, bounds, mailbox, work)
                    else:
                        few_rays_leaf_step(triangles, kdtree.first_block(node), count, ray_count, packet, bounds, work)
                searching = bool(False)
                while size > 0 and not searching:
                    size -= 1
                    at = load_int(stack_node, size)
                    low = stack_low[size]
                    high = stack_high[size]
                    searching = enter(packet, bounds, low, high, cells) > 0
        store(packet, rays, begin, hits, False)
        if wp.static(counting):
            counters.rows[begin] = work

    return specialised_kernel(omnidirectional)
