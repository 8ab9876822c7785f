"""Entry-point search in a kd-tree (MLRTA and AEPSA): a tile of rays finds the deepest node below which all its hits are.

**Problem.** Every packet starts at the root, although near the root all packets of a tile of the picture take the same path.

**Idea** (Reshetov, Soupikov and Hurley 2005). The rays of a large tile are bounded together, by intervals. The bounds traverse
the tree to find leaves that may contain hits. If there are none, all rays miss. Otherwise the deepest common ancestor of these
leaves is the entry point of the tile. The tile is split into 16 parts, each part searches for its own entry point below that of
the tile, and the packets of the smallest parts start at the entry point of their part. There are any number of levels of tiles
(`TileConfig.levels`), two if nothing else is chosen.

**Steps** of a search:

1. `descend`: depth first, near side first, to the first candidate leaf. Where both sides must be visited, the far one is pushed
   on the *bifurcation stack*. The stack is then frozen.
2. `choose`: the entry point is the topmost node whose far side, on the stack, reaches a candidate leaf; if there is none, it is
   the leaf itself.
3. `move_to`: the box of the entry point, by another descent to its number: nodes are numbered depth first.

`mlrta` and `aepsa` (Fowler, Collins and Manzke 2009) differ in both phases:
* In MLRTA every leaf that is not empty is a candidate. In AEPSA a leaf is a candidate only if one of its triangles overlaps the
  bounds (the packets' culling of triangles, W at a time), because the bounds of a tile reach many leaves whose triangles lie
  beside them.
* MLRTA takes nodes from the stack, deepest first, and searches the other side of each. AEPSA starts at the top and stops at the
  first success, because deeper nodes can no longer be the entry point.

**Arbitrary tiles.** A tile is a run of consecutive rays of the batch. The parts of the tree that it skips cannot be hit by any
of its rays, to the bit: its bounds contain those of the packets, which contain those of the rays
(`wrt.kernels.traversal.packet.core.packet_cells`). If the batch lists pixels in an order that keeps neighbours together
(blocks, Morton order), tiles are compact; if it lists them by rows, they are not, and most searches end at the root.

**Differences from the papers.** Tiles are bounded by intervals of origins and directions
(`wrt.kernels.traversal.packet.rays.packet_load`), so rays need not share an origin or signs. The queues of algorithm 5.1 in
Rahikainen (2013) are processed deepest first, so the first success would not be the topmost node; here AEPSA processes the
frozen stack from its bottom.

**Limits.** Packets of 64 already share the descent among their rays, so little is left to save
(notebooks/records/2026-11-21-kdtree-packets.md).

References: reshetov-2005; fowler-2009; rahikainen-2013 (chapter 5, algorithm 5.1).
"""

from functools import cache, partial

import warp as wp

from wrt.kernels.answers.answer_kind import start
from wrt.kernels.layout import kdtree_nodes as kdtree
from wrt.kernels.layout.kdtree_nodes import LEAF, MAX_TREE_DEPTH, KdNodes, child_high, child_low
from wrt.kernels.layout.ray_batch import HitBatch, RayBatch
from wrt.kernels.layout.unchecked import load_float, load_int
from wrt.kernels.runtime.options import specialised_kernel
from wrt.kernels.traversal.leaf import CounterRows, Counters
from wrt.kernels.traversal.packet import CULLINGS
from wrt.kernels.traversal.packet.core.packet_cells import cross_plane, enter_box
from wrt.kernels.traversal.packet.core.packet_kdtree import MIXED_AXES, make_packet_kdtree_walk, walk_memory
from wrt.kernels.traversal.packet.core.packet_kernel import PacketWork, packet_layout, packet_memory, packet_step
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_load import bound_rays
from wrt.kernels.traversal.single.single_kdtree import Cell, make_kdtree_walk, pop_cell, step_guessing
from wrt.kernels.traversal.traversal_config import TileConfig, TraversalConfig
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks

PACKETS = TileConfig.packets
"""Packets in the smallest tile that searches for an entry point, if nothing else is chosen."""

SPLIT = TileConfig.split
"""Number of parts of a large tile, as recommended by Reshetov et al. (2005), if nothing else is chosen."""


def rays_per_item(config: TraversalConfig) -> int:
    """Rays of a tile of the first level; an item of the kernel is one tile."""
    return config.tiles.split ** (config.tiles.levels - 1) * config.tiles.packets * config.packet.rays


