"""Terrain from a grid of heights."""

from __future__ import annotations

from typing import Any

import numpy as np

from wrt.kernels.validation import as_numbers, host_array


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
