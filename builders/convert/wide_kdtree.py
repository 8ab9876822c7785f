"""A kd-tree in nodes of W children: its cells in the layout of a wide BVH (`wrt.kernels.layout.bvh_nodes`), for incoherent
rays.

**Problem.** A step through a kd-tree loads one plane from memory for one comparison, and the next step depends on it. A wide
BVH is fast because a load serves W boxes, and this does not depend on how the boxes were made.

**Idea.** A cell of a kd-tree is a box. A wide node holds up to W cells that cover an inner node, so that a ray is tested
against all of them at once. Sorted by entry they are in the order in which the ray passes them, because cells do not overlap.
Popov et al. (2009) examined what bounding volume hierarchies gain if space is divided instead of the set of triangles. Ernst
and Greiner (2007) and Stich et al. (2009) let triangles be in several boxes, each clipped to its part of space. Here the
division already exists and only has to be converted.

**Phases**
1. count: references in the leaves below every node, from the leaves up;
2. place: cells, and the position of every node in a binary tree (`wrt.builders.bvh.phases.binary_tree`), from the root down.
   Empty cells get no node, and their siblings replace their parents: a ray that meets only empty cells of a node is done with
       it;
3. divide: the triangles below a cell of at most `MAX_UNDIVIDED_BLOCKS` blocks are listed, each once, and divided like those of
   a BVH (`wrt.builders.bvh.phases.bvh_subtrees`), by their boxes, clipped to the cell;
4. join: the boxes of inner nodes, from the leaves up;
5. collapse to nodes of W children (`wrt.builders.bvh.phases.collapse`).

**What we changed.** The tree is not converted down to its leaves, because these suit traversal by planes: they hold several
blocks, of which a ray would need one, and duplicate references. For cells that small, duplicates cost more, of memory above
all, than overlapping boxes (notebooks/records/2026-11-21-wide-kdtree.md).

**Why hits have the same bits.** A hit lies in the interval of its ray in some cell whose leaf lists the triangle
(`wrt.kernels.traversal.single.single_kdtree`), and in that of the triangle's box. So its t is at least the entry into either
and at most the exit. The entry into their intersection is the larger of the two, computed from the same planes by the same
formula; the same holds for the boxes above, which only widen it. No hit lies before the entry of the boxes around it: the
consistency rule (`wrt.kernels.simd.boxes`).

**Complexity.** Linear in the nodes, which one thread visits: there is about one node per ten triangles. All threads divide the
lists, in time n log n in the references of a leaf.

**Limits.** A triangle in several leaves is in several blocks, and tested again for each that a ray meets. Lists and triangle
records are held in addition to those of the tree. The tree must be finished: additions of a lazy build are not supported.

References: ernst-greiner-2007; popov-2009; stich-2009.
"""

import numpy as np
import warp as wp

from wrt.builders.bvh.bvh_config import BuildRules, BvhConfig
from wrt.builders.bvh.phases.bin_heuristic import SURFACE, AllDirections
from wrt.builders.bvh.phases.binary_build import BinaryBuild
from wrt.builders.bvh.phases.binary_tree import BinaryTree, Frame, empty_tree
from wrt.builders.bvh.phases.bvh_bins import make_scratch, range_box
from wrt.builders.bvh.phases.bvh_subtrees import STACK, SubtreeMemory, make_build_subtree, subtree_memory
from wrt.builders.bvh.phases.collapse import collapse
from wrt.builders.tree import Bvh, KdTree, Phases
from wrt.builders.triangle_boxes import Boxes, TriangleBoxes
from wrt.kernels.layout import kdtree_nodes as kdtree
from wrt.kernels.layout.kdtree_nodes import LEAF
from wrt.kernels.runtime import native
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import exact_kernel

MAX_UNDIVIDED_BLOCKS = 32
"""Blocks of references up to which a node is not divided by its planes: a compromise between duplicate references and the
kd-tree's own structure (notebooks/records/2026-11-21-wide-kdtree.md)."""

LISTS_PER_ITEM = 32
"""Lists that one thread divides one after the other, in the same scratch memory."""

