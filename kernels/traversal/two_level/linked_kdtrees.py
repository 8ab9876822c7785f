"""kd-trees whose leaves lead to other kd-trees: groups of triangles, groups of groups, and lists of trees.

**Idea** (Kang et al. 2013). A scene graph becomes a hierarchy of kd-trees. The planes of an upper tree come from the boxes of
its groups, which are few; the trees of groups are built separately, and those of groups at rest are kept. Groups may overlap,
so a leaf of an upper tree lists as many as meet its cell.

**What we do.** All nodes lie in one array. A leaf with a negative count leads to a list of *links*: roots of other trees with
their boxes. The walk (`wrt.kernels.traversal.single.single_kdtree`) keeps cells, nodes with an interval of t, on a stack. A
link is one more cell: its interval is that of the leaf within the link's box. So the walk goes through any number of levels
with one stack, and no ray is transformed. A cell whose entry lies beyond the best hit is skipped, in whatever tree it is.

**Lists.** If the root is a list of links, every ray visits each tree in turn, as Bikker (2007) does with a static and a dynamic
tree. If the trees of moving objects are single leaves, their triangles are tested one by one, as by Parker et al. (1999).

**Crossings** must be counted once, but a group that meets several cells of an upper tree is visited in each. Queries that count
go through the list of all groups (`LinkedNodes.every`) in place of the upper trees.

**Other spaces.** The walk takes the ray in the space of the cells and in that of the triangles, which may differ
(`wrt.kernels.traversal.two_level.fuzzy_boxes`).

References: kang-2013; bikker-2007; parker-1999.
"""

from functools import cache

import warp as wp

from wrt.kernels.answers.answer_kind import BestHit, start
from wrt.kernels.layout import kdtree_nodes as kdtree
from wrt.kernels.layout.kdtree_nodes import LEAF, MAX_TREE_DEPTH, KdNodes
from wrt.kernels.layout.ray_batch import HitBatch, Ray
from wrt.kernels.layout.unchecked import store_float, store_int
from wrt.kernels.simd.boxes import RaySlabs, ray_slabs, reach, slab_interval
from wrt.kernels.traversal.leaf import Counters, Leaf, begin_search, enter, leaf_search
from wrt.kernels.traversal.single.single_bvh import make_leaf_loop
from wrt.kernels.traversal.single.single_kdtree import Cell, pop_cell, split_cell, step_guessing, step_selecting
from wrt.kernels.traversal.single.single_kernel import make_ray_kernel
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks


@wp.struct
class Link:
    """A tree that a leaf leads to."""

    root: int
    """Its root; or the complement of the first link of a list."""
    more: int
    """Whether the next link is of the same list."""
    low: wp.vec3
    """`low` and `high` bound its triangles."""
    high: wp.vec3


@wp.struct
class LinkedNodes:
    """Trees of all levels.

    A leaf with a negative count is a list of links; the first one stands in place of its first block. Where a node is expected,
    a negative number is the complement of the first link of a list.
    """

    nodes: wp.array(dtype=wp.vec2i)
    links: wp.array(dtype=Link)
    root: int
    every: int
    """First link of the list of all trees with triangles."""
    low: wp.vec3
    high: wp.vec3


