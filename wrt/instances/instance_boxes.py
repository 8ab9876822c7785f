"""Boxes of instances, and the trees over them.

The box of a rotated box is too large by up to a factor of three in volume, and every ray that meets it in vain walks a tree's
first nodes. So a mesh is covered by the boxes of its vertices in the cells of an 8 x 8 x 8 grid, once, and the corners of those
are what is mapped: some thousand points, whatever the number of triangles.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from math import frexp
from operator import sub
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.accelerators.tree_descriptions import Bvh
from wrt.builders import tree as common
from wrt.builders.bvh.instance_forest import InstanceForest, build_forest
from wrt.builders.triangle_boxes import boxes_of
from wrt.engine.memory import keep_alive
from wrt.kernels.runtime.launch import launch
from wrt.kernels.traversal.two_level.instance_bounds import LANES, BoundedInstances, CoverPoints, bound_instances
from wrt.meshes.instance import MIN_RELATIVE_SIZE
from wrt.meshes.mesh_measures import extremes
from wrt.meshes.placement import MAX_COORDINATE

if TYPE_CHECKING:
    from wrt.engine.facts.scene_state import SceneState

CELLS = 8
"""Cells per axis of the grid that covers a mesh."""

FEW_MOVED = 16
"""The boxes above single instances are computed again if at most one of this many has moved."""

MAX_COST = 1.3
"""The upper level is built again when its cost has grown by this, as the trees of meshes are (`wrt.moving.UpdatePolicy`)."""

CENTER_STEPS = 16
"""The centre of a scene is a multiple of its size, rounded down to a power of two, divided by this: most motions leave it."""

TINY, EPSILON = float(np.finfo(np.float64).tiny), float(np.finfo(np.float64).eps)


@dataclass(frozen=True)
class InstanceBoxes:
    """Where all N instances are, in the scene's coordinates; all float64.

    Attributes:
        origin: (N, 3), the scene position of the centre of each instance's mesh.
        box: (6, N), bounding boxes: lowest x, y, z, highest x, y, z.
        norms: (N,), product of the norms of each map and of its inverse: by what they enlarge the padding of boxes
            (`wrt.kernels.traversal.two_level.instance_single`).
    """

    origin: np.ndarray
    box: np.ndarray
    norms: np.ndarray

    @classmethod
    def of(cls, transforms: np.ndarray, numbers: np.ndarray, covers: Covers) -> tuple[InstanceBoxes, np.ndarray]:
        """Computes them, and the (N, 3, 3) inverses of the linear parts of the transforms.

        Args:
            transforms: (N, 4, 4).
            numbers: (N,) mesh of each instance.
            covers: of the meshes.
        """
        count, cpu = len(transforms), wp.get_device("cpu")
        made, inverses = cls(np.empty((count, 3)), np.empty((6, count)), np.empty(count)), np.empty((count, 3, 3))
        bounded = BoundedInstances()
        bounded.origin = on_device(made.origin, wp.vec3d, cpu)
        bounded.corners, bounded.norms = (on_device(values, wp.float64, cpu) for values in (made.box, made.norms))
        maps = on_device(np.ascontiguousarray(transforms), wp.mat44d, cpu)
        inputs = [maps, on_device(numbers.astype(np.int32), int, cpu), covers.struct, bounded]
        launch(bound_instances, count, [*inputs, on_device(inverses, wp.mat33d, cpu)], device=cpu, chunk=4)
        return made, inverses

    @cached_property
    def extremes(self) -> list[float]:
        """Lowest x, y, z, highest x, y, z of all boxes, the greatest norm, and the least size (longest side) of a box."""
        size = (self.box[3:] - self.box[:3]).max(axis=0).min()
        return [*self.box[:3].min(axis=1).tolist(), *self.box[3:].max(axis=1).tolist(), float(self.norms.max()), float(size)]

    @cached_property
    def center(self) -> tuple[float, float, float]:
        """The point that the scene's positions are relative to."""
        return self.frame[0]

    @property
    def slack_scale(self) -> float:
        """By what the slack of boxes grows for the worst of the maps."""
        return 2.0 * self.extremes[6]

    @property
    def are_resolved(self) -> bool:
        """Whether all boxes are surely large enough for where they are, and within the range of a scene
        (`wrt.meshes.instance.check_extent` decides for others)."""
        low, high = min(self.extremes[:3]), max(self.extremes[3:6])
        return max(-low, high) <= MAX_COORDINATE / 2 and self.extremes[7] >= 4.0 * MIN_RELATIVE_SIZE * (high - low)

    def with_rows(self, rows: np.ndarray, others: InstanceBoxes) -> InstanceBoxes:
        """These, with others of some instances."""
        made = self.copied()
        made.origin[rows], made.box[:, rows], made.norms[rows] = others.origin, others.box, others.norms
        return made

    def copied(self) -> InstanceBoxes:
        """Arrays of its own."""
        return InstanceBoxes(self.origin.copy(), self.box.copy(), self.norms.copy())

    @cached_property
    def frame(self) -> tuple[tuple[float, float, float], float]:
        """The point that the scene's positions are relative to, and a bound on the rounding of boxes relative to it.

        The point is near the middle of all boxes. Both are still while the boxes move by little, and depend on the boxes alone.
        """
        low, high = self.extremes[:3], self.extremes[3:6]
        middle, size = [(a + b) / 2 for a, b in zip(low, high, strict=True)], max(map(sub, high, low))
        if size > 0.0:
            step = 2.0 ** (frexp(size)[1] - 1) / CENTER_STEPS
            middle = [round(value / step) * step for value in middle]
        reach = max(max(high), -min(low)) + max(map(abs, middle))
        fraction, exponent = frexp(max(reach, TINY))
        return (middle[0], middle[1], middle[2]), 8.0 * EPSILON * 2.0 ** (exponent - (fraction == 0.5))

    def rounded(self, rows: Any = slice(None)) -> tuple[np.ndarray, np.ndarray]:
        """(M, 3) float32 corners of the boxes of some instances relative to the centre, rounded outwards."""
        center, rounding = np.array(self.frame[0]), self.frame[1]
        low, high = self.box[:3].T[rows] - (center + rounding), self.box[3:].T[rows] - (center - rounding)
        return (
            np.nextafter(low.astype(np.float32), np.float32(-np.inf)),
            np.nextafter(high.astype(np.float32), np.float32(np.inf)),
        )


