"""A kd-tree in nodes of W children: its cells in the layout of a wide BVH (`wrt.kernels.layout.bvh_nodes`), for rays that part
company.

**Problem.** A step through a kd-tree is a load from memory that brings one comparison, and then the next step is known. What
makes a wide BVH quick, W boxes a load, does not depend on how the boxes came about.

**Idea.** A cell of a kd-tree is a box. A wide node holds up to W cells that cover those of an inner node, so that a ray is
tested against all of them at once; sorted by entry they are in the order in which the ray passes them, since cells do not
overlap. Popov et al. (2009) asked what bounding volume hierarchies gain if space is divided and not the set of triangles;
Ernst and Greiner (2007) and Stich et al. (2009) let triangles be in several boxes, each clipped to its part of space. Here the
division is finished already, and all that is left to do is to gather it.

**Phases**
1. count: references in the leaves below every node, from the leaves up;
2. place: cells, and the place of every node in a binary tree (`wrt.builders.bvh.phases.binary_tree`), from the root down. Empty
   cells have none, their siblings take the place of their parents: a ray that meets only empty cells of a node is done with it;
3. divide: the triangles below a cell of at most `TOGETHER` blocks are listed, each once, and divided as those of a BVH are
   (`wrt.builders.bvh.phases.bvh_subtrees`), by their boxes, clipped to the cell;
4. join: the boxes of inner nodes, from the leaves up;
5. collapse to nodes of W children (`wrt.builders.bvh.phases.collapse`).

**What we changed.** The tree is not followed to its leaves. They suit walks by planes: on average fifty triangles, four blocks
of which a ray would need one, and half as many references again as there are triangles. Where cells are that small, copies
cost more, of memory above all, than boxes that overlap.

**Measured** (one thread of a Zen 5, 1024 x 1024 rays; how many times as fast as the best walk by planes, `lockstep` for random
rays and ambient occlusion, else `packet`; and as packets or streams through the BVH of the same triangles):

               random        ao            shadow        far           near
    bunny      2.4 (0.81)    3.0 (0.95)    1.5 (1.00)    1.3 (0.96)    1.4 (0.93)
    dragon     1.3 (0.76)    2.2 (0.75)    1.7 (1.08)    1.3 (0.93)    1.4 (0.92)
    atrium     1.7 (0.91)    2.0 (0.86)    2.2 (1.00)    1.1 (0.96)    1.2 (1.01)

A random ray of the bunny meets 4 nodes and 1.4 leaves, where `lockstep` takes 18 steps to 4 leaves of 57 triangles. With
`together=0` there are a quarter more references, and random rays are 0.75 to 0.87 times as fast; with 60, some 1.03 times, but
little of the tree is left. The form is made in a tenth of the time that the in-place builder takes for the tree.

**Why hits stay the same to the bit.** A hit lies in the interval of its ray in some cell whose leaf lists the triangle
(`wrt.kernels.traversal.single.single_kdtree`), and in that of the triangle's box. So its t is at least the entry into either
and at most the leave, and the entry into their intersection is the larger of the two, computed from the same planes by the same
formula; likewise for the boxes above, which only widen it. No hit lies before the entry of the boxes around it: the consistency
rule (`wrt.kernels.simd.boxes`).

**Complexity.** Linear in the nodes, which one thread walks: there is one to some ten triangles. Lists are divided by all
threads, in time n log n in the references of a leaf.

**Limits.** A triangle in several leaves is in several blocks, and tested again for each that a ray meets. Lists and triangle
records are held beside those of the tree. Finished trees only: what a lazy one adds would have to find its place.

References:
    M. Ernst, G. Greiner: Early split clipping for bounding volume hierarchies. IEEE/EG Symposium on Interactive Ray Tracing
        2007.
    S. Popov, I. Georgiev, R. Dimov, P. Slusallek: Object partitioning considered harmful: space subdivision for BVHs.
        High Performance Graphics 2009.
    M. Stich, H. Friedrich, A. Dietrich: Spatial splits in bounding volume hierarchies. High Performance Graphics 2009.
"""

