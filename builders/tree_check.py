"""Whether arrays that come from outside are a tree: whatever traversals rely on without looking.

Builders make no tree that would be refused here; the check is for files. It takes a few passes over the arrays.
"""

import numpy as np

from wrt.builders.tree import Bvh, KdTree
from wrt.kernels.layout.bvh_nodes import MAX_WIDE_DEPTH
from wrt.kernels.layout.kdtree_nodes import LEAF, MAX_TREE_DEPTH

WIDTHS = (1, 2, 4, 8, 16)


def check_tree(tree: Bvh | KdTree, triangles: int) -> None:
    """Refuses a tree on the CPU whose indices lead out of its arrays, in a circle, or deeper than a stack is.

    Raises:
        ValueError: it does; the message says where.
    """
    primitive = tree.primitive.numpy()
    if tree.width not in WIDTHS or len(primitive) % tree.width:
        raise ValueError(f"blocks of {tree.width} triangles do not make {len(primitive)} lanes")
    if primitive.size and not (primitive.min() >= -1 and primitive.max() < triangles):
        raise ValueError(f"a leaf holds a triangle that is none of the {triangles}")
    if isinstance(tree, Bvh):
        check_bvh(tree)
    else:
        check_kdtree(tree)


def check_bvh(tree: Bvh) -> None:
    """Levels follow one another, and each node's children are in the next."""
    child, levels, width = tree.child.numpy(), np.array(tree.level_first), tree.width
    nodes = len(child) // width
    if width == 1 or len(child) != nodes * width or len(tree.bounds) != 6 * len(child):
        raise ValueError("nodes and boxes do not go together")
    if not 2 <= len(levels) <= MAX_WIDE_DEPTH + 1 or levels[0] != 0 or levels[-1] != nodes or (np.diff(levels) <= 0).any():
        raise ValueError("nodes and levels do not go together")
    level = np.searchsorted(levels, np.arange(nodes), side="right")
    begins, ends = np.append(levels, nodes)[level], np.append(levels, [nodes, nodes])[level + 1]
    child = child.reshape(nodes, width)
    inner = child >= 0
    if (inner & ((child < begins[:, None]) | (child >= ends[:, None]))).any():
        raise ValueError("a child is not in the level below its parent")
    leaf = ~child[~inner]
    check_leaves(leaf >> 6, leaf & 63, tree)


def check_kdtree(tree: KdTree) -> None:
    """Children come after their parents, and no way down is too long."""
    first, second = tree.nodes.numpy().reshape(-1, 2).T
    count, is_leaf = len(first), (second & 3) == LEAF
    inner = np.flatnonzero(~is_leaf)
    right = second[inner] >> 2
    if count == 0 or (right <= inner + 1).any() or (right >= count).any():
        raise ValueError("a child is not after its parent")
    check_leaves(first[is_leaf], second[is_leaf] >> 2, tree)
    below, depth = np.array([0]), 0
    while len(below := below[~is_leaf[below]]):
        below, depth = np.concatenate([below + 1, second[below] >> 2]), depth + 1
        if depth > MAX_TREE_DEPTH or len(below) > count:
            raise ValueError(f"leaves are deeper than {MAX_TREE_DEPTH}, or reached twice")


def check_leaves(first_block: np.ndarray, triangles: np.ndarray, tree: Bvh | KdTree) -> None:
    """The blocks of every leaf are there."""
    used = triangles != 0
    first_block, triangles = first_block[used].astype(np.int64), triangles[used].astype(np.int64)
    last = first_block + -(-triangles // tree.width)
    if (first_block < 0).any() or (triangles < 0).any() or (last > len(tree.primitive) // tree.width).any():
        raise ValueError("a leaf's blocks are not there")
