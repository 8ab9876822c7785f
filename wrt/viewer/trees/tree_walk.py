"""The way of one ray through a tree: the boxes that it visits, in their order, in float64 on the host.

The order is that of the single-ray traversals: in a bounding volume hierarchy, depth first and the nearest child first; in a
kd-tree, the near side of each plane first. A box is left out if the ray has hit something nearer before it comes to it. The
kernels decide in float32 and allow for rounding: where a ray touches a box within rounding, the kernel may visit one more.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from wrt.builders.bvh import bvh_statistics
from wrt.builders.kdtree import kdtree_statistics
from wrt.builders.tree import Bvh
from wrt.engine.facts.scene_state import SceneState
from wrt.viewer.trees.box_lines import box_corners

__all__ = ["Placed", "Visit", "Walk", "interval", "nearest_first"]


@dataclass(frozen=True)
class Visit:
    """A box on the traversal path of a ray.

    Attributes:
        corners: (8, 3) float64, in the coordinates of the scene; the boxes of an instance's mesh are turned as it is.
        depth: number of boxes above, through both levels of a scene of instances.
        entry: t where the ray enters the box, or starts in it.
        is_leaf: whether it is a leaf of its tree.
        triangles: those of the leaf, numbered as `wrt.Hits.primitive_id`; empty for all others.
        hit: the nearest of them that the ray hits; -1 if there is none.
        instance: whose box it is, or to whose mesh's tree it belongs; -1 for a tree above instances, and without instances.
        is_instance: whether it is the box of an instance, a leaf of the tree above them.
    """

    corners: np.ndarray
    depth: int
    entry: float
    is_leaf: bool
    triangles: np.ndarray
    hit: int
    instance: int = -1
    is_instance: bool = False


@dataclass(frozen=True)
class Placed:
    """Where the tree of a mesh stands in a scene.

    Attributes:
        to_scene, origin: (3, 3) and (3,): a point p of the tree is to_scene p + origin in the scene.
        depth: of its root.
        instance: as in `Visit`.
        entry: t where the ray enters the box of the instance.
    """

    to_scene: np.ndarray
    origin: np.ndarray
    depth: int = 0
    instance: int = -1
    entry: float = 0.0


class Walk:
    """A walk through the tree of a mesh under way.

    Args:
        scene: the state with the tree.
        origin, direction: (3,) of the ray in the coordinates of the tree.
        placed: where the tree is.
        best: t of the best hit so far.
    """

    def __init__(
        self, scene: SceneState, origin: np.ndarray, direction: np.ndarray, placed: Placed, best: float = np.inf
    ) -> None:
        self.origin, self.direction, self.placed, self.best = origin, direction, placed, best
        self.tree = scene.tree
        self.primitive = scene.tree.primitive.numpy()
        self.vertices = scene.device_mesh.vertices.numpy().astype(np.float64)
        self.faces = scene.device_mesh.faces.numpy()

    def visits(self) -> Iterator[Visit]:
        """The visits in their order."""
        low, high = (np.array(corner, dtype=np.float64) for corner in (self.tree.low, self.tree.high))
        entry, leave = interval(self.origin, self.direction, low, high)
        is_met = entry <= min(leave, self.best)
        if isinstance(self.tree, Bvh) and (is_met or self.placed.instance >= 0):
            yield from self.through_bvh(entry if is_met else self.placed.entry)  # an instance's box was met already
        elif is_met:
            yield from self.through_kdtree(entry, leave)

    def through_bvh(self, entry: float) -> Iterator[Visit]:
        """Depth first, the nearest child first."""
        for leaf in nearest_first(self.tree, self.origin, self.direction, 0, entry, lambda: self.best):
            first = leaf.first_block * self.tree.width
            triangles = self.primitive[first : first + leaf.triangles] if leaf.is_leaf else None
            yield self.visit(leaf.low, leaf.high, leaf.depth, leaf.entry, triangles)

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
        hit, placed = -1, self.placed
        if triangles is not None and len(triangles):
            t = self.distances(triangles)
            if t.min() < self.best:
                self.best, hit = float(t.min()), int(triangles[np.argmin(t)])
        corners = box_corners(np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64))
        numbers = np.empty(0, dtype=np.int32) if triangles is None else triangles
        at = corners @ placed.to_scene.T + placed.origin
        return Visit(at, placed.depth + depth, float(entry), triangles is not None, numbers, hit, placed.instance)

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


@dataclass(frozen=True)
class Box:
    """A box of a bounding volume hierarchy that a ray comes to, relative to its centre; fields as in `Visit` and
    `wrt.builders.bvh.bvh_statistics.UnpackedBvh`."""

    low: np.ndarray
    high: np.ndarray
    depth: int
    entry: float
    is_leaf: bool
    first_block: int = 0
    triangles: int = 0


def nearest_first(
    tree: Bvh, origin: np.ndarray, direction: np.ndarray, root: int, entry: float, best: Callable[[], float]
) -> Iterator[Box]:
    """The boxes that a ray visits, depth first and the nearest child first.

    Args:
        tree: the tree.
        origin, direction: (3,) of the ray relative to the tree's centre.
        root: node to start at.
        entry: t where the ray enters its box.
        best: t of the best hit so far; asked again after each box.
    """
    boxes = bvh_statistics.unpack(tree)
    waiting = [(entry, root, -1, np.array(tree.low), np.array(tree.high), 0)]
    while waiting:
        entry, node, lane, low, high, depth = waiting.pop()
        if entry > best():
            continue
        if lane >= 0:
            yield Box(low, high, depth, entry, True, int(boxes.first_block[node, lane]), int(boxes.triangles[node, lane]))
            continue
        yield Box(low, high, depth, entry, False)
        lows, highs = boxes.low[node].astype(np.float64), boxes.high[node].astype(np.float64)
        entries, leaves = interval(origin, direction, lows, highs)
        used = boxes.is_leaf[node] | boxes.is_inner[node]
        met = np.flatnonzero(used & (entries <= np.minimum(leaves, best())))
        for child in met[np.argsort(-entries[met], kind="stable")]:
            place = (boxes.child[node, child], -1) if boxes.is_inner[node, child] else (node, child)
            waiting.append((entries[child], *place, lows[child], highs[child], depth + 1))


def interval(origin: np.ndarray, direction: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[Any, Any]:
    """t where a ray enters and leaves boxes (..., 3); entry > leave if it misses."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = (low - origin) / direction, (high - origin) / direction
    near, far = np.fmin(*ends), np.fmax(*ends)
    outside = (direction == 0.0) & ((origin < low) | (origin > high))
    near, far = np.where(np.isnan(near), -np.inf, near), np.where(np.isnan(far), np.inf, far)
    entry, leave = np.maximum(near.max(axis=-1), 0.0), far.min(axis=-1)
    return np.where(outside.any(axis=-1), np.inf, entry), leave
