"""What a flat list of rays does not say and its numbers do: that all start at one point, and that they are a picture's pixels.

Interfaces that know rays only as (N, 3), and users who tile the eye N times, lose a third to half of the speed: packets of a
shared origin are culled better, and neighbours in both dimensions are traced together. Nothing but speed depends on what is
found here, and only CPUs look.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from wrt.kernels.rays import RayBatch

LEAST_RAYS = 4096
"""Fewer rays are not looked at: there is no time to win."""

LEAST_ROWS = 8
"""Rows and columns from which on a batch is taken for a picture."""

LONGEST_ROW = 1 << 13
"""Pixels of a row that is recognised in a flat list."""

JUMP = 4.0
"""Directions of neighbouring pixels differ by no more than so many times as much as the first two."""

BLOCK = 1 << 16
"""Origins that are compared at a time: the first that differs ends the search."""


def one_origin(origins: np.ndarray) -> np.ndarray:
    """Origins (..., 3) that are all the same, as a view of the first; others as they are."""
    if origins.size < 3 * LEAST_RAYS or not origins.flags.c_contiguous:
        return origins
    rows = origins.reshape(-1, 3)
    first = rows[0]
    if not (rows[:: len(rows) // 64] == first).all():
        return origins
    for begin in range(0, len(rows), BLOCK):
        block = rows[begin : begin + BLOCK]
        # column by column: four times as fast as comparing rows
        if any(block[:, axis].min() != first[axis] or block[:, axis].max() != first[axis] for axis in range(3)):
            return origins
    return np.broadcast_to(first, origins.shape)


def picture_columns(shape: tuple[int, ...], batch: RayBatch) -> int:
    """Columns of the picture whose pixels the rays are, row by row; 0 if they are none.

    Two dimensions are rows and columns. Of a flat list whose rays share their origin, a row ends where directions jump; the
    next must begin beside it, and so must all that follow.
    """
    if len(shape) == 2:
        return shape[1] if min(shape) >= LEAST_ROWS else 0
    flat = len(shape) == 1 and batch.origin_stride == 0 and batch.direction_stride == 1
    if not flat or batch.count < LEAST_RAYS or not batch.directions.device.is_cpu:
        return 0
    directions = batch.directions.numpy()
    with np.errstate(all="ignore"):
        limit = JUMP * np.abs(directions[1] - directions[0]).max()
        columns = _first_row(directions, limit)
        if columns < LEAST_ROWS or batch.count % columns or batch.count < LEAST_ROWS * columns:
            return 0
        return columns if (_changes(directions[::columns]) < limit).all() else 0


def _first_row(directions: np.ndarray, limit: float) -> int:
    """Directions before the first that differs from the one before by more than the limit; 0 if there are too many."""
    for length in (LONGEST_ROW // 4, LONGEST_ROW):  # most rows are short
        jumps = _changes(directions[: length + 1]) > limit
        first = int(jumps.argmax())
        if jumps[first]:
            return first // 3 + 1
    return 0


def _changes(vectors: np.ndarray) -> np.ndarray:
    """Changes of each component from each vector to the next, one after the other: NumPy is slow on rows of three."""
    flat = np.ascontiguousarray(vectors).reshape(-1)
    changes = flat[3:] - flat[:-3]
    return np.abs(changes, out=changes)
