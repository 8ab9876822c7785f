"""Phase "merging" of the build by clusters: Morton codes, and the binary tree that neighbouring clusters are merged into.

Triangles are in the order of their codes. Ranges of that order form a hierarchy by the highest bit in which codes differ; it is
not stored. A thread begins at every triangle and goes up. Of two that come to a node, the second goes on (Apetrei 2014). Where
the range has more than 16 triangles, it merges the lists of clusters of both halves, up to 16 each, until 16 are left: every
cluster looks at 8 neighbours on either side, and two that choose each other are merged (`merging.h`).

**One numbering.** A cluster keeps its place in the list, by its first triangle. The node that two clusters make has the number
of the second one's first triangle, which no other node can have. So nodes have the same numbers whatever the order of threads,
on the CPU and on CUDA, and no counter is shared.
"""

from functools import cache

import numpy as np
import warp as wp

from wrt.builders.triangle_boxes import AwaitedBoxes, Boxes, TriangleBoxes
from wrt.kernels.layout.unchecked import store_float
from wrt.kernels.runtime import native
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import exact_kernel, specialised_kernel

CODE_BITS = 30
"""Bits of a code, 10 for each axis."""

CELLS = wp.constant(1023.0)
"""The last cell along an axis."""

MIN_SIDE = 1e-30
"""Length of a side of the scene up to which it has one cell."""

BLOCK, BLOCKS = 64, 8
"""Threads of a block of `make_merge_clusters` on CUDA, and blocks of a multiprocessor."""

CHUNK = 2048
"""Triangles that are worth a chunk of their own."""

MERGE_CHUNK = 512
"""Triangles that are worth a chunk of their own where clusters are merged."""


@wp.struct
class MergedTree:
    """A binary tree of n triangles in the order of their codes. Nodes 0 .. n - 1 are triangles, n + 1 .. 2 n - 1 are inner."""

    box: wp.array(dtype=float)
    """(2 n * 8,) boxes as in `wrt.builders.bvh.phases.binary_tree`; the unused words hold the children, -1 for a triangle."""
    parent: wp.array(dtype=int)
    """(2 n,) twice the number of the parent, less n, and 1 for its right child; -1 for the root."""
    size: wp.array(dtype=int)
    """(n,) triangles of inner nodes."""
    triangle: wp.array(dtype=int)
    """(2 n,) ids of the triangles in order, and room for sorting them."""
    code: wp.array(dtype=int)
    """(2 n,) their codes, likewise."""
    cluster: wp.array(dtype=wp.vec4i)
    """(n,) lists of clusters: node, first triangle, number of triangles, unused."""
    waiting: wp.array(dtype=int)
    """(n,) by triangle: the other end of a range that ends there or begins after it, and waits for its sibling; -1 for none."""
    root: wp.array(dtype=int)
    """(1,) the root."""


def empty_merged_tree(count: int, device: wp.Device) -> MergedTree:
    """Allocates the tree of a number of triangles."""
    tree = MergedTree()
    tree.box = wp.empty(16 * count, dtype=float, device=device)
    for name, size in (("parent", 2), ("triangle", 2), ("code", 2), ("size", 1), ("waiting", 1)):
        setattr(tree, name, wp.empty(size * count, dtype=int, device=device))
    tree.cluster = wp.empty(count, dtype=wp.vec4i, device=device)
    tree.root = wp.empty(1, dtype=int, device=device)
    return tree


@wp.func_native("((wp::int32*)boxes.data)[8 * node + 3] = child[0]; ((wp::int32*)boxes.data)[8 * node + 7] = child[1];")
def set_children(boxes: wp.array(dtype=float), node: int, child: wp.vec2i):
    """Writes the children of a node."""


@wp.func_native("return {((wp::int32*)boxes.data)[8 * node + 3], ((wp::int32*)boxes.data)[8 * node + 7]};")
def children_of(boxes: wp.array(dtype=float), node: int) -> wp.vec2i:
    """The children of a node."""


@wp.func
def spread(cell: int):
    """The ten bits of a cell, three places apart."""
    bits = (cell | (cell << 16)) & 0x030000FF
    bits = (bits | (bits << 8)) & 0x0300F00F
    bits = (bits | (bits << 4)) & 0x030C30C3
    return (bits | (bits << 2)) & 0x09249249


