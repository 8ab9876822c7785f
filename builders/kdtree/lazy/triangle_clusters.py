"""A coarse presort: triangles are sorted into the cells of a grid by the centres of their boxes (count, scan, fill).

A cluster contains the triangles of one grid cell: a range of triangle ids and the box of their boxes. No triangle is in two
clusters, and no triangle is read again until a ray comes near its cluster. A first pass over the triangles computes cells,
counts and boxes, separately for each chunk; a second pass writes the ids.

References: shevtsov-2007-kdtree (initial clustering); hunt-2007.
"""

from dataclasses import dataclass

import numpy as np
import warp as wp

from wrt.builders.triangle_boxes import Boxes
from wrt.kernels.layout import kdtree_nodes as kdtree
from wrt.kernels.runtime import native
from wrt.kernels.runtime.launch import get_num_threads, launch
from wrt.kernels.runtime.options import exact_kernel

MAX_CELLS = 1 << 15
"""Most cells of the grid, so that their boxes fit the second-level cache of a core."""

TRIANGLES_PER_CELL = 16
"""Triangles per cell of the grid, counting empty cells; a surface leaves most cells empty."""

MIN_CHUNK = 1 << 15
"""Least number of triangles in a chunk, because each chunk has its own table of boxes."""


@wp.struct
class Grid:
    """A grid of cells over a box."""

    low: wp.vec3
    scale: wp.vec3
    """Cells per unit of length."""
    cells: wp.vec3i
    """Cells along each axis."""


@dataclass
class Clusters:
    """Triangles, cluster after cluster.

    Attributes:
        order: (triangles,) ids; None for the order of all triangles that the tree has already.
        first: (clusters + 1,) start of each cluster in `order`, followed by the end of the last.
        low, high: (clusters, 3) float32, a box that strictly contains its triangles' boxes.
        core_low, core_high: (clusters, 3) float32, the part of that box in the cell of the grid. Cores do not overlap, so they
            give better candidate planes; the whole boxes decide which cells a cluster meets.
        are_meshes: whether the clusters are meshes, of any number of triangles.
        sorted_area: area of the boxes after the last sort, relative to that of the box around them; 0 if that was just now.
        ends: (clusters,) end of each cluster, if clusters do not follow one another; `first` is then (clusters,).
        nodes: (clusters,) the nodes of the scene that they are (`wrt.builders.kdtree.lazy.scene_groups`); None if none.
    """

    order: wp.array | None
    first: np.ndarray
    low: np.ndarray
    high: np.ndarray
    core_low: np.ndarray
    core_high: np.ndarray
    are_meshes: bool = False
    sorted_area: float = 0.0
    ends: np.ndarray | None = None
    nodes: np.ndarray | None = None

    @property
    def bounds(self) -> np.ndarray:
        """(clusters, 2) start and end of each in `order`."""
        begin, end = (self.first[:-1], self.first[1:]) if self.ends is None else (self.first, self.ends)
        return np.stack([begin, end], axis=1)

    @property
    def sizes(self) -> np.ndarray:
        """(clusters,) number of triangles of each."""
        return np.diff(self.first) if self.ends is None else self.ends - self.first


@native.func_native(
    "clusters.h",
    "const size_t cells = grid.cells.c[0] * (size_t)grid.cells.c[1] * grid.cells.c[2];\n"
    "int* counter = counts.data + chunk * cells;\n"
    "float* table = corners.data + chunk * cells * 8;\n"
    "const int begin = chunk * size, end = begin + size < ids.shape[0] ? begin + size : ids.shape[0];\n"
    "wrt::count_cells(boxes, ids.data, begin, end, grid, cell_of.data, counter, table, cells);",
)
def count_range(
    boxes: Boxes,
    ids: wp.array(dtype=int),
    size: int,
    grid: Grid,
    chunk: int,
    cell_of: wp.array(dtype=int),
    counts: wp.array2d(dtype=int),
    corners: wp.array2d(dtype=float),
):
    """Computes the cells of a chunk of `size` triangles and, per cell, their number and their box, (low, -high)."""


@wp.func_native(
    """
    int* __restrict__ place = places.data + (size_t)chunk * places.shape[1];
    for (int i = begin; i < end; ++i) order.data[place[cell_of.data[i]]++] = ids.data[i];
"""
)
def fill_range(
    ids: wp.array(dtype=int),
    begin: int,
    end: int,
    cell_of: wp.array(dtype=int),
    chunk: int,
    places: wp.array2d(dtype=int),
    order: wp.array(dtype=int),
):
    """Writes ids to the next positions of their cells."""


@exact_kernel
def count_cells(
    first: int,
    boxes: Boxes,
    ids: wp.array(dtype=int),
    size: int,
    grid: Grid,
    cell_of: wp.array(dtype=int),
    counts: wp.array2d(dtype=int),
    corners: wp.array2d(dtype=float),
):
    """Item: a chunk of `size` triangles. Computes their cells, and counts and boxes per cell."""
    count_range(boxes, ids, size, grid, first + wp.tid(), cell_of, counts, corners)


@exact_kernel
def fill_cells(
    first: int,
    ids: wp.array(dtype=int),
    size: int,
    cell_of: wp.array(dtype=int),
    places: wp.array2d(dtype=int),
    order: wp.array(dtype=int),
):
    """Item: a chunk of `size` triangles. Writes their ids, sorted by cell."""
    chunk = first + wp.tid()
    fill_range(ids, chunk * size, wp.min(ids.shape[0], (chunk + 1) * size), cell_of, chunk, places, order)


