"""Checks that arrays from outside form a valid tree, because traversals do not check what they read.

Trees from builders always pass; the check is for trees read from files. It takes a few passes over the arrays.
"""

import numpy as np

from wrt.builders.tree import Bvh, KdTree
from wrt.kernels.layout.bvh_nodes import MAX_WIDE_DEPTH
from wrt.kernels.layout.kdtree_nodes import LEAF, MAX_TREE_DEPTH

WIDTHS = (1, 2, 4, 8, 16)


def check_tree(tree: Bvh | KdTree, triangles: int) -> None:
    """Rejects a tree on the CPU with indices out of range, cycles, or more levels than a traversal's stack holds.

    Args:
        tree: the tree.
        triangles: number of triangles of the mesh.

    Raises:
        ValueError: the tree is invalid; the message names the fault.
    """
    primitive = tree.primitive.numpy()
    if tree.width not in WIDTHS or len(primitive) % tree.width:
        raise ValueError(
            f"primitive has {len(primitive)} entries; that must be a multiple of the width, {tree.width}, one of {WIDTHS}"
        )
    if primitive.size and not (primitive.min() >= -1 and primitive.max() < triangles):
        raise ValueError(f"a leaf refers to a triangle that does not exist; the mesh has {triangles}")
    if isinstance(tree, Bvh):
        check_bvh(tree)
    else:
        check_kdtree(tree)


def check_bvh(tree: Bvh) -> None:
    """Checks that levels are contiguous and that each node's children are in the next level."""
    child, levels, width = tree.child.numpy(), np.array(tree.level_first, dtype=np.int64), tree.width
    nodes = len(child) // width
    if width == 1 or len(child) != nodes * width or len(tree.bounds) != 6 * len(child):
        raise ValueError("the sizes of child and bounds do not match, or the width is 1")
    if not 2 <= len(levels) <= MAX_WIDE_DEPTH + 1 or levels[0] != 0 or levels[-1] != nodes or not is_ascending(levels):
        raise ValueError(f"level_first does not divide the {nodes} nodes into 1 to {MAX_WIDE_DEPTH} levels")
    level = np.searchsorted(levels, np.arange(nodes), side="right")
    begins, ends = np.append(levels, nodes)[level], np.append(levels, [nodes, nodes])[level + 1]
    child = child.reshape(nodes, width)
    inner = child >= 0
    if (inner & ((child < begins[:, None]) | (child >= ends[:, None]))).any():
        raise ValueError("a child is not in the level below its parent")
    leaf = ~child[~inner]
    check_leaves(leaf >> 6, leaf & 63, tree)


def is_ascending(numbers: np.ndarray) -> bool:
    """Whether each number is above the one before; differences of numbers far apart would wrap around."""
    return bool((numbers[1:] > numbers[:-1]).all())


def check_kdtree(tree: KdTree) -> None:
    """Checks that children follow their parents, and that no path is too long."""
    first, second = tree.nodes.numpy().reshape(-1, 2).T
    count, is_leaf = len(first), (second & 3) == LEAF
    inner = np.flatnonzero(~is_leaf)
    right = second[inner] >> 2
    if count == 0 or (right <= inner + 1).any() or (right >= count).any():
        raise ValueError("a child does not follow its parent, or there are no nodes")
    check_leaves(first[is_leaf], second[is_leaf] >> 2, tree)
    below, depth = np.array([0]), 0
    while len(below := below[~is_leaf[below]]):
        below, depth = np.concatenate([below + 1, second[below] >> 2]), depth + 1
        if depth > MAX_TREE_DEPTH or len(below) > count:
            raise ValueError(f"a leaf is deeper than {MAX_TREE_DEPTH}, or has two parents")
    if tree.pairs is not None:
        check_pairs(tree.nodes.numpy(), tree.pairs.numpy())


def check_pairs(nodes: np.ndarray, pairs: np.ndarray) -> None:
    """Checks that nodes in pairs are those of a valid tree, whatever their order."""
    level, places = np.array([0]), np.array([0])
    while len(level):
        if places.min() < 0 or places.max() + 1 > len(pairs):
            raise ValueError("a pair of nodes does not exist")
        leaf = nodes[level, 1] & 3 == LEAF
        same = nodes[level, 0] == pairs[places, 0], (nodes[level, 1] ^ pairs[places, 1]) & np.where(leaf, -1, 3) == 0
        if not np.logical_and(*same).all():
            raise ValueError("nodes in pairs are not those of the tree")
        level, places = level[~leaf], places[~leaf]
        left = pairs[places, 1] >> 2
        level, places = np.concatenate([level + 1, nodes[level, 1] >> 2]), np.concatenate([left, left + 1])


def check_leaves(first_block: np.ndarray, triangles: np.ndarray, tree: Bvh | KdTree) -> None:
    """Checks that the blocks of every leaf exist."""
    used = triangles != 0
    first_block, triangles = first_block[used].astype(np.int64), triangles[used].astype(np.int64)
    last = first_block + -(-triangles // tree.width)
    if (first_block < 0).any() or (triangles < 0).any() or (last > len(tree.primitive) // tree.width).any():
        raise ValueError(f"a leaf refers to blocks that do not exist; there are {len(tree.primitive) // tree.width}")
