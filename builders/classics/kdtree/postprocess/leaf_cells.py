"""What lies in the cell of a leaf: which of its triangles meet it, and the box of their parts there.

The clip is that of `core.clip`, with cells enlarged by the same pad, so a triangle that is removed is as far from the cell
as there, and no hit is lost.
"""

import numpy as np
import warp as wp

from wrt.builders.core.clip import ClippedMesh, clipped_mesh
from wrt.builders.kdtree.kdtree_statistics import UnpackedKdTree
from wrt.builders.tree import KdTree
from wrt.builders.triangle_boxes import Boxes, TriangleBoxes
from wrt.kernels.runtime import native
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import exact_module

exact_module(__name__)


@native.func_native(
    "clip.h",
    "const auto cell = wrt::cell_of(low, high, lists.pad);\n"
    "const int* triangles = primitive.data + begin;\n"
    "return wrt::measure_leaf(lists, cell, boxes, triangles, count, tested, keeps.data + begin, inner_low, inner_high);",
)
def measure_range(
    lists: ClippedMesh,
    boxes: Boxes,
    primitive: wp.array(dtype=int),
    begin: int,
    count: int,
    low: wp.vec3,
    high: wp.vec3,
    tested: bool,
    keeps: wp.array(dtype=wp.uint8),
    inner_low: wp.ref[wp.vec3],
    inner_high: wp.ref[wp.vec3],
) -> int:
    """Marks the triangles in primitive[begin .. begin + count - 1] that meet a cell, all of them if they are not `tested`.
    Returns their number, and the box of these triangles, or of their parts, within the cell."""
    ...


@wp.kernel
def measure_leaves(
    first: int,
    mesh: ClippedMesh,
    boxes: Boxes,
    primitive: wp.array(dtype=int),
    begin: wp.array(dtype=int),
    count: wp.array(dtype=int),
    low: wp.array(dtype=wp.vec3),
    high: wp.array(dtype=wp.vec3),
    tested: bool,
    keeps: wp.array(dtype=wp.uint8),
    kept: wp.array(dtype=int),
    inner_low: wp.array(dtype=wp.vec3),
    inner_high: wp.array(dtype=wp.vec3),
):
    """Item: a leaf. See `measure_range`; begin: first lane of its list."""
    leaf = first + wp.tid()
    box_low = wp.vec3()
    box_high = wp.vec3()
    kept[leaf] = measure_range(
        mesh, boxes, primitive, begin[leaf], count[leaf], low[leaf], high[leaf], tested, keeps, box_low, box_high
    )
    inner_low[leaf] = box_low
    inner_high[leaf] = box_high


def leaf_contents(
    tree: KdTree, flat: UnpackedKdTree, triangles: TriangleBoxes, tested: bool, shrinks: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """What the leaves of a tree contain.

    Args:
        tree: the tree, on the device of the boxes.
        flat: its nodes.
        triangles: its triangles.
        tested: whether triangles are tested against the cells.
        shrinks: whether boxes are those of the triangles' parts in the cells; needs `tested`.

    Returns:
        keeps: (lanes,) bool, whether a lane of `primitive` holds a triangle that meets its leaf's cell.
        kept: (leaves,) number of these, leaf by leaf in the order of the nodes.
        low, high: (leaves, 3) float32, the box of what a leaf keeps within its cell; empty if it keeps nothing.
    """
    device, leaves = tree.nodes.device, np.flatnonzero(flat.is_leaf)
    mesh = clipped_mesh(triangles, triangles.size, shrinks) if tested else ClippedMesh()
    begin, count = (
        wp.array(a[leaves].astype(np.int32), device=device) for a in (flat.first_block * tree.width, flat.triangles)
    )
    low, high = (wp.array(a[leaves].astype(np.float32), dtype=wp.vec3, device=device) for a in (flat.low, flat.high))
    keeps = wp.zeros(len(tree.primitive), dtype=wp.uint8, device=device)
    kept = wp.empty(len(leaves), dtype=int, device=device)
    inner_low, inner_high = (wp.empty(len(leaves), dtype=wp.vec3, device=device) for _ in range(2))
    inputs = [mesh, triangles.boxes, tree.primitive, begin, count, low, high, tested, keeps, kept, inner_low, inner_high]
    launch(measure_leaves, len(leaves), inputs, device=device, chunk=256)
    return keeps.numpy() != 0, kept.numpy(), inner_low.numpy(), inner_high.numpy()
