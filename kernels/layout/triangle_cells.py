"""The cell of a grid in which the middle of each triangle's box lies."""

import warp as wp

from wrt.kernels.runtime.options import exact_kernel


@exact_kernel
def triangle_cells(
    first: int,
    vertices: wp.array(dtype=wp.vec3d),
    faces: wp.array(dtype=wp.vec3i),
    low: wp.vec3d,
    scale: wp.vec3d,
    cells: wp.vec3i,
    cell: wp.array(dtype=int),
):
    """Writes the number of a triangle's cell, (x cells[1] + y) cells[2] + z. Item: a triangle.

    Args:
        vertices, faces: of the mesh.
        low, scale: a coordinate p lies in the cell (p - low) scale, rounded down and clamped to the grid.
        cells: of the grid along each axis.
    """
    i = first + wp.tid()
    face = faces[i]
    a = vertices[face[0]]
    b = vertices[face[1]]
    c = vertices[face[2]]
    number = int(0)
    for axis in range(3):
        lower = wp.min(a[axis], wp.min(b[axis], c[axis]))
        upper = wp.max(a[axis], wp.max(b[axis], c[axis]))
        middle = wp.float64(0.5) * lower + wp.float64(0.5) * upper
        place = wp.clamp(int((middle - low[axis]) * scale[axis]), 0, cells[axis] - 1)
        number = number * cells[axis] + place
    cell[i] = number
