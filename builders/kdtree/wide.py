"""A kd-tree in nodes of W children: its cells in the layout of a wide BVH (`wrt.kernels.bvh`), for rays that part company.

**Problem.** A step through a kd-tree is one comparison for a load from memory, and random rays take fifty of them. What makes
a wide BVH quick, W boxes a load and no stack of planes, does not depend on boxes being drawn round triangles.

**Idea.** A cell of a kd-tree is a box. A wide node holds up to W cells that cover those of an inner node, so that a ray is
tested against all of them at once; sorted by entry they are in the order in which the ray passes them, since cells do not
overlap. Popov et al. (2009) asked what bounding volume hierarchies gain if space is divided and not the set of triangles;
Ernst and Greiner (2007) and Stich et al. (2009) let triangles be in several boxes, each clipped to its part of space. Here
the division is finished already, and all that is left to do is to gather it.

**Phases**
1. count: references and blocks of the leaves below every node, from the leaves up;
2. place: cells, and the place of every node in a binary tree (`wrt.builders.bvh.tree`), from the root down. Empty cells have
   none, their siblings take the place of their parents: a ray that meets only empty cells of a node is done with it;
3. fill: every leaf's list is halved along the longest side of its box until halves fit a block. Halves and blocks get the boxes
   of what is in them, clipped to the cell;
4. join: the boxes of inner nodes, from the leaves up;
5. collapse to nodes of W children (`wrt.builders.bvh.collapse`).

**Why hits stay the same to the bit.** A hit lies in the interval of its ray in some cell whose leaf lists the triangle
(`wrt.kernels.traversal.single`), and in that of the triangle's box. So its t is at least the entry into either and at most
the leave, and the entry into their intersection is the larger of the two, computed from the same planes by the same formula;
likewise for the boxes above, which only widen it. No hit lies before the entry of the boxes around it: the consistency rule
(`wrt.kernels.boxes`).

**Complexity.** O(n log n) in the references of the largest leaf, O(n) in all others and in nodes. Nodes are walked by one thread,
as there is one to some ten triangles; lists and subtrees by all.

**Limits.** A triangle in several leaves is in several blocks, and tested again for each that a ray meets. Lists and triangle
records are held beside those of the tree. Finished trees only: what a lazy one adds would have to find its place.

References:
    M. Ernst, G. Greiner: Early split clipping for bounding volume hierarchies. IEEE/EG Symposium on Interactive Ray Tracing
        2007.
    S. Popov, I. Georgiev, R. Dimov, P. Slusallek: Object partitioning considered harmful: space subdivision for BVHs.
        High Performance Graphics 2009.
    M. Stich, H. Friedrich, A. Dietrich: Spatial splits in bounding volume hierarchies. High Performance Graphics 2009.
    C. A. R. Hoare: Algorithm 65: FIND. Communications of the ACM 4(7), 1961.
"""

import numpy as np
import warp as wp

from wrt.builders.bvh.collapse import BinaryBuild, collapse
from wrt.builders.bvh.config import BvhConfig
from wrt.builders.bvh.tree import LEAF as END
from wrt.builders.bvh.tree import BinaryTree, middle
from wrt.builders.common import Bvh, KdTree, Phases
from wrt.builders.triangles import Boxes, TriangleBoxes
from wrt.kernels import kdtree
from wrt.kernels.kdtree import LEAF
from wrt.kernels.launch import launch

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

GRAIN = 1024
"""Blocks of a subtree that one thread solves by itself in the collapse."""

MOST_HALVINGS = wp.constant(32)
"""Of a leaf's list: it has less than 2^31 triangles."""


@wp.struct
class Cells:
    """What is known of the nodes of a kd-tree, by number."""

    low: wp.array(dtype=wp.vec3)
    """(nodes,) the cell."""
    high: wp.array(dtype=wp.vec3)
    references: wp.array(dtype=wp.vec2i)
    """(nodes,) of the leaves below: the first, and how many."""
    pairs: wp.array(dtype=wp.vec2i)
    """(nodes,) where the pairs below begin, and the blocks below, of which there is one more."""
    place: wp.array(dtype=int)
    """(nodes,) its node of the binary tree; an inner node that has an empty child shares it with the other one."""


