"""Memory layout of the kd-tree: 8 bytes per node, depth-first order.

A node is two 32-bit words:

    word 0   inner node: the splitting plane's position, bits of a float32
             leaf:       index of its first triangle block
    word 1   bits 0-1    0, 1, 2: inner node that splits x, y, z;  3: leaf
             bits 2-30   inner node: index of its right (upper) child;  leaf: number of triangles, 0 if it is empty

The left (lower) child of node i is node i + 1. A leaf of n triangles owns ceil(n / W) consecutive blocks of W lanes.

There is a second order of the same nodes, in pairs: the two children of a node are adjacent. An inner node then stores the
index of its left child, and the right child follows it. Pairs can be in any order (`wrt.builders.kdtree.LAYOUTS`).

References: havran-2001 (depth-first layout); wald-2004 (8-byte node).
"""

from functools import cache

import warp as wp

MAX_TREE_DEPTH = 64
"""Greatest depth of a tree that a builder makes; bounds the stack of every traversal."""

LEAF = wp.constant(3)
"""Axis bits of a leaf."""

MAX_INDEX = (1 << 29) - 1
"""Largest child index and leaf size that a node can hold."""


@wp.struct
class KdNodes:
    """The nodes of a tree and its box, or the subtree below one of its nodes."""

    nodes: wp.array(dtype=wp.vec2i)
    root: int
    """Node at which a traversal begins: 0, or the node whose box is `low`, `high`."""
    low: wp.vec3
    high: wp.vec3


@wp.func
def inner_node(axis: int, position: float, right: int):
    """Packs an inner node."""
    return wp.vec2i(wp.cast(position, wp.int32), (right << 2) | axis)


@wp.func
def leaf_node(first_block: int, triangles: int):
    """Packs a leaf."""
    return wp.vec2i(first_block, (triangles << 2) | LEAF)


@wp.func_native("return nodes.data[index];")
def load_node(nodes: wp.array(dtype=wp.vec2i), index: int) -> wp.vec2i:
    """Node `index`, without the bounds check of `nodes[index]`; every traversal step depends on the latency of this load."""


@wp.func
def children_depth_first(index: int, node: wp.vec2i):
    """Indices of an inner node's children, (lower, upper)."""
    return wp.vec2i(index + 1, node[1] >> 2)


@cache
def children_in_pairs(stride: int) -> wp.Function:
    """`children_depth_first` if nodes are in pairs, and each is the first of `stride` words of 8 bytes."""

    @wp.func
    def children(index: int, node: wp.vec2i):
        return wp.vec2i(node[1] >> 2, (node[1] >> 2) + wp.static(stride))

    return children


@wp.func
def split_axis(node: wp.vec2i):
    """0, 1 or 2; `LEAF` for a leaf."""
    return node[1] & 3


@wp.func
def split_position(node: wp.vec2i):
    """Position of an inner node's splitting plane."""
    return wp.cast(node[0], wp.float32)


@wp.func
def right_child(node: wp.vec2i):
    """Index of an inner node's upper child."""
    return node[1] >> 2


@wp.func
def child_low(low: wp.vec3, axis: int, position: float, is_right: bool):
    """Lower corner of a child's cell: that of its parent, except along the split axis of the right child."""
    result = wp.vec3(low)
    if is_right:
        result[axis] = position
    return result


@wp.func
def child_high(high: wp.vec3, axis: int, position: float, is_right: bool):
    """Upper corner of a child's cell: that of its parent, except along the split axis of the left child."""
    result = wp.vec3(high)
    if not is_right:
        result[axis] = position
    return result


@wp.func
def first_block(node: wp.vec2i):
    """Index of a leaf's first triangle block."""
    return node[0]


@wp.func
def leaf_triangles(node: wp.vec2i):
    """Number of triangles in a leaf."""
    return node[1] >> 2
