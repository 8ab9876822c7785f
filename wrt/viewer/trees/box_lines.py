"""Boxes and paths as lines over the picture, in the colours of costs.

Coordinates are given to the browser relative to the centre of the scene: it draws in float32.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from wrt.builders.bvh.bvh_statistics import half_area
from wrt.builders.influence.area_top_level import TopLevel, region_of
from wrt.viewer.trees.tree_levels import TreeBoxes

if TYPE_CHECKING:
    import viser

    from wrt.scene.scene import Scene

__all__ = ["box_corners", "box_edges", "draw_boxes", "heat_colors", "octree_boxes", "region_corners"]

CORNERS = np.array([[i & 1, i >> 1 & 1, i >> 2] for i in range(8)])
EDGES = np.array([(i, i | bit) for bit in (1, 2, 4) for i in range(8) if not i & bit])
"""(12, 2) corners at the ends of the edges of a box."""


def box_corners(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(..., 8, 3) corners of boxes (..., 3)."""
    return np.where(CORNERS == 0, low[..., None, :], high[..., None, :])


def box_edges(corners: np.ndarray) -> np.ndarray:
    """(12 N, 2, 3) ends of the edges of boxes with corners (N, 8, 3)."""
    return corners[:, EDGES].reshape(-1, 2, 3)


def heat_colors(shares: np.ndarray) -> np.ndarray:
    """(N, 3) uint8 from blue for 0 over green and yellow to red for 1."""
    x = np.clip(np.nan_to_num(shares), 0.0, 1.0)
    channels = (np.clip(2.0 * x - 0.4, 0.0, 1.0), 1.0 - np.abs(2.0 * x - 1.0) ** 2, np.clip(1.2 - 2.4 * x, 0.0, 1.0))
    return np.rint(255.0 * np.stack(channels, axis=-1)).astype(np.uint8)


def draw_boxes(client: viser.ClientHandle, name: str, corners: Any, colors: np.ndarray, center: np.ndarray) -> Any:
    """Draws boxes with corners (N, 8, 3) in colours (N, 3) and returns their handle; None for no boxes, which removes those of
    that name."""
    if len(corners) == 0:
        client.scene.remove_by_name(name)
        return None
    points = box_edges(np.asarray(corners) - center).astype(np.float32)
    shades = np.repeat(colors, 12, axis=0)[:, None].repeat(2, axis=1)
    position = tuple(map(float, center))
    return client.scene.add_line_segments(name, points, shades, thickness=1.5, thickness_units="screen", position=position)  # type: ignore[call-overload]


MOST_CELLS = 1 << 20
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
    while sum(map(len, cells)) <= MOST_CELLS:
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