@wp.struct
class List:
    """Part of a leaf's list that is to be halved."""

    node: int
    """Of the binary tree."""
    pair: int
    """Where its pairs begin."""
    first: int
    """Its first reference."""
    count: int


@wp.kernel
def count_references(first: int, nodes: wp.array(dtype=wp.vec2i), width: int, cells: Cells):
    """One item: children before parents."""
    for i in range(nodes.shape[0]):
        at = nodes.shape[0] - 1 - i
        node = nodes[at]
        triangles = kdtree.leaf_triangles(node)
        blocks = (triangles + width - 1) / width
        if kdtree.split_axis(node) != LEAF:
            right = kdtree.right_child(node)
            triangles = cells.references[at + 1][1] + cells.references[right][1]
            blocks = cells.pairs[at + 1][1] + cells.pairs[right][1]
        cells.references[at] = wp.vec2i(0, triangles)
        cells.pairs[at] = wp.vec2i(1, blocks)


@wp.func
def move_in(cells: Cells, child: int, place: int, first_pair: int, first_reference: int):
    """Gives a child its place."""
    cells.place[child] = place
    cells.pairs[child] = wp.vec2i(first_pair, cells.pairs[child][1])
    cells.references[child] = wp.vec2i(first_reference, cells.references[child][1])


@wp.kernel
def place_nodes(first: int, nodes: wp.array(dtype=wp.vec2i), cells: Cells, tree: BinaryTree):
    """One item: parents before children. The root has its place, 0, and its cell."""
    for at in range(nodes.shape[0]):
        node = nodes[at]
        axis = kdtree.split_axis(node)
        if axis != LEAF:
            left = at + 1
            right = kdtree.right_child(node)
            low = cells.low[at]
            high = cells.high[at]
            position = wp.clamp(kdtree.split_position(node), low[axis], high[axis])
            cells.low[left] = low
            cells.high[right] = high
            low[axis] = position
            high[axis] = position
            cells.low[right] = low
            cells.high[left] = high
            place = cells.place[at]
            pair = cells.pairs[at][0]
            references = cells.references[at]
            blocks = cells.pairs[left][1]
            if blocks > 0 and cells.pairs[right][1] > 0:
                tree.pair[place] = pair
                tree.range[place] = references
                move_in(cells, left, 2 * pair, pair + 1, references[0])
                move_in(cells, right, 2 * pair + 1, pair + blocks, references[0] + cells.references[left][1])
            else:
                move_in(cells, left, place, pair, references[0])
                move_in(cells, right, place, pair, references[0])


@wp.func
def clip_to_cell(boxes: Boxes, triangle: int, axis: int, low: wp.vec3, high: wp.vec3):
    """The part of a triangle's box along an axis that is in a cell, (low, high)."""
    return wp.vec2(wp.max(boxes.low[axis, triangle], low[axis]), wp.min(boxes.high[axis, triangle], high[axis]))


@wp.func
def middle_of(boxes: Boxes, triangle: int, axis: int, low: wp.vec3, high: wp.vec3):
    """Twice the middle of that."""
    part = clip_to_cell(boxes, triangle, axis, low, high)
    return part[0] + part[1]


@wp.func
def put_lesser_first(
    order: wp.array(dtype=int), first: int, end: int, last: int, boxes: Boxes, axis: int, low: wp.vec3, high: wp.vec3
):
    """Arranges order[first .. end - 1] so that none up to number `last` has its middle behind that of a later one (Hoare 1961)."""
    begin = int(first)
    until = end - 1
    while begin < until:
        pivot = middle_of(boxes, order[last], axis, low, high)
        i = int(begin)
        j = int(until)
        while i <= j:
            while middle_of(boxes, order[i], axis, low, high) < pivot:
                i += 1
            while middle_of(boxes, order[j], axis, low, high) > pivot:
                j -= 1
            if i <= j:
                triangle = order[i]
                order[i] = order[j]
                order[j] = triangle
                i += 1
                j -= 1
        if j < last:
            begin = i
        if i > last:
            until = j


