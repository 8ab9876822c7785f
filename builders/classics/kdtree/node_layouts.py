"""Orders of a tree's nodes in memory (Havran 2001).

**Problem.** A traversal step in a large tree waits for the node that it goes to. The delay depends on which nodes were loaded
in the same cache lines before.

**Layouts.** All keep the 8 bytes of a node, with the children of a node side by side (`wrt.kernels.layout.kdtree_nodes`,
pairs), and differ in the order of the pairs:

    random          none: pairs are at random positions, as if each had been allocated separately
    breadth_first   level after level
    depth_first     the pair of a node's left child follows it, as in the trees that builders make
    subtrees        a cache line, 64 bytes, holds the upper part of a subtree: the pair of its root's children, their pairs, and
                    so on level by level while there is room, here four pairs. The subtrees below begin new lines. Lines are not
                    shared, and not all are full
    pages           the same with 4096 bytes, 256 pairs, and without gaps: small subtrees share a page
    van_emde_boas   the upper half of the levels, then each subtree below, left to right; and every part again in this order
                    (Prokop 1999). So for any size of a line or a page, a path meets few of them

**What we changed.** Havran's nodes have two pointers; here both children share one, so a line holds twice as many.

**Results.** Depth first and subtrees are faster for trees that exceed the caches; small trees gain little
(notebooks/records/2026-11-21-kdtree-layouts.md).

References: havran-2001; prokop-1999; rahikainen-2013 (section 2.2).
"""

from collections import deque
from dataclasses import replace

import numpy as np
import warp as wp

from wrt.builders.kdtree import LAYOUTS, NATIVE
from wrt.builders.kdtree.kdtree_statistics import UnpackedKdTree, unpack
from wrt.builders.tree import KdTree
from wrt.kernels.layout.kdtree_nodes import LEAF

LINE = 64
"""Bytes of a cache line."""

PAIRS = 4
"""Pairs of nodes in a cache line."""

PAGE_PAIRS = 256
"""Pairs of nodes in a page of 4096 bytes."""


def place_random(tree: UnpackedKdTree) -> np.ndarray:
    """A random order with a fixed seed."""
    inner = np.flatnonzero(~tree.is_leaf)
    return in_order(tree, np.random.default_rng(0).permutation(inner))


def place_breadth_first(tree: UnpackedKdTree) -> np.ndarray:
    """Order by depth."""
    inner = np.flatnonzero(~tree.is_leaf)
    return in_order(tree, inner[np.argsort(tree.depth[inner], kind="stable")])


def place_depth_first(tree: UnpackedKdTree) -> np.ndarray:
    """The tree's own order."""
    return in_order(tree, np.flatnonzero(~tree.is_leaf))


def in_order(tree: UnpackedKdTree, inner: np.ndarray) -> np.ndarray:
    """Positions of the children of inner nodes, pair after pair, behind the root's."""
    place = np.zeros(len(tree.axis), dtype=np.int64)
    place[inner] = 2 + 2 * np.arange(len(inner))
    return place


def place_subtrees(tree: UnpackedKdTree) -> np.ndarray:
    """The upper parts of subtrees, one per line."""
    return place_parts(tree, PAIRS, gaps=True)


def place_pages(tree: UnpackedKdTree) -> np.ndarray:
    """The upper parts of subtrees, as large as a page at most, without gaps."""
    return place_parts(tree, PAGE_PAIRS, gaps=False)


def place_parts(tree: UnpackedKdTree, size: int, gaps: bool) -> np.ndarray:
    """The upper parts of subtrees, of at most `size` pairs. The first part begins with the root, which takes the place of a
    pair. gaps: whether every part takes the room of a full one."""
    place = np.zeros(len(tree.axis), dtype=np.int64)
    left, right, leaf = tree.left.tolist(), tree.right.tolist(), tree.is_leaf.tolist()
    stack, first, room = [] if leaf[0] else [0], 1, size - 1
    while stack:
        below = deque([stack.pop()])
        taken = 0
        while below and taken < room:
            node = below.popleft()
            place[node] = 2 * (first + taken)
            taken += 1
            below.extend(child for child in (left[node], right[node]) if not leaf[child])
        stack += reversed(below)
        first, room = first + (room if gaps else taken), size
    return place


def place_van_emde_boas(tree: UnpackedKdTree) -> np.ndarray:
    """The recursive order of Prokop 1999: a sort by where each division of the levels puts a node."""
    inner = np.flatnonzero(~tree.is_leaf)
    levels = int(tree.depth[inner].max()) + 1 if len(inner) else 0
    begin, end = np.zeros(levels, dtype=np.int64), np.full(levels, levels)  # of each level's part of the levels
    depth, keys = tree.depth[inner], []
    while (end - begin > 1).any():
        middle = (begin + end) // 2
        below = np.arange(levels) >= middle
        key = np.zeros(len(inner), dtype=np.int64)
        for at in np.unique(middle[below & (end - begin > 1)]):
            own = (middle[depth] == at) & below[depth]
            key[own] = 1 + ancestors(tree, int(at))[inner[own]]
        keys.append(key)
        begin, end = np.where(below & (end - begin > 1), middle, begin), np.where(below | (end - begin <= 1), end, middle)
    return in_order(tree, inner[np.lexsort(keys[::-1])] if keys else inner)


def ancestors(tree: UnpackedKdTree, level: int) -> np.ndarray:
    """(nodes,) the ancestor of each node on a level, or the node itself; -1 above that level."""
    found = np.where(tree.depth == level, np.arange(len(tree.depth)), -1)
    for depth in range(level, int(tree.depth.max())):
        inner = np.flatnonzero((tree.depth == depth) & ~tree.is_leaf)
        found[tree.left[inner]] = found[tree.right[inner]] = found[inner]
    return found


def lay_out(tree: KdTree, layout: str) -> KdTree:
    """Copies the tree with its nodes in pairs, in an order of `LAYOUTS`, on the CPU. It needs traversals compiled for pairs.

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


def with_layout(tree: KdTree, layout: str) -> KdTree:
    """The tree with a second copy of its nodes in an order of `LAYOUTS`; itself if that is the order of builders.

    Raises:
        ValueError: unknown layout.
    """
    if layout == NATIVE:
        return tree
    return replace(tree, layout=layout, pairs=lay_out(tree, layout).nodes)


def in_records(tree: KdTree, words: int) -> KdTree:
    """A tree in pairs with its nodes in records of some words of 8 bytes, of which a node takes the first: for measurements
    of what pointers in nodes cost. It needs traversals compiled for such records."""
    packed = tree.nodes.numpy()
    nodes = aligned(len(packed) * words)
    spread = packed.copy()
    inner = packed[:, 1] & 3 != LEAF
    spread[inner, 1] = (packed[inner, 1] >> 2) * words << 2 | packed[inner, 1] & 3
    nodes.numpy()[::words] = spread
    return replace(tree, nodes=nodes)


def aligned(count: int) -> wp.array:
    """(count,) vec2i zeros on the CPU, aligned to a cache line."""
    room = wp.zeros(count + LINE // 8, dtype=wp.vec2i, device="cpu")
    begin = -room.ptr % LINE // 8
    return room[begin : begin + count]


def aligned_copy(pairs: np.ndarray) -> np.ndarray:
    """A copy of nodes in pairs that begins with a cache line, as orders in memory need it."""
    copy = aligned(len(pairs)).numpy()
    copy[:] = pairs
    return copy
