"""The arrays of a mesh: checked once, and copied so that nothing can change them afterwards.

Kernels follow the indices in `faces` without checks, so the checked values must not change.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from wrt.kernels.validation import host_array


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
            f"{vertex_count - 1}); {int(bad.any(axis=1).sum())} faces are affected. Are the indices one-based?"
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
