"""Detection of a shared origin, and of images, in flat lists of rays.

Interfaces that pass rays as (N, 3), and callers that repeat the camera position N times, would lose a third to half of the
speed: packets with a shared origin are culled better, and tiles of an image are more coherent than its rows. Results do not
depend on this detection, only speed does. It runs only on CPUs.
"""

from __future__ import annotations

from collections import deque

import numpy as np
import warp as wp

from wrt.engine.host_arrays import HostArray, address_of, point_at
from wrt.engine.rays.coherence import MIN_IMAGE_RAYS
from wrt.kernels.query.ordering.coherence_detection import BLOCK, MIN_ROWS, compare_neighbours
from wrt.kernels.runtime.launch import Chunks, PreparedLaunch

PART = 1 << 30
"""Words that are compared in one launch: kernels number them with 32 bits."""


class NeighbourComparison:
    """The kernel that compares neighbours, with its packed arguments, for one thread at a time."""

    def __init__(self) -> None:
        device = wp.get_device("cpu")
        found = wp.zeros(1, dtype=int, device=device)
        self._found, self._step = found.numpy(), 0
        self._launch = PreparedLaunch(compare_neighbours, [found, 3, found], device)
        self._words = self._launch.argument(1)

    def all_equal(self, values: np.ndarray) -> bool:
        """Whether all vectors (N, 3) have the same bits."""
        step, count = 3 * values.itemsize // 4, 3 * len(values) * (values.itemsize // 4)
        begin = address_of(values)
        self._found[0] = 0
        self._launch.set_value(2, step)
        for first in range(0, count - step, PART):
            size = min(PART + step, count - first)
            point_at(self._words, HostArray(begin + 4 * first, size, wp.int32, values))
            self._launch.run(-(-(size - step) // BLOCK), COMPARED, values)
        return self._found[0] == 0


COMPARED = Chunks(chunk=4)

_free: deque[NeighbourComparison] = deque()


def detect_shared_origin(origins: np.ndarray) -> np.ndarray:
    """Origins (..., 3) that are all equal, as a view of the first; others, and those with a NaN, unchanged."""
    size = origins.size
    if size < 3 * MIN_IMAGE_RAYS or not origins.flags.c_contiguous or origins.item(0) != origins.item(size - 3):
        return origins
    rows = origins.reshape(-1, 3)
    first = rows[0]
    if not (rows[:: len(rows) // 64] == first).all():
        return origins
    try:
        comparison = _free.pop()
    except IndexError:
        comparison = NeighbourComparison()
    equal = comparison.all_equal(rows)
    _free.append(comparison)
    return np.broadcast_to(first, origins.shape) if equal else origins


def columns_of_shape(shape: tuple[int, ...]) -> int:
    """Columns of the image whose pixels two-dimensional rays are; 0 for other shapes."""
    return shape[1] if len(shape) == 2 and min(shape) >= MIN_ROWS else 0