NO_LEAF = wp.constant(1 << 24)
"""Number of references that exceeds every leaf of a wide tree: it keeps nodes with children in two cells from becoming
leaves."""

NO_POSITION = wp.constant(-1)
"""Position of a node below one that is kept whole."""

SLOTS = wp.constant(2048)
"""Slots of a hash table of triangles, which is never more than half full."""

GOLDEN = wp.constant(wp.uint32(2654435769))
"""2^32 over the golden ratio, for Fibonacci hashing."""


@wp.struct
class Cells:
    """Data of the nodes of a kd-tree, by node number."""

    low: wp.array(dtype=wp.vec3)
    """(nodes,) lower corner of the cell."""
    high: wp.array(dtype=wp.vec3)
    references: wp.array(dtype=wp.vec2i)
    """(nodes,) the first reference of the leaves below, and their number."""
    position: wp.array(dtype=int)
    """(nodes,) its node of the binary tree. An inner node with an empty child shares it with the other child."""
    split_nodes: wp.array(dtype=int)
    """(split_nodes,) nodes of the binary tree with children in two cells, parents before children; sized for all nodes."""
    pairs: wp.array(dtype=int)
    """(split_nodes,) pairs of their children."""
    whole: wp.array(dtype=int)
    """(whole,) nonempty nodes of the kd-tree that are kept whole."""
    totals: wp.array(dtype=int)
    """(2,) lengths of the lists `split_nodes` and `whole`."""


@wp.struct
class LeafLists:
    """A kd-tree and the triangles that its leaves list."""

    nodes: wp.array(dtype=wp.vec2i)
    primitive: wp.array(dtype=int)
    width: int
    """Triangles per block of `primitive`."""


@exact_kernel
def count_references(first: int, nodes: wp.array(dtype=wp.vec2i), cells: Cells):
    """One item. Counts references, children before parents."""
    for i in range(nodes.shape[0]):
        at = nodes.shape[0] - 1 - i
        node = nodes[at]
        count = kdtree.leaf_triangles(node)
        if kdtree.split_axis(node) != LEAF:
            count = cells.references[at + 1][1] + cells.references[kdtree.right_child(node)][1]
        cells.references[at] = wp.vec2i(0, count)


@wp.func
def divide_cell(cells: Cells, at: int, node: wp.vec2i):
    """Computes the cells of the children of an inner node."""
    axis = kdtree.split_axis(node)
    right = kdtree.right_child(node)
    low = cells.low[at]
    high = cells.high[at]
    position = wp.clamp(kdtree.split_position(node), low[axis], high[axis])
    cells.low[at + 1] = low
    cells.high[right] = high
    low[axis] = position
    high[axis] = position
    cells.low[right] = low
    cells.high[at + 1] = high


@wp.func
def set_position(cells: Cells, node: int, position: int, first_reference: int):
    """Sets the position of a node."""
    cells.position[node] = position
    cells.references[node] = wp.vec2i(first_reference, cells.references[node][1])


@exact_kernel
def place_nodes(first: int, nodes: wp.array(dtype=wp.vec2i), max_whole: int, cells: Cells, tree: BinaryTree):
    """One item. Places nodes, parents before children. The root's cell and its position, 0, are set. max_whole: references of a
    node that is kept whole, at most."""
    split_nodes = int(0)
    whole = int(0)
    for at in range(nodes.shape[0]):
        node = nodes[at]
        position = cells.position[at]
        references = cells.references[at]
        left = at + 1
        right = kdtree.right_child(node)
        is_leaf = kdtree.split_axis(node) == LEAF
        is_whole = position != NO_POSITION and (is_leaf or references[1] <= max_whole)
        if is_whole and references[1] > 0:
            cells.whole[whole] = at
            whole += 1
        if (is_whole or position == NO_POSITION) and not is_leaf:
            cells.position[left] = NO_POSITION
            cells.position[right] = NO_POSITION
        elif not is_leaf:
            divide_cell(cells, at, node)
            on_left = cells.references[left][1]
            if on_left > 0 and on_left < references[1]:
                pair = references[0] + on_left
                tree.pair[position] = pair
                tree.range[position] = wp.vec2i(references[0], NO_LEAF)
                cells.split_nodes[split_nodes] = position
                cells.pairs[split_nodes] = pair
                split_nodes += 1
                set_position(cells, left, 2 * pair, references[0])
                set_position(cells, right, 2 * pair + 1, pair)
            else:
                set_position(cells, left, position, references[0])
                set_position(cells, right, position, references[0])
    cells.totals[0] = split_nodes
    cells.totals[1] = whole


