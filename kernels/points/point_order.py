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

from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import exact_kernel

BITS = 7
"""Bits of the number of a cell along an axis."""


@wp.func
def cell_of(offset: float, scale: float):
    """Number of a cell along an axis, its bits apart by two zeros; coordinates outside of the grid, and NaN, are clamped."""
    place = offset * scale
    last = float(wp.static((1 << BITS) - 1))
    cell = int(wp.where(place >= 0.0, wp.where(place < last, place, last), 0.0))
    apart = int(0)
    for bit in range(wp.static(BITS)):
        apart = apart | (((cell >> bit) & 1) << (3 * bit))
    return apart


@exact_kernel
def find_cells(
    first: int,
    position: wp.array(dtype=wp.vec3),
    low: wp.vec3,
    scale: wp.vec3,
    cell: wp.array(dtype=int),
    number: wp.array(dtype=int),
):
    """Writes the number of a point's cell along the curve, and the point's own. Item: a point."""
    i = first + wp.tid()
    number[i] = i
    place = position[i] - low
    cell[i] = 4 * cell_of(place[0], scale[0]) + 2 * cell_of(place[1], scale[1]) + cell_of(place[2], scale[2])


def grid_scale(low: wp.vec3, high: wp.vec3) -> wp.vec3:
    """Cells in a unit of length, along each axis of a box."""
    return wp.vec3(*(float(1 << BITS) / max(float(b) - float(a), 1e-30) for a, b in zip(low, high, strict=True)))


def sort_cells(cell: wp.array, order: wp.array, count: int) -> None:
    """Sorts points by their cells, by what `find_cells` wrote of them; stable. order: their numbers, which are moved.

    On CUDA both arrays have room for twice as many, and cells are sorted, too.
    """
    if cell.device.is_cuda:
        wp.utils.radix_sort_pairs(cell, order, count, 0, 3 * BITS)
        return
    numbers = cell.numpy()[:count]
    found = np.argsort(numbers.astype(np.uint16), kind="stable")  # numbers of 16 bits sort by their digits, others do not
    order.numpy()[:count] = found[np.argsort((numbers >> 16).astype(np.uint8)[found], kind="stable")]


def morton_order(position: wp.array, low: wp.vec3, high: wp.vec3) -> wp.array:
    """(N,) int32: numbers of points along the curve through the box, on their device; stable.

    Args:
        position: (N,) vec3.
        low, high: the box.
    """
    device, count = position.device, len(position)
    cell, order = (wp.empty(2 * count if device.is_cuda else count, dtype=int, device=device) for _ in range(2))
    launch(find_cells, count, [position, low, grid_scale(low, high), cell, order], device=device, chunk=4096)
    sort_cells(cell, order, count)
    return order[:count]