@wp.func
def write_code(i: int, boxes: Boxes, low: wp.vec3, scale: wp.vec3, tree: MergedTree):
    """Writes the code of the middle of a triangle's box."""
    code = int(0)
    for axis in range(3):
        middle = 0.5 * boxes.low[axis, i] + 0.5 * boxes.high[axis, i]
        cell = int(wp.clamp((middle - low[axis]) * scale[axis], 0.0, CELLS))
        code = code | (spread(cell) << (2 - axis))
    tree.code[i] = code
    tree.triangle[i] = i


@exact_kernel
def write_codes(first: int, boxes: Boxes, low: wp.vec3, scale: wp.vec3, tree: MergedTree):
    """Item: a triangle."""
    write_code(first + wp.tid(), boxes, low, scale, tree)


@wp.func
def found_corner(found: wp.array(dtype=int), k: int):
    """A number of `wrt.builders.triangle_boxes.CornerSearch.found`."""
    bits = found[k]
    return wp.cast(bits ^ ((bits >> 31) & 0x7FFFFFFF), wp.float32)


@exact_kernel
def write_codes_within(first: int, boxes: Boxes, found: wp.array(dtype=int), tree: MergedTree):
    """The same within corners that were found on the device."""
    low = wp.vec3()
    scale = wp.vec3()
    for axis in range(3):
        low[axis] = found_corner(found, axis)
        side = -found_corner(found, axis + 3) - low[axis]
        if side > wp.static(MIN_SIDE):
            scale[axis] = 1024.0 / side
    write_code(first + wp.tid(), boxes, low, scale, tree)


@exact_kernel
def begin_clusters(first: int, boxes: Boxes, count: int, tree: MergedTree):
    """Item: a triangle in the order of the codes. Writes its box; it is a cluster."""
    i = first + wp.tid()
    triangle = tree.triangle[i]
    for axis in range(3):
        store_float(tree.box, 8 * i + axis, boxes.low[axis, triangle])
        store_float(tree.box, 8 * i + 4 + axis, -boxes.high[axis, triangle])
    set_children(tree.box, i, wp.vec2i(-1, -1))
    tree.parent[i] = -1
    tree.parent[count + i] = -1
    tree.cluster[i] = wp.vec4i(i, i, 1, 0)
    tree.waiting[i] = -1


@native.func_native("merging.h", "wrt::merge_from(tree, i, count, by_area);")
def merge_from(tree: MergedTree, i: int, count: int, by_area: bool):
    """Goes up from triangle i."""


@cache
def make_merge_clusters() -> wp.Kernel:
    """The kernel that merges clusters. Item: a triangle; on CUDA, items fill whole warps."""

    def merge_clusters(first: int, count: int, by_area: bool, tree: MergedTree):
        merge_from(tree, first + wp.tid(), count, by_area)

    return specialised_kernel(merge_clusters, bounds=(BLOCK, BLOCKS))


def sort_by_codes(triangles: TriangleBoxes, tree: MergedTree) -> None:
    """Sorts the triangles by their codes; of equal codes, by their ids."""
    device, count = triangles.boxes.low.device, triangles.count
    if isinstance(triangles, AwaitedBoxes):
        launch(write_codes_within, count, [triangles.boxes, triangles.search.found, tree], device=device, chunk=CHUNK)
        wp.utils.radix_sort_pairs(tree.code, tree.triangle, count, 0, CODE_BITS)
        triangles.check()  # waits for the corners while the device sorts; clusters of NaN would not be merged
        return
    sides = (triangles.high - triangles.low).astype(np.float32)
    scale = np.where(sides > MIN_SIDE, np.float32(1024.0) / np.maximum(sides, np.float32(MIN_SIDE)), np.float32(0.0))
    corner = wp.vec3(*map(float, triangles.low))
    inputs = [triangles.boxes, corner, wp.vec3(*map(float, scale)), tree]
    launch(write_codes, count, inputs, device=device, chunk=CHUNK)
    wp.utils.radix_sort_pairs(tree.code, tree.triangle, count, 0, CODE_BITS)


def merge(triangles: TriangleBoxes, tree: MergedTree, by_area: bool = True) -> None:
    """Makes the tree over the sorted triangles, at least two.

    by_area: whether pairs of least surface area are merged; if not, neighbours are, in a tree of little depth.
    """
    device, count = triangles.boxes.low.device, triangles.count
    launch(begin_clusters, count, [triangles.boxes, count, tree], device=device, chunk=CHUNK)
    items = count if device.is_cpu else -(-count // BLOCK) * BLOCK
    launch(make_merge_clusters(), items, [count, by_area, tree], device=device, chunk=MERGE_CHUNK)