def make_grid(low: np.ndarray, high: np.ndarray, triangles: int) -> Grid:
    """A grid of nearly cubic cells over a box. Along an axis shorter than a cell there is one cell."""
    size = high.astype(np.float64) - low
    size = np.where(np.isfinite(size), size, 0.0)
    wanted = min(MAX_CELLS, max(1, triangles // TRIANGLES_PER_CELL))
    volumes = np.cumprod(np.sort(size)[::-1])
    edge = max((volumes / wanted) ** (1.0 / np.arange(1, 4)))
    cells = np.maximum(1, np.floor(size / edge)) if edge > 0.0 else np.ones(3)
    grid = Grid()
    grid.low = wp.vec3(*map(float, low))
    grid.scale = wp.vec3(*(float(c / s) if s > 0.0 else 0.0 for c, s in zip(cells, size, strict=True)))
    grid.cells = wp.vec3i(*map(int, cells))
    return grid


def sort_into_clusters(boxes: Boxes, ids: wp.array, low: np.ndarray, high: np.ndarray) -> Clusters:
    """Sorts triangles into clusters.

    Args:
        boxes: of all triangles of the mesh.
        ids: (triangles,) int32, the triangles to sort.
        low, high: (3,) the box that the grid divides; triangles may extend beyond it.
    """
    device, count = ids.device, len(ids)
    grid = make_grid(low, high, count)
    size = max(MIN_CHUNK, -(-count // get_num_threads()))
    chunks, cells = -(-count // size), int(np.prod(np.array(grid.cells)))
    cell_of, order = (wp.empty(count, dtype=int, device=device) for _ in range(2))
    counts = wp.empty((chunks, cells), dtype=int, device=device)
    corners = wp.empty((chunks, cells * 8), dtype=float, device=device)
    launch(count_cells, chunks, [boxes, ids, size, grid, cell_of, counts, corners], device=device, chunk=1)
    number = counts.numpy()
    total = number.sum(axis=0)
    first = np.cumsum(total) - total
    places = wp.array(first + np.cumsum(number, axis=0) - number, dtype=int, device=device)
    launch(fill_cells, chunks, [ids, size, cell_of, places, order], device=device, chunk=1)
    used = np.flatnonzero(total)
    box = corners.numpy().reshape(chunks, cells, 8)[:, used].min(axis=0)
    low, high = np.nextafter(box[:, :3], -np.float32(np.inf)), np.nextafter(-box[:, 4:7], np.float32(np.inf))
    core_low, core_high = cores(grid, used, low, high)
    return Clusters(order, np.append(first[used], count), low, high, core_low, core_high)


def cores(grid: Grid, used: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The parts of the clusters' boxes in their cells; used: numbers of the cells. Outer cells extend to infinity."""
    scale, cells = np.array(grid.scale, dtype=np.float32), np.array(grid.cells)
    place = np.stack(np.unravel_index(used, cells[::-1])[::-1], axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        begin, end = (np.array(grid.low, dtype=np.float32) + (place + step).astype(np.float32) / scale for step in (0, 1))
    begin, end = np.where(place > 0, begin, -np.inf), np.where(place < cells - 1, end, np.inf)
    return np.clip(begin, low, high).astype(np.float32), np.clip(end, low, high).astype(np.float32)


@exact_kernel
def list_leaves(
    first: int,
    nodes: wp.array(dtype=wp.vec2i),
    low: wp.array2d(dtype=float),
    high: wp.array2d(dtype=float),
    places: wp.array(dtype=int),
    counts: wp.array(dtype=int),
    leaves: wp.array(dtype=int),
):
    """Item: a cluster. Counts the leaves of a tree that its box, (clusters, 3), meets. If there is room, lists them from its
    position on."""
    cluster = first + wp.tid()
    stack = wp.zeros(shape=(kdtree.MAX_TREE_DEPTH,), dtype=int)
    size = int(1)
    count = int(0)
    while size > 0:
        size -= 1
        index = stack[size]
        node = nodes[index]
        axis = kdtree.split_axis(node)
        if axis == kdtree.LEAF:
            if leaves.shape[0] > 0:
                leaves[places[cluster] + count] = index
            count += 1
        else:
            if high[cluster, axis] > kdtree.split_position(node):
                stack[size] = kdtree.right_child(node)
                size += 1
            if low[cluster, axis] < kdtree.split_position(node):
                stack[size] = index + 1
                size += 1
    counts[cluster] = count


def leaves_of(clusters: Clusters, nodes: wp.array) -> tuple[np.ndarray, np.ndarray]:
    """The leaves of a tree that the clusters meet: (leaf, cluster) of every pair, in the order of the leaves."""
    device, count = nodes.device, len(clusters.low)
    low, high = (wp.array(corner, dtype=float, device=device) for corner in (clusters.low, clusters.high))
    places, counts, leaves = (wp.empty(n, dtype=int, device=device) for n in (count, count, 0))
    launch(list_leaves, count, [nodes, low, high, places, counts, leaves], device=device)
    number = counts.numpy().copy()
    places = wp.array(np.cumsum(number) - number, dtype=int, device=device)
    leaves = wp.empty(int(number.sum()), dtype=int, device=device)
    launch(list_leaves, count, [nodes, low, high, places, counts, leaves], device=device)
    leaf = leaves.numpy()
    order = np.argsort(leaf, kind="stable")
    return leaf[order], np.repeat(np.arange(count), number)[order]