@wp.func
def bound_list(boxes: Boxes, tree: BinaryTree, list: List, low: wp.vec3, high: wp.vec3):
    """Writes the box of a list's node; returns its longest axis."""
    longest = int(0)
    size = float(-1.0)
    for axis in range(3):
        part = clip_to_cell(boxes, tree.order[list.first], axis, low, high)
        for i in range(1, list.count):
            other = clip_to_cell(boxes, tree.order[list.first + i], axis, low, high)
            part = wp.vec2(wp.min(part[0], other[0]), wp.max(part[1], other[1]))
        tree.box[list.node * 8 + axis] = part[0]
        tree.box[list.node * 8 + 4 + axis] = -part[1]
        if part[1] - part[0] > size:
            size = part[1] - part[0]
            longest = axis
    return longest


@wp.kernel
def fill_leaves(
    first: int,
    nodes: wp.array(dtype=wp.vec2i),
    primitive: wp.array(dtype=int),
    list_width: int,
    width_bits: int,
    boxes: Boxes,
    cells: Cells,
    tree: BinaryTree,
):
    """Item: a node of the kd-tree; nothing is done for inner ones and empty leaves. list_width: of the kd-tree's blocks."""
    at = first + wp.tid()
    node = nodes[at]
    if kdtree.split_axis(node) != LEAF or kdtree.leaf_triangles(node) == 0:
        return
    whole = List()
    whole.node = cells.place[at]
    whole.pair = cells.pairs[at][0]
    whole.first = cells.references[at][0]
    whole.count = kdtree.leaf_triangles(node)
    for i in range(whole.count):
        tree.order[whole.first + i] = primitive[kdtree.first_block(node) * list_width + i]
    waiting = wp.zeros(shape=(MOST_HALVINGS,), dtype=List)
    waiting[0] = whole
    size = int(1)
    while size > 0:
        size -= 1
        list = waiting[size]
        axis = bound_list(boxes, tree, list, cells.low[at], cells.high[at])
        tree.range[list.node] = wp.vec2i(list.first, list.count)
        tree.pair[list.node] = END
        if list.count > (1 << width_bits):
            count = middle(list.count, width_bits)
            end = list.first + list.count
            put_lesser_first(tree.order, list.first, end, list.first + count - 1, boxes, axis, cells.low[at], cells.high[at])
            tree.pair[list.node] = list.pair
            half = List()
            half.node = 2 * list.pair + 1
            half.pair = list.pair + (count >> width_bits)  # whole blocks
            half.first = list.first + count
            half.count = list.count - count
            waiting[size] = half
            half.node = 2 * list.pair
            half.pair = list.pair + 1
            half.first = list.first
            half.count = count
            waiting[size + 1] = half
            size += 2


@wp.kernel
def join_boxes(first: int, nodes: wp.array(dtype=wp.vec2i), cells: Cells, tree: BinaryTree):
    """One item: children before parents."""
    for i in range(nodes.shape[0]):
        at = nodes.shape[0] - 1 - i
        if kdtree.split_axis(nodes[at]) != LEAF:
            place = cells.place[at]
            left = cells.place[at + 1]
            if cells.pairs[at][1] > 0 and left != place:
                for component in range(8):
                    both = wp.min(tree.box[left * 8 + component], tree.box[left * 8 + 8 + component])
                    tree.box[place * 8 + component] = both


