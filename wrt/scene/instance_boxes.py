"""Boxes of instances, and the tree over them.

The box of a rotated box is too large by up to a factor of three in volume, and every ray that meets it in vain walks a tree's
first nodes. So a mesh is covered by the boxes of its vertices in the cells of an 8 x 8 x 8 grid, once, and the corners of those
are what is mapped: some thousand points, whatever the number of triangles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from wrt.accelerators.tree_descriptions import Bvh
from wrt.builders.triangle_boxes import Boxes, TriangleBoxes
from wrt.kernels.layout.instance_maps import Placement

if TYPE_CHECKING:
    from wrt.builders import tree as common
    from wrt.meshes.instance import Instance
    from wrt.state.scene_state import SceneState

CELLS = 8
"""Cells per axis of the grid that covers a mesh."""

MAPPED_AT_ONCE = 64
"""Instances whose points are transformed at a time, which takes some megabytes."""


@dataclass(frozen=True)
class InstanceBoxes:
    """The maps of all N instances, and their boxes in the scene's coordinates; all float64.

    Attributes:
        to_scene, to_object: (N, 3, 3), inverse to each other.
        origin: (N, 3), the scene position of the centre of each instance's mesh.
        low, high: (N, 3), corners of the bounding boxes.
        stretch: largest factor by which the maps enlarge the padding of boxes
            (`wrt.kernels.traversal.two_level.instance_single`).
    """

    to_scene: np.ndarray
    to_object: np.ndarray
    origin: np.ndarray
    low: np.ndarray
    high: np.ndarray
    stretch: float

    @classmethod
    def of(
        cls,
        instances: Sequence[Instance],
        geometry_ids: Sequence[int],
        centers: Sequence[np.ndarray],
        covers: Sequence[np.ndarray],
    ) -> InstanceBoxes:
        """Computes them; centers, covers: of each mesh, the latter by `cover`."""
        transforms = np.array([instance.transform for instance in instances])
        to_scene, numbers = transforms[:, :3, :3], np.array(geometry_ids)
        to_object = np.linalg.inv(to_scene)
        origin = (to_scene @ np.array(centers)[numbers][:, :, None])[:, :, 0] + transforms[:, :3, 3]
        low, high = np.empty_like(origin), np.empty_like(origin)
        for number, points in enumerate(covers):
            own = np.flatnonzero(numbers == number)
            for chosen in np.array_split(own, -(-len(own) // MAPPED_AT_ONCE)):
                moved = to_scene[chosen] @ points.T
                low[chosen], high[chosen] = moved.min(axis=2) + origin[chosen], moved.max(axis=2) + origin[chosen]
        norms = np.abs(to_scene).sum(axis=2).max(axis=1) * np.abs(to_object).sum(axis=2).max(axis=1)
        return cls(to_scene, to_object, origin, low, high, 2.0 * float(norms.max()))

    def table(self, center: np.ndarray, geometry: Sequence[int], first: np.ndarray, mask: Sequence[int]) -> np.ndarray:
        """(N,) `Placement`, as kernels read it."""
        table = np.zeros(len(self.origin), dtype=Placement.numpy_dtype())
        table["to_scene"], table["to_object"], table["origin"] = self.to_scene, self.to_object, self.origin - center
        table["geometry"], table["first"], table["mask"] = geometry, first, mask
        return table


def cover(part: SceneState) -> np.ndarray:
    """(P, 3) float64 points relative to a mesh's centre whose convex hull contains all its triangles; few if the mesh is
    large.
    """
    mesh = part.device_mesh
    points = mesh.vertices.numpy()[part.meshes[0].referenced]
    low, high = points.min(axis=0), points.max(axis=0)
    if len(points) <= CELLS**3:
        return points.astype(np.float64)
    cell = ((points - low) / np.maximum(high - low, np.finfo(np.float32).tiny) * CELLS).astype(np.int64).clip(0, CELLS - 1)
    cell = (cell[:, 0] * CELLS + cell[:, 1]) * CELLS + cell[:, 2]
    order = np.argsort(cell, kind="stable")
    begins = np.flatnonzero(np.diff(cell[order], prepend=-1))
    ranked = points[order].astype(np.float64)
    corners = np.stack([np.minimum.reduceat(ranked, begins), np.maximum.reduceat(ranked, begins)])
    choices = np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, 8)
    return np.concatenate([np.stack([corners[c, :, axis] for axis, c in enumerate(choice)], axis=1) for choice in choices.T])


def build_upper(boxes: InstanceBoxes, center: np.ndarray, width: int) -> common.Bvh:
    """The tree over the instances' boxes, rounded outwards, with one instance per leaf."""
    low, high = boxes.low - center, boxes.high - center
    rounding = 4.0 * np.finfo(np.float64).eps * (np.abs(low).max() + np.abs(high).max() + np.abs(center).max())
    low = np.nextafter((low - rounding).astype(np.float32), np.float32(-np.inf))
    high = np.nextafter((high + rounding).astype(np.float32), np.float32(np.inf))
    arrays = Boxes()
    arrays.low = wp.array(np.ascontiguousarray(low.T), dtype=float, device="cpu")
    arrays.high = wp.array(np.ascontiguousarray(high.T), dtype=float, device="cpu")
    triangles = TriangleBoxes(arrays, len(low), low.min(axis=0), high.max(axis=0))
    return Bvh(width=width, max_leaf_triangles=1).build(triangles, width)
