"""Finds the triangles of cells that are to be built (`lazy_kdtree`) among those of the clusters that may meet a cell.

A cell's list of triangles is complete if its list of clusters is: a triangle whose box meets the interior of a cell belongs to
a cluster whose box does. A triangle in the plane between two cells belongs to the upper one. Clusters extend slightly beyond
their triangles (`triangle_clusters`), so that both cells list its cluster.

The phases are count, scan and fill. One item is a pair of a cell and a cluster.
"""

import numpy as np
import warp as wp

from wrt.builders.core.subtrees import Frame
from wrt.builders.triangle_boxes import Boxes
from wrt.kernels.runtime import native
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import exact_kernel


@wp.struct
class Pair:
    """A cell and a cluster whose box meets it."""

    low: wp.vec3
    """The cell."""
    high: wp.vec3
    planar_end: wp.vec3
    """Upper bound of the planar triangles of the cell: its upper corner, or more if the cell ends with the scene."""
    begin: int
    """First of the cluster's triangles; `end` is one past the last."""
    end: int
    to: int
    """Position to which the ids of the triangles in the cell are written."""


@native.func_native("clusters.h", "return wrt::choose_triangles(boxes, order.data, pair, writing, ids.data);")
def choose_triangles(boxes: Boxes, order: wp.array(dtype=int), pair: Pair, writing: bool, ids: wp.array(dtype=int)) -> int:
    """Counts the triangles of a cluster that are in a cell, and writes their ids if `writing`."""


@exact_kernel
def count_pairs(first: int, boxes: Boxes, order: wp.array(dtype=int), pairs: wp.array(dtype=Pair), counts: wp.array(dtype=int)):
    """Item: a pair. Writes its number of triangles."""
    i = first + wp.tid()
    counts[i] = choose_triangles(boxes, order, pairs[i], False, counts)


@exact_kernel
def fill_pairs(first: int, boxes: Boxes, order: wp.array(dtype=int), pairs: wp.array(dtype=Pair), ids: wp.array(dtype=int)):
    """Item: a pair. Writes the ids of its triangles."""
    choose_triangles(boxes, order, pairs[first + wp.tid()], True, ids)


@native.func_native("clusters.h", "wrt::gather_references(boxes, ids.data, references.data, frame);")
def gather_references(boxes: Boxes, ids: wp.array(dtype=int), references: wp.array(dtype=float), frame: wp.ref[Frame]):
    """Writes the references of a node's ids, and computes their box."""


@exact_kernel
def list_references(
    first: int, boxes: Boxes, ids: wp.array(dtype=int), references: wp.array(dtype=float), frames: wp.array(dtype=Frame)
):
    """Item: a node to build. Its list begins at frame.first[0], in ids and in references."""
    number = first + wp.tid()
    frame = frames[number]
    gather_references(boxes, ids, references, frame)
    frames[number] = frame


def list_triangles(boxes: Boxes, order: wp.array, pairs: np.ndarray) -> tuple[wp.array, np.ndarray]:
    """The triangles of every pair: (ids in the order of the pairs, (pairs,) their numbers). Sets `to` of the `Pair` records."""
    device, count = order.device, len(pairs)
    counts = wp.empty(count, dtype=int, device=device)
    launch(count_pairs, count, [boxes, order, wp.array(pairs, dtype=Pair, device=device), counts], device=device, chunk=16)
    numbers = counts.numpy()
    pairs["to"] = np.cumsum(numbers) - numbers
    ids = wp.empty(int(numbers.sum()), dtype=int, device=device)
    launch(fill_pairs, count, [boxes, order, wp.array(pairs, dtype=Pair, device=device), ids], device=device, chunk=16)
    return ids, numbers


def as_roots(
    boxes: Boxes, cells: np.ndarray, ids: wp.array, first: np.ndarray, sizes: np.ndarray
) -> tuple[wp.array, np.ndarray]:
    """The references of cells, and the cells as roots of subtrees, structured as `Frame`.

    Args:
        boxes: of all triangles.
        cells: (cells,) `wrt.builders.kdtree.lazy.lazy_kdtree.CELL`.
        ids: triangles, cell after cell.
        first, sizes: (cells,) start and number of each cell's triangles.
    """
    frame = np.zeros(len(cells), dtype=Frame.numpy_dtype())
    for name in ("low", "high", "depth"):
        frame[name] = cells[name]
    frame["path"]["growth"] = cells["growth"]
    frame["parent"] = -1
    frame["triangles"] = frame["count"][:, 0] = sizes
    frame["first"][:, 0] = first
    references = wp.empty(8 * len(ids), dtype=float, device=ids.device)
    frames = wp.array(frame, dtype=Frame, device=ids.device)
    launch(list_references, len(cells), [boxes, ids, references, frames], device=ids.device, chunk=1)
    return references, frames.numpy()
