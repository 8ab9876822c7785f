"""Phase "layout" of the build by clusters: the nodes of a merged tree in the order of other trees.

From a node, a walk to the root tells its depth, the triangles before it and the inner nodes before it, parents first. That is
its place in a binary tree of pairs (`wrt.builders.bvh.phases.binary_tree`), for the collapse. Where nodes have two children
and leaves at most two triangles, no collapse is needed: nodes in that order, sorted by their depth, are in the order of the
wide tree. It is the tree that the collapse would make.
"""

from typing import Any

import numpy as np
import warp as wp

from wrt.builders.bvh.bvh_config import BuildRules, BvhConfig
from wrt.builders.bvh.phases.binary_build import BinaryBuild
from wrt.builders.bvh.phases.binary_tree import LEAF, BinaryTree, empty_tree, half_area
from wrt.builders.bvh.phases.cluster_merging import CHUNK, MergedTree, children_of
from wrt.builders.bvh.phases.large_boxes import is_flat
from wrt.builders.cost import leaf_cost
from wrt.builders.tree import BuildStats, Bvh
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.kernels.layout.bvh_nodes import MAX_WIDE_DEPTH, check_blocks, leaf_child
from wrt.kernels.layout.unchecked import load_float, store_float
from wrt.kernels.runtime.launch import get_num_threads, launch
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.runtime.workspace import HostNumbers, Workspace, part_of

DEEPEST = wp.constant(126)
"""Depth that stands for itself and all greater ones."""

NO_NODE = wp.constant(127)
"""Depth that stands for a node which is a leaf of two triangles."""

DEPTH_BITS = 7

TASKS_PER_THREAD = 4
"""Subtrees per thread of the collapse."""


@wp.struct
class Place:
    """Where a node is in the tree."""

    depth: int
    triangles: int
    """Triangles before its own."""
    nodes: int
    """Inner nodes before it, parents before children, the left one before the right one."""


@wp.func
def place_of(tree: MergedTree, count: int, inner: int):
    """The place of an inner node, of number count + inner."""
    place = Place()
    size = tree.size[inner]
    link = tree.parent[count + inner]
    while link >= 0:
        parent = link >> 1
        whole = tree.size[parent]
        if (link & 1) == 1:
            place.triangles += whole - size
            place.nodes += whole - size - 1
        place.nodes += 1
        place.depth += 1
        size = whole
        link = tree.parent[count + parent]
    return place


@exact_kernel
def write_pairs(first: int, count: int, merged: MergedTree, tree: BinaryTree, depths: wp.array(dtype=int)):
    """Item: an inner node, by its number less `count`; 0 is none. Writes its children, and how deep it is."""
    inner = first + wp.tid()
    if inner == 0:
        return
    place = place_of(merged, count, inner)
    depths[place.nodes] = place.depth
    child = children_of(merged.box, count + inner)
    begin = place.triangles
    next_pair = place.nodes + 2
    for side in range(2):
        node = child[side]
        to = 2 * (place.nodes + 1) + side
        for k in range(8):
            if k != 3 and k != 7:
                store_float(tree.box, 8 * to + k, load_float(merged.box, 8 * node + k))
        size = int(1)
        if node < count:
            tree.pair[to] = LEAF
            tree.order[begin] = merged.triangle[node]
        else:
            size = merged.size[node - count]
            tree.pair[to] = next_pair
        tree.range[to] = wp.vec2i(begin, size)
        begin += size
        next_pair += size - 1
    if merged.parent[count + inner] < 0:
        for k in range(8):
            if k != 3 and k != 7:
                store_float(tree.box, k, load_float(merged.box, 8 * (count + inner) + k))
        tree.range[0] = wp.vec2i(0, count)
        tree.pair[0] = 1


