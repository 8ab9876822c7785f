"""Dividing space into parts: the top of a kd-tree over the cells of a grid, split where it halves the triangles.

Only the number of triangles of each cell is needed, so triangles are read once to count them and once to distribute them. A
triangle belongs to the cell that contains the middle of its box, and so to one part: the boxes of parts overlap, but no
triangle is in two of them. A cell with more triangles than a part may have is divided by the order of its triangles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from wrt.kernels.layout.triangle_cells import triangle_cells
from wrt.kernels.runtime.launch import as_device, launch

CELLS = 1 << 21
"""Cells of the grid, about: 8 MB of counts."""

CHUNK = 1 << 14
"""Triangles that are worth a chunk of their own."""


@dataclass(frozen=True)
class Grid:
    """A grid of nearly cubic cells over a box.

    Attributes:
        low: (3,) float64, its lowest corner.
        scale: (3,) float64, cells per unit of length.
        shape: number of cells along each axis.
    """

    low: np.ndarray
    scale: np.ndarray
    shape: tuple[int, int, int]

    @classmethod
    def over(cls, low: np.ndarray, high: np.ndarray, cells: int = CELLS) -> Grid:
        """A grid of about this many cells; flat boxes have one cell along their flat axes."""
        sides = high - low
        side, shape = 1.0, np.ones(3, dtype=int)
        for axes in range(3, 0, -1):  # axes shorter than a cell get one, and leave their share to the others
            longest = np.sort(sides)[::-1][:axes]
            if longest[-1] > 0.0:
                side = float(np.exp(np.log(longest).mean())) / cells ** (1 / axes)
                shape = np.maximum(1, np.floor(sides / side)).astype(int)
                if longest[-1] >= side:
                    break
        scale = np.divide(shape, sides, out=np.zeros(3), where=sides > 0.0)
        return cls(low, scale, tuple(shape.tolist()))

    def cells_of(self, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
        """(F,) int32: number of the cell of each triangle, in C order of `shape`."""
        device = as_device("cpu")
        cell = wp.empty(len(faces), dtype=int, device=device)
        inputs = [
            wp.array(vertices.astype(np.float64, copy=False), dtype=wp.vec3d, device=device, copy=False),
            wp.array(faces, dtype=wp.vec3i, device=device, copy=False),
            wp.vec3d(*self.low.tolist()),
            wp.vec3d(*self.scale.tolist()),
            wp.vec3i(*self.shape),
            cell,
        ]
        launch(triangle_cells, len(faces), inputs, device=device, chunk=CHUNK)
        return cell.numpy()


@dataclass(frozen=True)
class Division:
    """Which part the triangles of a cell belong to.

    Attributes:
        region: (cells,) int32, region of each cell.
        first_part: (regions + 1,) first part of each region, and the number of parts. A region has one part, unless it is
            a single cell with more than `limit` triangles.
        limit: greatest number of triangles of a part.
    """

    region: np.ndarray
    first_part: np.ndarray
    limit: int

    @property
    def parts(self) -> int:
        """Number of parts."""
        return int(self.first_part[-1])

    def parts_of(self, cells: np.ndarray, seen: np.ndarray) -> np.ndarray:
        """(F,) int32: the part of each triangle.

        Args:
            cells: (F,) cells of further triangles.
            seen: (regions,) triangles that each region has received so far; updated.
        """
        region = self.region[cells]
        parts = self.first_part[region].astype(np.int32)
        crowded = np.flatnonzero(np.diff(self.first_part) > 1)
        for number in crowded:
            own = np.flatnonzero(region == number)
            parts[own] += ((seen[number] + np.arange(len(own))) // self.limit).astype(np.int32)
        seen += np.bincount(region, minlength=len(seen))
        return parts


def divide(counts: np.ndarray, limit: int) -> Division:
    """Divides the cells of a grid into regions of at most `limit` triangles, where that is possible.

    Args:
        counts: (X, Y, Z) number of triangles of each cell.
        limit: greatest number of triangles of a part.
    """
    region = np.zeros(counts.shape, dtype=np.int32)
    pieces: list[int] = []
    waiting = [tuple(slice(0, n) for n in counts.shape)]
    while waiting:
        box = waiting.pop()
        inside = counts[box]
        total = int(inside.sum())
        if total == 0:
            continue
        if total > limit and inside.size > 1:
            waiting.extend(split(inside, box))
        else:
            region[box] = len(pieces)
            pieces.append(-(-total // limit))
    return Division(region.reshape(-1), np.cumsum([0, *pieces]), limit)


def split(counts: np.ndarray, box: tuple[slice, ...]) -> list[tuple[slice, ...]]:
    """The two halves of a box of cells: across its longest axis, where the numbers of triangles are most alike."""
    axis = int(np.argmax(counts.shape))
    sums = np.cumsum(counts.sum(axis=tuple(other for other in range(3) if other != axis)))
    place = 1 + int(np.argmin(np.abs(sums[:-1] - sums[-1] / 2)))
    middle = box[axis].start + place
    halves = slice(middle, box[axis].stop), slice(box[axis].start, middle)
    return [tuple(half if other == axis else one for other, one in enumerate(box)) for half in halves]
