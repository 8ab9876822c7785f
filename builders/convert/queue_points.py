"""Cutting a wide BVH into an upper tree and subtrees that fit a cache.

A child is a **queue point** if its subtree, nodes and triangle records together, is no larger than the cache, but that of its
parent is; or if it is a leaf above all such subtrees. A tree that fits as a whole has one queue point, its root. The upper tree
has the nodes above the queue points, and each queue point as a leaf. Leaves hold at most 63 triangles, so none exceeds a cache.

The bytes of subtrees are summed level by level from the deepest: O(nodes), vectorised, once per tree.

References: navratil-2007.
"""

from dataclasses import dataclass

import numpy as np

from wrt.builders.tree import Bvh
from wrt.kernels.layout.bvh_nodes import EMPTY_LANE


@dataclass(frozen=True)
class QueuePoints:
    """The cut through a tree.

    Attributes:
        bounds: (nodes * 6 * width,) float32, boxes of the upper tree (`wrt.kernels.layout.bvh_nodes`).
        child: (nodes * width,) int32 child words of the upper tree; a leaf has the number of its queue point in the place of
            its first block.
        roots: (points,) int32 child word of each queue point in the tree.
        bytes: (points,) int64, bytes of each subtree.
        depth: largest number of inner nodes on a path of the upper tree.
    """

    bounds: np.ndarray
    child: np.ndarray
    roots: np.ndarray
    bytes: np.ndarray
    depth: int


def find_queue_points(tree: Bvh, block_bytes: int, cache_bytes: int, max_points: int) -> QueuePoints:
    """The cut for a cache of a size; for a larger one, if there would be more than `max_points` queue points.

    Args:
        tree: the tree, on the CPU.
        block_bytes: bytes of the triangle records of a block.
        cache_bytes: of the cache.
        max_points: greatest number of queue points.
    """
    width = tree.width
    child, sizes = tree.child.numpy().reshape(-1, width), child_bytes(tree, block_bytes)
    total = node_bytes(width) + int(sizes[0].sum())
    if total <= cache_bytes:
        return whole_tree(tree, total)
    while True:
        is_upper = np.zeros(len(child), dtype=bool)
        is_upper[0] = True
        inner = child[(child >= 0) & (sizes > cache_bytes)]
        is_upper[inner] = True
        nodes = np.flatnonzero(is_upper)
        points = (sizes[nodes] > 0) & ~((child[nodes] >= 0) & (sizes[nodes] > cache_bytes))
        if points.sum() <= max_points:
            break
        cache_bytes *= 2
    words = child[nodes]
    place = np.cumsum(is_upper) - 1
    upper = np.where(words >= 0, place[np.maximum(words, 0)], words).astype(np.int32)
    upper[points] = ~(np.arange(points.sum(), dtype=np.int32) << 6 | 1)
    bounds = tree.bounds.numpy().reshape(len(child), -1)[nodes].reshape(-1)
    depth = int(np.searchsorted(tree.level_first, nodes[-1], side="right"))
    return QueuePoints(bounds, upper.reshape(-1), words[points], sizes[nodes][points], depth)


def whole_tree(tree: Bvh, size: int) -> QueuePoints:
    """The cut above the root of a tree that fits: an upper tree of one node, whose only child is the tree."""
    box = np.full((6, tree.width), np.inf, dtype=np.float32)  # unused lanes have an empty box
    box[3:] = -np.inf
    box[:, 0] = [*tree.low, *tree.high]
    child = np.full(tree.width, EMPTY_LANE, dtype=np.int32)
    child[0] = ~1
    return QueuePoints(box.reshape(-1), child, np.zeros(1, dtype=np.int32), np.array([size]), 1)


def node_bytes(width: int) -> int:
    """Bytes of a node: six bounds and a word for each child."""
    return 7 * 4 * width


def child_bytes(tree: Bvh, block_bytes: int) -> np.ndarray:
    """(nodes, width) int64: bytes of the subtree of each child; 0 for an unused lane."""
    width = tree.width
    child = tree.child.numpy().reshape(-1, width)
    triangles = np.where(child < 0, ~child & 63, 0)
    sizes = -(-triangles // width) * np.int64(block_bytes)
    for begin, end in reversed(list(zip(tree.level_first[:-1], tree.level_first[1:], strict=True))):
        words = child[begin:end]
        inner = words >= 0
        sizes[begin:end][inner] = node_bytes(width) + sizes[words[inner]].sum(axis=1)
    return sizes
