"""Replacement of leaves of a finished tree by subtrees. The tree stays in depth-first order
(`wrt.kernels.layout.kdtree_nodes`)."""

import numpy as np
import warp as wp

from wrt.kernels.layout import kdtree_nodes as kdtree
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import exact_kernel

EMPTY = (0, 3)
"""An empty leaf."""

EMPTY_LEAF = wp.constant(wp.vec2i(*EMPTY))


@exact_kernel
def move_nodes(first: int, nodes: wp.array(dtype=wp.vec2i), shift: wp.array(dtype=int), enlarged: wp.array(dtype=wp.vec2i)):
    """Item: a node. Copies it to its new index. shift: (nodes,) increase of each node's index."""
    i = first + wp.tid()
    node = nodes[i]
    axis = kdtree.split_axis(node)
    if axis != kdtree.LEAF:
        right = kdtree.right_child(node)
        node = kdtree.inner_node(axis, kdtree.split_position(node), right + shift[right])
    enlarged[i + shift[i]] = node


def insert_gaps(nodes: wp.array, leaves: np.ndarray, sizes: np.ndarray) -> tuple[wp.array, np.ndarray]:
    """Makes room for subtrees that replace leaves.

    Args:
        nodes: (nodes,) vec2i; not modified.
        leaves: indices of the leaves to replace.
        sizes: nodes of each subtree, at least 1.

    Returns:
        The enlarged array and shift. The subtree of leaf i must then be written from leaves[i] + shift[leaves[i]] on. shift:
        (nodes,) increase of each node's index.
    """
    device, count = nodes.device, len(nodes)
    growth = np.zeros(count, dtype=np.int32)
    growth[leaves] = sizes - 1
    shift = np.cumsum(growth, dtype=np.int32) - growth
    enlarged = wp.empty(count + int(growth.sum()), dtype=wp.vec2i, device=device)
    launch(move_nodes, count, [nodes, wp.array(shift, dtype=int, device=device), enlarged], device=device, chunk=4096)
    return enlarged, shift


@exact_kernel
def close_finished(first: int, skeleton: wp.array(dtype=wp.vec2i)):
    """One item. Turns parts of the skeleton that are completely built into empty leaves. Their nodes remain, unreachable."""
    for i in range(skeleton.shape[0]):
        index = skeleton.shape[0] - 1 - i  # children before their parents
        node = skeleton[index]
        if kdtree.split_axis(node) == kdtree.LEAF:
            continue
        if skeleton[index + 1] == EMPTY_LEAF and skeleton[kdtree.right_child(node)] == EMPTY_LEAF:
            skeleton[index] = EMPTY_LEAF


def unbuilt_leaves(numbers: np.ndarray) -> np.ndarray:
    """Leaves of the skeleton for cells that are not built."""
    return np.stack([numbers, np.full_like(numbers, 1 << 2 | kdtree.LEAF)], axis=1).astype(np.int32)


def joined(a: wp.array, b: wp.array) -> wp.array:
    """The concatenation of two arrays."""
    result = wp.empty(len(a) + len(b), dtype=a.dtype, device=a.device)
    for part, to in ((a, 0), (b, len(a))):
        if len(part):
            wp.copy(result, part, dest_offset=to)
    return result