@cache
def candidate_leaf(config: TraversalConfig, accelerated: bool) -> wp.Function:
    """`wp.func(triangles, node, bounds) -> bool`: whether a leaf may contain a hit of a ray of the tile (a candidate leaf)."""
    vertex = CULLINGS["vertex"]  # a culling that needs only bounds, not rays
    holds = vertex.holds_for(TRIANGLE_TESTS[config.triangle_test])
    cull_triangles = (vertex if holds else CULLINGS["interval"]).triangles(packet_layout(config))
    width = config.width

    @wp.func
    def is_candidate(triangles: TriangleBlocks, node: wp.vec2i, bounds: wp.ref[PacketBounds]):
        rest = int(kdtree.leaf_triangles(node))
        result = bool(rest > 0)
        if wp.static(accelerated):
            block = int(kdtree.first_block(node))
            result = bool(False)
            while rest > 0 and not result:
                result = cull_triangles(triangles.records, block, bounds) != wp.uint32(0)
                block += 1
                rest -= wp.static(width)
        return result

    return is_candidate


@cache
def make_descent(config: TraversalConfig, accelerated: bool) -> wp.Function:
    """`wp.func(nodes, triangles, bounds, cell, stack_node, stack_entry, stack_leave, work) -> int`: moves to the first
    candidate leaf below a cell; returns the number of cells that wait then, -1 if there is none."""
    is_candidate, counting = candidate_leaf(config, accelerated), config.counters

    @wp.func
    def descend(
        nodes: wp.array(dtype=wp.vec2i),
        triangles: TriangleBlocks,
        bounds: wp.ref[PacketBounds],
        cell: wp.ref[Cell],
        stack_node: wp.array(dtype=int),
        stack_entry: wp.array(dtype=float),
        stack_leave: wp.array(dtype=float),
        work: wp.ref[Counters],
    ):
        size = int(0)
        reached = bool(False)
        searching = bool(True)
        while searching:
            node = kdtree.load_node(nodes, cell.node)
            axis = kdtree.split_axis(node)
            if axis != LEAF:
                crossing = cross_plane(bounds, axis, kdtree.split_position(node), cell.entry, cell.leave)
                right = kdtree.right_child(node)
                step_guessing(crossing, cell.node + 1, right, cell, stack_node, stack_entry, stack_leave, size)
                if wp.static(counting):
                    work.nodes += 1
            else:
                if wp.static(counting):
                    work.leaves += 1
                reached = is_candidate(triangles, node, bounds)
                searching = size > 0 and not reached
                if searching:
                    pop_cell(cell, stack_node, stack_entry, stack_leave, size)
        return wp.where(reached, size, -1)

    return descend


@cache
def make_choice(config: TraversalConfig, accelerated: bool) -> wp.Function:
    """`wp.func(nodes, triangles, bounds, stack_node, stack_entry, stack_leave, size, work) -> int`: the topmost of `size`
    waiting cells that reaches a candidate leaf, -1 if none does."""
    descend = make_descent(config, accelerated)

    @wp.func
    def choose(
        nodes: wp.array(dtype=wp.vec2i),
        triangles: TriangleBlocks,
        bounds: wp.ref[PacketBounds],
        stack_node: wp.array(dtype=int),
        stack_entry: wp.array(dtype=float),
        stack_leave: wp.array(dtype=float),
        size: int,
        work: wp.ref[Counters],
    ):
        own_node = wp.zeros(shape=(MAX_TREE_DEPTH,), dtype=int)
        own_entry = wp.zeros(shape=(MAX_TREE_DEPTH,), dtype=float)
        own_leave = wp.zeros(shape=(MAX_TREE_DEPTH,), dtype=float)
        chosen = int(-1)
        done = int(0)
        while done < size:
            which = wp.where(wp.static(accelerated), done, size - 1 - done)
            cell = Cell()
            cell.node = load_int(stack_node, which)
            cell.entry = load_float(stack_entry, which)
            cell.leave = load_float(stack_leave, which)
            done += 1
            if descend(nodes, triangles, bounds, cell, own_node, own_entry, own_leave, work) >= 0:
                chosen = which
                if wp.static(accelerated):
                    done = size
        return chosen

    return choose


@wp.func
def move_to(tree: wp.ref[KdNodes], target: int, above: bool):
    """Moves `tree.root` to a node below it, or to the node above that."""
    low = wp.vec3(tree.low)
    high = wp.vec3(tree.high)
    at = int(tree.root)
    while at != target:
        node = kdtree.load_node(tree.nodes, at)
        go_right = target >= kdtree.right_child(node)
        below = wp.where(go_right, kdtree.right_child(node), at + 1)
        if above and below == target:
            break
        low = child_low(low, kdtree.split_axis(node), kdtree.split_position(node), go_right)
        high = child_high(high, kdtree.split_axis(node), kdtree.split_position(node), go_right)
        at = below
    tree.root = at
    tree.low = low
    tree.high = high


