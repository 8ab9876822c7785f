"""Memory layout of a light buffer: a cube of directions around a point light, and for each of its cells a list of triangles.

A direction c from the light belongs to the face of the axis along which it is longest: face 2 a if c[a] > 0, 2 a + 1 if it is
negative. On the face it lies at u = c[a + 1] / |c[a]|, v = c[a + 2] / |c[a]|, axes in cyclic order, each from -1 to 1. A face
has R x R cells; cell (i, j) of face f is number (f R + j) R + i, i along u. The *depth* of a point is |c[a]|.

A cell is four words:

    begin     index of the first entry of its list
    count     number of entries
    far       bits of a float32: behind this depth every shadow ray of the cell is occluded; inf if no triangle covers the cell
    first     bits of a float32: the least depth of its entries; inf if there is none

An entry is 64 bits: the least depth at which a shadow ray of the cell can hit the triangle (bits of a float32, never negative)
in the upper 32, its number in the lower 32. Lists are sorted by entry, so by depth, then by triangle. A list contains no
triangle behind the depth `far` of its cell.

References: haines-greenberg-1986.
"""

import warp as wp

FACES = 6

CELL_WORDS = 4
CELL_BYTES = 4 * CELL_WORDS
ENTRY_BYTES = 8

MAX_RESOLUTION = 4096
"""Greatest number of cells along an edge of a face."""

CELL_SLACK = 2.0**-20
"""Distance in u and v by which rounding may place a ray in a neighbouring cell; see `wrt.builders.lights.light_raster`."""

DEPTH_SLACK = 2.0**-20
"""Relative error of depths in float32, on either side of a comparison."""


@wp.struct
class LightCells:
    """The light buffer as kernels read it."""

    cells: wp.array(dtype=int)
    """(6 * R * R * 4,) cell words."""
    entries: wp.array(dtype=wp.uint64)
    resolution: int
    """R."""
    limit: float
    """Greatest reach (`wrt.kernels.simd.boxes.reach`) of a ray for which the lists are complete."""
    slack: float
    """Greatest distance of a hit from the exact line between light and point, plus that from its triangle."""
    low: wp.vec3
    """`low` and `high` bound the scene, relative to its centre."""
    high: wp.vec3