@cache
def make_cell_walk(config: TraversalConfig, levels: int, Search: type, test_leaf: wp.Function) -> wp.Function:
    """`wp.func(tree, first, cells, search, hits, i, best, work) -> best`: traverses what is below a cell, for ray number i.

    first: a cell; its node as in `LinkedNodes`. cells: the ray in the cells' space. search: of leaves, in the triangles' space.

    Args:
        config: the specialisation.
        levels: most cells that wait at a time.
        Search: struct of the search state that leaves need.
        test_leaf: tests a leaf, as that of `make_leaf_loop` does.
    """
    step = step_guessing if config.coherent else step_selecting
    counting, any_hit = config.counters, config.answer.rules.ends_at_first

    @wp.func
    def walk_cells(
        tree: LinkedNodes,
        first: Cell,
        cells: wp.ref[RaySlabs],
        search: wp.ref[Search],
        hits: wp.ref[HitBatch],
        i: int,
        best: BestHit,
        work: wp.ref[Counters],
    ):
        cell = Cell()
        cell.node = first.node
        cell.entry = first.entry
        cell.leave = first.leave
        own = KdNodes()
        own.nodes = tree.nodes
        own.root = first.node
        stack_node = wp.zeros(shape=(levels,), dtype=int)
        stack_entry = wp.zeros(shape=(levels,), dtype=float)
        stack_leave = wp.zeros(shape=(levels,), dtype=float)
        size = int(0)
        searching = cell.entry <= cell.leave
        while searching:
            if cell.node < 0:
                link = tree.links[-1 - cell.node]
                if link.more != 0:
                    store_int(stack_node, size, cell.node - 1)
                    store_float(stack_entry, size, cell.entry)
                    store_float(stack_leave, size, cell.leave)
                    size += 1
                inside = slab_interval(cells, link.low, link.high)
                cell.node = link.root
                cell.entry = wp.where(inside[0] > cell.entry, inside[0], cell.entry)
                cell.leave = wp.where(inside[1] < cell.leave, inside[1], cell.leave)
                own.root = link.root
                searching = cell.entry <= cell.leave and cell.entry <= best.t
                if wp.static(counting):
                    work.boxes += 1
            else:
                node = kdtree.load_node(tree.nodes, cell.node)
                if kdtree.split_axis(node) != LEAF:
                    crossing = split_cell(cells, node, cell)
                    left = cell.node + 1
                    step(crossing, left, kdtree.right_child(node), cell, stack_node, stack_entry, stack_leave, size)
                    if wp.static(counting):
                        work.nodes += 1
                elif kdtree.leaf_triangles(node) < 0:
                    cell.node = -1 - kdtree.first_block(node)
                else:
                    leaf = Leaf()
                    leaf.node = cell.node
                    leaf.within = wp.vec2(cell.entry, cell.leave)
                    leaf.block = kdtree.first_block(node)
                    leaf.count = kdtree.leaf_triangles(node)
                    best = test_leaf(own, leaf, cells, search, hits, i, best, work)
                    if wp.static(any_hit):
                        size = wp.where(best.primitive < 0, size, 0)
                    searching = bool(False)
            while size > 0 and not searching:
                pop_cell(cell, stack_node, stack_entry, stack_leave, size)
                searching = cell.entry <= best.t
        return best

    return walk_cells


@cache
def make_linked_walk(config: TraversalConfig) -> wp.Function:
    """`wp.func(tree, triangles, ray, hits, i, work) -> best` for ray number i, which must be valid."""
    begin, crossing = begin_search(config.triangle_test), config.answer.rules.crossings
    levels = max(config.stack.levels, MAX_TREE_DEPTH)
    walk_cells = make_cell_walk(config, levels, leaf_search(config.triangle_test), make_leaf_loop(config, KdNodes))

    @wp.func
    def walk_linked_kdtrees(
        tree: LinkedNodes, triangles: TriangleBlocks, ray: Ray, hits: wp.ref[HitBatch], i: int, work: wp.ref[Counters]
    ):
        slabs = ray_slabs(ray.origin, ray.direction, reach(ray.origin, tree.low, tree.high))
        search = begin(triangles, ray, slabs)
        interval = enter(slabs, tree.low, tree.high, ray.t_min, ray.t_max)
        first = Cell()
        first.node = tree.root
        if wp.static(crossing):
            first.node = -1 - tree.every
        first.entry = interval[0]
        first.leave = interval[1]
        return walk_cells(tree, first, slabs, search, hits, i, start(ray.t_max), work)

    return walk_linked_kdtrees


@cache
def make_linked_kernel(config: TraversalConfig) -> wp.Kernel:
    """The kernel for one specialisation."""
    return make_ray_kernel(config, LinkedNodes, make_linked_walk(config))
