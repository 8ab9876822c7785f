"""The boxes of a tree, level by level, with what they hold and what they cost, on the host."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wrt.builders.bvh import bvh_statistics
from wrt.builders.bvh.bvh_statistics import half_area
from wrt.builders.tree import Bvh, KdTree

__all__ = ["MEASURES", "TreeBoxes", "tree_boxes"]

MEASURES = ("depth", "triangles", "fill", "cost", "overlap", "empty space")
"""What boxes can be coloured by: fields of `TreeBoxes`."""


@dataclass(frozen=True)
class TreeBoxes:
    """The boxes of all nodes of a tree, each N long.

    Attributes:
        low, high: (N, 3) float64, relative to the centre of the scene.
        depth: inner nodes above.
        is_leaf: whether it is a leaf.
        triangles: of a leaf; 0 for inner nodes.
        fill: share of the lanes of a leaf's blocks, or of an inner node, that are used.
        cost: half the surface area relative to the root's, times the blocks of a leaf, or once for an inner node.
        overlap: share of the volume that siblings cover too, summed over them; 0 in a kd-tree.
        empty_space: of an inner node of a bounding volume hierarchy, the share of its volume outside all children, if these do
            not overlap; of a kd-tree's leaf, 1 if it holds no triangle, else 0.
    """

    low: np.ndarray
    high: np.ndarray
    depth: np.ndarray
    is_leaf: np.ndarray
    triangles: np.ndarray
    fill: np.ndarray
    cost: np.ndarray
    overlap: np.ndarray
    empty_space: np.ndarray

    @property
    def levels(self) -> int:
        """Number of levels; the root is level 0."""
        return int(self.depth.max()) + 1

    def measure(self, name: str) -> np.ndarray:
        """(N,) float64: one of `MEASURES`."""
        return getattr(self, name.replace(" ", "_")).astype(np.float64)

    def at_level(self, level: int, with_leaves: bool, max_boxes: int) -> np.ndarray:
        """Indices of the boxes of a level, those that cost most first.

        Args:
            level: 0 for the root.
            with_leaves: whether leaves of higher levels are among them, so that all triangles are in some box.
            max_boxes: largest number of boxes.
        """
        found = np.flatnonzero((self.depth == level) | (with_leaves & self.is_leaf & (self.depth < level)))
        return found[np.argsort(-self.cost[found], kind="stable")][:max_boxes]


def tree_boxes(tree: Bvh | KdTree) -> TreeBoxes:
    """All boxes of a tree."""
    return _of_bvh(tree) if isinstance(tree, Bvh) else _of_kdtree(tree)


def _of_bvh(tree: Bvh) -> TreeBoxes:
    boxes, width = bvh_statistics.unpack(tree), tree.width
    node, lane = np.nonzero(boxes.is_leaf | boxes.is_inner)
    low, high = boxes.low.astype(np.float64), boxes.high.astype(np.float64)
    used = boxes.is_leaf | boxes.is_inner
    volume = np.where(used, np.prod(np.where(used[..., None], high - low, 0.0), axis=-1), 0.0)
    overlap = np.zeros(used.shape)
    for other in range(1, width):  # each lane with the one `other` places further, around the end
        near_low, near_high = np.roll(low, other, axis=1), np.roll(high, other, axis=1)
        shared = np.prod(np.clip(np.minimum(high, near_high) - np.maximum(low, near_low), 0.0, None), axis=-1)
        overlap += np.where(used & np.roll(used, other, axis=1), shared, 0.0)
    root_low, root_high = (np.array(corner, dtype=np.float64)[None] for corner in (tree.low, tree.high))
    lows, highs = np.concatenate([root_low, low[node, lane]]), np.concatenate([root_high, high[node, lane]])
    is_leaf = np.concatenate([[False], boxes.is_leaf[node, lane]])
    number = np.concatenate([[0], np.where(boxes.is_inner, boxes.child, 0)[node, lane]])  # of the node, if it is an inner one
    triangles = np.concatenate([[0], boxes.triangles[node, lane]])
    own = np.concatenate([[np.prod(root_high - root_low)], volume[node, lane]])
    blocks = -(-triangles // width)
    fill = np.where(is_leaf, _share(triangles, blocks * width), used.mean(axis=1)[number])
    empty = np.where(is_leaf, 0.0, np.clip(1.0 - _share(volume.sum(axis=1)[number], own), 0.0, 1.0))
    return TreeBoxes(
        lows,
        highs,
        np.concatenate([[0], boxes.depth[node] + 1]),
        is_leaf,
        triangles,
        fill,
        half_area(lows, highs) / max(float(half_area(lows[0], highs[0])), 1e-300) * np.where(is_leaf, blocks, 1),
        np.concatenate([[0.0], _share(overlap[node, lane], volume[node, lane])]),
        np.where(own > 0.0, empty, 0.0),
    )


def _of_kdtree(tree: KdTree) -> TreeBoxes:
    from wrt.builders.kdtree import kdtree_statistics  # not needed for the first picture

    cells = kdtree_statistics.unpack(tree)
    blocks = -(-cells.triangles // tree.width)
    area = half_area(cells.low, cells.high) / max(float(half_area(cells.low[0], cells.high[0])), 1e-300)
    return TreeBoxes(
        cells.low,
        cells.high,
        cells.depth,
        cells.is_leaf,
        cells.triangles,
        np.where(cells.is_leaf, _share(cells.triangles, blocks * tree.width), 1.0),
        area * np.where(cells.is_leaf, blocks, 1),
        np.zeros(len(area)),
        (cells.is_leaf & (cells.triangles == 0)).astype(np.float64),
    )


def _share(part: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """part / whole, 0 where the whole is 0."""
    return np.where(whole > 0, part / np.where(whole > 0, whole, 1), 0.0)
