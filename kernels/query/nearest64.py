"""Nearest hits by brute force in float64: every triangle, by the watertight test's arithmetic (Woop, Benthin, Wald 2013); and
winding numbers, by the solid angles of all triangles (van Oosterom, Strackee 1983).

The reference that scenes are checked against (`Scene.verify`). A triangle's corners are sheared so that the ray is the third
axis; the ray meets the triangle, edges included, if it is on the same side of all three edges. Threads and blocks of rays never
change an answer.

References: van-oosterom-strackee-1983; woop-2013.
"""

import numpy as np
import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.launch import as_device, get_num_threads, launch
from wrt.kernels.runtime.options import exact_kernel

LANES = 8
"""Triangles that are tested at a time."""

TILE = wp.constant(1024)
"""Triangles that stay in the cache while each ray of a block is tested against them; a multiple of LANES."""

MAX_RAYS = 8
"""Rays of a block."""


@wp.struct
class Nearest:
    """The nearest hit so far."""

    t: wp.float64
    triangle: int
    """-1: none."""


@native.func_native(
    "nearest64.h",
    f"wrt::nearest_of<{LANES}>(corners.data, corners.shape[1], begin, end, origin.c, direction.c, z, found);",
)
def test_tile(
    corners: wp.array2d(dtype=wp.float64),
    begin: int,
    end: int,
    origin: wp.vec3d,
    direction: wp.vec3d,
    z: int,
    found: wp.ref[Nearest],
):
    """Tests the triangles begin .. end - 1; of equally near ones the first counts. z: as in `longest_axis`."""


@wp.func
def longest_axis(direction: wp.vec3d):
    """The axis along which a ray is longest; -1 if it is no ray: zero, infinite or NaN."""
    size = wp.vec3d(wp.abs(direction[0]), wp.abs(direction[1]), wp.abs(direction[2]))
    axis = wp.where(size[1] > size[0], 1, 0)
    axis = wp.where(size[2] > size[axis], 2, axis)
    valid = size[axis] > wp.float64(0.0)
    for other in range(3):
        valid = valid and size[other] < wp.float64(wp.static(float("inf")))
    return wp.where(valid, axis, -1)


@exact_kernel
def find_nearest(
    first: int,
    size: int,
    corners: wp.array2d(dtype=wp.float64),
    origins: wp.array(dtype=wp.vec3d),
    directions: wp.array(dtype=wp.vec3d),
    hits: wp.array(dtype=Nearest),
):
    """Item: a block of `size` rays."""
    begin = (first + wp.tid()) * size
    end = wp.min(begin + size, origins.shape[0])
    for tile in range(0, corners.shape[1], TILE):
        tile_end = wp.min(tile + TILE, corners.shape[1])
        for ray in range(begin, end):
            direction = directions[ray]
            z = longest_axis(direction)
            if z >= 0:
                found = hits[ray]
                test_tile(corners, tile, tile_end, origins[ray], direction, z, found)
                hits[ray] = found


@exact_kernel
def sum_angles(
    first: int, corners: wp.array2d(dtype=wp.float64), points: wp.array(dtype=wp.vec3d), sums: wp.array(dtype=wp.float64)
):
    """Item: a point. Half the sum of the solid angles of all triangles, positive where a triangle's back is seen."""
    i = first + wp.tid()
    total = wp.float64(0.0)
    for k in range(corners.shape[1]):
        a = wp.vec3d(corners[0, k], corners[1, k], corners[2, k]) - points[i]
        b = wp.vec3d(corners[3, k], corners[4, k], corners[5, k]) - points[i]
        c = wp.vec3d(corners[6, k], corners[7, k], corners[8, k]) - points[i]
        la, lb, lc = wp.length(a), wp.length(b), wp.length(c)
        total += wp.atan2(wp.dot(a, wp.cross(b, c)), la * lb * lc + wp.dot(a, b) * lc + wp.dot(b, c) * la + wp.dot(c, a) * lb)
    sums[i] = total


def vertex_rows(vertices: np.ndarray, faces: np.ndarray) -> wp.array:
    """(9, T) float64: x, y, z of the first corners, of the second and of the third.

    Padded to whole lanes with triangles without area, which no ray hits."""
    rows = np.zeros((9, -(-len(faces) // LANES) * LANES))
    for corner in range(3):
        for axis in range(3):
            np.take(vertices[:, axis], faces[:, corner], out=rows[3 * corner + axis, : len(faces)])
    return wp.array(rows, dtype=wp.float64, device=as_device("cpu"), copy=False)


def nearest_hits(corners: wp.array, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nearest hits at t >= 0, edges included: ((N,) int triangle or -1, (N,) float64 t or inf).

    Args:
        corners: as in `vertex_rows`.
        origins, directions: (N, 3) float64.
    """
    count, device = len(origins), corners.device
    rays = [wp.array(np.ascontiguousarray(a, dtype=np.float64), dtype=wp.vec3d, device=device) for a in (origins, directions)]
    start = np.zeros(count, dtype=Nearest.numpy_dtype())
    start["t"], start["triangle"] = np.inf, -1
    hits = wp.array(start, dtype=Nearest, device=device)
    size = max(1, min(MAX_RAYS, count // (4 * get_num_threads())))
    launch(find_nearest, -(-count // size), [size, corners, *rays, hits], device=device, chunk=1, longest=64)
    found = hits.numpy()
    return found["triangle"].astype(np.int64), found["t"].copy()


def winding_numbers(corners: wp.array, points: np.ndarray) -> np.ndarray:
    """(N,) float64: how often a surface that faces outward surrounds each point; a whole number if the surface is closed.

    Args:
        corners: as in `vertex_rows`.
        points: (N, 3) float64.
    """
    device = corners.device
    sums = wp.zeros(len(points), dtype=wp.float64, device=device)
    places = wp.array(np.ascontiguousarray(points, dtype=np.float64), dtype=wp.vec3d, device=device)
    launch(sum_angles, len(points), [corners, places, sums], device=device, chunk=1, longest=64)
    return sums.numpy() / (2.0 * np.pi)