import warp as wp

from wrt.builders.bvh.bvh_config import BuildRules, BvhConfig
from wrt.builders.bvh.phases.bin_heuristic import SURFACE, AllDirections
from wrt.builders.bvh.phases.binary_tree import BinaryTree, Frame, empty_tree
from wrt.builders.bvh.phases.bvh_bins import Scratch, make_scratch, range_box
from wrt.builders.bvh.phases.bvh_subtrees import STACK, make_build_subtree
from wrt.builders.bvh.phases.collapse import BinaryBuild, collapse
from wrt.builders.tree import Bvh, KdTree, Phases
from wrt.builders.triangle_boxes import Boxes, TriangleBoxes
from wrt.builders.triangle_references import ID_OFFSET
from wrt.kernels.layout import kdtree_nodes as kdtree
from wrt.kernels.layout.kdtree_nodes import LEAF
from wrt.kernels.runtime.launch import launch

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

TOGETHER = 32
"""Blocks of references up to which a node is not followed further."""

RUN = 32
"""Lists that one thread divides one after the other, in the same work space."""

TOO_MANY = wp.constant(1 << 24)
"""References that no leaf of a wide tree has: what is in two cells is not put together again."""

NOWHERE = wp.constant(-1)
"""Place of a node below one that is not followed further."""

SLOTS = wp.constant(2048)
"""Of a table of triangles, which is never more than half full."""

GOLDEN = wp.constant(wp.uint32(2654435769))
"""2^32 over the golden ratio."""


@wp.struct
class Cells:
    """What is known of the nodes of a kd-tree, by number."""

    low: wp.array(dtype=wp.vec3)
    """(nodes,) the cell."""
    high: wp.array(dtype=wp.vec3)
    references: wp.array(dtype=wp.vec2i)
    """(nodes,) of the leaves below: the first, and how many."""
    place: wp.array(dtype=int)
    """(nodes,) its node of the binary tree; an inner node that has an empty child shares it with the other one."""
    parted: wp.array(dtype=int)
    """(parted,) nodes of the binary tree that have children in two cells, parents before children; room for all nodes."""
    pairs: wp.array(dtype=int)
    """(parted,) their children."""
    whole: wp.array(dtype=int)
    """(whole,) nodes of the kd-tree that are not followed further, and not empty."""
    totals: wp.array(dtype=int)
    """(2,) how many of these there are: parted, whole."""


@wp.kernel
def count_references(first: int, nodes: wp.array(dtype=wp.vec2i), cells: Cells):
    """One item: children before parents."""
    for i in range(nodes.shape[0]):
        at = nodes.shape[0] - 1 - i
        node = nodes[at]
        count = kdtree.leaf_triangles(node)
        if kdtree.split_axis(node) != LEAF:
            count = cells.references[at + 1][1] + cells.references[kdtree.right_child(node)][1]
        cells.references[at] = wp.vec2i(0, count)


@wp.func
def divide_cell(cells: Cells, at: int, node: wp.vec2i):
    """Gives the children of an inner node their cells."""
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
def move_in(cells: Cells, node: int, place: int, first_reference: int):
    """Gives a node its place."""
    cells.place[node] = place
    cells.references[node] = wp.vec2i(first_reference, cells.references[node][1])


@wp.kernel
def place_nodes(first: int, nodes: wp.array(dtype=wp.vec2i), most: int, cells: Cells, tree: BinaryTree):
    """One item: parents before children. The root has its cell and its place, 0. most: references that are left together."""
    parted = int(0)
    whole = int(0)
    for at in range(nodes.shape[0]):
        node = nodes[at]
        place = cells.place[at]
        references = cells.references[at]
        left = at + 1
        right = kdtree.right_child(node)
        is_leaf = kdtree.split_axis(node) == LEAF
        is_whole = place != NOWHERE and (is_leaf or references[1] <= most)
        if is_whole and references[1] > 0:
            cells.whole[whole] = at
            whole += 1
        if (is_whole or place == NOWHERE) and not is_leaf:
            cells.place[left] = NOWHERE
            cells.place[right] = NOWHERE
        elif not is_leaf:
            divide_cell(cells, at, node)
            on_left = cells.references[left][1]
            if on_left > 0 and on_left < references[1]:
                pair = references[0] + on_left
                tree.pair[place] = pair
                tree.range[place] = wp.vec2i(references[0], TOO_MANY)
                cells.parted[parted] = place
                cells.pairs[parted] = pair
                parted += 1
                move_in(cells, left, 2 * pair, references[0])
                move_in(cells, right, 2 * pair + 1, pair)
            else:
                move_in(cells, left, place, references[0])
                move_in(cells, right, place, references[0])
    cells.totals[0] = parted
    cells.totals[1] = whole


