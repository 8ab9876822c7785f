"""The order of points along the curve: that of a stable sort by cells, whatever the number of points and threads."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from wrt.kernels.points.point_order import BITS, MIN_PARALLEL, morton_order
from wrt.kernels.runtime.launch import use_threads

LOW, HIGH = (-1.0, 0.0, 2.0), (1.0, 4.0, 2.5)


def cells(points: np.ndarray) -> np.ndarray:
    """(N,) numbers of cells of points, bit by bit."""
    offset = points - np.array(LOW, np.float32)
    scale = np.array([(1 << BITS) / (high - low) for low, high in zip(LOW, HIGH, strict=True)], np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        place = np.clip(np.nan_to_num(offset * scale, nan=0.0, posinf=1e9, neginf=-1e9), 0, (1 << BITS) - 1).astype(int)
    number = np.zeros(len(points), int)
    for bit in range(BITS):
        for axis in range(3):
            number |= (place[:, axis] >> bit & 1) << (3 * bit + 2 - axis)
    return number


@pytest.mark.parametrize("count", [1, 300, MIN_PARALLEL - 1, MIN_PARALLEL, 2 * MIN_PARALLEL + 17])
def test_order(count):
    rng = np.random.default_rng(count)
    points = rng.uniform(np.array(LOW) - 0.2, np.array(HIGH) + 0.2, (count, 3)).astype(np.float32)
    points[::7] = points[0]  # equal cells keep their order
    for row, value in enumerate((np.nan, np.inf, -np.inf, 3e38, -3e38)):
        points[row + 1 :: 41, row % 3] = value
    expected = np.argsort(cells(points), kind="stable")
    position = wp.array(points, dtype=wp.vec3, device="cpu")
    for threads in (1, 2, 5):
        with use_threads(threads):
            order = morton_order(position, wp.vec3(*LOW), wp.vec3(*HIGH)).numpy()
        np.testing.assert_array_equal(order, expected)