@cache
def make_search(config: TraversalConfig, accelerated: bool) -> wp.Function:
    """`wp.func(tree, triangles, bounds, work) -> bool`: moves `tree.root` to the entry point; False if no ray can hit
    anything."""
    descend, choose = make_descent(config, accelerated), make_choice(config, accelerated)

    @wp.func
    def search(tree: wp.ref[KdNodes], triangles: TriangleBlocks, bounds: wp.ref[PacketBounds], work: wp.ref[Counters]):
        interval = enter_box(bounds, tree.low, tree.high)
        if not interval[0] <= interval[1]:
            return False
        cell = Cell()
        cell.node = tree.root
        cell.entry = interval[0]
        cell.leave = interval[1]
        stack_node = wp.zeros(shape=(MAX_TREE_DEPTH,), dtype=int)
        stack_entry = wp.zeros(shape=(MAX_TREE_DEPTH,), dtype=float)
        stack_leave = wp.zeros(shape=(MAX_TREE_DEPTH,), dtype=float)
        size = descend(tree.nodes, triangles, bounds, cell, stack_node, stack_entry, stack_leave, work)
        if size < 0:
            return False
        chosen = choose(tree.nodes, triangles, bounds, stack_node, stack_entry, stack_leave, size, work)
        target = int(cell.node)
        if chosen >= 0:
            target = load_int(stack_node, chosen)
        move_to(tree, target, chosen >= 0)
        return True

    return search


@cache
def make_entry_point_kernel(config: TraversalConfig, accelerated: bool) -> wp.Kernel:
    """The kernel for one specialisation; `accelerated` selects AEPSA."""
    search = make_search(config, accelerated)
    trace_packet = packet_step(config, KdNodes, make_packet_kdtree_walk(config), make_kdtree_walk(config), MIXED_AXES)
    store, counting = config.answer.stored.store, config.counters
    packet_rays, large, levels, split = config.packet.rays, rays_per_item(config), config.tiles.levels, config.tiles.split
    small = config.tiles.packets * packet_rays
    size, memory_size = packet_layout(config).size, walk_memory(config)

    @wp.func
    def search_tile(
        tree: KdNodes,
        part_tree: wp.ref[KdNodes],
        triangles: TriangleBlocks,
        rays: RayBatch,
        begin: int,
        count: int,
        work: wp.ref[Counters],
    ):
        bounds = PacketBounds()
        bound_rays(rays, begin, count, tree.low, tree.high, bounds)
        return bounds.active > 0 and search(part_tree, triangles, bounds, work)

    def entry_points(
        first: int, tree: KdNodes, triangles: TriangleBlocks, rays: RayBatch, hits: HitBatch, counters: CounterRows
    ):
        packet = wp.zeros(shape=(size,), dtype=float)
        walk_memory = wp.zeros(shape=(memory_size,), dtype=int)
        memory = packet_memory(packet, walk_memory)
        tile = (first + wp.tid()) * wp.static(large)
        end = wp.min(tile + wp.static(large), rays.count)
        work = PacketWork()
        work.counters = counters
        part_tree = KdNodes()
        part_tree.nodes = tree.nodes
        root = wp.zeros(shape=(levels,), dtype=int)  # of each level: the entry point of the tile that is under way
        low = wp.zeros(shape=(levels,), dtype=wp.vec3)
        high = wp.zeros(shape=(levels,), dtype=wp.vec3)
        may_hit = wp.zeros(shape=(levels,), dtype=int)
        part = int(tile)
        while part < end:
            part_end = wp.min(part + wp.static(small), end)
            part_may_hit = bool(True)
            part_tree.root = tree.root
            part_tree.low = tree.low
            part_tree.high = tree.high
            rays_here = int(large)
            for level in range(levels):
                if (part - tile) % rays_here == 0:
                    if part_may_hit and (level == 0 or kdtree.split_axis(kdtree.load_node(tree.nodes, part_tree.root)) != LEAF):
                        part_may_hit = search_tile(tree, part_tree, triangles, rays, part, rays_here, work.done)
                    root[level] = part_tree.root
                    low[level] = part_tree.low
                    high[level] = part_tree.high
                    may_hit[level] = wp.where(part_may_hit, 1, 0)
                else:
                    part_tree.root = root[level]
                    part_tree.low = low[level]
                    part_tree.high = high[level]
                    part_may_hit = may_hit[level] != 0
                rays_here /= split
            begin = int(part)
            while begin < part_end:
                if part_may_hit:
                    trace_packet(tree, part_tree, triangles, rays, begin, memory, hits, work)
                else:
                    for i in range(begin, wp.min(begin + wp.static(packet_rays), part_end)):
                        store(hits, i, start(0.0))
                    if wp.static(counting):
                        counters.rows[begin] = work.done
                        work.done = Counters()
                begin += wp.static(packet_rays)
            part += wp.static(small)

    return specialised_kernel(entry_points)


make_mlrta = partial(make_entry_point_kernel, accelerated=False)
make_aepsa = partial(make_entry_point_kernel, accelerated=True)