def binary_build(triangles: TriangleBoxes, merged: MergedTree) -> tuple[BinaryBuild, int]:
    """The binary tree for the collapse, on the CPU, and its depth."""
    device, count = triangles.boxes.low.device, triangles.count
    tree, depths = empty_tree(count, device), wp.zeros(count, dtype=int, device=device)
    launch(write_pairs, count, [count, merged, tree, depths], device=device, chunk=CHUNK)
    ends = tree.range.numpy()[2 : 2 * count]
    sizes = ends.reshape(-1, 2, 2)[:, :, 1].sum(axis=1)  # of the parents of pairs, which are in order
    large = max(count // (TASKS_PER_THREAD * get_num_threads()), 2)
    top, is_root, begin = np.flatnonzero(sizes > large), np.zeros(len(sizes) + 2, dtype=bool), 0
    children = tree.pair.numpy()[2 : 2 * count].reshape(-1, 2)[top] - 1
    is_root[np.where(children >= 0, children, len(sizes))] = True
    roots = np.flatnonzero(is_root[: len(sizes)] & (sizes <= large)) if len(top) else np.array([begin])
    ranges = np.stack([roots + 1, roots + sizes[roots]], axis=1).astype(np.int32)
    above = wp.array((top + 1).astype(np.int32), dtype=int, device=device) if len(top) else None
    subtrees = wp.array(ranges, dtype=wp.vec2i, device=device)
    return BinaryBuild(tree, subtrees, above, wp.empty(16 * count, dtype=float, device=device)), int(depths.numpy().max()) + 1


def single_triangle(triangles: TriangleBoxes) -> BinaryBuild:
    """The tree of one triangle."""
    device = triangles.boxes.low.device
    tree = empty_tree(1, device)
    tree.box = wp.array([*triangles.low, 0.0, *-triangles.high, 0.0] * 2, dtype=float, device=device)
    tree.range = wp.array([(0, 1)] * 2, dtype=wp.vec2i, device=device)
    tree.pair.zero_()
    tree.order.zero_()
    return BinaryBuild(tree, wp.array([(1, 1)], dtype=wp.vec2i, device=device), None, wp.empty(16, dtype=float, device=device))


@wp.struct
class OrderedNodes:
    """Inner nodes in the order of the wide tree."""

    depth: wp.array(dtype=int)
    """(2 n,) depths, and room for sorting them."""
    inner: wp.array(dtype=int)
    """(2 n,) numbers of nodes, less n, likewise."""
    rank: wp.array(dtype=int)
    """(n,) place of each node in the order; -1 for a leaf of two triangles."""
    leaves: wp.array(dtype=int)
    """(n,) leaves of a node, by its place."""
    block: wp.array(dtype=int)
    """(n,) first block of a node, by its place."""
    level: wp.array(dtype=int)
    """(128,) first node of each depth, -1 if there is none; in memory of the host."""


@wp.func
def is_large_part(rules: BuildRules, tree: MergedTree, node: int, root_area: float):
    """Whether a triangle's box is flat and large."""
    return is_flat(tree.box, node) and half_area(tree.box, node) > rules.large * root_area


@wp.func
def is_leaf_of_two(rules: BuildRules, tree: MergedTree, count: int, node: int):
    """Whether an inner node becomes a leaf: by what the collapse compares."""
    inner = node - count
    root = tree.root[0]
    if tree.size[inner] != 2 or node == root or rules.max_leaf < 2:
        return False
    child = children_of(tree.box, node)
    root_area = half_area(tree.box, root)
    large = is_large_part(rules, tree, child[0], root_area) or is_large_part(rules, tree, child[1], root_area)
    if large and not is_flat(tree.box, node):
        return False
    area = half_area(tree.box, node)
    one = leaf_cost(rules.cost, 1)
    parts = half_area(tree.box, child[0]) * one + half_area(tree.box, child[1]) * one
    return area * leaf_cost(rules.cost, 2) <= area * rules.cost.traversal + parts


@exact_kernel
def place_nodes(first: int, count: int, rules: BuildRules, tree: MergedTree, nodes: OrderedNodes):
    """Item: an inner node, by its number less `count`; 0 is none. Puts it where it is among all inner nodes."""
    inner = first + wp.tid()
    if inner == 0:
        return
    place = place_of(tree, count, inner)
    depth = wp.min(place.depth, DEEPEST)
    if is_leaf_of_two(rules, tree, count, count + inner):
        depth = NO_NODE
    nodes.depth[place.nodes] = depth
    nodes.inner[place.nodes] = inner
    nodes.rank[inner] = wp.where(depth == NO_NODE, -1, 0)


@exact_kernel
def rank_nodes(first: int, count: int, tree: MergedTree, nodes: OrderedNodes):
    """Item: a place in the order of depths. Ranks its node, counts its leaves, and finds where levels begin."""
    i = first + wp.tid()
    depth = nodes.depth[i]
    if i == 0 or nodes.depth[i - 1] != depth:
        nodes.level[depth] = i
    leaves = int(0)
    if depth != NO_NODE:
        inner = nodes.inner[i]
        nodes.rank[inner] = i
        child = children_of(tree.box, count + inner)
        for side in range(2):
            is_leaf = child[side] < count
            if not is_leaf:  # the sign of a rank is known since nodes were placed
                is_leaf = nodes.rank[child[side] - count] < 0
            if is_leaf:
                leaves += 1
    nodes.leaves[i] = leaves


@exact_kernel
def write_binary(
    first: int,
    count: int,
    tree: MergedTree,
    nodes: OrderedNodes,
    bounds: wp.array(dtype=float),
    child: wp.array(dtype=int),
    primitive: wp.array(dtype=int),
):
    """Item: a node in order. Writes its boxes, its child words and the triangles of its leaves."""
    i = first + wp.tid()
    pair = children_of(tree.box, count + nodes.inner[i])
    block = nodes.block[i]
    for side in range(2):
        node = pair[side]
        for axis in range(3):
            store_float(bounds, 12 * i + 2 * axis + side, load_float(tree.box, 8 * node + axis))
            store_float(bounds, 12 * i + 6 + 2 * axis + side, -load_float(tree.box, 8 * node + 4 + axis))
        word = int(-1)
        if node >= count:
            word = nodes.rank[node - count]
        if word < 0:
            one = node
            other = int(-1)
            if node >= count:
                both = children_of(tree.box, node)
                one = both[0]
                other = both[1]
            primitive[2 * block] = tree.triangle[one]
            second = int(-1)
            if other >= 0:
                second = tree.triangle[other]
            primitive[2 * block + 1] = second
            word = leaf_child(block, wp.where(other >= 0, 2, 1))
            block += 1
        child[2 * i + side] = word


KERNELS = (write_pairs,)
"""One kernel of each module."""


def empty_order(count: int, device: wp.Device) -> OrderedNodes:
    """Allocates the order of the nodes of a number of triangles."""
    nodes = OrderedNodes()
    nodes.depth, nodes.inner = (wp.empty(2 * count, dtype=int, device=device) for _ in range(2))
    nodes.rank, nodes.leaves, nodes.block = (wp.empty(count, dtype=int, device=device) for _ in range(3))
    return nodes


def binary_bvh(
    work: Workspace, triangles: TriangleBoxes, merged: MergedTree, config: BvhConfig, stats: BuildStats
) -> Bvh | None:
    """The tree of nodes with two children and leaves of at most two triangles, of at least two triangles; None if it would be
    too deep.

    Raises:
        ValueError: the tree would have more than MAX_BLOCKS blocks.
    """
    device, count = work.device, triangles.count
    nodes = work.make("order", count, lambda size: empty_order(size, device))
    levels = work.make("levels", 1, lambda _: HostNumbers(NO_NODE + 1, int, device))
    nodes.level = levels.sent
    levels.values.fill(-1)

    def run(kernel: wp.Kernel, items: int, *inputs: object) -> None:
        work.launch(kernel, items, [count, *inputs], chunk=CHUNK)

    run(place_nodes, count, work.make("rules", 1, lambda _: config.struct()), merged, nodes)
    wp.utils.radix_sort_pairs(nodes.depth, nodes.inner, count - 1, 0, DEPTH_BITS)
    run(rank_nodes, count - 1, merged, nodes)
    leaves, block = (part_of(values, 0, count - 1, int) for values in (nodes.leaves, nodes.block))
    wp.utils.array_scan(leaves, block, inclusive=False)
    level = levels.fetch()  # the only round trip to the host
    depth = int(np.count_nonzero(level[:NO_NODE] >= 0))
    if depth > MAX_WIDE_DEPTH:
        return None
    end = int(level[NO_NODE]) if level[NO_NODE] >= 0 else count - 1
    check_blocks(end + 1, 2)
    memory = wp.empty(16 * end + 2, dtype=int, device=device)
    bounds, child = part_of(memory, 0, 12 * end, float), part_of(memory, 48 * end, 2 * end, int)
    primitive = part_of(memory, 56 * end, 2 * (end + 1), int)  # of the 2 `end` children, all that are not nodes are leaves
    run(write_binary, end, merged, nodes, bounds, child, primitive)
    stats.reserve(triangles.boxes.low, triangles.boxes.high, *arrays_of(merged), *arrays_of(nodes), bounds, child, primitive)
    low, high = wp.vec3(*map(float, triangles.low)), wp.vec3(*map(float, triangles.high))
    return Bvh(bounds, child, primitive, low, high, 2, (*level[:depth].tolist(), end), stats)


def arrays_of(struct: Any) -> list[wp.array]:
    """The arrays of a struct."""
    return [value for value in vars(struct).values() if isinstance(value, wp.array)]