@wp.func_native(
    f"""
    const size_t n = boxes.low.shape[1];
    float* to = references.data + (size_t)i * 8;
    for (size_t axis = 0; axis < 3; ++axis) {{
        const float from_low = boxes.low.data[axis * n + triangle], from_high = boxes.high.data[axis * n + triangle];
        to[axis] = from_low > low.c[axis] ? from_low : low.c[axis];
        to[4 + axis] = -(from_high < high.c[axis] ? from_high : high.c[axis]);
    }}
    const int bits = triangle + {ID_OFFSET};
    memcpy(to + 3, &bits, 4);
    to[7] = 0.0f;
"""
)
def write_clipped(boxes: Boxes, triangle: int, low: wp.vec3, high: wp.vec3, references: wp.array(dtype=float), i: int):
    """Reference number i: a triangle's box, clipped to a cell."""
    ...


@wp.func
def is_new(table: wp.array(dtype=int), triangle: int):
    """Whether a triangle is not in the table yet, whose free slots are 0; it is put there."""
    number = triangle + 1
    slot = int((wp.uint32(number) * GOLDEN) >> wp.uint32(21))  # Fibonacci hashing
    while table[slot] != 0 and table[slot] != number:
        slot = (slot + 1) & (SLOTS - 1)
    fresh = table[slot] == 0
    table[slot] = number
    return fresh


@wp.func
def gather(
    nodes: wp.array(dtype=wp.vec2i),
    primitive: wp.array(dtype=int),
    list_width: int,
    boxes: Boxes,
    cells: Cells,
    at: int,
    references: wp.array(dtype=float),
):
    """Writes the references of the triangles below a node, each once, clipped to its cell; how many they are."""
    table = wp.zeros(shape=(SLOTS,), dtype=int)
    low = cells.low[at]
    high = cells.high[at]
    first = cells.references[at][0]
    listed = cells.references[at][1]
    several = kdtree.split_axis(nodes[at]) != LEAF  # a leaf lists each once, and may have any number
    count = int(0)
    below = int(at)
    while listed > 0:
        if kdtree.split_axis(nodes[below]) == LEAF:
            triangles = kdtree.leaf_triangles(nodes[below])
            for i in range(triangles):
                triangle = primitive[kdtree.first_block(nodes[below]) * list_width + i]
                fresh = triangle >= 0
                if several and fresh:
                    fresh = is_new(table, triangle)
                if fresh:
                    write_clipped(boxes, triangle, low, high, references, first + count)
                    count += 1
            listed -= triangles
        below += 1
    return count


build_subtree = make_build_subtree(SURFACE)


@wp.kernel
def divide_lists(
    first: int,
    nodes: wp.array(dtype=wp.vec2i),
    primitive: wp.array(dtype=int),
    list_width: int,
    boxes: Boxes,
    cells: Cells,
    rules: BuildRules,
    references: wp.array(dtype=float),
    triangles: int,
    scratch: Scratch,
    domain: wp.array(dtype=float),
    stack: wp.array2d(dtype=Frame),
    tree: BinaryTree,
    subtrees: wp.array(dtype=wp.vec2i),
):
    """Item: a run of nodes that are not followed further. list_width: of the kd-tree's blocks; triangles: references of all
    leaves; the rest as of `wrt.builders.bvh.phases.bvh_subtrees`, with work space by run."""
    run = first + wp.tid()
    for number in range(run * RUN, wp.min((run + 1) * RUN, subtrees.shape[0])):
        at = cells.whole[number]
        task = Frame()
        task.node = cells.place[at]
        task.first = cells.references[at][0]
        task.count = gather(nodes, primitive, list_width, boxes, cells, at, references)
        range_box(references, task.first, task.count, tree.box, task.node)
        end = build_subtree(rules, AllDirections(), references, triangles, task, run, scratch, domain, stack, tree)
        subtrees[number] = wp.vec2i(task.first + 1, end)


