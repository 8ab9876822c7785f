"""From a binary tree to nodes of W children, in the layout of `wrt.kernels.bvh`.

**Algorithm.** A wide node takes the place of a binary one: of the nodes it holds, the one with the greatest surface area is
opened, until it holds W (Wald, Benthin, Boulos 2008). Wide nodes are made level by level, in parallel:

    open    every node picks its children, and counts its inner ones and the blocks of its leaves
    scan    the counts of the nodes before it tell each node where its children and blocks begin
    fill    the next level's nodes are listed

When all levels are known, one launch writes boxes, child words and leaf blocks.

References:
    I. Wald, C. Benthin, S. Boulos: Getting rid of packets: efficient SIMD single-ray traversal using multi-branching BVHs.
        IEEE Symposium on Interactive Ray Tracing 2008.
"""

import warp as wp

from wrt.builders.bvh.config import BvhConfig
from wrt.builders.bvh.tree import LEAF, BinaryTree, half_area
from wrt.builders.common import BuildStats, Bvh
from wrt.builders.triangles import TriangleBoxes
from wrt.kernels.boxes import INFINITY
from wrt.kernels.bvh import EMPTY_LANE, MAX_BLOCKS, leaf_child
from wrt.kernels.launch import launch

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

MAX_WIDTH = 16

NO_NODE = wp.constant(-1)
"""Binary node of an unused lane."""


@wp.struct
class WideLevels:
    """The wide nodes as they are found, in breadth-first order."""

    source: wp.array(dtype=int)
    """(nodes,) the binary node that each stands for."""
    pick: wp.array2d(dtype=int)
    """(nodes, W) the binary nodes of its children; NO_NODE."""
    first: wp.array(dtype=wp.vec2i)
    """(nodes,) its first inner child and its first block; before the scan, how many it has of each."""


@wp.kernel
def open_nodes(first: int, level_first: int, tree: BinaryTree, width_bits: int, wide: WideLevels):
    """Item: a node of the level."""
    index = level_first + first + wp.tid()
    width = 1 << width_bits
    area = wp.zeros(shape=(MAX_WIDTH,), dtype=float)
    row = wide.pick[index]
    row[0] = wide.source[index]
    area[0] = 0.0
    held = int(1)
    target = int(0)
    if tree.pair[row[0]] == LEAF:
        target = int(-1)
    while target >= 0 and held < width:
        pair = tree.pair[row[target]]
        row[target] = 2 * pair
        row[held] = 2 * pair + 1
        for side in range(2):
            node = 2 * pair + side
            lane = wp.where(side == 0, target, held)
            area[lane] = wp.where(tree.pair[node] == LEAF, -1.0, half_area(tree.box, node))
        held += 1
        target = int(-1)
        best = float(-1.0)
        for lane in range(held):
            if area[lane] > best:
                best = area[lane]
                target = lane
    counts = wp.vec2i(0, 0)
    for lane in range(width):
        if lane >= held:
            row[lane] = NO_NODE
        elif tree.pair[row[lane]] == LEAF:
            counts[1] += (tree.range[row[lane]][1] + width - 1) >> width_bits
        else:
            counts[0] += 1
    wide.first[index] = counts


@wp.kernel
def scan_level(first: int, level_first: int, level_end: int, wide: WideLevels, totals: wp.array(dtype=int)):
    """One item. totals: (2,) wide nodes and blocks so far."""
    nodes = totals[0]
    blocks = totals[1]
    for index in range(level_first, level_end):
        counts = wide.first[index]
        wide.first[index] = wp.vec2i(nodes, blocks)
        nodes += counts[0]
        blocks += counts[1]
    totals[0] = nodes
    totals[1] = blocks


@wp.kernel
def list_children(first: int, level_first: int, tree: BinaryTree, width: int, wide: WideLevels):
    """Item: a node of the level."""
    index = level_first + first + wp.tid()
    to = wide.first[index][0]
    for lane in range(width):
        node = wide.pick[index, lane]
        inner = node != NO_NODE
        if inner:
            inner = tree.pair[node] != LEAF
        if inner:
            wide.source[to] = node
            to += 1


@wp.kernel
def write_nodes(
    first: int,
    tree: BinaryTree,
    width_bits: int,
    wide: WideLevels,
    bounds: wp.array(dtype=float),
    child: wp.array(dtype=int),
    primitive: wp.array(dtype=int),
):
    """Item: a wide node."""
    index = first + wp.tid()
    width = 1 << width_bits
    next_child = wide.first[index][0]
    next_block = wide.first[index][1]
    for lane in range(width):
        node = wide.pick[index, lane]
        word = int(EMPTY_LANE)
        if node == NO_NODE:
            for component in range(6):
                bounds[(index * 6 + component) * width + lane] = wp.where(component < 3, INFINITY, -INFINITY)
        else:
            for axis in range(3):
                bounds[(index * 6 + axis) * width + lane] = tree.box[node * 8 + axis]
                bounds[(index * 6 + 3 + axis) * width + lane] = -tree.box[node * 8 + 4 + axis]
            if tree.pair[node] == LEAF:
                order = tree.range[node]
                word = leaf_child(next_block, order[1])
                blocks = (order[1] + width - 1) >> width_bits
                for i in range(blocks << width_bits):
                    triangle = int(-1)
                    if i < order[1]:
                        triangle = tree.order[order[0] + i]
                    primitive[(next_block << width_bits) + i] = triangle
                next_block += blocks
            else:
                word = next_child
                next_child += 1
        child[index * width + lane] = word


def collapse(tree: BinaryTree, triangles: TriangleBoxes, config: BvhConfig, stats: BuildStats) -> Bvh:
    """The wide tree.

    Raises:
        ValueError: it would need more than MAX_BLOCKS blocks.
    """
    device, width = tree.box.device, config.cost.width
    bits = width.bit_length() - 1
    most = triangles.count
    wide = WideLevels()
    wide.source = wp.zeros(most, dtype=int, device=device)
    wide.pick = wp.empty((most, width), dtype=int, device=device)
    wide.first = wp.empty(most, dtype=wp.vec2i, device=device)
    totals = wp.array([1, 0], dtype=int, device=device)
    level_first = [0]
    nodes, blocks = 1, 0
    while level_first[-1] < nodes:
        first, count = level_first[-1], nodes - level_first[-1]
        launch(open_nodes, count, [first, tree, bits, wide], device=device, chunk=64)
        launch(scan_level, 1, [first, nodes, wide, totals], device=device)
        launch(list_children, count, [first, tree, width, wide], device=device, chunk=1024)
        level_first.append(nodes)
        nodes, blocks = totals.numpy().tolist()  # the one round trip of a level
    if blocks > MAX_BLOCKS:
        raise ValueError(f"the tree has {blocks} blocks of {width} triangles; there is room for {MAX_BLOCKS}")
    bounds = wp.empty(nodes * 6 * width, dtype=float, device=device)
    child = wp.empty(nodes * width, dtype=int, device=device)
    primitive = wp.empty(blocks * width, dtype=int, device=device)
    launch(write_nodes, nodes, [tree, bits, wide, bounds, child, primitive], device=device, chunk=64)
    low, high = wp.vec3(*map(float, triangles.low)), wp.vec3(*map(float, triangles.high))
    return Bvh(bounds, child, primitive, low, high, width, tuple(level_first), stats)
