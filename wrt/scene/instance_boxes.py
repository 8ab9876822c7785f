"""Boxes of instances, and the trees over them.

The box of a rotated box is too large by up to a factor of three in volume, and every ray that meets it in vain walks a tree's
first nodes. So a mesh is covered by the boxes of its vertices in the cells of an 8 x 8 x 8 grid, once, and the corners of those
are what is mapped: some thousand points, whatever the number of triangles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.accelerators.tree_descriptions import Bvh
from wrt.builders import tree as common
from wrt.builders.bvh.instance_forest import InstanceForest, build_forest
from wrt.builders.triangle_boxes import boxes_of
from wrt.meshes.instance import MIN_RELATIVE_SIZE
from wrt.meshes.placement import MAX_COORDINATE

if TYPE_CHECKING:
    from wrt.state.scene_state import SceneState

CELLS = 8
"""Cells per axis of the grid that covers a mesh."""

MAPPED_AT_ONCE = 64
"""Instances whose points are transformed at a time, which takes some megabytes."""

CENTER_STEPS = 16
"""The centre of a scene is a multiple of its size, rounded down to a power of two, divided by this: most motions leave it."""


@dataclass(frozen=True)
class InstanceBoxes:
    """The maps of all N instances, and their boxes in the scene's coordinates; all float64.

    Attributes:
        to_scene, to_object: (N, 3, 3), inverse to each other.
        origin: (N, 3), the scene position of the centre of each instance's mesh.
        low, high: (N, 3), corners of the bounding boxes.
        norms: (N,), product of the norms of the two maps: by what they enlarge the padding of boxes
            (`wrt.kernels.traversal.two_level.instance_single`).
    """

    to_scene: np.ndarray
    to_object: np.ndarray
    origin: np.ndarray
    low: np.ndarray
    high: np.ndarray
    norms: np.ndarray

    @classmethod
    def of(
        cls, transforms: np.ndarray, numbers: np.ndarray, centers: Sequence[np.ndarray], covers: Sequence[np.ndarray]
    ) -> InstanceBoxes:
        """Computes them.

        Args:
            transforms: (N, 4, 4).
            numbers: (N,) mesh of each instance.
            centers, covers: of each mesh, the latter by `cover`.
        """
        to_scene = transforms[:, :3, :3]
        to_object = np.linalg.inv(to_scene)
        origin = (to_scene @ np.array(centers)[numbers][:, :, None])[:, :, 0] + transforms[:, :3, 3]
        low, high = np.empty_like(origin), np.empty_like(origin)
        for number in np.unique(numbers).tolist():
            own, points = np.flatnonzero(numbers == number), covers[number].T
            for begin in range(0, len(own), MAPPED_AT_ONCE):
                chosen = own[begin : begin + MAPPED_AT_ONCE]
                moved = to_scene[chosen] @ points
                low[chosen], high[chosen] = moved.min(axis=2) + origin[chosen], moved.max(axis=2) + origin[chosen]
        norms = np.abs(to_scene).sum(axis=2).max(axis=1) * np.abs(to_object).sum(axis=2).max(axis=1)
        return cls(to_scene, to_object, origin, low, high, norms)

    @property
    def stretch(self) -> float:
        """By what the slack of boxes grows for the worst of the maps."""
        return 2.0 * float(self.norms.max())

    @property
    def are_resolved(self) -> bool:
        """Whether all boxes are surely large enough for where they are, and within the range of a scene
        (`wrt.meshes.instance.check_extent` decides for others)."""
        low, high = self.low.min(), self.high.max()
        sizes = (self.high - self.low).max(axis=1)
        return bool(max(-low, high) <= MAX_COORDINATE / 2 and sizes.min() >= 4.0 * MIN_RELATIVE_SIZE * (high - low))

    def write(self, table: np.ndarray, rows: Any) -> None:
        """Writes the maps of some instances into a (N,) table of `Placement`; not their origins."""
        table["to_scene"][rows], table["to_object"][rows] = self.to_scene[rows], self.to_object[rows]

    def with_rows(self, rows: np.ndarray, others: InstanceBoxes) -> InstanceBoxes:
        """These, with other maps and boxes of some instances."""
        arrays = []
        for name in ROWS:
            values = getattr(self, name).copy()
            values[rows] = getattr(others, name)
            arrays.append(values)
        return InstanceBoxes(*arrays)

    def center(self) -> np.ndarray:
        """(3,) the point that the scene's positions are relative to: near the middle of all boxes, and still while they move by
        little. It depends on the boxes alone.
        """
        low, high = self.low.min(axis=0), self.high.max(axis=0)
        middle, size = (low + high) / 2, float((high - low).max())
        if size == 0.0:
            return middle
        step = 2.0 ** np.floor(np.log2(size)) / CENTER_STEPS
        return np.round(middle / step) * step

    def around(self, center: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(N, 3) float32 corners of the boxes relative to a point, rounded outwards."""
        low, high = self.low - center, self.high - center
        rounding = 4.0 * np.finfo(np.float64).eps * (np.abs(low).max() + np.abs(high).max() + np.abs(center).max())
        low = np.nextafter((low - rounding).astype(np.float32), np.float32(-np.inf))
        return low, np.nextafter((high + rounding).astype(np.float32), np.float32(np.inf))