def wide_form(tree: KdTree, triangles: TriangleBoxes, config: BvhConfig) -> Bvh:
    """The tree in nodes of `config.cost.width` children, on the CPU, where tree and triangles have to be.

    Args:
        tree: nodes in depth-first order, none of which waits to be built.
        triangles: those that it was built over.
        config: what nodes and blocks cost; its `max_leaf_triangles` is the width, as leaves are single blocks here.

    Raises:
        ValueError: there would be more than `wrt.kernels.bvh.MAX_BLOCKS` blocks.
    """
    device, width_bits = tree.nodes.device, config.cost.width.bit_length() - 1
    phases, nodes = Phases(device), tree.nodes
    with phases("place"):
        cells = _empty_cells(tree)
        launch(count_references, 1, [nodes, config.cost.width, cells], device=device)
        references, blocks = (int(counts[:1].numpy()[0, 1]) for counts in (cells.references, cells.pairs))
        binary = _empty_tree(references, blocks, device)
        launch(place_nodes, 1, [nodes, cells, binary], device=device)
    with phases("fill"):
        inputs = [nodes, tree.primitive, tree.width, width_bits, triangles.boxes, cells, binary]
        launch(fill_leaves, len(nodes) if blocks else 0, inputs, device=device, chunk=64)
        launch(join_boxes, 1, [nodes, cells, binary], device=device)
    with phases("collapse"):
        ranges, top = _subtrees(nodes.numpy(), cells.pairs.numpy())
        build = BinaryBuild(
            binary,
            wp.array(ranges, dtype=wp.vec2i, device=device),
            wp.array(top, dtype=int, device=device) if len(top) else None,
            wp.empty(16 * max(blocks, 1), dtype=float, device=device),
        )
        return collapse(build, triangles, config, phases.stats)


def _empty_cells(tree: KdTree) -> Cells:
    """Room for what is known of the nodes; the root's cell and place are."""
    device, count = tree.nodes.device, len(tree.nodes)
    cells = Cells()
    cells.low = wp.empty(count, dtype=wp.vec3, device=device)
    cells.high = wp.empty(count, dtype=wp.vec3, device=device)
    cells.low[:1].fill_(tree.low)
    cells.high[:1].fill_(tree.high)
    cells.references = wp.empty(count, dtype=wp.vec2i, device=device)
    cells.pairs = wp.empty(count, dtype=wp.vec2i, device=device)
    cells.place = wp.zeros(count, dtype=int, device=device)
    return cells


def _empty_tree(references: int, blocks: int, device: wp.Device) -> BinaryTree:
    """Room for the binary tree; its root is a leaf without triangles, for trees that have none."""
    tree = BinaryTree()
    tree.box = wp.zeros(16 * max(blocks, 1), dtype=float, device=device)
    tree.range = wp.zeros(2 * max(blocks, 1), dtype=wp.vec2i, device=device)
    tree.pair = wp.zeros(2 * max(blocks, 1), dtype=int, device=device)
    tree.order = wp.empty(references, dtype=int, device=device)
    return tree


def _subtrees(nodes: np.ndarray, pairs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(subtrees, 2) ranges of the pairs of subtrees of at most `GRAIN` blocks, and of larger leaves; the pairs above them.

    Args:
        nodes: (nodes, 2) the kd-tree's.
        pairs: (nodes, 2) `Cells.pairs`.
    """
    first, blocks = pairs.T
    inner = np.flatnonzero(nodes[:, 1] & 3 != LEAF)
    right = nodes[inner, 1] >> 2
    above = np.full(len(nodes), GRAIN + 1)
    above[inner + 1] = above[right] = blocks[inner]
    is_leaf = np.ones(len(nodes), dtype=bool)
    is_leaf[inner] = False
    own = ((blocks <= GRAIN) | is_leaf) & (above > GRAIN) & (blocks > 1)
    parted = (blocks[inner] > GRAIN) & (blocks[inner + 1] > 0) & (blocks[right] > 0)
    ranges = np.stack([first[own], (first + blocks)[own] - 1], axis=1)
    return ranges.astype(np.int32), first[inner[parted]].astype(np.int32)
