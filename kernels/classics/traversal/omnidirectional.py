"""Omnidirectional packets on a kd-tree (Reshetov 2006): packets of any directions, each ray with its own interval.

**Problem.** Packets that decide by one interval need rays with similar directions. Secondary rays are not similar, and
splitting packets until their rays are leaves lanes idle.

**Idea.** Every ray keeps its own interval of t in the current cell, in lanes. At a plane all intervals are split at once, each
by the sign of its own direction, and a child is visited if the part of some ray is not empty. Near and far differ from ray to
ray, so the order of the children is right for some rays only. A cell that lies behind the best hits of all its rays therefore
does not end the search; the search continues with the next cell on the stack.

**Steps.**

1. `enter_cell`: the intervals of all rays in the box of the tree, clipped to their ranges and best hits: `entry` of the P rays,
   then `leave`. A ray that is not in the cell has an empty interval. The formulas per ray are those of
   `wrt.kernels.traversal.single.single_kdtree`.
2. `split_cell`, at a plane: splits all intervals; the other child waits if some ray visits both.
3. `leaf_of_cell`, at a leaf: if more than `MAX_FEW_RAYS` rays of the packet have reached it, W rays are tested against a
   triangle at a time; otherwise each ray is tested against W triangles at a time (`few_active_rays`). The lanes are filled in
   both cases.
4. The next cell on the stack that some ray still enters; the end if there is none.

**The order.** Of the rays that visit both children, the majority decides which child comes first. This rule is ours: Rahikainen
(2013), the source of this file, does not give the rule of the paper.

**Differences from the paper.** A cell on the stack is its node and its box, not P intervals. When it is popped, the intervals
are computed from the box, clipped to the current best hits. The size of the stack does not depend on the packet. Rays with
equal signs need no special case, and no ray is traced alone.

**Limits.** If rays have nothing in common, a packet visits the cells of all its rays, and most lanes are idle;
`wrt.kernels.traversal.lockstep.lockstep_kernel` is faster there. Figures: notebooks/records/2026-11-21-kdtree-packets.md.

References: reshetov-2006; rahikainen-2013 (chapter 5).
"""

from functools import cache

import warp as wp

from wrt.kernels.layout import kdtree_nodes as kdtree
from wrt.kernels.layout.kdtree_nodes import LEAF, MAX_TREE_DEPTH, KdNodes, child_high, child_low
from wrt.kernels.layout.ray_batch import HitBatch, RayBatch
from wrt.kernels.layout.unchecked import load_float, load_int, store_int
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import specialised_kernel
from wrt.kernels.traversal.leaf import CounterRows, Counters
from wrt.kernels.traversal.mailbox import MAILBOXES
from wrt.kernels.traversal.packet import CULLINGS, CullingTraits
from wrt.kernels.traversal.packet.core.few_active_rays import few_rays_step, store_few_ray
from wrt.kernels.traversal.packet.core.packet_kernel import leaf_step, packet_layout
from wrt.kernels.traversal.packet.rays.packet_bounds import MAX_FEW_RAYS, PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout
from wrt.kernels.traversal.packet.rays.packet_load import load_packet
from wrt.kernels.traversal.packet.rays.packet_store import store_packet
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks


def rays_per_item(config: TraversalConfig) -> int:
    """Rays of a packet; an item of the kernel is one packet."""
    return config.packet.rays


@cache
def enter_cell(layout: PacketLayout) -> wp.Function:
    """`wp.func(packet, bounds, low, high, cells) -> int`: computes the intervals in a box; returns the number of rays inside.

    The intervals are clipped to the rays' ranges and best hits.
    """

    @native.func_native("packet_cells.h", f"return wrt::enter_cell({layout.packet}, bounds, low, high, cells.data);")
    def enter_cell_native(
        packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds], low: wp.vec3, high: wp.vec3, cells: wp.array(dtype=float)
    ) -> int: ...

    return enter_cell_native


@cache
def split_cell(layout: PacketLayout) -> wp.Function:
    """`wp.func(packet, bounds, axis, position, cells) -> bits`: moves to a child.

    Bit 0: the child is the right one. Bit 1: both must be visited; the move is then to the child that is near for the majority
    of the rays that visit both.
    """

    @native.func_native("packet_cells.h", f"return wrt::split_cell({layout.packet}, bounds, axis, position, cells.data);")
    def split_cell_native(
        packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds], axis: int, position: float, cells: wp.array(dtype=float)
    ) -> int: ...

    return split_cell_native


@cache
def leaf_of_cell(config: TraversalConfig) -> wp.Function:
    """`wp.func(triangles, node, cells, packet, bounds, mailbox, work)`: tests a leaf, by the number of rays in its cell."""
    P, test_packet, test_few = config.packet.rays, leaf_step(config), few_rays_step(config)

    @wp.func
    def visit(
        triangles: wp.ref[TriangleBlocks],
        node: wp.vec2i,
        cells: wp.array(dtype=float),
        packet: wp.array(dtype=float),
        bounds: wp.ref[PacketBounds],
        mailbox: wp.array(dtype=int),
        work: wp.ref[Counters],
    ):
        met = int(0)
        for k in range(wp.static(P)):
            if load_float(cells, k) <= load_float(cells, wp.static(P) + k):
                store_few_ray(bounds, wp.min(met, wp.static(MAX_FEW_RAYS - 1)), k)
                met += 1
        first, count = kdtree.first_block(node), kdtree.leaf_triangles(node)
        if met > wp.static(MAX_FEW_RAYS):
            test_packet(triangles, first, count, packet, bounds, mailbox, work)
        else:
            test_few(triangles, first, count, met, packet, bounds, work)

    return visit


@cache
def make_omnidirectional_kernel(config: TraversalConfig) -> wp.Kernel:
    """The kernel for one specialisation."""
    layout = packet_layout(config)
    load, store = (
        load_packet(layout, CullingTraits.SLOPES in CULLINGS[config.packet.culling].traits),
        store_packet(layout, config.answer.rules.ends_at_first),
    )
    enter, split = enter_cell(layout), split_cell(layout)
    visit, counting, size_of_packet, P = leaf_of_cell(config), config.counters, layout.size, config.packet.rays
    cell_floats, memory = 2 * P, MAILBOXES[config.mailbox].size

    def omnidirectional(
        first: int, tree: KdNodes, triangles: TriangleBlocks, rays: RayBatch, hits: HitBatch, counters: CounterRows
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
                if kdtree.leaf_triangles(node) > 0:
                    visit(triangles, node, cells, packet, bounds, mailbox, work)
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