ROWS = tuple(field.name for field in fields(InstanceBoxes))


@dataclass
class UpperTree(common.Bvh):
    """The tree over the instances of a scene, one of them per leaf.

    Attributes:
        parts_depth: the greatest depth of the trees of meshes, for traversals whose stacks serve both levels.
        forest: its nodes on the host.
        environments, roots: on the device, as in the forest.
    """

    parts_depth: int = 0
    forest: InstanceForest | None = None
    environments: wp.array | None = None
    roots: wp.array | None = None

    @property
    def depth(self) -> int:
        """Largest number of inner nodes on a path of either level."""
        return max(len(self.level_first) - 1, self.parts_depth)

    def with_boxes(self, corners: tuple[np.ndarray, np.ndarray]) -> UpperTree:
        """The same nodes around other boxes, as `InstanceBoxes.around` gives them."""
        bounds = wp.array(self.forest.bounds(*corners).reshape(-1), dtype=float, device=self.child.device, copy=False)
        low, high = wp.vec3(*corners[0].min(axis=0)), wp.vec3(*corners[1].max(axis=0))
        return UpperTree(
            bounds,
            self.child,
            self.primitive,
            low,
            high,
            self.width,
            self.level_first,
            self.stats,
            parts_depth=self.parts_depth,
            forest=self.forest,
            environments=self.environments,
            roots=self.roots,
        )


def build_upper(
    corners: tuple[np.ndarray, np.ndarray], environments: np.ndarray, width: int, parts_depth: int, device: wp.Device
) -> UpperTree:
    """The trees over the instances.

    Args:
        corners: their boxes, as `InstanceBoxes.around` gives them.
        environments: (N,) int32 environment of each.
        width: children of a node.
        parts_depth: as in `UpperTree`.
        device: of the tree.
    """

    def build(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        tree = Bvh(width=width, max_leaf_triangles=1).build(boxes_of(low, high), width)
        return tree.child.numpy().reshape(-1, width), tree.primitive.numpy()[::width]

    forest = build_forest(*corners, environments, width, build)
    order = np.repeat(np.arange(len(environments), dtype=np.int32), width)
    arrays = (forest.child.reshape(-1), order, forest.environments, forest.roots)
    child, order, numbers, roots = (wp.array(values, dtype=int, device=device) for values in arrays)
    zero = wp.vec3()
    tree = UpperTree(None, child, order, zero, zero, width, forest.level_first, common.BuildStats(), None, parts_depth)
    tree.forest, tree.environments, tree.roots = forest, numbers, roots
    return tree.with_boxes(corners)


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
