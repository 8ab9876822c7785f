"""The order in which points are searched: by cells of a grid along a Morton curve.

**Problem.** Points in any order visit any nodes, and nothing is known of their nearest triangle beforehand.

**Idea.** Neighbours on the curve are near each other. They visit the same nodes, and what is nearest to one is near the other.
There are 128 x 128 x 128 cells. On CPUs, each point begins with what was nearest to the one before it, and groups of points
begin below the nodes that all of them pass (notebooks/records/2026-11-28-points-begin-together.md). On CUDA, 32 points walk
side by side, and read the same nodes where they are nearest to each other (notebooks/records/2026-11-28-points-gpu.md).

References: morton-1966.
"""

import numpy as np
import warp as wp

from wrt.kernels.points.cell_sort import sort_by_cells
from wrt.kernels.runtime import native
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import exact_kernel

BITS = 7
"""Bits of the number of a cell along an axis."""

GROUP = 256
"""Points of an item on CPUs."""

MIN_PARALLEL = 16384
"""Fewest points that threads sort together: below, launches take as long."""


@native.func_native("point_cells.h", "wrt::find_cells(position.data + begin, count, low, scale, cell.data + begin);")
def find_range(
    position: wp.array(dtype=wp.vec3), begin: int, count: int, low: wp.vec3, scale: wp.vec3, cell: wp.array(dtype=int)
):
    """Writes the numbers of the cells of some points."""


@exact_kernel
def find_cells(
    first: int,
    position: wp.array(dtype=wp.vec3),
    group: int,
    low: wp.vec3,
    scale: wp.vec3,
    cell: wp.array(dtype=int),
    number: wp.array(dtype=int),
):
    """Item: a group of points. Writes the numbers of their cells; if there is room, and a group is one point, its own, too."""
    begin = (first + wp.tid()) * group
    if number.shape[0] > 0:
        number[begin] = begin
    find_range(position, begin, wp.min(group, position.shape[0] - begin), low, scale, cell)


def grid_scale(low: wp.vec3, high: wp.vec3) -> wp.vec3:
    """Cells in a unit of length, along each axis of a box."""
    return wp.vec3(*(float(1 << BITS) / max(float(b) - float(a), 1e-30) for a, b in zip(low, high, strict=True)))


def sort_cells(cell: wp.array, order: wp.array, count: int) -> None:
    """Sorts the numbers of points by their cells, both as `find_cells` wrote them one by one; stable. On CUDA both arrays have
    room for twice as many, and cells are sorted, too."""
    if cell.device.is_cuda:
        wp.utils.radix_sort_pairs(cell, order, count, 0, 3 * BITS)
    else:
        order.numpy()[:count] = sorted_numbers(cell.numpy()[:count])


def sorted_numbers(cells: np.ndarray) -> np.ndarray:
    """(N,) numbers of points in the order of their cells; by one thread."""
    found = np.argsort(cells.astype(np.uint16), kind="stable")  # numbers of 16 bits sort by their digits, others do not
    return found[np.argsort((cells >> 16).astype(np.uint8)[found], kind="stable")]


def morton_order(position: wp.array, low: wp.vec3, high: wp.vec3) -> wp.array:
    """(N,) int32: numbers of points along the curve through the box, on their device; stable.

    Args:
        position: (N,) vec3.
        low, high: the box.
    """
    device, count = position.device, len(position)
    on_cuda = device.is_cuda
    cell = wp.empty(2 * count if on_cuda else count, dtype=int, device=device)  # Warp's sort needs twice the space
    order = wp.empty(2 * count if on_cuda else 0, dtype=int, device=device)
    group = 1 if on_cuda else GROUP
    inputs = [position, group, low, grid_scale(low, high), cell, order]
    launch(find_cells, -(-count // group), inputs, device=device, chunk=4096 // group)
    if on_cuda:
        sort_cells(cell, order, count)
        return order[:count]
    if count >= MIN_PARALLEL:
        sort_by_cells(cell)
        return cell
    return wp.array(sorted_numbers(cell.numpy()).astype(np.int32), dtype=int, device=device)