def write_maps(table: np.ndarray, rows: Any, transforms: np.ndarray, inverses: np.ndarray) -> None:
    """Writes the maps of some instances, (M, 4, 4) transforms and (M, 3, 3) inverses, into a (N,) table of `Placement`; not
    their origins."""
    table["to_scene"][rows] = transforms[:, :3, :3]
    table["to_object"][rows] = inverses


@dataclass
class UpperTree(common.Bvh):
    """The tree over the instances of a scene, one of them per leaf.

    Attributes:
        parts_depth: the greatest depth of the trees of meshes, for traversals whose stacks serve both levels.
        forest: its nodes on the host.
        environments, roots, lists: on the device, as in the forest.
        corners: the boxes of the instances, (N, 3) float32 each; None, as `host`, after a move on the device.
        host: (nodes, 6, W) `bounds` on the host.
        extent: as in `InstanceTree`, in the memory of a graph that moves instances; else None.
        built_cost: of the forest (`InstanceForest.cost`) when it was built.
        cost: the same now; None if it was not computed.
    """

    parts_depth: int = 0
    forest: InstanceForest | None = None
    environments: wp.array | None = None
    roots: wp.array | None = None
    lists: wp.array | None = None
    corners: tuple[np.ndarray, np.ndarray] | None = None
    host: np.ndarray | None = None
    extent: wp.array | None = None
    built_cost: float = 0.0
    cost: float | None = None

    @property
    def is_degraded(self) -> bool:
        """Whether instances have moved so that other nodes would be much better."""
        cost = self.forest.cost(self.host) if self.cost is None else self.cost
        return cost > MAX_COST * self.built_cost

    @property
    def depth(self) -> int:
        """Largest number of inner nodes on a path of either level."""
        return max(len(self.level_first) - 1, self.parts_depth)

    def with_boxes(self, low: np.ndarray, high: np.ndarray, rows: np.ndarray | None = None) -> UpperTree:
        """The same nodes around other boxes.

        Args:
            low, high: (N, 3) float32, as `InstanceBoxes.rounded` gives them.
            rows: instances that moved; None for all.
        """
        few = rows is not None and FEW_MOVED * len(rows) <= len(low)
        host = self.forest.moved(self.host, low, high, rows) if few else self.forest.bounds(low, high)
        return self.around(low, high, host)

    def around(self, low: np.ndarray, high: np.ndarray, host: np.ndarray, cost: float | None = None) -> UpperTree:
        """The same nodes around other boxes; low, high: as in `with_boxes`; host, cost: as the attributes."""
        root = host[self.forest.root]
        other = copy(self)
        other.__dict__.pop("_struct", None)
        other.cost = cost
        other.corners, other.host, other.bounds = (low, high), host, on_device(host, wp.float32, self.child.device)
        other.low, other.high = wp.vec3(*root[:3].min(axis=1).tolist()), wp.vec3(*root[3:].max(axis=1).tolist())
        return other


def on_device(values: np.ndarray, dtype: type, device: wp.Device) -> wp.array:
    """A flat array of what a NumPy array holds, whose memory it shares on the CPU: faster than `wp.array` for structs."""
    count, cpu = values.nbytes // wp.types.type_size_in_bytes(dtype), wp.get_device("cpu")
    shared = wp.array(ptr=address_of(values), dtype=dtype, shape=count, capacity=values.nbytes, device=cpu)
    if device.is_cpu:
        return keep_alive(shared, values)
    made = wp.empty(count, dtype=dtype, device=device)
    wp.copy(made, shared)  # has read all of it when it returns, as the memory is not pinned
    return made


