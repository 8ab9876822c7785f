"""Combination of wide BVHs: replacing subtrees, placing several trees below an upper one, and joining trees side by side.

Nodes are in breadth-first order (`wrt.kernels.layout.bvh_nodes`). The nodes of all trees are collected in one pool. Lanes that
led to the old subtrees are redirected to the new ones. Then the nodes that can be reached from the root are renumbered level by
level.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import warp as wp

from wrt.builders.leaf_blocks import gather_blocks
from wrt.builders.rebuild_heuristic import Part
from wrt.builders.tree import BuildStats, Bvh
from wrt.builders.triangle_boxes import TriangleBoxes, boxes_of
from wrt.kernels.layout.bvh_nodes import EMPTY_LANE

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
    """A separate tree for the triangles `ids`. low, high: (T, 3) float32 boxes of all triangles."""
    return with_triangle_ids(build(boxes_of(low[ids], high[ids])), ids)


def replace_subtrees(tree: Bvh, subtrees: Mapping[Part, Bvh]) -> tuple[Bvh, np.ndarray]:
    """Replaces parts of a tree by other trees. No part is the root or below another part.

    Args:
        tree: the tree.
        subtrees: the replacement of each part; a part is a node or some children of one node.

    Returns:
        The new tree, and for each of its nodes the number of the old node that it is, -1 for a node of a replacement.
    """
    sizes, child, bounds, lists = pool_nodes([tree, *subtrees.values()])
    for part in subtrees:
        if len(part) > 1:
            merge_lanes(child[: sizes[0]], bounds, part)
    new_index = np.arange(len(child))
    new_index[[part[0] for part in subtrees]] = np.cumsum(sizes)[:-1]
    child = np.where(child >= 0, new_index[np.maximum(child, 0)], child)
    grafted, order = reachable_tree(child, bounds, lists, tree)
    return grafted, np.where(order < sizes[0], order, -1)


def merge_lanes(child: np.ndarray, bounds: np.ndarray, siblings: Part) -> None:
    """Merges the lanes of some siblings into the lane of the first of them; unused lanes move to the end. Changes both arrays.

    Args:
        child, bounds: (nodes, W) and (nodes, 6 W), as `pool_nodes` returns them.
        siblings: children of one node.
    """
    rows, lanes = np.nonzero(np.isin(child, siblings))
    words, corners = child[rows[0]], bounds[rows[0]].reshape(2, 3, -1)
    corners[0, :, lanes[0]] = corners[0][:, lanes].min(axis=1)
    corners[1, :, lanes[0]] = corners[1][:, lanes].max(axis=1)
    words[lanes[0]] = siblings[0]
    kept = np.delete(np.arange(len(words)), lanes[1:])
    words[: len(kept)], words[len(kept) :] = words[kept], EMPTY_LANE
    corners[..., : len(kept)] = corners[..., kept]
    corners[0, :, len(kept) :], corners[1, :, len(kept) :] = np.inf, -np.inf


def merge_below(top: Bvh, trees: Sequence[Bvh], members: Sequence[np.ndarray]) -> Bvh:
    """Builds one tree from several: each replaces a leaf of an upper tree.

    Args:
        top: tree over the boxes of the trees, one per leaf.
        trees: the trees, in the order in which `top` numbers them.
        members: for each tree, the ids of its triangles 0, 1 and so on.
    """
    named = [with_triangle_ids(tree, own) for tree, own in zip(trees, members, strict=True)]
    sizes, child, bounds, lists = pool_nodes([top, *named])
    roots = np.cumsum(sizes)[:-1]
    upper = child[: sizes[0]]
    leaf = (upper < 0) & (upper != EMPTY_LANE)
    upper[leaf] = roots[top.primitive.numpy()[(~upper[leaf] >> 6) * top.width]]
    return reachable_tree(child, bounds, lists, top)[0]


def with_triangle_ids(tree: Bvh, ids: np.ndarray) -> Bvh:
    """The same tree with triangle i renumbered to ids[i]."""
    lists = tree.primitive.numpy()
    numbers = np.where(lists >= 0, ids[lists], -1).astype(np.int32)
    return replace(tree, primitive=wp.array(numbers, dtype=int, device=tree.primitive.device))


def reachable_tree(child: np.ndarray, bounds: np.ndarray, lists: np.ndarray, like: Bvh) -> tuple[Bvh, np.ndarray]:
    """The tree of the nodes of a pool that can be reached from node 0, and for each of its nodes its number in the pool.

    Args:
        child, bounds, lists: as `pool_nodes` returns them.
        like: a tree with the same root's box, width, device and statistics.
    """
    width, device = like.width, like.bounds.device
    order, level_first = breadth_first(child)
    number = np.empty(len(child), dtype=np.int64)
    number[order] = np.arange(len(order))
    words = child[order]
    words = np.where(words >= 0, number[np.maximum(words, 0)], words)
    leaf = (words < 0) & (words != EMPTY_LANE)
    packed = ~words[leaf]
    primitive, first = gather_blocks(lists, width, packed >> 6, -(-(packed & 63) // width))
    words[leaf] = ~(first << 6 | packed & 63)
    arrays = bounds[order].ravel(), words.ravel().astype(np.int32), primitive
    made = [wp.array(values, dtype=kind, device=device) for values, kind in zip(arrays, (float, int, int), strict=True)]
    stats = BuildStats(dict(like.stats.seconds))
    stats.reserve(*made)
    return Bvh(*made, like.low, like.high, width, level_first, stats), order


def pool_nodes(trees: Sequence[Bvh]) -> tuple[list[int], np.ndarray, np.ndarray, np.ndarray]:
    """Number of nodes of each tree; then, for all trees, (nodes, W) child words with pool indices, boxes and leaf lists."""
    sizes, children, node_base, block_base = [tree.level_first[-1] for tree in trees], [], 0, 0
    for tree, size in zip(trees, sizes, strict=True):
        words = tree.child.numpy().reshape(-1, tree.width)[:size]
        leaf = (words < 0) & (words != EMPTY_LANE)
        children.append(np.where(words >= 0, words + node_base, np.where(leaf, words - (block_base << 6), words)))
        node_base, block_base = node_base + size, block_base + len(tree.primitive) // tree.width
    bounds = [tree.bounds.numpy().reshape(-1, 6 * tree.width)[:size] for tree, size in zip(trees, sizes, strict=True)]
    lists = [tree.primitive.numpy() for tree in trees]
    return sizes, np.concatenate(children), np.concatenate(bounds), np.concatenate(lists)


def join_trees(trees: Sequence[Bvh], members: Sequence[np.ndarray]) -> tuple[Bvh, np.ndarray]:
    """Trees side by side in the same arrays, and the root of each. The result as a whole has no root, box or levels.

    Args:
        trees: trees on one device.
        members: for each tree, the ids of its triangles 0, 1 and so on.
    """
    sizes, child, bounds, lists = pool_nodes([with_triangle_ids(tree, own) for tree, own in zip(trees, members, strict=True)])
    device, stats = trees[0].bounds.device, BuildStats()
    arrays = bounds.ravel(), child.ravel().astype(np.int32), lists
    made = [wp.array(values, dtype=kind, device=device) for values, kind in zip(arrays, (float, int, int), strict=True)]
    return Bvh(*made, wp.vec3(), wp.vec3(), trees[0].width, (0,), stats), np.cumsum(sizes) - sizes


def breadth_first(child: np.ndarray) -> tuple[np.ndarray, tuple[int, ...]]:
    """The nodes that can be reached from node 0, level by level, and the first of each level. child: (nodes, W) words."""
    levels, first = [np.zeros(1, dtype=np.int64)], [0, 1]
    while len(below := child[levels[-1]][child[levels[-1]] >= 0]):
        levels.append(below)
        first.append(first[-1] + len(below))
    return np.concatenate(levels), tuple(first)
