"""Memory layout of a tree of two children a node for CUDA: nodes of 64 bytes, triangles of 48 bytes.

A thread that walks on its own reads a node, and a triangle, in loads of 16 bytes at addresses that depend on nothing but their
number. Both are made from a wide tree of width 2 (`wrt.kernels.layout.bvh_nodes`), on its device, in the same order.

A node is 4 vec4; `a` and `b` are its children:

    (a.low x, a.high x, a.low y, a.high y)
    (b.low x, b.high x, b.low y, b.high y)
    (a.low z, a.high z, b.low z, b.high z)
    (word of a, word of b, 0, 0)            bits of the child words of `wrt.kernels.layout.bvh_nodes`

A leaf's word tells its first block of two triangles and their number; triangle k of it is number 2 * block + k.

A triangle is 3 vec4: its vertices, the first one followed by the bits of its id. A slot that no leaf uses has the id -1.

**Size.** A leaf has at least one triangle, so N triangles take at most 64 (N - 1) bytes of nodes and 96 N bytes of triangles.
With leaves of up to two triangles, as CUDA's trees have, they take about 110 bytes a triangle.

References: aila-laine-2009.
"""

import warp as wp

from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.unchecked import load_float, load_int
from wrt.kernels.runtime.launch import kept, launch
from wrt.kernels.runtime.options import exact_kernel

WIDTH = 2
"""Children of a node, and triangles of a block of the tree that the layout is made from."""

NODE_VECTORS, TRIANGLE_VECTORS = 4, 3
"""vec4 of a node and of a triangle."""

CHUNK = 4096
"""Nodes or triangles that are worth a chunk of their own."""


@wp.struct
class BinaryNodes:
    """The nodes of a tree and its bounding box."""

    nodes: wp.array(dtype=wp.vec4)
    """(nodes * 4,)"""
    low: wp.vec3
    high: wp.vec3


@wp.struct
class PackedTriangles:
    """The triangles to which leaves refer."""

    corners: wp.array(dtype=wp.vec4)
    """(slots * 3,)"""


@wp.struct
class BinaryPart:
    """A geometry that instances place: its tree and its triangles."""

    tree: BinaryNodes
    triangles: PackedTriangles


@exact_kernel
def pack_nodes(first: int, tree: WideNodes, nodes: wp.array(dtype=wp.vec4)):
    """Writes a node. Item: a node."""
    i = first + wp.tid()
    box = 12 * i
    for side in range(2):
        x = box + side
        low_x = load_float(tree.bounds, x)
        low_y = load_float(tree.bounds, x + 2)
        high_x = load_float(tree.bounds, x + 6)
        high_y = load_float(tree.bounds, x + 8)
        nodes[4 * i + side] = wp.vec4(low_x, high_x, low_y, high_y)
    low = wp.vec2(load_float(tree.bounds, box + 4), load_float(tree.bounds, box + 5))
    high = wp.vec2(load_float(tree.bounds, box + 10), load_float(tree.bounds, box + 11))
    nodes[4 * i + 2] = wp.vec4(low[0], high[0], low[1], high[1])
    left = wp.cast(load_int(tree.child, 2 * i), wp.float32)
    right = wp.cast(load_int(tree.child, 2 * i + 1), wp.float32)
    nodes[4 * i + 3] = wp.vec4(left, right, 0.0, 0.0)


@exact_kernel
def pack_corners(
    first: int,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    primitive: wp.array(dtype=int),
    corners: wp.array(dtype=wp.vec4),
):
    """Writes a triangle. Item: a slot of a leaf."""
    slot = first + wp.tid()
    triangle = primitive[slot]
    face = faces[wp.max(triangle, 0)]
    for k in range(3):
        vertex = vertices[face[k]]
        word = float(0.0)
        if k == 0:
            word = wp.cast(triangle, wp.float32)
        corners[3 * slot + k] = wp.vec4(vertex[0], vertex[1], vertex[2], word)


def pack_tree(tree: WideNodes) -> BinaryNodes:
    """The nodes of a wide tree of width 2, on its device.

    Raises:
        RuntimeError: a graph is being captured on the device.
    """
    packed, device, count = BinaryNodes(), tree.child.device, len(tree.child) // WIDTH
    with kept(device):
        packed.nodes = wp.empty(NODE_VECTORS * count, dtype=wp.vec4, device=device)
        packed.low, packed.high = tree.low, tree.high
        launch(pack_nodes, count, [tree, packed.nodes], device=device, chunk=CHUNK)
    return packed


def pack_triangles(vertices: wp.array, faces: wp.array, primitive: wp.array) -> PackedTriangles:
    """Triangles in the order of the leaves of a tree.

    Args:
        vertices: (V,) vec3, relative to the scene's centre.
        faces: (F,) vec3i.
        primitive: (slots,) int32 triangle ids, -1 in unused slots.

    Raises:
        RuntimeError: a graph is being captured on the device.
    """
    packed, device, count = PackedTriangles(), vertices.device, len(primitive)
    with kept(device):
        packed.corners = wp.empty(TRIANGLE_VECTORS * count, dtype=wp.vec4, device=device)
        launch(pack_corners, count, [vertices, faces, primitive, packed.corners], device=device, chunk=CHUNK)
    return packed
