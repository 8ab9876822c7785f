"""The binary tree between a builder and the collapse to wide nodes.

Nodes come in pairs of siblings. The pair into which a node with the triangles [first, first + count) is split is stored among
the pairs first + 1 .. first + count - 1, which suffice for its whole subtree. So subtrees are built in parallel without
allocation. The root is node 0. Pair p consists of the nodes 2 p and 2 p + 1.

A box is stored as (low, -high), 8 floats, so a union of boxes is one minimum over all components.
"""

import warp as wp

from wrt.kernels.layout.bvh_nodes import MAX_WIDE_DEPTH
from wrt.kernels.layout.struct_arrays import with_known_layout
from wrt.kernels.runtime import native

LEAF = wp.constant(0)
"""`BinaryTree.pair` of a leaf."""


@wp.struct
class BinaryTree:
    """A tree over the triangles in the order `order`. Most of the reserved memory is never written."""

    box: wp.array(dtype=float)
    """(2 * triangles * 8,) per node: low x, y, z, unused, -high x, y, z, unused."""
    range: wp.array(dtype=wp.vec2i)
    """(2 * triangles,) first triangle in `order` and number of triangles, also of inner nodes."""
    pair: wp.array(dtype=int)
    """(2 * triangles,) the pair of its children; LEAF for a leaf."""
    order: wp.array(dtype=int)
    """(triangles,) triangle ids."""


@with_known_layout
@wp.struct
class Frame:
    """A node that is being built or waits for its left sibling."""

    node: int
    first: int
    """Its first triangle in the tree's order."""
    count: int
    buffer: int
    """Start of the buffer that holds its references: 0 or the number of triangles."""
    depth: int


@wp.func
def child_of(frame: Frame, left: int, pair: int, side: int):
    """The frame of a child, 0 for the left one of `left` triangles or 1, in the same buffer. The children are a pair."""
    child = Frame()
    child.node = 2 * pair + side
    child.first = frame.first + side * left
    child.count = wp.where(side == 0, left, frame.count - left)
    child.buffer = frame.buffer
    child.depth = frame.depth + 1
    return child


def empty_tree(triangles: int, device: wp.Device) -> BinaryTree:
    """Allocates the tree of a number of triangles."""
    tree = BinaryTree()
    tree.box = wp.empty(16 * triangles, dtype=float, device=device)
    tree.range = wp.empty(2 * triangles, dtype=wp.vec2i, device=device)
    tree.pair = wp.empty(2 * triangles, dtype=int, device=device)
    tree.order = wp.empty(triangles, dtype=int, device=device)
    return tree


BOTH = "wrt::sides_of_both(boxes.data + (size_t)pair * 16, boxes.data + (size_t)pair * 16 + 8)"
"""C++: the sides of the box around both nodes of a pair."""


@native.func_native("reference.h", "return wrt::sides_of(boxes.data + (size_t)node * 8).half_area();")
def half_area(boxes: wp.array(dtype=float), node: int) -> float:
    """Half the surface area of a node's box."""


@native.func_native("reference.h", f"return {BOTH}.half_area();")
def half_area_of_both(boxes: wp.array(dtype=float), pair: int) -> float:
    """Half the surface area of the box around both nodes of a pair."""


@wp.func
def halvings(count: int):
    """ceil(log2(count)): number of halvings until one element is left."""
    bits = int(0)
    while (1 << bits) < count and bits < 30:
        bits += 1
    return bits


@wp.func
def must_split_at_median(depth: int, count: int):
    """Whether a node must be split in the middle so that its subtree does not become too deep.

    `depth + halvings(count)` never exceeds MAX_WIDE_DEPTH. Any other split adds at most 1 to it and is made only below the
    limit; a split in the middle does not change it. At a leaf it is at least the depth.
    """
    return depth + halvings(count) >= wp.static(MAX_WIDE_DEPTH)


@wp.func
def middle(count: int, width_bits: int):
    """Triangles on the left of a split in the middle: whole blocks, if there is more than one."""
    blocks = (count + (1 << width_bits) - 1) >> width_bits
    return wp.where(blocks > 1, ((blocks + 1) >> 1) << width_bits, (count + 1) >> 1)


@wp.func
def split_cost(left_area: float, left_cost: float, right_area: float, right_cost: float):
    """The part of a split's cost that differs between the splits of a node."""
    return left_area * left_cost + right_area * right_cost
