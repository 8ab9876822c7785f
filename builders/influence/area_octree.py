"""The octree over the regions of influence areas, built level by level from pairs of a cell and an area.

A cell is a leaf if every region that touches it encloses it, or at the greatest depth. Other cells are divided into eight. A
child is tested only against the regions that touch its parent, all pairs of a slice of cells in one launch. So a level costs
one test per pair, not cells times areas. A leaf's word holds the number of the list of areas that touch it, and each distinct
list is stored once. Where many regions overlap, nearly every leaf has its own long list, so an octree that exceeds MAX_BYTES
is rejected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import warp as wp

from wrt.kernels.influence.region_tests import DISJOINT, ENCLOSED, INTERSECTING, Region, classify_pairs
from wrt.kernels.runtime.launch import launch

MAX_BYTES = 1 << 30
"""Most memory of an octree during its build, without the current slice: the size of a full one of eight levels with short
lists."""

CELL_BYTES = 56
"""Bytes per cell: its word and, while its level is built, its corners and the start of its pairs."""

SLICE_PAIRS = 1 << 21
"""Pairs that are tested in one launch, about 50 MB. A single cell may have more."""


@dataclass(frozen=True)
class Cells:
    """Cells of a level and their pairs.

    Attributes:
        low, high: (N, 3) corners.
        begin: (N + 1,) each cell's first pair, followed by the number of pairs.
        area: (pairs,) int32 areas whose regions touch the cell, ascending within each cell.
        is_mixed: (N,) bool, whether some region touches the cell without enclosing it.
    """

    low: np.ndarray
    high: np.ndarray
    begin: np.ndarray
    area: np.ndarray
    is_mixed: np.ndarray

    def __len__(self) -> int:
        """Number of cells."""
        return len(self.low)

    @property
    def bytes(self) -> int:
        """Bytes of the pairs."""
        return self.area.nbytes

    def children(self, parents: np.ndarray, regions: wp.array, cuts: Cuts) -> Cells:
        """The children of each of the cells `parents`, in the order of the parents."""
        low, high = cuts.cut(self, parents)
        sizes = np.repeat(np.diff(self.begin)[parents], cuts.fan)
        ends = np.cumsum(sizes)
        cell = np.repeat(np.arange(len(low), dtype=np.int32), sizes)
        starts = np.repeat(self.begin[:-1][parents], cuts.fan) - (ends - sizes)
        area = self.area[np.arange(len(cell)) + starts[cell]]
        state = classify(regions, low, high, cell, area)
        touching = state != DISJOINT
        if cuts.slack > 0.0:
            part = np.flatnonzero(state == INTERSECTING)
            within = classify(regions, low + cuts.slack, high - cuts.slack, cell[part], area[part])
            state[part[within != INTERSECTING]] = ENCLOSED
        counts = np.bincount(cell[touching], minlength=len(low))
        mixed = np.bincount(cell[state == INTERSECTING], minlength=len(low)) > 0
        return Cells(low, high, np.append(0, np.cumsum(counts)), area[touching], mixed)

    @classmethod
    def joined(cls, parts: Sequence[Cells]) -> Cells:
        """The concatenated cells of all parts."""
        if len(parts) == 1:
            return parts[0]
        counts = np.concatenate([np.diff(part.begin) for part in parts])
        arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in ("low", "high", "area", "is_mixed")}
        return cls(begin=np.append(0, np.cumsum(counts)), **arrays)


class Cuts(Protocol):
    """How cells are divided.

    Attributes:
        name: of the structure, for messages.
        fan: children of a cell.
        steps: levels that halve all three axes.
        slack: distance from its faces within which a cell is not cut to tell a region's inside from its outside.
    """

    name: str
    fan: int
    steps: int
    slack: float

    def words(self, cells: Cells, divided: np.ndarray, first: np.ndarray) -> np.ndarray:
        """The words of the cells of a level that are divided, (N,) bool; first: of their children, the first ones' numbers."""
        ...

    def cut(self, cells: Cells, parents: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Corners of the children of some cells of the level, in the order of the parents."""
        ...


class Octants:
    """Cells are divided into eight."""

    name, fan, steps, slack = "octree", 8, 1, 0.0

    def words(self, cells: Cells, divided: np.ndarray, first: np.ndarray) -> np.ndarray:
        """The numbers of the first children."""
        return first

    def cut(self, cells: Cells, parents: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As `Cuts`."""
        return cut_cells(cells.low[parents], cells.high[parents])


class AreaLists:
    """The distinct lists of areas, in the order in which they are found.

    Attributes:
        lists: ascending areas, int32.
        bytes: their memory.
    """

    def __init__(self) -> None:
        self.bytes = 0
        self._numbers: dict[bytes, int] = {}

    @property
    def lists(self) -> list[np.ndarray]:
        return [np.frombuffer(key, dtype=np.int32) for key in self._numbers]

    def number(self, areas: np.ndarray) -> int:
        """The number of a list; a new list gets the next number."""
        key = areas.tobytes()
        if key not in self._numbers:
            self._numbers[key] = len(self._numbers)
            self.bytes += len(key)
        return self._numbers[key]

    def numbers(self, cells: Cells, chosen: np.ndarray) -> np.ndarray:
        """The numbers of the lists of a slice of cells: few cells have a list that none before them has."""
        sizes = np.diff(cells.begin)[chosen]
        ends = np.cumsum(sizes)
        areas = cells.area[np.repeat(cells.begin[:-1][chosen] - (ends - sizes), sizes) + np.arange(sizes.sum())]
        first, inverse = first_of_equal_lists(areas, ends - sizes, sizes)
        numbers = np.empty(len(first), dtype=np.int32)
        for one in np.argsort(first):
            numbers[one] = self.number(areas[ends[first[one]] - sizes[first[one]] : ends[first[one]]])
        return numbers[inverse]


def first_of_equal_lists(values: np.ndarray, begin: np.ndarray, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of N lists, one after the other in `values`, of ascending integers from 0 on: the first of each group of equal ones, and
    each list's group.

    Lists of the same hash are compared; if any two of them differ, each list is a group of its own.
    """
    hashes = np.append(np.uint64(0), np.cumsum(hash64(np.arange(values.max(initial=0) + 1))[values]))  # modulo 2^64
    _, first, inverse = np.unique(hashes[begin + sizes] - hashes[begin], return_index=True, return_inverse=True)
    same = first[inverse]
    if (sizes == sizes[same]).all() and (
        values == values[np.repeat(begin[same] - begin, sizes) + np.arange(len(values))]
    ).all():
        return first, inverse
    return np.arange(len(begin)), np.arange(len(begin))


def hash64(values: np.ndarray) -> np.ndarray:
    """uint64 hashes of integers (Steele, Lea, Flood: Fast splittable pseudorandom number generators, OOPSLA 2014)."""
    z = (values.astype(np.uint64) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


def build_octree(
    structs: Sequence[Region], low: np.ndarray, high: np.ndarray, depth: int, cuts: Cuts | None = None
) -> tuple[np.ndarray, list[np.ndarray]]:
    """(child words, lists of areas) of an octree, or of a tree of other cuts, in the layout of
    `wrt.kernels.influence.area_assignment.AreaTree`.

    The look-up may find a point on the border of two cells in either, and rounding may move it across. A region that touches
    both cells is therefore classified as disjoint from neither (`wrt.kernels.influence.region_tests.is_separated`).

    Args:
        structs: the regions.
        low, high: (3,) corners of the root, which all regions touch.
        depth: most levels below the root.
        cuts: how cells are divided; None for octants.

    Raises:
        ValueError: the tree would take more than MAX_BYTES.
    """
    count, cuts = len(structs), cuts or Octants()
    regions = wp.array(list(structs), dtype=Region, device="cpu")
    cells = Cells(low[None], high[None], np.array([0, count]), np.arange(count, dtype=np.int32), np.ones(1, dtype=bool))
    lists, levels, total = AreaLists(), [], 1
    for level in range(depth + 1):
        divided = cells.is_mixed & (level < depth)
        words = np.empty(len(cells), dtype=np.int32)
        words[divided] = cuts.words(cells, divided, total + cuts.fan * np.arange(divided.sum()))
        leaves = slices(np.flatnonzero(~divided), np.diff(cells.begin))
        words[~divided] = ~np.concatenate([lists.numbers(cells, chosen) for chosen in leaves])
        levels.append(words)
        total += cuts.fan * int(divided.sum())
        if not divided.any():
            break
        parts, held = [], total * CELL_BYTES + cells.bytes + lists.bytes
        for parents in slices(np.flatnonzero(divided), cuts.fan * np.diff(cells.begin)):
            parts.append(cells.children(parents, regions, cuts))
            held += parts[-1].bytes
            if held > MAX_BYTES:
                raise ValueError(
                    f"the {cuts.name} over {count} influence areas takes more than {MAX_BYTES >> 20} MB at level {level + 1} "
                    f"of {depth}; pass depth={level // cuts.steps} to wrt.known_rays.RayAwareBvh, or top_level='array'"
                )
        cells = Cells.joined(parts)
    return np.concatenate(levels), lists.lists


def slices(chosen: np.ndarray, pairs: np.ndarray) -> list[np.ndarray]:
    """Runs of the chosen cells with up to SLICE_PAIRS pairs each, or a single cell. `pairs`: number of pairs of each cell."""
    place = np.cumsum(pairs[chosen]) // SLICE_PAIRS
    return np.split(chosen, np.flatnonzero(np.diff(place)) + 1)


def classify(regions: wp.array, low: np.ndarray, high: np.ndarray, cell: np.ndarray, area: np.ndarray) -> np.ndarray:
    """(pairs,) uint8 DISJOINT, INTERSECTING or ENCLOSED for pairs of a cell, whose corners are (N, 3), and an area."""
    corners = [wp.array(np.ascontiguousarray(a), dtype=wp.vec3d, device="cpu", copy=False) for a in (low, high)]
    pairs = [wp.array(a, dtype=int, device="cpu", copy=False) for a in (cell, area)]
    state = wp.empty(len(cell), dtype=wp.uint8, device="cpu")
    launch(classify_pairs, len(cell), [regions, *corners, *pairs, state], device=state.device, chunk=4096)
    return state.numpy()


def cut_cells(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners, (8 N, 3), of the eight children of N cells, in the order of the parents."""
    upper = np.array([[k >> axis & 1 for axis in range(3)] for k in range(8)], dtype=bool)
    middle = (0.5 * (low + high))[:, None]
    lows = np.where(upper, middle, low[:, None])
    highs = np.where(upper, high[:, None], middle)
    return lows.reshape(-1, 3), highs.reshape(-1, 3)
