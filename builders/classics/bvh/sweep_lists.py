"""What an exact sweep build works on: the triangles' boxes, and their ids sorted by centroid along each axis (`sweep`)."""

import warp as wp

from wrt.builders.bvh.phases.binary_tree import Frame
from wrt.builders.radix_sort import sort_rows
from wrt.builders.triangle_boxes import Boxes, TriangleBoxes
from wrt.kernels.layout.struct_arrays import with_known_layout
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.boxes import INFINITY, max_of, min_of

exact_module(__name__)

EMIT_CHUNK = 4096
"""Triangles whose keys are worth a chunk of their own."""


@wp.struct
class SweepLists:
    """Memory of the build. A node has the same part of each of the three lists, in one of two buffers."""

    corner: wp.array(dtype=wp.vec3)
    """(2 * triangles,) lower and upper corner of each triangle's box."""
    sorted: wp.array2d(dtype=int)
    """(3, 2 * triangles) two buffers of ids by centroid along each axis, then by id."""
    suffix: wp.array2d(dtype=float)
    """(3, 2 * triangles) half areas of the boxes of all triangles from here to the end of the node's list; the second half is
    room to sort."""
    spare: wp.array(dtype=int)
    """(triangles,) the right side of a list while it is partitioned."""
    on_left: wp.array(dtype=wp.uint8)
    """(triangles,)"""


@with_known_layout
@wp.struct
class Partition:
    """The best partition found."""

    cost: float
    axis: int
    left: int
    """Triangles on the left."""


@wp.struct
class Box:
    """The box of some triangles."""

    low: wp.vec3
    high: wp.vec3


@wp.func
def empty_box():
    """The box of no triangle."""
    corner = wp.vec3(INFINITY, INFINITY, INFINITY)
    return Box(corner, -corner)


@wp.func
def enlarged(box: Box, lists: SweepLists, triangle: int):
    """A box that holds a triangle too."""
    return Box(min_of(box.low, lists.corner[2 * triangle]), max_of(box.high, lists.corner[2 * triangle + 1]))


@wp.func
def joined(a: Box, b: Box):
    """The box around two boxes."""
    return Box(min_of(a.low, b.low), max_of(a.high, b.high))


@wp.func
def area_of(box: Box):
    """Half the surface area of a box."""
    size = box.high - box.low
    return size[0] * size[1] + size[1] * size[2] + size[2] * size[0]


@wp.func
def store_box(to: wp.array(dtype=float), node: int, box: Box):
    """Writes a node's box, in the layout of `BinaryTree.box`."""
    for axis in range(3):
        to[node * 8 + axis] = box.low[axis]
        to[node * 8 + 4 + axis] = -box.high[axis]


@wp.func
def mark_sides(lists: SweepLists, frame: Frame, best: Partition, begin: int, end: int):
    """Notes on which side of a node's partition the triangles begin .. end - 1 of the partition's axis are."""
    for i in range(begin, end):
        triangle = lists.sorted[best.axis, frame.buffer + i]
        lists.on_left[triangle] = wp.where(i < frame.first + best.left, wp.uint8(1), wp.uint8(0))


@wp.kernel
def emit_keys(first: int, boxes: Boxes, lists: SweepLists):
    """Item: a triangle. Writes its box, and its centroids, which are sorted later, to `SweepLists.suffix`."""
    i = first + wp.tid()
    low = wp.vec3(boxes.low[0, i], boxes.low[1, i], boxes.low[2, i])
    high = wp.vec3(boxes.high[0, i], boxes.high[1, i], boxes.high[2, i])
    lists.corner[2 * i] = low
    lists.corner[2 * i + 1] = high
    for axis in range(3):
        lists.suffix[axis, i] = low[axis] + high[axis]
        lists.sorted[axis, i] = i


def sorted_lists(triangles: TriangleBoxes) -> SweepLists:
    """The lists of the root, in the first buffer. No centroid is NaN or -0.0, as no corner is."""
    count, device = triangles.count, triangles.boxes.low.device
    lists = SweepLists()
    lists.corner = wp.empty(2 * count, dtype=wp.vec3, device=device)
    lists.sorted = wp.empty((3, 2 * count), dtype=int, device=device)
    lists.suffix = wp.empty((3, 2 * count), dtype=float, device=device)
    lists.spare = wp.empty(count, dtype=int, device=device)
    lists.on_left = wp.empty(count, dtype=wp.uint8, device=device)
    launch(emit_keys, count, [triangles.boxes, lists], device=device, chunk=EMIT_CHUNK)
    sort_rows(lists.suffix, lists.sorted, wp.vec3i(count, count, count))
    return lists