@native.func_native("reference.h", "wrt::write_clipped(boxes, triangle, low, high, references.data + (size_t)i * 8);")
def write_clipped(boxes: Boxes, triangle: int, low: wp.vec3, high: wp.vec3, references: wp.array(dtype=float), i: int):
    """Writes reference number i: a triangle's box, clipped to a cell."""


@wp.func
def is_new(table: wp.array(dtype=int), triangle: int):
    """Whether a triangle is not yet in the hash table, whose free slots are 0. Inserts it."""
    number = triangle + 1
    slot = int((wp.uint32(number) * GOLDEN) >> wp.uint32(21))  # Fibonacci hashing
    while table[slot] != 0 and table[slot] != number:
        slot = (slot + 1) & (SLOTS - 1)
    is_first = table[slot] == 0
    table[slot] = number
    return is_first


@wp.func
def gather(lists: LeafLists, boxes: Boxes, cells: Cells, at: int, references: wp.array(dtype=float)):
    """Writes the references of the triangles below a node, each once, clipped to its cell; returns their number."""
    table = wp.zeros(shape=(SLOTS,), dtype=int)
    low = cells.low[at]
    high = cells.high[at]
    first = cells.references[at][0]
    listed = cells.references[at][1]
    several = kdtree.split_axis(lists.nodes[at]) != LEAF  # a leaf lists each triangle once, and may have any number
    count = int(0)
    below = int(at)
    while listed > 0:
        if kdtree.split_axis(lists.nodes[below]) == LEAF:
            triangles = kdtree.leaf_triangles(lists.nodes[below])
            for i in range(triangles):
                triangle = lists.primitive[kdtree.first_block(lists.nodes[below]) * lists.width + i]
                is_first = triangle >= 0
                if several and is_first:
                    is_first = is_new(table, triangle)
                if is_first:
                    write_clipped(boxes, triangle, low, high, references, first + count)
                    count += 1
            listed -= triangles
        below += 1
    return count


build_subtree = make_build_subtree(SURFACE)


@exact_kernel
def divide_lists(
    first: int,
    lists: LeafLists,
    boxes: Boxes,
    cells: Cells,
    rules: BuildRules,
    memory: SubtreeMemory,
    stack: wp.array2d(dtype=Frame),
    tree: BinaryTree,
    subtrees: wp.array(dtype=wp.vec2i),
):
    """Item: a run of nodes that are kept whole, which has a slot of the memory; its buffers hold the references of all leaves.
    The other arguments are those of `wrt.builders.bvh.phases.bvh_subtrees`."""
    run = first + wp.tid()
    for number in range(run * LISTS_PER_ITEM, wp.min((run + 1) * LISTS_PER_ITEM, subtrees.shape[0])):
        at = cells.whole[number]
        task = Frame()
        task.node = cells.position[at]
        task.first = cells.references[at][0]
        task.count = gather(lists, boxes, cells, at, memory.references)
        range_box(memory.references, task.first, task.count, tree.box, task.node)
        end = build_subtree(rules, AllDirections(), memory, stack, run, task, tree)
        subtrees[number] = wp.vec2i(task.first + 1, end)


@exact_kernel
def join_boxes(first: int, cells: Cells, tree: BinaryTree):
    """One item. Computes the boxes of inner nodes, children before parents."""
    for i in range(cells.totals[0]):
        at = cells.totals[0] - 1 - i
        for component in range(8):
            left = tree.box[cells.pairs[at] * 16 + component]
            right = tree.box[cells.pairs[at] * 16 + 8 + component]
            tree.box[cells.split_nodes[at] * 8 + component] = wp.min(left, right)


