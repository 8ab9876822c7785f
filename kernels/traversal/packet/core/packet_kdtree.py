"""Packet traversal of a kd-tree: P rays decide together which sides of a plane to visit.

**Problem.** A step of a single ray is a load, two products and three branches, which repeat the work of the neighbouring rays.

**Idea.** The cell of a packet is a node and an interval of t that contains the interval of each of its rays. At a plane the
ends of the packet's intervals give the t at which the last ray leaves the near side and the first ray enters the far side
(`wrt.kernels.traversal.packet.core.packet_cells`). A side that no ray visits within the cell is skipped. This costs little more
than the step of a single ray. In a leaf, triangles are culled for the whole packet, and the remaining ones are tested, W rays
at a time. Wald et al. (2001) made the decision from four rays in lanes; Reshetov et al. (2005) by interval arithmetic for any
number of rays.

**Differences from the papers.** Both papers need rays with the same signs, and split other packets. Here an axis with both
signs is bounded too (`wrt.kernels.traversal.packet.core.packet_cells`). As with single rays, a cell on the stack that begins
after the farthest of the best hits is dropped, and the search continues with the next one: widened cells overlap, so an outer
cell may begin before an inner one.

**Limits.** A triangle in several leaves is tested in each of them unless a mailbox remembers it. The traversal of a packet
whose rays have diverged is abandoned after `MAX_STEPS_PER_RAY` steps per ray, and continues in parts
(`wrt.kernels.traversal.packet.core.packet_splitting`). Shadow rays to a point light gain little, because neighbours start on
different surfaces. Figures: notebooks/records/2026-11-21-kdtree-packets.md.

References: wald-2001; reshetov-2005; boulos-2006; rahikainen-2013 (chapters 3 and 5).
"""

from functools import cache

import warp as wp

from wrt.kernels.layout import kdtree_nodes as kdtree
from wrt.kernels.layout.kdtree_nodes import LEAF, MAX_TREE_DEPTH, KdNodes
from wrt.kernels.layout.unchecked import load_float, load_int, store_int
from wrt.kernels.traversal.leaf import Counters
from wrt.kernels.traversal.mailbox import MAILBOXES
from wrt.kernels.traversal.packet.core.packet_cells import cross_plane, enter_box
from wrt.kernels.traversal.packet.core.packet_kernel import PacketWalk, leaf_step, make_packet_kernel
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.single.single_kdtree import Cell, make_kdtree_walk, step_guessing
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks

MAX_STEPS_PER_RAY = 4
"""Steps per ray (nodes and leaves) after which a packet's traversal is abandoned: about the cost of tracing its rays one by
one."""

MIXED_AXES = 2
"""Greatest number of axes with both signs for which a packet is traversed as a whole; only packets with three are not."""


def walk_memory(config: TraversalConfig) -> int:
    """Ints of local memory that a walk needs: its mailbox."""
    return MAILBOXES[config.mailbox].size


@cache
def make_packet_kdtree_walk(config: TraversalConfig) -> wp.Function:
    """`wp.func(tree, triangles, packet, memory, bounds, work) -> bool`: traces one packet; False if its traversal was
    abandoned.

    The walk starts at `tree.root`. If that is not the root of the whole tree, no ray of the packet may have a hit elsewhere.
    """
    test_leaf = leaf_step(config)
    mailbox_size, counting, max_steps = MAILBOXES[config.mailbox].size, config.counters, MAX_STEPS_PER_RAY * config.packet.rays

    @wp.func
    def walk_packet_kdtree(
        tree: wp.ref[KdNodes],
        triangles: wp.ref[TriangleBlocks],
        packet: wp.array(dtype=float),
        memory: wp.array(dtype=int),
        bounds: wp.ref[PacketBounds],
        work: wp.ref[Counters],
    ):
        interval = enter_box(bounds, tree.low, tree.high)
        cell = Cell()
        cell.node = tree.root
        cell.entry = interval[0]
        cell.leave = interval[1]
        stack_node = wp.zeros(shape=(MAX_TREE_DEPTH,), dtype=int)
        stack_entry = wp.zeros(shape=(MAX_TREE_DEPTH,), dtype=float)
        stack_leave = wp.zeros(shape=(MAX_TREE_DEPTH,), dtype=float)
        for i in range(wp.static(mailbox_size)):
            store_int(memory, i, 0)
        size = int(0)
        steps = int(0)
        searching = cell.entry <= cell.leave
        while searching:
            steps += 1
            node = kdtree.load_node(tree.nodes, cell.node)
            axis = kdtree.split_axis(node)
            if axis != LEAF:
                crossing = cross_plane(bounds, axis, kdtree.split_position(node), cell.entry, cell.leave)
                right = kdtree.right_child(node)
                step_guessing(crossing, cell.node + 1, right, cell, stack_node, stack_entry, stack_leave, size)
                if wp.static(counting):
                    work.nodes += 1
            else:
                test_leaf(triangles, kdtree.first_block(node), kdtree.leaf_triangles(node), packet, bounds, memory, work)
                searching = bool(False)
                size = wp.where(steps <= wp.static(max_steps), size, 0)
                while size > 0 and not searching:
                    size -= 1
                    cell.node = load_int(stack_node, size)
                    cell.entry = load_float(stack_entry, size)
                    cell.leave = load_float(stack_leave, size)
                    searching = cell.entry <= bounds.t_max
        return steps <= wp.static(max_steps)

    return walk_packet_kdtree


@cache
def make_packet_kdtree_kernel(config: TraversalConfig) -> wp.Kernel:
    """The kernel for one specialisation."""
    walk = PacketWalk(make_packet_kdtree_walk(config), make_kdtree_walk(config), MIXED_AXES, walk_memory(config))
    return make_packet_kernel(config, KdNodes, walk)
