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

MAX_CELLS = 1 << 20
"""Cells after which no deeper level is listed."""


def region_corners(scene: Scene) -> np.ndarray:
    """(areas, 8, 3) float64 corners of the regions in which the rays of each influence area start.

    Args:
        scene: with `area_trees`.
    """
    return np.stack([region_of(area, *scene.bounds).corners for area in scene.state.area_trees.areas])


def octree_boxes(top: TopLevel) -> TreeBoxes:
    """The cells of an octree or kd-tree over influence areas; a single one if it is an array.

    `triangles` is the number of areas that a leaf lists, which a look-up tests in turn; `fill` its share of all areas; `cost`
    counts them times the cell's share of the root's surface; `empty_space` is 1 for a leaf without an area.
    """
    tree = top.struct
    child, counts = tree.child.numpy(), np.diff(tree.begin.numpy())
    cells, corners = [np.zeros(1, dtype=np.int64)], [top.root]
    while sum(map(len, cells)) <= MAX_CELLS:
        inner = child[cells[-1]] >= 0
        if not inner.any():
            break
        children, *both = top.divide(cells[-1][inner], *(corner[inner] for corner in corners[-1]))
        cells.append(children)
        corners.append(tuple(both))  # type: ignore[arg-type]
    depth = np.repeat(np.arange(len(cells)), [len(level) for level in cells])
    words = child[np.concatenate(cells)]
    low, high = (np.concatenate(part) for part in zip(*corners, strict=True))
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
