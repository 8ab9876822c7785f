"""From nodes level by level to nodes in depth-first order (`wrt.kernels.layout.kdtree_nodes`).

Sizes of subtrees are summed from the leaves up: of two siblings, the one that comes second goes on with both. The number of
subtrees that have come and the sizes are one word, so that no thread can see one without the other. Then each node goes up to
the root, and adds what comes before it. Neither needs levels.
"""

import numpy as np
import warp as wp

from wrt.builders.kdtree.levelwise.cell_nodes import BuiltNodes
from wrt.builders.kdtree.levelwise.grid_sums import add_to
from wrt.kernels.layout import kdtree_nodes as kdtree
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import exact_kernel

NODE_SHIFT, ARRIVAL_SHIFT = wp.constant(wp.int64(31)), wp.constant(wp.int64(61))
"""Of the nodes and of the children that have come, in a size; its lower bits are blocks of triangles."""

BLOCKS = wp.constant(wp.int64((1 << 31) - 1))
NODES = wp.constant(wp.int64((1 << 30) - 1))

NODE_CHUNK = 1024
"""On the CPU, nodes that are worth a chunk of their own."""


@wp.func
def blocks_of(triangles: int, width_bits: int):
    """Blocks of a leaf."""
    return (triangles + (1 << width_bits) - 1) >> width_bits


@wp.func
def node_count(size: wp.int64):
    """Nodes of a subtree."""
    return int((size >> NODE_SHIFT) & NODES)


@exact_kernel
def sum_sizes(first: int, width_bits: int, built: BuiltNodes):
    """Item: a node. A leaf adds its size to those of all above it, as far as it is the last to come.

    built.size: (nodes,) 0 before."""
    here = first + wp.tid()
    node = built.node[here]
    if kdtree.split_axis(node) != kdtree.LEAF:
        return
    size = (wp.int64(1) << NODE_SHIFT) | wp.int64(blocks_of(kdtree.leaf_triangles(node), width_bits))
    built.size[here] = size
    link = built.parent[here]
    while link >= 0:
        above = link >> 1
        arrived = size + (wp.int64(1) << ARRIVAL_SHIFT)
        before = add_to(built.size, above, arrived)
        link = -1
        if before != wp.int64(0):
            own = wp.int64(1) << NODE_SHIFT
            add_to(built.size, above, own)
            size = (before & ((wp.int64(1) << ARRIVAL_SHIFT) - wp.int64(1))) + size + own
            link = built.parent[above]


@exact_kernel
def place_nodes(
    first: int, width_bits: int, built: BuiltNodes, nodes: wp.array(dtype=wp.vec2i), primitive: wp.array(dtype=int)
):
    """Item: a node. Writes it, and the triangles of a leaf, to their places."""
    here = first + wp.tid()
    node = built.node[here]
    at = here
    index = int(0)
    block = int(0)
    link = built.parent[at]
    while link >= 0:
        index += 1
        if (link & 1) == 1:
            size = built.size[at - 1]
            index += node_count(size)
            block += int(size & BLOCKS)
        at = link >> 1
        link = built.parent[at]
    axis = kdtree.split_axis(node)
    if axis == kdtree.LEAF:
        count = kdtree.leaf_triangles(node)
        listed = kdtree.first_block(node)
        begin = block << width_bits
        for i in range(blocks_of(count, width_bits) << width_bits):
            triangle = int(-1)
            if i < count:
                triangle = built.listed[listed + i]
            primitive[begin + i] = triangle
        node = kdtree.leaf_node(block, count)
    else:
        left = built.size[kdtree.right_child(node)]  # pairs: the left child's place
        node = kdtree.inner_node(axis, kdtree.split_position(node), index + 1 + node_count(left))
    nodes[index] = node


def number(built: BuiltNodes, count: int, width: int) -> tuple[wp.array, wp.array]:
    """The nodes and the leaf lists of the finished tree of `count` nodes."""
    device, bits = built.node.device, width.bit_length() - 1
    launch(sum_sizes, count, [bits, built], device=device, chunk=NODE_CHUNK)
    size = int(built.size[:1].numpy()[0])
    nodes = wp.empty(count, dtype=wp.vec2i, device=device)
    primitive = wp.empty((size & int(np.int64(BLOCKS))) * width, dtype=int, device=device)
    launch(place_nodes, count, [bits, built, nodes, primitive], device=device, chunk=NODE_CHUNK)
    return nodes, primitive