def to_wide_bvh(tree: KdTree, triangles: TriangleBoxes, config: BvhConfig, undivided_blocks: int = MAX_UNDIVIDED_BLOCKS) -> Bvh:
    """Converts a tree to nodes of `config.cost.width` children, on the CPU. Tree and triangles must be on the CPU too.

    Args:
        tree: a finished tree with nodes in depth-first order.
        triangles: the triangles of the tree.
        config: cost of nodes and blocks.
        undivided_blocks: a node with at most as many references as fit into this number of blocks is divided by its triangles'
            boxes, not by its planes; 0: the tree is converted down to its leaves.

    Raises:
        ValueError: `undivided_blocks` is out of its range, or there would be more than
            `wrt.kernels.layout.bvh_nodes.MAX_BLOCKS` blocks.
    """
    device, nodes, max_blocks = tree.nodes.device, tree.nodes, int(SLOTS) // 2 // config.cost.width
    if not 0 <= undivided_blocks <= max_blocks:
        raise ValueError(
            f"undivided_blocks is {undivided_blocks}; it must be from 0 to {max_blocks}, at most {max_blocks} blocks of "
            f"{config.cost.width}"
        )
    phase = Phases(device)
    with phase("place"):
        cells = _empty_cells(tree)
        launch(count_references, 1, [nodes, cells], device=device)
        count = int(cells.references[:1].numpy()[0, 1])
        binary = empty_tree(max(count, 1), device)
        if count == 0:  # the root is a leaf
            for array in (binary.pair, binary.range, binary.box):
                array.zero_()
        else:
            write_root(binary, triangles)
        launch(place_nodes, 1, [nodes, undivided_blocks * config.cost.width, cells, binary], device=device)
        split_nodes, whole = cells.totals.numpy().tolist()
    with phase("divide"):
        runs = -(-whole // LISTS_PER_ITEM)
        references = wp.empty(16 * max(count, 1), dtype=float, device=device)  # two buffers
        subtrees = wp.empty(whole, dtype=wp.vec2i, device=device)
        lists = LeafLists()
        lists.nodes, lists.primitive, lists.width = nodes, tree.primitive, tree.width
        domain = wp.empty(8 * STACK * runs, dtype=float, device=device)
        stack = wp.empty((runs, STACK), dtype=Frame, device=device)
        memory = subtree_memory(references, count, make_scratch(runs, device), domain)
        work = [config.struct(), memory, stack, binary, subtrees]
        launch(divide_lists, runs, [lists, triangles.boxes, cells, *work], device=device, chunk=1)
        launch(join_boxes, 1, [cells, binary], device=device)
    with phase("collapse"):
        top = cells.pairs[:split_nodes] if split_nodes else None
        return collapse(BinaryBuild(binary, subtrees, top, references), triangles, config, phase.stats)


def write_root(binary: BinaryTree, triangles: TriangleBoxes) -> None:
    """Writes the root's box, on which the division of nodes below depends (`wrt.builders.bvh.phases.large_boxes`)."""
    root = np.zeros(8, dtype=np.float32)
    root[0:3], root[4:7] = triangles.low, -triangles.high
    binary.box[:8].assign(root)


def _empty_cells(tree: KdTree) -> Cells:
    """Allocates the data of the nodes, and sets the root's cell and position."""
    device, count = tree.nodes.device, len(tree.nodes)
    cells = Cells()
    cells.low, cells.high = (wp.empty(count, dtype=wp.vec3, device=device) for _ in range(2))
    cells.low[:1].fill_(tree.low)
    cells.high[:1].fill_(tree.high)
    cells.references = wp.empty(count, dtype=wp.vec2i, device=device)
    cells.position = wp.zeros(count, dtype=int, device=device)
    cells.split_nodes, cells.pairs, cells.whole = (wp.empty(count, dtype=int, device=device) for _ in range(3))
    cells.totals = wp.zeros(2, dtype=int, device=device)
    return cells
