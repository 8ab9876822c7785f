"""Refill: keeps the planes of a kd-tree and rebuilds the lists of its leaves for triangles that have moved.

A kd-tree cannot be refitted: planes divide space, and a triangle that crosses one changes sides. But the planes may stay. Every
triangle's box is sent down the tree again, and listed in each leaf that it reaches. This is one traversal per triangle without
a search for planes. The tree is correct for any motion. Boxes that straddle many planes make long lists, so the caller limits
their length.

A triangle in a plane goes to the right of it. A plane may come to lie outside the box of all triangles, or two may coincide.
Rays meet widened cells (`wrt.kernels.simd.boxes`), so cells without interior lose nothing.

References: yang-2008 (trees are deformed until a heuristic requests a rebuild).
"""

from dataclasses import replace
from time import perf_counter

import numpy as np
import warp as wp

from wrt.builders.cost import SurfaceAreaCost
from wrt.builders.kdtree.kdtree_statistics import UnpackedKdTree, half_area
from wrt.builders.tree import BuildStats, KdTree
from wrt.builders.triangle_boxes import Boxes, TriangleBoxes
from wrt.kernels.layout import kdtree_nodes as kdtree
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import exact_kernel

STACK = kdtree.MAX_TREE_DEPTH + 1


@exact_kernel
def find_leaves(
    first: int,
    nodes: wp.array(dtype=wp.vec2i),
    boxes: Boxes,
    offsets: wp.array(dtype=int),
    counts: wp.array(dtype=int),
    leaves: wp.array(dtype=int),
):
    """Item: a triangle. Counts the leaves that its box reaches and, if there are `offsets`, lists them."""
    i = first + wp.tid()
    stack = wp.zeros(shape=(STACK,), dtype=int)
    waiting = int(1)
    count = int(0)
    while waiting > 0:
        waiting -= 1
        index = stack[waiting]
        node = nodes[index]
        axis = kdtree.split_axis(node)
        if axis == kdtree.LEAF:
            if offsets.shape[0] > 0:
                leaves[offsets[i] + count] = index
            count += 1
        else:
            position = kdtree.split_position(node)
            if boxes.high[axis, i] > position or boxes.low[axis, i] >= position:
                stack[waiting] = kdtree.right_child(node)
                waiting += 1
            if boxes.low[axis, i] < position:
                stack[waiting] = index + 1
                waiting += 1
    if offsets.shape[0] == 0:
        counts[i] = count


def refill(tree: KdTree, triangles: TriangleBoxes, shift: np.ndarray, max_references: int) -> KdTree | None:
    """The same planes with moved triangles in the leaves, depth first; None if this needs more references than allowed.

    Args:
        tree: a tree over the same number of triangles, on the CPU; not modified.
        triangles: boxes of the moved triangles.
        shift: (3,) float64 translation of the planes.
        max_references: most entries of all leaf lists together.
    """
    start, device, none = perf_counter(), tree.nodes.device, wp.empty(0, dtype=int, device=tree.nodes.device)
    words = tree.nodes.numpy().copy()
    axis = words[:, 1] & 3
    inner, leaf = np.flatnonzero(axis != kdtree.LEAF), np.flatnonzero(axis == kdtree.LEAF)
    positions = words[inner, 0].view(np.float32) + shift[axis[inner]]
    words[inner, 0] = positions.astype(np.float32).view(np.int32)
    nodes = wp.array(words, dtype=wp.vec2i, device=device)
    counts = wp.empty(triangles.count, dtype=int, device=device)
    launch(find_leaves, triangles.count, [nodes, triangles.boxes, none, counts, none], device=device, chunk=1024)
    offsets = np.cumsum(counts.numpy(), dtype=np.int64)
    if offsets[-1] > max_references:
        return None
    found = wp.empty(int(offsets[-1]), dtype=int, device=device)
    offsets = wp.array((offsets - counts.numpy()).astype(np.int32), dtype=int, device=device)
    launch(find_leaves, triangles.count, [nodes, triangles.boxes, offsets, counts, found], device=device, chunk=1024)
    sizes, primitive = fill_leaves(found.numpy(), counts.numpy(), len(words), tree.width)
    blocks = -(-sizes // tree.width)
    words[leaf, 0], words[leaf, 1] = (np.cumsum(blocks) - blocks)[leaf], sizes[leaf] << 2 | kdtree.LEAF
    stats = BuildStats({"refill": perf_counter() - start})
    moved = wp.array(words, dtype=wp.vec2i, device=device), wp.array(primitive, dtype=int, device=device)
    stats.reserve(*moved, found, counts, offsets)
    low, high = (wp.vec3(*map(float, corner)) for corner in (triangles.low, triangles.high))
    plain = {"layout": "depth_first", "pairs": None}  # a copy in another order would hold the old leaves
    return replace(tree, nodes=moved[0], primitive=moved[1], low=low, high=high, stats=stats, **plain)


def fill_leaves(leaves: np.ndarray, counts: np.ndarray, nodes: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Number of triangles of each node, 0 for inner nodes, and all lists, padded to whole blocks.

    Args:
        leaves: leaves of triangle 0, then those of triangle 1 and so on.
        counts: (triangles,) number of leaves of each triangle.
        nodes: number of nodes of the tree.
        width: triangles per block.
    """
    order = np.argsort(leaves, kind="stable")
    sizes = np.bincount(leaves, minlength=nodes)
    room = -(-sizes // width) * width
    slots = np.repeat(np.cumsum(room) - room - (np.cumsum(sizes) - sizes), sizes) + np.arange(len(leaves))
    primitive = np.full(int(room.sum()), -1, dtype=np.int32)
    primitive[slots] = np.repeat(np.arange(len(counts), dtype=np.int32), counts)[order]
    return sizes, primitive


def node_costs(flat: UnpackedKdTree, cost: SurfaceAreaCost) -> np.ndarray:
    """(nodes,) expected cost of a ray below a node whose cell it meets; the root's is the tree's SAH cost."""
    costs = np.where(flat.is_leaf, cost.of_leaf(flat.triangles), cost.traversal).astype(np.float64)
    left, right = child_probabilities(flat)
    order = np.argsort(flat.depth, kind="stable")
    ends = np.cumsum(np.bincount(flat.depth))
    for level in reversed(np.split(order, ends[:-1])):
        inner = level[~flat.is_leaf[level]]
        costs[inner] += left[inner] * costs[flat.left[inner]] + right[inner] * costs[flat.right[inner]]
    return costs


def child_probabilities(flat: UnpackedKdTree) -> tuple[np.ndarray, np.ndarray]:
    """Probabilities, for each node, that a ray through its cell meets the left and the right child's cell."""
    area = half_area(flat.low, flat.high)
    safe = np.where(area > 0.0, area, 1.0)
    return tuple(np.where(flat.is_leaf, 0.0, area[child] / safe) for child in (flat.left, flat.right))
