"""Points of regular grids in blocks of 8 x 8 x 8, and the values that they get.

Points of a block follow a Morton curve, so that some that follow each other are near each other.

References: morton-1966.
"""

import warp as wp

from wrt.kernels.runtime.options import exact_kernel

BLOCK = wp.constant(8)
"""Points of a block along an axis."""

BLOCK_POINTS = wp.constant(512)
"""Points of a block."""


@wp.struct
class Grid:
    """The points of a grid."""

    origin: wp.vec3d
    """The first point."""
    spacing: wp.float64
    """Distance of neighbours along each axis."""
    shape: wp.vec3i
    """Points along each axis; blocks reach beyond them."""
    blocks: wp.array(dtype=wp.vec3i)
    """(B,) the first point of each block."""


@wp.func
def index_of(grid: Grid, i: int):
    """Which point of the grid is point i of the blocks."""
    place = i % BLOCK_POINTS
    inner = wp.vec3i(
        ((place >> 2) & 1) | ((place >> 4) & 2) | ((place >> 6) & 4),
        ((place >> 1) & 1) | ((place >> 3) & 2) | ((place >> 5) & 4),
        (place & 1) | ((place >> 2) & 2) | ((place >> 4) & 4),
    )
    return grid.blocks[i // BLOCK_POINTS] + inner


@exact_kernel
def place_points(first: int, grid: Grid, points: wp.array(dtype=wp.vec3d)):
    """Writes a point of a block. Item: a point."""
    i = first + wp.tid()
    points[i] = grid.origin + grid.spacing * wp.vec3d(index_of(grid, i))


@exact_kernel
def place_middles(first: int, grid: Grid, points: wp.array(dtype=wp.vec3d)):
    """Writes the middle of a block. Item: a block."""
    i = first + wp.tid()
    half = wp.float64(0.5) * wp.float64(BLOCK - 1)
    points[i] = grid.origin + grid.spacing * (wp.vec3d(grid.blocks[i]) + wp.vec3d(half, half, half))


@exact_kernel
def store_values(
    first: int,
    grid: Grid,
    distance: wp.array(dtype=float),
    middle: wp.array(dtype=float),
    band: float,
    values: wp.array3d(dtype=float),
):
    """Stores the value of a point, if it is in the grid. Item: a point.

    Args:
        first, grid: of the blocks.
        distance: (B * 512,) or (0,) for those whose points are all farther than the band.
        middle: (B,) of the middle of each block, whose sign counts; (0,) where distances have signs.
        band: greatest absolute value.
        values: is filled.
    """
    i = first + wp.tid()
    at = index_of(grid, i)
    if at[0] < grid.shape[0] and at[1] < grid.shape[1] and at[2] < grid.shape[2]:
        value = band
        if distance.shape[0] > 0:
            value = distance[i]
        if middle.shape[0] > 0 and middle[i // BLOCK_POINTS] < 0.0:
            value = -value
        if value > band:
            value = band
        if value < -band:
            value = -band
        values[at[0], at[1], at[2]] = value