def address_of(values: np.ndarray) -> int:
    """Address of the first element. NumPy would describe all fields of a struct."""
    return (values.view(np.uint8) if values.dtype.names else values).__array_interface__["data"][0]


def build_upper(
    corners: tuple[np.ndarray, np.ndarray],
    environments: np.ndarray,
    width: int,
    parts_depth: int,
    device: wp.Device,
    placed: np.ndarray | None = None,
) -> UpperTree:
    """The trees over the instances.

    Args:
        corners: their boxes, as `InstanceBoxes.rounded` gives them.
        environments: (N,) int32 environment of each.
        width: children of a node.
        parts_depth: as in `UpperTree`.
        device: of the tree.
        placed: (N,) row of each instance in the table of placements; None for its number.
    """

    def build(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        tree = Bvh(width=width, max_leaf_triangles=1).build(boxes_of(low, high), width)
        return tree.child.numpy().reshape(-1, width), tree.primitive.numpy()[::width]

    forest = build_forest(*corners, environments, width, build)
    order = np.repeat(np.arange(len(environments)) if placed is None else placed, width).astype(np.int32)
    arrays = (forest.child.reshape(-1), order, forest.environments, forest.roots, forest.lists)
    child, places, numbers, roots, lists = (wp.array(values, dtype=int, device=device) for values in arrays)
    zero = wp.vec3()
    tree = UpperTree(None, child, places, zero, zero, width, forest.level_first, common.BuildStats(), parts_depth=parts_depth)
    tree.forest, tree.environments, tree.roots, tree.lists = forest, numbers, roots, lists
    tree = tree.with_boxes(*corners)
    tree.built_cost = forest.cost(tree.host)
    return tree


@dataclass(frozen=True)
class Covers:
    """Points that cover meshes, for kernels on the CPU.

    Attributes:
        each: (P, 3) float64 points of each mesh, by `cover`.
        struct: all points, each mesh's last one repeated up to whole lanes.
    """

    each: tuple[np.ndarray, ...]
    struct: CoverPoints

    @classmethod
    def of(cls, each: Sequence[np.ndarray], states: Sequence[SceneState]) -> Covers:
        """Those of the meshes of some states."""
        filled = [np.pad(points, ((0, -len(points) % LANES), (0, 0)), mode="edge") for points in each]
        struct, cpu = CoverPoints(), wp.get_device("cpu")
        struct.begins = wp.array(np.cumsum([0, *map(len, filled)]), dtype=int, device=cpu)
        struct.points = wp.array(np.concatenate(filled).T.ravel(), dtype=wp.float64, device=cpu)
        struct.centers = wp.array(np.array([state.center for state in states]), dtype=wp.vec3d, device=cpu)
        return cls(tuple(each), struct)


def cover(part: SceneState) -> np.ndarray:
    """(P, 3) float64 points relative to a mesh's centre whose convex hull contains all its triangles; few if the mesh is
    large.
    """
    mesh = part.device_mesh
    points = mesh.vertices.numpy()[part.meshes[0].referenced]
    if len(points) <= CELLS**3:
        return points.astype(np.float64)
    low, high = extremes(points)
    cell = ((points - low) / np.maximum(high - low, np.finfo(np.float32).tiny) * CELLS).astype(np.int64).clip(0, CELLS - 1)
    cell = (cell[:, 0] * CELLS + cell[:, 1]) * CELLS + cell[:, 2]
    order = np.argsort(cell, kind="stable")
    begins = np.flatnonzero(np.diff(cell[order], prepend=-1))
    ranked = points[order].astype(np.float64)
    corners = np.stack([np.minimum.reduceat(ranked, begins), np.maximum.reduceat(ranked, begins)])
    choices = np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, 8)
    return np.concatenate([outermost(corners[choice, :, range(3)].T, 2.0 * choice - 1.0) for choice in choices.T])


def outermost(points: np.ndarray, signs: np.ndarray) -> np.ndarray:
    """Those of (P, 3) points that no other one exceeds in all three coordinates times their (3,) signs.

    A corner of a cell is farthest of its cell only along directions of its own signs, along which another such corner that
    exceeds it is as far or farther, in rounded arithmetic too. So boxes stay the same without it.
    """
    ranked = points * signs
    ranked = ranked[np.argsort(-ranked.sum(axis=1), kind="stable")]
    for others in (ranked[:FEW_MOVED], None):
        by = ranked if others is None else others
        is_below = (by[:, None] >= ranked).all(axis=2) & (by[:, None] > ranked).any(axis=2)
        ranked = ranked[~is_below.any(axis=0)]
    return ranked * signs
