"""Orders of a tree's nodes in memory (survey, section 2.2; Havran 2001).

**Problem.** A step through a large tree waits for the node it goes to. How long depends on what came along with the nodes
before.

**Layouts.** All keep the 8 bytes of a node, with the children of a node side by side (`wrt.kernels.layout.kdtree_nodes`,
pairs), and differ in the order of the pairs:

    random          none: a pair is anywhere, as if each had been allocated by itself
    breadth_first   level after level
    depth_first     the pair of a node's left child follows it, as in the trees that builders make
    subtrees        a line of the cache, 64 bytes, holds the upper part of a subtree: the pair of its root's children, theirs,
                    and so on level by level while there is room, here four pairs; what is below begins lines of its own.
                    Lines are not shared, and not all are full

**What we changed.** Havran's nodes have two pointers, here both children share one, so that a line holds twice as many.

**Measured** by `wrt bench layouts` (one thread of a Zen 5, the dragon, random rays; how many times as fast as the random
layout): with a triangle a block, 17 MB of nodes, breadth first 1.6, depth first 2.2, subtrees 2.5 (Havran expected 1.6 of depth
first and 2.5 of subtrees, and measured 1.25 and 1.4). With 16 a block the nodes have 191 kB, and no layout gains more than
a tenth.

References:
    V. Havran: Heuristic ray shooting algorithms. PhD thesis, Czech Technical University in Prague, 2001.
    V. Rahikainen: On real-time ray tracing. MSc thesis, University of Tampere, 2013 (the survey).
"""

from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import warp as wp

from wrt.builders.kdtree.kdtree_statistics import UnpackedKdTree, unpack
from wrt.builders.tree import KdTree

LINE = 64
"""Bytes of a line of the cache."""

PAIRS = 4
"""Pairs of a line."""


def place_randomly(tree: UnpackedKdTree) -> np.ndarray:
    """A random order, always the same one."""
    inner = np.flatnonzero(~tree.is_leaf)
    return in_order(tree, np.random.default_rng(0).permutation(inner))


def place_breadth_first(tree: UnpackedKdTree) -> np.ndarray:
    """By depth."""
    inner = np.flatnonzero(~tree.is_leaf)
    return in_order(tree, inner[np.argsort(tree.depth[inner], kind="stable")])


def place_depth_first(tree: UnpackedKdTree) -> np.ndarray:
    """In the tree's own order."""
    return in_order(tree, np.flatnonzero(~tree.is_leaf))


def in_order(tree: UnpackedKdTree, inner: np.ndarray) -> np.ndarray:
    """Places of the children of inner nodes, pair after pair, behind the root's."""
    place = np.zeros(len(tree.axis), dtype=np.int64)
    place[inner] = 2 + 2 * np.arange(len(inner))
    return place


def place_subtrees(tree: UnpackedKdTree) -> np.ndarray:
    """The upper parts of subtrees, a line each; the first line begins with the root, whose own place is a pair."""
    place = np.zeros(len(tree.axis), dtype=np.int64)
    left, right, leaf = tree.left.tolist(), tree.right.tolist(), tree.is_leaf.tolist()
    stack, first, room = [] if leaf[0] else [0], 1, PAIRS - 1
    while stack:
        below = deque([stack.pop()])
        taken = 0
        while below and taken < room:
            node = below.popleft()
            place[node] = 2 * (first + taken)
            taken += 1
            below.extend(child for child in (left[node], right[node]) if not leaf[child])
        stack += reversed(below)
        first, room = first + room, PAIRS
    return place


LAYOUTS: dict[str, Callable[[UnpackedKdTree], np.ndarray]] = {
    "random": place_randomly,
    "breadth_first": place_breadth_first,
    "depth_first": place_depth_first,
    "subtrees": place_subtrees,
}
"""Name -> (tree) -> (nodes,) for each inner node where its left child is placed, an even number from 2 on; the root is at 0."""


def lay_out(tree: KdTree, layout: str) -> KdTree:
    """The tree with its nodes in pairs, in an order of `LAYOUTS`, on the CPU. Only traversals made for pairs can walk it.

    Raises:
        ValueError: unknown layout.
    """
    if layout not in LAYOUTS:
        raise ValueError(f"layout is {layout!r}; choose from {', '.join(LAYOUTS)}")
    flat, words = unpack(tree), tree.nodes.numpy()
    place = LAYOUTS[layout](flat)
    inner = np.flatnonzero(~flat.is_leaf)
    index = np.zeros(len(words), dtype=np.int64)
    index[flat.left[inner]], index[flat.right[inner]] = place[inner], place[inner] + 1
    moved = words.copy()
    moved[inner, 1] = place[inner] << 2 | flat.axis[inner]
    lines = -(-(int(index.max()) + 2) * 8 // LINE)
    nodes = aligned(lines * LINE // 8)
    nodes.numpy()[index] = moved
    return replace(tree, nodes=nodes)


def aligned(count: int) -> wp.array:
    """(count,) vec2i zeros on the CPU, which begin with a line of the cache."""
    room = wp.zeros(count + LINE // 8, dtype=wp.vec2i, device="cpu")
    begin = -room.ptr % LINE // 8
    return room[begin : begin + count]
