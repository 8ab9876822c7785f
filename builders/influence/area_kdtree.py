"""The kd-tree over the regions of influence areas: cells are cut in two, where that leaves the fewest areas to be tested.

**Problem.** An octree cuts all axes in the middle, wherever regions end. Falcone (2024, section 7.2) supposes that a kd-tree
may be better.

**Algorithm.** The build is that of the octree (`wrt.builders.influence.area_octree`): level by level, cells until every region
that touches them encloses them. Only the cuts differ. A look-up asks for the cell of a point, so that the share of look-ups
that end on a side of a plane is its share of the cell's volume, where rays would have its share of the surface. The expected
number of areas on the list of a point is

    cost(plane) = (x - low) / (high - low) n_left + (high - x) / (high - low) n_right

Planes at the faces of the boxes around regions are tried on all axes, moved away from the region by MARGIN of the largest
coordinate, so that the region touches one side only; what it leaves of the other side, a few margins wide, is not cut. The
boxes of oblique regions tell little: where no plane saves SAVING of the tests, the cell's longest side is halved.

**Complexity.** O(P log P) a level with P pairs of a cell and an area that touches it.

**What we changed.** The kd-tree that the thesis cites, Fussell and Subramanian's, holds triangles for rays. This one holds
regions for points.

References: falcone-2024 (sections 5.5.2, 7.2); fussell-subramanian-1988.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wrt.builders.influence.area_octree import Cells
from wrt.kernels.influence.region_tests import Region

MARGIN = 2.0**-40
"""Distance of planes from the regions, relative to the largest coordinate: well above the rounding of float64."""

SAVING = 0.1
"""Least share of the tests that a plane at a face of a box must save."""


class FacePlanes:
    """Cells are cut in two by planes at the faces of boxes around regions. For one build, level by level.

    Attributes:
        planes: for each level, (cells,) float64 coordinates of the planes; 0 for leaves.

    Args:
        structs: the regions.
    """

    name, fan, steps = "kd-tree", 2, 3

    def __init__(self, structs: Sequence[Region]) -> None:
        low, high = (np.array([getattr(struct, name) for struct in structs], dtype=np.float64) for name in ("low", "high"))
        margin = MARGIN * float(np.abs([low, high]).max())
        self.slack = 4.0 * margin
        self._low, self._high = low - margin, high + margin
        self._axis = np.empty(0, dtype=np.int64)
        self.planes: list[np.ndarray] = []

    def words(self, cells: Cells, divided: np.ndarray, first: np.ndarray) -> np.ndarray:
        """The numbers of the first children, and the axes in the lowest two bits."""
        self._axis, plane = np.zeros(len(cells), dtype=np.int64), np.zeros(len(cells))
        if divided.any():
            chosen = np.flatnonzero(divided)
            self._axis[chosen], plane[chosen] = self.choose(cells, chosen)
        self.planes.append(plane)
        return first << 2 | self._axis[divided]

    def cut(self, cells: Cells, parents: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Corners of the lower and the upper part of each cell, by the planes that `words` chose."""
        return cut_at(cells.low[parents], cells.high[parents], self._axis[parents], self.planes[-1][parents])

    def choose(self, cells: Cells, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(N,) axes and (N,) coordinates of the planes of least cost."""
        low, high = cells.low[chosen], cells.high[chosen]
        sizes = np.diff(cells.begin)[chosen]
        ends = np.cumsum(sizes)
        cell = np.repeat(np.arange(len(chosen)), sizes)
        area = cells.area[np.arange(len(cell)) + np.repeat(cells.begin[:-1][chosen] - (ends - sizes), sizes)]
        tried = [self.costs(cell, area, sizes, low, high, axis) for axis in range(3)]
        cells_of, at, cost = (np.concatenate(part) for part in zip(*tried, strict=True))
        axes = np.repeat(np.arange(3), [len(part[0]) for part in tried])
        order = np.lexsort((cost, cells_of))
        best = order[np.flatnonzero(np.diff(cells_of[order], prepend=-1))]
        halved, row = np.argmax(high - low, axis=1), np.arange(len(chosen))
        saves = cost[best] <= (1.0 - SAVING) * sizes
        middle = 0.5 * (low[row, halved] + high[row, halved])
        return np.where(saves, axes[best], halved), np.where(saves, at[best], middle)

    def costs(
        self, cell: np.ndarray, area: np.ndarray, sizes: np.ndarray, low: np.ndarray, high: np.ndarray, axis: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Cells, coordinates and costs of all planes across an axis; inf outside of a cell.

        Args:
            cell, area: (pairs,) cells from 0 on and areas that touch them.
            sizes: (cells,) pairs of each.
            low, high: (cells, 3) corners.
            axis: across which.
        """
        at = np.concatenate([self._high[area, axis], self._low[area, axis]])
        cells_of, is_low = np.tile(cell, 2), np.repeat([False, True], len(cell))
        order = np.lexsort((is_low, at, cells_of))
        at, cells_of, is_low = at[order], cells_of[order], is_low[order]
        before = 2 * (np.cumsum(sizes) - sizes)[cells_of]  # events of the cells before
        lows = np.cumsum(is_low) - is_low - before // 2
        highs = np.arange(len(at)) + 1 - np.cumsum(is_low) - before // 2
        below = (at - low[cells_of, axis]) / (high - low)[cells_of, axis]
        cost = below * lows + (1.0 - below) * (sizes[cells_of] - highs)
        return cells_of, at, np.where((below > 0.0) & (below < 1.0), cost, np.inf)


def cut_at(low: np.ndarray, high: np.ndarray, axis: np.ndarray, plane: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners, (2 N, 3), of both parts of N cells, the lower one first, cut across an axis each."""
    lows, highs = np.repeat(low, 2, axis=0), np.repeat(high, 2, axis=0)
    row = np.arange(len(low))
    highs[2 * row, axis] = plane
    lows[2 * row + 1, axis] = plane
    return lows, highs
