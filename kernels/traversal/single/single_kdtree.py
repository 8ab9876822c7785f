"""Single-ray traversal of a kd-tree with a stack, robust by construction.

**Problem.** The classic recursive traversal compares the t of a splitting plane with the ray's interval in a node. It is wrong
if they are equal: for a ray whose origin lies on the plane, a ray that stays in the plane, an entry and an exit both on the
plane (Havran 2001; Rahikainen 2013, chapter 5).

**Solution.** Each child gets its own interval and is visited if that is not empty. The near child (by the sign of the
direction, not by the side of the origin) ends at the t at which the plane is left, the far child starts at the t at which it is
entered. Both are computed with the plane widened by the slack of `wrt.kernels.simd.boxes`, so the two intervals overlap
slightly.
* Plane behind the origin: the near interval ends below t_min, and only the far child is visited. Plane beyond the exit: only
  the near child is visited.
* Ray parallel to the plane: t is +-inf; the child that contains the origin gets the whole interval, the other child none.
  Origin exactly in the widened plane: NaN, which gives no bound, so both children get the whole interval.
* A triangle in the splitting plane is in one child only; its t equals the t of the plane, which both intervals contain.

The entry of a cell is never later than the t of a hit on a triangle in it (the consistency rule). A cell on the stack whose
entry lies beyond the best hit is therefore dropped; at a tie it is visited, because a smaller primitive id may win there. The
search then continues with the next cell on the stack: children overlap, so an outer cell may start before an inner one.

**Two forms of the step.** With branches, the processor predicts the next node and executes ahead of the comparisons, which is
right for neighbouring rays, because they take the same path. For incoherent rays every second prediction is wrong and the work
is discarded, so there both outcomes are computed and one is selected. `TraversalConfig.coherent` chooses the form; the hits are
the same. Figures: notebooks/records/2026-11-21-single-rays.md.

References: havran-2001; rahikainen-2013 (chapter 5).
"""

from functools import cache

import warp as wp

from wrt.kernels.answers.answer_kind import start
from wrt.kernels.layout import compact_nodes as compact
from wrt.kernels.layout import kdtree_nodes as kdtree
from wrt.kernels.layout.kdtree_nodes import LEAF, MAX_TREE_DEPTH, KdNodes
from wrt.kernels.layout.ray_batch import Ray
from wrt.kernels.layout.unchecked import load_float, load_int, store_float, store_int
from wrt.kernels.simd.boxes import RaySlabs, cross_plane, ray_slabs, reach
from wrt.kernels.traversal.crossings import make_leaf_step
from wrt.kernels.traversal.leaf import Counters, Leaf, begin_search, block_step, enter
from wrt.kernels.traversal.mailbox import MAILBOXES, NONE
from wrt.kernels.traversal.single.single_kernel import make_ray_kernel
from wrt.kernels.traversal.traversal_config import SingleConfig, TraversalConfig
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks

ALL_LANES = wp.constant(wp.uint32(0xFFFFFFFF))
"""Mask of all triangles of a block."""


@wp.struct
class Cell:
    """A node and the interval of t in which the ray may be inside its box."""

    node: int
    entry: float
    leave: float


@wp.func
def split_cell(slabs: wp.ref[RaySlabs], node: wp.vec2i, cell: wp.ref[Cell]):
    """Where a ray crosses the plane of an inner node: see `cross_plane`, clipped to the interval of the cell."""
    crossing = cross_plane(slabs, kdtree.split_axis(node), kdtree.split_position(node))
    crossing[1] = wp.where(crossing[1] < cell.leave, crossing[1], cell.leave)
    crossing[2] = wp.where(crossing[2] > cell.entry, crossing[2], cell.entry)
    return crossing


@wp.func
def step_guessing(
    crossing: wp.vec3,
    left: int,
    right: int,
    cell: wp.ref[Cell],
    stack_node: wp.array(dtype=int),
    stack_entry: wp.array(dtype=float),
    stack_leave: wp.array(dtype=float),
    size: wp.ref[int],
):
    """One step through an inner node, with branches. crossing: of `split_cell`."""
    near = int(left)
    far = int(right)
    if crossing[0] < 0.0:
        near = right
        far = left
    if cell.entry > crossing[1]:
        cell.node = far
        cell.entry = crossing[2]
    else:
        if crossing[2] <= cell.leave:
            store_int(stack_node, size, far)
            store_float(stack_entry, size, crossing[2])
            store_float(stack_leave, size, cell.leave)
            size += 1
        cell.node = near
        cell.leave = crossing[1]


@wp.func
def step_selecting(
    crossing: wp.vec3,
    left: int,
    right: int,
    cell: wp.ref[Cell],
    stack_node: wp.array(dtype=int),
    stack_entry: wp.array(dtype=float),
    stack_leave: wp.array(dtype=float),
    size: wp.ref[int],
):
    """The same step without branches: the sign bit of the direction swaps the children, and the far child is always written."""
    swap = (left ^ right) & (wp.cast(crossing[0], wp.int32) >> 31)
    near = left ^ swap
    far = right ^ swap
    visit_near = cell.entry <= crossing[1]
    store_int(stack_node, size, far)
    store_float(stack_entry, size, crossing[2])
    store_float(stack_leave, size, cell.leave)
    size += wp.where(visit_near and crossing[2] <= cell.leave, 1, 0)
    cell.node = wp.where(visit_near, near, far)
    cell.entry = wp.where(visit_near, cell.entry, crossing[2])
    cell.leave = wp.where(visit_near, crossing[1], cell.leave)


