"""The arrays of a mesh and of a terrain: checked once, and copied so that nothing can change them afterwards; their measures.

Kernels follow the indices in `faces` without checks, so the checked values must not change.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from wrt.kernels.validation import as_numbers, host_array


def as_array(values: Any, argument: str) -> np.ndarray:
    """A NumPy array of a caller's argument.

    Raises:
        TypeError: it cannot be read as one, such as a tensor that records gradients.
        ValueError: rows of different lengths; masked values.
    """
    try:
        array = host_array(argument, values)
    except TypeError as error:
        if not isinstance(error.__cause__, ValueError):
            raise
        # NumPy raises this for rows of different lengths
        raise ValueError(f"{argument} must be an array of shape (N, 3), three numbers in every row: {error}") from error
    return array if array.dtype.isnative else array.astype(array.dtype.newbyteorder("="))


def checked_vertices(vertices: Any) -> np.ndarray:
    """(V, 3) float32 or float64, frozen.

    Raises:
        TypeError, ValueError: as `wrt.TriangleMesh`.
    """
    array = as_array(vertices, "vertices")
    if array.dtype.kind not in "fiu":
        raise TypeError(f"vertices must be real numbers, got dtype {array.dtype}; convert them to float32 or float64")
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"vertices must have shape (V, 3), got {array.shape}; reshape to one point a row")
    kept = array.dtype.type in (np.float32, np.float64)
    array = frozen(array.astype(array.dtype.type if kept else np.float64, copy=False))
    each = np.isfinite(array)
    if not each.all():
        finite = each.all(axis=1)
        first = int(np.argmin(finite))
        raise ValueError(
            f"vertices must be finite: {int((~finite).sum())} of {len(array)} are NaN or infinite, the first is "
            f"vertex {first} = {array[first].tolist()}; remove or repair them (and the faces that use them)"
        )
    return array


def checked_faces(faces: Any, vertex_count: int) -> np.ndarray:
    """(F, 3) int32, frozen; F >= 1, all indices below `vertex_count`.

    Raises:
        TypeError, ValueError: as `wrt.TriangleMesh`.
    """
    array = as_array(faces, "faces")
    if array.size == 0:
        raise ValueError("faces is empty: a mesh needs at least one triangle, an index array of shape (F, 3)")
    if array.dtype.kind not in "iu":
        raise TypeError(f"faces must be integer vertex indices, got dtype {array.dtype}; convert with .astype('int32')")
    if array.ndim == 2 and array.shape[1] == 4:
        raise ValueError(
            f"faces has shape {array.shape}: these look like quads; triangulate them, "
            "for example with np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])"
        )
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"faces must have shape (F, 3), got {array.shape}; reshape to one triangle a row")
    if array.dtype == np.int32:
        array = frozen(array)  # copied before the check: the caller could change the original
    if array.min() < 0 or array.max() >= vertex_count:
        bad = (array < 0) | (array >= vertex_count)
        first = int(np.argmax(bad.any(axis=1)))
        index = int(array[first][bad[first]][0])
        raise ValueError(
            f"faces[{first}] refers to vertex {index}, but there are {vertex_count} vertices (valid: 0 to "
            f"{vertex_count - 1}); faces affected: {int(bad.any(axis=1).sum())}. Are the indices one-based?"
        )
    return frozen(array.astype(np.int32, copy=False))


def frozen(array: np.ndarray) -> np.ndarray:
    """A contiguous read-only copy in the memory of a `bytes` object, so that it cannot be made writable again. An array
    that already is one is returned as it is.
    """
    owner = array
    while isinstance(owner, np.ndarray) and not owner.flags.writeable:  # arrays from a pickle may be writable views of bytes
        owner = owner.base
    if isinstance(owner, bytes) and array.flags.c_contiguous:
        return array.view(np.ndarray)
    return np.frombuffer(array.tobytes(), dtype=array.dtype).reshape(array.shape)


# An angle below four rounding steps of float64 cannot be told from zero: the triangle counts as degenerate.
_SINE_OF_DEGENERATE = 4.0 * np.finfo(np.float64).eps


def extremes(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Smallest and largest value of each column of an (N, 3) array. By column, NumPy takes a twentieth of the time."""
    columns = points.T
    return np.array([column.min() for column in columns]), np.array([column.max() for column in columns])


def normals_and_areas(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals (F, 3), zero where degenerate, and areas (F,).

    Both edges are first scaled to about unit length, so that products neither underflow nor overflow.
    """
    corner = vertices[faces[:, 0]].astype(np.float64)
    edge1 = vertices[faces[:, 1]] - corner
    edge2 = vertices[faces[:, 2]] - corner
    scale1 = np.abs(edge1).max(axis=1)
    scale2 = np.abs(edge2).max(axis=1)
    edge1 /= np.where(scale1 > 0.0, scale1, 1.0)[:, None]
    edge2 /= np.where(scale2 > 0.0, scale2, 1.0)[:, None]
    normals = np.cross(edge1, edge2)
    lengths = np.linalg.norm(normals, axis=1)
    lengths[lengths <= _SINE_OF_DEGENERATE] = 0.0  # both edges have lengths from 1 to sqrt(3), or zero
    normals *= np.where(lengths > 0.0, 1.0 / np.where(lengths > 0.0, lengths, 1.0), 0.0)[:, None]
    return normals, 0.5 * lengths * scale1 * scale2


def first_of_equal_points(points: np.ndarray) -> np.ndarray:
    """(V,) for every point, the smallest index of a point with exactly the same coordinates (-0.0 equals 0.0)."""
    order = np.lexsort(points.T)  # stable: equal points stay in the order of their indices
    ranked = points[order]
    starts = np.concatenate([[True], (ranked[1:] != ranked[:-1]).any(axis=1)])
    first = np.empty(len(points), dtype=np.int64)
    first[order] = order[starts][np.cumsum(starts) - 1]
    return first


def height_map_arrays(heights: Any, spacing: Any, origin: Any) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (rows * columns, 3) float64 and faces (F, 3) of a terrain; arguments and errors as in
    `wrt.TriangleMesh.from_heightmap`."""
    values = host_array("heights", heights)
    if values.dtype.kind not in "fiu":
        raise TypeError(f"heights must hold real numbers, not {values.dtype}")
    if values.ndim != 2 or min(values.shape) < 2:
        raise ValueError(f"heights must have shape (rows, columns), at least 2 x 2, not {values.shape}")
    step, start = as_numbers("spacing", spacing), as_numbers("origin", origin, (3,))
    if step.shape not in ((), (1,), (2,)):
        raise ValueError(f"spacing must be a number or two, of columns and of rows, not an array of shape {step.shape}")
    step = np.broadcast_to(step, (2,))
    if not step.all():
        raise ValueError(f"spacing must not be 0, and is {step.tolist()}")
    known = np.isfinite(values)
    rows, columns = np.indices(values.shape)
    places = np.stack([step[0] * columns, step[1] * rows, np.where(known, values, 0.0)], axis=-1).astype(np.float64) + start
    number = rows * values.shape[1] + columns
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    whole = known[:-1, :-1] & known[:-1, 1:] & known[1:, 1:] & known[1:, :-1]
    cells = np.stack([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)], axis=-2)[whole]
    faces = cells.reshape(-1, 3)
    if not len(faces):
        raise ValueError(
            f"heights of shape {values.shape}, {int(known.sum())} of them finite, have no cell of four finite numbers; a cell "
            "needs two neighbours in each of two rows"
        )
    return places.reshape(-1, 3), faces if step[0] * step[1] > 0.0 else faces[:, ::-1]
