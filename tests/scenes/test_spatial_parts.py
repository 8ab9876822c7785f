"""How triangles are divided among the parts of a partitioned scene."""

from __future__ import annotations

import numpy as np
import pytest

from wrt.disk.spatial_parts import Grid, divide


def test_divisions():
    """Every triangle is in one part; parts are no larger than asked, and not much smaller than half of that."""
    rng = np.random.default_rng(0)
    points = np.concatenate([rng.normal(size=(20_000, 3)), rng.normal(size=(20_000, 3)) * 1e-5])
    grid = Grid.over(points.min(axis=0), points.max(axis=0), 4096)
    cells = grid.cells_of(points, np.repeat(np.arange(len(points), dtype=np.int32)[:, None], 3, axis=1))
    counts = np.bincount(cells, minlength=int(np.prod(grid.shape)))
    division = divide(counts.reshape(grid.shape), 1000)
    seen = np.zeros(len(division.first_part) - 1, dtype=np.int64)
    parts = np.concatenate([division.parts_of(piece, seen) for piece in np.array_split(cells, 7)])
    sizes = np.bincount(parts, minlength=division.parts)
    assert sizes.sum() == len(points)
    assert sizes.max() <= 1000
    assert sizes.min() > 0
    assert division.parts < 2.5 * len(points) / 1000


@pytest.mark.parametrize("sides", [(1, 1, 1), (4, 2, 0), (1e-9, 7, 0), (0, 0, 0), (1e6, 1, 1e-3)])
def test_grids_have_about_as_many_cells_as_asked(sides):
    grid = Grid.over(np.zeros(3), np.array(sides, dtype=np.float64), 4096)
    assert np.prod(grid.shape) <= 4096 * 1.01
    assert np.prod(grid.shape) >= (512 if any(sides) else 1)
