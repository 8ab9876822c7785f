"""A kd-tree in compact subtrees (`wrt.kernels.layout.compact_nodes`): nodes without indices, in cache lines.

**Problem.** In a node of 8 bytes, half is the index of its children. A cache line of such nodes holds a subtree of eight.

**Idea** (Havran 2001). Within a subtree of fixed shape a node's place tells where its children are, and only subtrees have
numbers. Of 16 words, 7 are planes, 8 are the numbers of subtrees or the leaves themselves, and one has the axes.

**Steps.** From the root on, each subtree takes `height` levels, and every inner node below them begins another one, in
depth-first order.

**Complexity.** O(N), level by level of subtrees.

**Limits.** Where leaves are near the root of a subtree, the places below them are unused. Only the walk of single rays reads
this layout, for closest and any hits: for measurements (notebooks/records/2026-11-23-spatial-splits-and-compact-subtrees.md).

References: havran-2001; rahikainen-2013 (section 2.2).
"""

from dataclasses import replace

import numpy as np

from wrt.builders.classics.kdtree.node_layouts import aligned
from wrt.builders.kdtree.kdtree_statistics import UnpackedKdTree, unpack
from wrt.builders.tree import KdTree
from wrt.kernels.layout.compact_nodes import HEIGHTS, LONG

MAX_FIRST = 1 << 25
"""Blocks, and places of long leaves, that a word can number."""


def subtrees_below(tree: UnpackedKdTree, roots: np.ndarray, height: int) -> np.ndarray:
    """(roots, 2^(height + 1)) the nodes of subtrees by their places in a heap, -1 for none; place 0 is not used."""
    half, is_leaf = 1 << height, tree.is_leaf
    placed = np.full((len(roots), 2 * half), -1, dtype=np.int64)
    placed[:, 1] = roots
    for at in range(1, half):
        node = placed[:, at]
        inner = (node >= 0) & ~is_leaf[node]
        placed[inner, 2 * at], placed[inner, 2 * at + 1] = tree.left[node[inner]], tree.right[node[inner]]
    return placed


def subtree_roots(tree: UnpackedKdTree, height: int) -> np.ndarray:
    """The nodes at which subtrees begin, in depth-first order, in which nodes are numbered."""
    level, found, is_leaf = np.zeros(1, dtype=np.int64), [], tree.is_leaf
    while len(level):
        found.append(level)
        exits = subtrees_below(tree, level, height)[:, 1 << height :].ravel()
        exits = exits[exits >= 0]
        level = exits[~is_leaf[exits]]
    return np.sort(np.concatenate(found))


def to_compact(tree: KdTree, height: int) -> KdTree:
    """Copies the tree with its nodes in compact subtrees of some levels, on the CPU. It needs a traversal compiled for them.

    Raises:
        ValueError: a height other than those of `HEIGHTS`, or too many blocks or subtrees.
    """
    if height not in HEIGHTS:
        raise ValueError(f"height is {height}; choose from {', '.join(map(str, HEIGHTS))}")
    flat, half = unpack(tree), 1 << height
    roots = subtree_roots(flat, height)
    placed, is_leaf = subtrees_below(flat, roots, height), flat.is_leaf
    long = np.flatnonzero(is_leaf & (flat.triangles >= LONG))
    first, held = flat.first_block.astype(np.int64), np.minimum(flat.triangles, LONG)
    first[long] = len(roots) * half + np.arange(len(long))  # their nodes follow the subtrees; a node is two words
    first[held == 0] = 0
    if max(first.max(), len(roots) * half + len(long)) >= MAX_FIRST:
        raise ValueError(f"the tree has {len(roots)} compact subtrees; at most {MAX_FIRST // half} can be numbered, and blocks")
    number = np.zeros(len(is_leaf), dtype=np.int64)
    number[roots] = np.arange(len(roots))
    word = np.where(is_leaf, ~(first << 6 | held), number).astype(np.int32)  # of a node at an exit
    plane = tree.nodes.numpy()[:, 0]
    words = np.zeros((len(roots), 2 * half), dtype=np.int32)
    axes = np.zeros(len(roots), dtype=np.int64)
    for at in range(1, half):
        node = placed[:, at]
        used = node >= 0
        axes |= np.where(used, flat.axis[node], 0).astype(np.int64) << 2 * at
        words[used, at] = plane[node[used]]
        leaf = used & is_leaf[node]
        words[leaf, at << height - (at.bit_length() - 1)] = word[node[leaf]]
    words[:, 0] = axes.astype(np.uint32).view(np.int32)
    exits = placed[:, half:]
    words[:, half:] = np.where(exits >= 0, word[exits], words[:, half:])
    nodes = aligned(len(roots) * half + len(long))
    nodes.numpy()[: len(roots) * half] = words.reshape(-1, 2)
    nodes.numpy()[len(roots) * half :] = tree.nodes.numpy()[long]
    return replace(tree, nodes=nodes)
