"""The octree that finds the influence areas of rays, cell by cell: as tables, JSON, and cut by a plane for pictures."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from wrt.atomic_files import write_text
from wrt.builders.influence.area_top_level import TopLevel

if TYPE_CHECKING:
    from wrt.scene.scene import Scene

__all__ = ["OctreeAnalysis", "analyse_octree"]


@dataclass(frozen=True)
class OctreeAnalysis:
    """The cells of the octree or kd-tree over the influence areas of a scene; of an array of areas, the one cell of all.

    Attributes:
        low, high: (cells, 3) float64, corners in the scene's coordinates; parents come before their children.
        parent: (cells,) the cell around each; -1 for the root.
        level: (cells,) number of cells around it.
        is_leaf: (cells,) bool.
        areas: for each leaf, the areas whose regions touch it, by their places in the accelerator's `areas`; None for others.
        bytes: of the cells and lists as rays look them up.
    """

    low: np.ndarray
    high: np.ndarray
    parent: np.ndarray
    level: np.ndarray
    is_leaf: np.ndarray
    areas: tuple[tuple[int, ...] | None, ...]
    bytes: int

    @property
    def listed(self) -> np.ndarray:
        """(cells,) number of areas that each leaf lists; 0 for others."""
        return np.array([len(one or ()) for one in self.areas])

    @property
    def levels(self) -> list[dict[str, Any]]:
        """Figures by level: cells, leaves, leaves without an area, and areas a leaf lists on average (None without leaves)."""
        rows, listed = [], self.listed
        for level in range(int(self.level.max()) + 1):
            here = self.level == level
            leaves = here & self.is_leaf
            row = {"level": level, "cells": int(here.sum()), "leaves": int(leaves.sum())}
            row |= {"empty leaves": int((leaves & (listed == 0)).sum())}
            rows.append(row | {"areas a leaf": float(listed[leaves].mean()) if leaves.any() else None})
        return rows

    def rows(self) -> list[dict[str, Any]]:
        """One row a cell, of plain numbers; "areas" is None but for leaves."""
        return [
            {
                "cell": i,
                "parent": int(self.parent[i]),
                "level": int(self.level[i]),
                "low": self.low[i].tolist(),
                "high": self.high[i].tolist(),
                "areas": None if self.areas[i] is None else list(self.areas[i]),
            }
            for i in range(len(self.level))
        ]

    def to_dict(self) -> dict[str, Any]:
        """All figures as JSON types: "bytes", "levels", "cells" (`rows`)."""
        return {"bytes": self.bytes, "levels": self.levels, "cells": self.rows()}

    def save_json(self, path: str | Path) -> None:
        """Writes `to_dict` to a file at `path`, whole or not at all."""
        write_text(path, json.dumps(self.to_dict(), indent=1) + "\n")

    def cut(self, axis: int, at: float) -> tuple[np.ndarray, np.ndarray]:
        """The leaves that a plane across an axis cuts: what a picture of the octree shows.

        Args:
            axis: 0, 1 or 2 for a plane across x, y or z.
            at: the plane's coordinate along the axis.

        Returns:
            (N, 2, 2) lower and upper corners of rectangles in the other two axes, in their order; and (N,) areas that each
            lists.

        Raises:
            ValueError: another axis.
        """
        if axis not in (0, 1, 2):
            raise ValueError(f"axis is {axis}; it must be 0, 1 or 2, for x, y or z")
        chosen = self.is_leaf & (self.low[:, axis] <= at) & (at < self.high[:, axis])
        others = [other for other in range(3) if other != axis]
        return np.stack([self.low[chosen][:, others], self.high[chosen][:, others]], axis=1), self.listed[chosen]


def analyse_octree(scene: Scene) -> OctreeAnalysis:
    """Measures the octree or kd-tree over the influence areas of a scene.

        scene = wrt.Scene(mesh, wrt.known_rays.RayAwareBvh(areas=areas, top_level="octree"))
        wrt.known_rays.analyse_octree(scene).save_json("octree.json")

    Args:
        scene: built with a `wrt.known_rays.RayAwareBvh`.

    Raises:
        ValueError: the scene has no influence areas with triangles.
    """
    if scene.state.area_trees is None:
        raise ValueError(
            "the scene has no influence areas with triangles; make it with accelerator=wrt.known_rays.RayAwareBvh(areas=...)"
        )
    return measure_cells(scene.state.area_trees.top, scene.state.area_trees.numbers)


def measure_cells(top: TopLevel, numbers: tuple[int, ...]) -> OctreeAnalysis:
    """The cells of a top level; `numbers` are those that its areas are called by."""
    child, count = top.struct.child.numpy(), top.cells
    low, high = np.zeros((count, 3)), np.zeros((count, 3))
    level, parent = np.zeros(count, dtype=int), np.full(count, -1)
    cells, (lows, highs) = np.zeros(1, dtype=int), top.root
    while len(cells):
        low[cells], high[cells] = lows + top.center, highs + top.center
        inner = child[cells] >= 0
        parents = cells[inner]
        cells, lows, highs = top.divide(parents, lows[inner], highs[inner])
        parent[cells] = np.repeat(parents, len(cells) // max(len(parents), 1))
        level[cells] = level[parent[cells]] + 1
    lists = [tuple(numbers[area] for area in one) for one in top.lists]
    areas = tuple(lists[~word] if word < 0 else None for word in child.tolist())
    return OctreeAnalysis(low, high, parent, level, child < 0, areas, top.bytes)
