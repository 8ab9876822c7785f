"""The way of one ray through a tree: the boxes that it visits, in their order, in float64 on the host.

The order is that of the single-ray traversals: in a bounding volume hierarchy, depth first and the nearest child first; in a
kd-tree, the near side of each plane first. A box is left out if the ray has hit something nearer before it comes to it. The
kernels decide in float32 and allow for rounding: where a ray touches a box within rounding, the kernel may visit one more.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from wrt.builders.bvh import bvh_statistics
from wrt.builders.kdtree import kdtree_statistics
from wrt.builders.tree import Bvh
from wrt.state.scene_state import SceneState

__all__ = ["Visit", "walk"]

MOST_VISITS = 10_000
"""Visits after which a walk ends."""


@dataclass(frozen=True)
class Visit:
    """A box on the way of a ray.

    Attributes:
        low, high: (3,) float64 corners, in the coordinates of the scene.
        depth: number of inner nodes above.
        entry: t where the ray enters the box, or starts in it.
        is_leaf: whether it is a leaf.
        triangles: those of the leaf, numbered through all meshes; empty for an inner node.
        hit: the nearest of them that the ray hits; -1 if there is none.
    """

    low: np.ndarray
    high: np.ndarray
    depth: int
    entry: float
    is_leaf: bool
    triangles: np.ndarray
    hit: int


def walk(scene: SceneState, origin: Any, direction: Any) -> list[Visit]:
    """The boxes that a ray visits on its way to its closest hit.

    Args:
        scene: the state of a scene with a single tree.
        origin, direction: (3,) of the ray.

    Raises:
        ValueError: the scene has many trees.
    """
    if scene.instances or not hasattr(scene.tree, "nodes" if scene.accelerator.kind == "kdtree" else "child"):
        raise ValueError("the scene has many trees; pick in a wrt.Scene of one mesh or several, without instances")
    return [*Walk(scene, origin, direction).visits()]


class Walk:
    """A walk under way."""

    def __init__(self, scene: SceneState, origin: Any, direction: Any) -> None:
        self.center = np.asarray(scene.center, dtype=np.float64)
        self.origin = np.asarray(origin, dtype=np.float64) - self.center
        self.direction = np.asarray(direction, dtype=np.float64)
        self.tree = scene.tree
        self.primitive = scene.tree.primitive.numpy()
        self.vertices = scene.device_mesh.vertices.numpy().astype(np.float64)
        self.faces = scene.device_mesh.faces.numpy()
        self.best = np.inf

    def visits(self) -> Iterator[Visit]:
        """The visits in their order."""
        low, high = (np.array(corner, dtype=np.float64) for corner in (self.tree.low, self.tree.high))
        entry, leave = self.interval(low, high)
        if not entry <= leave:
            return
        steps = self.through_bvh(low, high, entry) if isinstance(self.tree, Bvh) else self.through_kdtree(entry, leave)
        for number, visit in enumerate(steps):
            if number >= MOST_VISITS:
                return
            yield visit

    def through_bvh(self, low: np.ndarray, high: np.ndarray, entry: float) -> Iterator[Visit]:
        """Depth first, the nearest child first."""
        boxes, width = bvh_statistics.unpack(self.tree), self.tree.width
        waiting = [(entry, 0, -1, low, high, 0)]
        while waiting:
            entry, node, lane, low, high, depth = waiting.pop()
            if entry > self.best:
                continue
            if lane >= 0:
                first = boxes.first_block[node, lane] * width
                yield self.visit(low, high, depth, entry, self.primitive[first : first + boxes.triangles[node, lane]])
                continue
            yield self.visit(low, high, depth, entry, None)
            entries, leaves = self.interval(boxes.low[node].astype(np.float64), boxes.high[node].astype(np.float64))
            used = boxes.is_leaf[node] | boxes.is_inner[node]
            met = np.flatnonzero(used & (entries <= np.minimum(leaves, self.best)))
            for child in met[np.argsort(-entries[met], kind="stable")]:
                inner = boxes.is_inner[node, child]
                place = (boxes.child[node, child], -1) if inner else (node, child)
                waiting.append((entries[child], *place, boxes.low[node, child], boxes.high[node, child], depth + 1))

    def through_kdtree(self, entry: float, leave: float) -> Iterator[Visit]:
        """The near side of each plane first."""
        cells, width = kdtree_statistics.unpack(self.tree), self.tree.width
        waiting = [(entry, leave, 0)]
        while waiting:
            entry, leave, node = waiting.pop()
            if entry > self.best:
                continue
            low, high, depth = cells.low[node], cells.high[node], int(cells.depth[node])
            if cells.is_leaf[node]:
                first = cells.first_block[node] * width
                yield self.visit(low, high, depth, entry, self.primitive[first : first + cells.triangles[node]])
                continue
            yield self.visit(low, high, depth, entry, None)
            axis = cells.axis[node]
            with np.errstate(divide="ignore", invalid="ignore"):
                crossing = (cells.position[node] - self.origin[axis]) / self.direction[axis]
            near, far = cells.left[node], cells.right[node]
            if self.direction[axis] < 0.0 or (self.direction[axis] == 0.0 and self.origin[axis] > cells.position[node]):
                near, far = far, near
            if np.isnan(crossing) or self.direction[axis] == 0.0:
                crossing = np.inf
            if crossing <= leave:
                waiting.append((max(entry, crossing), leave, far))
            if crossing >= entry:
                waiting.append((entry, min(leave, crossing), near))

    def visit(self, low: np.ndarray, high: np.ndarray, depth: int, entry: float, triangles: np.ndarray | None) -> Visit:
        """A visit; of a leaf, with its triangles tested."""
        hit = -1
        if triangles is not None and len(triangles):
            t = self.distances(triangles)
            if t.min() < self.best:
                self.best, hit = float(t.min()), int(triangles[np.argmin(t)])
        none = np.empty(0, dtype=np.int32)
        corners = self.center + low, self.center + high
        return Visit(*corners, depth, float(entry), triangles is not None, none if triangles is None else triangles, hit)

    def interval(self, low: np.ndarray, high: np.ndarray) -> tuple[Any, Any]:
        """t where the ray enters and leaves boxes (..., 3); entry > leave if it misses."""
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = (low - self.origin) / self.direction, (high - self.origin) / self.direction
        near, far = np.fmin(*ends), np.fmax(*ends)
        outside = (self.direction == 0.0) & ((self.origin < low) | (self.origin > high))
        near, far = np.where(np.isnan(near), -np.inf, near), np.where(np.isnan(far), np.inf, far)
        entry, leave = np.maximum(near.max(axis=-1), 0.0), far.min(axis=-1)
        return np.where(outside.any(axis=-1), np.inf, entry), leave

    def distances(self, triangles: np.ndarray) -> np.ndarray:
        """(n,) t of hits with triangles, infinite for misses (Moeller and Trumbore 1997)."""
        a, b, c = (self.vertices[self.faces[triangles, corner]] for corner in range(3))
        across = np.cross(self.direction, c - a)
        area = np.einsum("ij,ij->i", b - a, across)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = np.einsum("ij,ij->i", self.origin - a, across) / area
            normal = np.cross(self.origin - a, b - a)
            v = normal @ self.direction / area
            t = np.einsum("ij,ij->i", c - a, normal) / area
            hit = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1.0 + 1e-9) & (t >= 0.0)
        return np.where(hit, t, np.inf)