@wp.kernel
def join_boxes(first: int, cells: Cells, tree: BinaryTree):
    """One item: children before parents."""
    for i in range(cells.totals[0]):
        at = cells.totals[0] - 1 - i
        for component in range(8):
            left = tree.box[cells.pairs[at] * 16 + component]
            right = tree.box[cells.pairs[at] * 16 + 8 + component]
            tree.box[cells.parted[at] * 8 + component] = wp.min(left, right)


def wide_form(tree: KdTree, triangles: TriangleBoxes, config: BvhConfig, together: int = TOGETHER) -> Bvh:
    """The tree in nodes of `config.cost.width` children, on the CPU, where tree and triangles have to be.

    Args:
        tree: nodes in depth-first order, none of which waits to be built.
        triangles: those that it was built over.
        config: what nodes and blocks cost.
        together: a node below which there are no more references than in so many blocks is not followed further; 0: down to
            the leaves.

    Raises:
        ValueError: `together` is out of its range, or there would be more than `wrt.kernels.layout.bvh_nodes.MAX_BLOCKS`
            blocks.
    """
    device, nodes, most = tree.nodes.device, tree.nodes, int(SLOTS) // 2 // config.cost.width
    if not 0 <= together <= most:
        raise ValueError(f"together is {together}; it must be from 0 to {most}, at most {most} blocks of {config.cost.width}")
    phase = Phases(device)
    with phase("place"):
        cells = _empty_cells(tree)
        launch(count_references, 1, [nodes, cells], device=device)
        count = int(cells.references[:1].numpy()[0, 1])
        binary = empty_tree(max(count, 1), device)
        if count == 0:  # the root is a leaf
            for array in (binary.pair, binary.range, binary.box):
                array.zero_()
        launch(place_nodes, 1, [nodes, together * config.cost.width, cells, binary], device=device)
        parted, whole = cells.totals.numpy().tolist()
    with phase("divide"):
        runs = -(-whole // RUN)
        references = wp.empty(16 * max(count, 1), dtype=float, device=device)  # two buffers
        scratch, domain = make_scratch(runs, device), wp.empty(8 * STACK * runs, dtype=float, device=device)
        stack = wp.empty((runs, STACK), dtype=Frame, device=device)
        subtrees = wp.empty(whole, dtype=wp.vec2i, device=device)
        lists = [nodes, tree.primitive, tree.width, triangles.boxes, cells]
        work = [config.struct(), references, count, scratch, domain, stack, binary, subtrees]
        launch(divide_lists, runs, [*lists, *work], device=device, chunk=1)
        launch(join_boxes, 1, [cells, binary], device=device)
    with phase("collapse"):
        top = cells.pairs[:parted] if parted else None
        return collapse(BinaryBuild(binary, subtrees, top, references), triangles, config, phase.stats)


def _empty_cells(tree: KdTree) -> Cells:
    """Room for what is known of the nodes; the root's cell and place are."""
    device, count = tree.nodes.device, len(tree.nodes)
    cells = Cells()
    cells.low, cells.high = (wp.empty(count, dtype=wp.vec3, device=device) for _ in range(2))
    cells.low[:1].fill_(tree.low)
    cells.high[:1].fill_(tree.high)
    cells.references = wp.empty(count, dtype=wp.vec2i, device=device)
    cells.place = wp.zeros(count, dtype=int, device=device)
    cells.parted, cells.pairs, cells.whole = (wp.empty(count, dtype=int, device=device) for _ in range(3))
    cells.totals = wp.zeros(2, dtype=int, device=device)
    return cells
