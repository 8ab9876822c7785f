"""Subtrees of a wide BVH built again, in place of the old ones.

Nodes are in breadth-first order (`wrt.kernels.bvh`), level by level: the nodes of all trees go into one pool, the lanes that
led to the old subtrees lead to the new ones, and what can be reached from the root is numbered again.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import warp as wp

from wrt.builders.common import BuildStats, Bvh
from wrt.builders.leaf_blocks import gather_blocks
from wrt.builders.triangles import TriangleBoxes, boxes_of
from wrt.kernels.bvh import EMPTY_LANE

Build = Callable[[TriangleBoxes], Bvh]


def subtree_triangles(tree: Bvh, node: int) -> np.ndarray:
    """Ids of the triangles below a node, in order."""
    child, primitive, found = tree.child.numpy().reshape(-1, tree.width), tree.primitive.numpy(), []
    level = np.array([node])
    while len(level):
        words = child[level].ravel()
        leaves = words[(words < 0) & (words != EMPTY_LANE)]
        blocks = -(-(~leaves & 63) // tree.width)
        found.append(gather_blocks(primitive, tree.width, ~leaves >> 6, blocks)[0])
        level = words[words >= 0]
    ids = np.concatenate(found)
    return np.sort(ids[ids >= 0])


def build_subtree(ids: np.ndarray, low: np.ndarray, high: np.ndarray, build: Build) -> Bvh:
    """A tree of its own for the triangles `ids`; low, high: (T, 3) float32 boxes of all triangles."""
    tree = build(boxes_of(low[ids], high[ids]))
    lists = tree.primitive.numpy()
    numbers = np.where(lists >= 0, ids[lists], -1).astype(np.int32)
    return replace(tree, primitive=wp.array(numbers, dtype=int, device=tree.primitive.device))


def graft(tree: Bvh, subtrees: Mapping[int, Bvh]) -> tuple[Bvh, np.ndarray]:
    """The tree with others in place of some of its nodes, none of which is the root or below another.

    Returns:
        The tree, and for each of its nodes which of the old ones it is, -1 for one of a new subtree.
    """
    width, trees = tree.width, [tree, *subtrees.values()]
    sizes = [other.level_first[-1] for other in trees]
    pools, node_base, block_base = [], 0, 0
    for other, size in zip(trees, sizes, strict=True):
        words = other.child.numpy().reshape(-1, width)[:size]
        is_leaf = (words < 0) & (words != EMPTY_LANE)
        pools.append(np.where(words >= 0, words + node_base, np.where(is_leaf, words - (block_base << 6), words)))
        node_base, block_base = node_base + size, block_base + len(other.primitive) // width
    child = np.concatenate(pools)
    bounds = np.concatenate([t.bounds.numpy().reshape(-1, 6 * width)[:size] for t, size in zip(trees, sizes, strict=True)])
    leads_to = np.arange(len(child))
    leads_to[list(subtrees)] = np.cumsum(sizes)[:-1]
    child = np.where(child >= 0, leads_to[np.maximum(child, 0)], child)
    order, level_first = breadth_first(child)
    number = np.empty(len(child), dtype=np.int64)
    number[order] = np.arange(len(order))
    words = child[order]
    words = np.where(words >= 0, number[np.maximum(words, 0)], words)
    leaf = (words < 0) & (words != EMPTY_LANE)
    packed = ~words[leaf]
    lists = np.concatenate([other.primitive.numpy() for other in trees])
    primitive, first = gather_blocks(lists, width, packed >> 6, -(-(packed & 63) // width))
    words[leaf] = ~(first << 6 | packed & 63)
    device = tree.bounds.device
    arrays = bounds[order].ravel(), words.ravel().astype(np.int32), primitive
    made = [wp.array(values, dtype=kind, device=device) for values, kind in zip(arrays, (float, int, int), strict=True)]
    stats = BuildStats(dict(tree.stats.seconds))
    stats.reserve(*made)
    source = np.where(order < sizes[0], order, -1)
    return Bvh(*made, tree.low, tree.high, width, level_first, stats), source


def breadth_first(child: np.ndarray) -> tuple[np.ndarray, tuple[int, ...]]:
    """The nodes that can be reached from node 0, level by level, and the first of each level; child: (nodes, W) words."""
    levels, first = [np.zeros(1, dtype=np.int64)], [0, 1]
    while len(below := child[levels[-1]][child[levels[-1]] >= 0]):
        levels.append(below)
        first.append(first[-1] + len(below))
    return np.concatenate(levels), tuple(first)