@wp.func
def pop_cell(
    cell: wp.ref[Cell],
    stack_node: wp.array(dtype=int),
    stack_entry: wp.array(dtype=float),
    stack_leave: wp.array(dtype=float),
    size: wp.ref[int],
):
    """Takes the cell that was pushed last."""
    size -= 1
    cell.node = load_int(stack_node, size)
    cell.entry = load_float(stack_entry, size)
    cell.leave = load_float(stack_leave, size)


@wp.func
def load_in_place(nodes: wp.array(dtype=wp.vec2i), index: wp.ref[int]):
    """A node that is where its index says."""
    return kdtree.load_node(nodes, index)


def node_order(single: SingleConfig) -> tuple[wp.Function, wp.Function, int]:
    """How nodes are found: `wp.func(nodes, index) -> node`, `wp.func(index, node) -> (lower, upper)` child, and the root."""
    if single.compact:
        return compact.load_compact(single.compact), compact.compact_children(single.compact), compact.ROOT
    words = single.pair_words
    return load_in_place, kdtree.children_in_pairs(words) if words else kdtree.children_depth_first, 0


@cache
def make_kdtree_walk(config: TraversalConfig) -> wp.Function:
    """`wp.func(tree, triangles, ray, hits, i, work) -> best` for ray number i, which must be valid."""
    prepare = TRIANGLE_TESTS[config.triangle_test].prepare
    nearest, Results, begin = config.answer.nearest, config.answer.search.State, begin_search(config.triangle_test)
    test_block = block_step(config) if nearest else make_leaf_step(config, KdNodes)
    step = step_guessing if config.coherent else step_selecting
    load, children_of, root = node_order(config.single)
    width, counting, any_hit = config.width, config.counters, config.answer.rules.ends_at_first
    forget, memory = MAILBOXES[config.mailbox].filter(config.width), MAILBOXES[config.mailbox].size
    remembering = config.mailbox != NONE

    @wp.func
    def walk_kdtree(tree: KdNodes, triangles: TriangleBlocks, ray: Ray, hits: wp.ref[Results], i: int, work: wp.ref[Counters]):
        best = start(ray.t_max)
        slabs = ray_slabs(ray.origin, ray.direction, reach(ray.origin, tree.low, tree.high))
        if wp.static(nearest):
            state = prepare(ray.origin, ray.direction)
        else:
            search = begin(triangles, ray, slabs)
        interval = enter(slabs, tree.low, tree.high, ray.t_min, ray.t_max)
        cell = Cell()
        cell.node = wp.static(root)
        cell.entry = interval[0]
        cell.leave = interval[1]
        stack_node = wp.zeros(shape=(MAX_TREE_DEPTH,), dtype=int)
        stack_entry = wp.zeros(shape=(MAX_TREE_DEPTH,), dtype=float)
        stack_leave = wp.zeros(shape=(MAX_TREE_DEPTH,), dtype=float)
        mailbox = wp.zeros(shape=(memory,), dtype=int)
        size = int(0)
        searching = cell.entry <= cell.leave
        while searching:
            at = int(cell.node)
            node = load(tree.nodes, at)
            if kdtree.split_axis(node) != LEAF:
                crossing = split_cell(slabs, node, cell)
                children = children_of(at, node)
                step(crossing, children[0], children[1], cell, stack_node, stack_entry, stack_leave, size)
                if wp.static(counting):
                    work.nodes += 1
            else:
                count = kdtree.leaf_triangles(node)
                block = kdtree.first_block(node)
                if wp.static(counting):
                    work.leaves += 1
                    work.triangles += count
                while count > 0:
                    if wp.static(not nearest):
                        leaf = Leaf()
                        leaf.node = cell.node
                        leaf.within = wp.vec2(cell.entry, cell.leave)
                        best = test_block(tree, leaf, block, search, slabs, hits, i, best)
                    elif wp.static(remembering):
                        fresh = forget(triangles.primitive, block, ALL_LANES, mailbox)
                        if fresh != wp.uint32(0):
                            best = test_block(triangles, block, state, slabs, ray.t_min, best)
                        elif wp.static(counting):
                            work.avoided += wp.min(count, wp.static(width))
                            work.triangles -= wp.min(count, wp.static(width))
                    else:
                        best = test_block(triangles, block, state, slabs, ray.t_min, best)
                    block += 1
                    count -= wp.static(width)
                searching = bool(False)
                if wp.static(any_hit):
                    size = wp.where(best.primitive < 0, size, 0)
                while size > 0 and not searching:
                    pop_cell(cell, stack_node, stack_entry, stack_leave, size)
                    searching = cell.entry <= best.t
        return best

    return walk_kdtree


@cache
def make_single_kdtree_kernel(config: TraversalConfig) -> wp.Kernel:
    """The kernel for one specialisation."""
    return make_ray_kernel(config, KdNodes, make_kdtree_walk(config))
