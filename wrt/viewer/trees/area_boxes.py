"""What finds the influence area of a ray, as boxes: the areas' regions, and the cells of the octree over them, on the host."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from wrt.builders.bvh.bvh_statistics import half_area
from wrt.builders.influence.area_top_level import TopLevel, region_of
from wrt.viewer.trees.tree_levels import TreeBoxes

if TYPE_CHECKING:
    from wrt.scene.scene import Scene

__all__ = ["octree_boxes", "region_corners"]

MOST_CELLS = 1 << 20
"""Cells after which no deeper level is listed."""


def region_corners(scene: Scene) -> np.ndarray:
    """(areas, 8, 3) float64 corners of the regions in which the rays of each influence area start.

    Args:
        scene: with `area_trees`.
    """
    return np.stack([region_of(area, *scene.bounds).corners for area in scene.area_trees.areas])


def octree_boxes(top: TopLevel) -> TreeBoxes:
    """The cells of an octree over influence areas; a single one if it is an array.

    `triangles` is the number of areas that a leaf lists, which a look-up tests in turn; `fill` its share of all areas; `cost`
    counts them times the cell's share of the root's surface; `empty_space` is 1 for a leaf without an area.
    """
    tree = top.struct
    child, counts = tree.child.numpy(), np.diff(tree.begin.numpy())
    size = 2.0**tree.depth / tree.cells
    cells, lows, levels = [np.zeros(1, dtype=np.int64)], [np.array(tree.low, dtype=np.float64)[None]], [0]
    octants = np.array([[i & 1, i >> 1 & 1, i >> 2] for i in range(8)], dtype=np.float64)
    while sum(map(len, cells)) <= MOST_CELLS:
        inner = child[cells[-1]] >= 0
        if not inner.any():
            break
        half = size / 2 ** (levels[-1] + 1)
        lows.append((lows[-1][inner][:, None] + half * octants).reshape(-1, 3))
        cells.append((child[cells[-1][inner]][:, None] + np.arange(8)).ravel())
        levels.append(levels[-1] + 1)
    depth = np.repeat(levels, [len(level) for level in cells])
    low, words = np.concatenate(lows), child[np.concatenate(cells)]
    high = low + (size / 2.0**depth)[:, None]
    is_leaf = words < 0
    areas = np.where(is_leaf, counts[np.where(is_leaf, ~words, 0)], 0)
    share = half_area(low, high) / float(half_area(low[0], high[0]))
    return TreeBoxes(
        low,
        high,
        depth,
        is_leaf,
        areas,
        np.where(is_leaf, areas / len(tree.regions), 1.0),
        share * np.where(is_leaf, np.maximum(areas, 1), 1),
        np.zeros(len(low)),
        (is_leaf & (areas == 0)).astype(np.float64),
    )
