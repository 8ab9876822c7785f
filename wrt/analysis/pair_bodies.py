"""The bodies of a scene between which distances are: their trees, their placements, and the pairs of boxes near the roots."""

from __future__ import annotations

from dataclasses import dataclass, replace
from threading import Lock
from typing import TYPE_CHECKING, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
import warp as wp

from wrt.accelerators.accelerator import resolve_accelerator
from wrt.analysis.winding_clusters import state_of_one_bvh
from wrt.engine.launch.triangle_records import vertex_blocks
from wrt.kernels.layout.bvh_nodes import EMPTY_LANE
from wrt.kernels.pairs.pair_walk import Body, PairWork
from wrt.kernels.runtime.launch import kept
from wrt.scene.mesh_state import build_state

if TYPE_CHECKING:
    from wrt.engine.facts.scene_state import SceneState

TOP_NODES = 100
"""Nodes near a root that the host opens."""

TREE_ERROR = 2.0**-22
"""Of distances of boxes, relative to how far a mesh reaches from its centre: its vertices are float32 there."""

ROUNDING = 2.0**-44
"""Of distances in float64, relative to coordinates."""


class PairTree(NamedTuple):
    """The tree of a mesh and its triangles as they were given.

    Attributes:
        other: the state that was built for its tree; None if the mesh's own has such a one.
        vertices: (V,) vec3d on the device.
        faces: (F,) vec3i on the device.
        child: (T, W) words of the first nodes.
        boxes: (T, W, 2, 3) float64 middles and half sizes of their boxes, relative to the mesh's centre.
        root: (2, 3) the same of all.
    """

    other: SceneState | None  # not the mesh's own, which would keep itself alive
    vertices: wp.array
    faces: wp.array
    child: np.ndarray
    boxes: np.ndarray
    root: np.ndarray


@dataclass(frozen=True, eq=False)
class PlacedBody:
    """A mesh in a scene.

    Attributes:
        number: of the instance, or of the mesh in a scene without instances.
        part: the state of the mesh.
        tree: of the part.
        linear, origin: a point p of the mesh is at linear p + origin.
        center: (3,) the mesh's centre in the scene.
    """

    number: int
    part: SceneState
    tree: PairTree
    linear: np.ndarray
    origin: np.ndarray
    center: np.ndarray

    @property
    def state(self) -> SceneState:
        """The state whose tree it is."""
        return self.tree.other or self.part

    @property
    def box(self) -> np.ndarray:
        """(2, 3) middle and half size of its box in the scene."""
        return self.placed(self.tree.root)

    def placed(self, boxes: np.ndarray) -> np.ndarray:
        """Boxes around (..., 2, 3) boxes of the mesh, along the axes of the scene."""
        return np.stack([boxes[..., 0, :] @ self.linear.T + self.center, boxes[..., 1, :] @ np.abs(self.linear).T], axis=-2)

    @property
    def reach(self) -> float:
        """How far the mesh reaches from its centre, summed over the axes."""
        return float((np.abs(self.linear) @ np.abs(self.tree.root).sum(axis=0)).sum())

    @property
    def coordinates(self) -> float:
        """The size of its coordinates, summed over the axes: of those that are mapped, of the map, and in the scene."""
        middle = np.abs(self.linear) @ np.abs(self.state.center)
        return float((middle + np.abs(self.origin) + np.abs(self.center)).sum()) + 2.0 * self.reach

    def struct(self) -> Body:
        """What kernels read."""
        body, state = Body(), self.state
        body.nodes, body.primitive = state.tree.struct(), vertex_blocks(state).primitive
        body.vertices, body.faces = self.tree.vertices, self.tree.faces
        body.linear, body.origin, body.center = wp.mat33d(*self.linear.ravel()), wp.vec3d(*self.origin), wp.vec3d(*self.center)
        return body


_trees: WeakKeyDictionary[SceneState, PairTree] = WeakKeyDictionary()
_meshes: WeakKeyDictionary[SceneState, dict[int, SceneState]] = WeakKeyDictionary()
_lock = Lock()


def check_bodies(scene: SceneState, query: str) -> str:
    """What the bodies of a scene are: "instance", or "mesh" where there are none.

    Raises:
        ValueError: a scene of another kind, or of a single mesh.
    """
    if isinstance(getattr(scene, "mesh_states", None), tuple) and scene.instances:
        kind, count = "instance", len(scene.instances)
    elif scene.is_plain:
        kind, count = "mesh", len(scene.meshes)
    else:
        raise ValueError(f"{query} needs triangles in trees; use wrt.Scene(scene.meshes)")
    if count < 2:
        raise ValueError(
            f"{query} is between two meshes or instances, and the scene has one; make it of both, "
            "wrt.Scene([mesh, other]), or of instances"
        )
    return kind


def body_count(scene: SceneState) -> int:
    """Number of instances, or of meshes where there are none."""
    return len(scene.instances or scene.meshes)


def body_of(scene: SceneState, number: int) -> PlacedBody:
    """An instance, or a mesh where there are none."""
    if scene.instances:
        part, transform = scene.parts[scene.geometry_ids[number]], scene.instances[number].transform
    else:
        part, transform = mesh_part(scene, number), np.eye(4)
    tree = pair_tree(part)
    linear, origin = transform[:3, :3], transform[:3, 3]
    center = linear @ (tree.other or part).center + origin
    return PlacedBody(number, part, tree, linear, origin, center)


def mesh_part(scene: SceneState, number: int) -> SceneState:
    """The state of one mesh of a scene whose meshes share a tree, built at the first call."""
    with _lock:
        known = _meshes.setdefault(scene, {})
        if number not in known:
            settings = replace(scene.settings, accelerator=resolve_accelerator("bvh"))
            known[number] = build_state((scene.meshes[number],), settings, None)
        return known[number]


def pair_tree(part: SceneState) -> PairTree:
    """The tree of a mesh, made at the first call."""
    with _lock:
        if part not in _trees:
            _trees[part] = make_tree(part)
        return _trees[part]


def make_tree(part: SceneState) -> PairTree:
    """The tree of a mesh; one is built if its own is a kd-tree, or has triangles in several leaves."""
    state, mesh = state_of_one_bvh(part), part.meshes[0]
    with kept(part.device):
        vertices = wp.array(np.asarray(mesh.vertices, dtype=np.float64), dtype=wp.vec3d, device=part.device)
        faces = wp.array(np.asarray(mesh.faces, dtype=np.int32), dtype=wp.vec3i, device=part.device)
    width, nodes = state.width, state.tree.struct()
    count = min(TOP_NODES, nodes.child.shape[0] // width)
    corners = nodes.bounds[: count * 6 * width].numpy().reshape(count, 2, 3, width).astype(np.float64).transpose(0, 3, 1, 2)
    child = nodes.child[: count * width].numpy().reshape(count, width).copy()
    corners = np.where((child != int(EMPTY_LANE))[..., None, None], corners, 0.0)
    root = np.array([state.tree.low, state.tree.high], dtype=np.float64)
    return PairTree(None if state is part else state, vertices, faces, child, middles(corners), middles(root))


def middles(corners: np.ndarray) -> np.ndarray:
    """(..., 2, 3) middles and half sizes of boxes, by their corners."""
    low, high = corners[..., 0, :], corners[..., 1, :]
    return np.stack([0.5 * (low + high), 0.5 * (high - low)], axis=-2)


def box_gaps(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(...) least and greatest distances of points of two boxes, each (..., 2, 3): middle and half size."""
    apart, half = np.abs(a[..., 0, :] - b[..., 0, :]), a[..., 1, :] + b[..., 1, :]
    return np.linalg.norm(np.maximum(apart - half, 0.0), axis=-1), np.linalg.norm(apart + half, axis=-1)


def slack_of(a: PlacedBody, b: PlacedBody) -> tuple[float, float]:
    """By how much distances of boxes may be too large, and those of triangles too small; see `wrt.kernels.pairs`."""
    rounding = ROUNDING * (a.coordinates + b.coordinates)
    return TREE_ERROR * (a.reach + b.reach) + rounding, rounding


def pair_work(a: PlacedBody, b: PlacedBody, max_distance: float, entries: int) -> PairWork:
    """Pairs of boxes near the roots, the nearest first, below which are all pairs of triangles up to `max_distance`.

    Args:
        a, b: the bodies.
        max_distance: greatest distance of a pair; 0 for pairs that meet.
        entries: about how many are enough.
    """
    slack, near_slack = slack_of(a, b)
    width = a.state.width
    own, other = (body.placed(body.tree.boxes).reshape(-1, 2, 3) for body in (a, b))
    child, other_child = a.tree.child.ravel(), b.tree.child.ravel()
    roots = (np.flatnonzero(words[:width] != int(EMPTY_LANE)) for words in (child, other_child))
    lanes = np.stack(np.meshgrid(*roots, indexing="ij"), axis=-1).reshape(-1, 2)
    size, other_size = own[:, 1].sum(axis=1), other[:, 1].sum(axis=1)
    while True:
        gap, greatest = box_gaps(own[lanes[:, 0]], other[lanes[:, 1]])
        near = gap <= min(max_distance, float(greatest.min(initial=np.inf)) if max_distance > 0.0 else 0.0) + slack
        lanes, gap = lanes[near], gap[near]
        words = np.stack([child[lanes[:, 0]], other_child[lanes[:, 1]]], axis=1)
        can = (words >= 0) & (words < [len(a.tree.child), len(b.tree.child)])
        if len(lanes) >= entries or not can.any():
            break
        first = can[:, 0] & (~can[:, 1] | (size[lanes[:, 0]] >= other_size[lanes[:, 1]]))
        second = can[:, 1] & ~first
        parts = [lanes[~(first | second)]]
        for side, chosen, all_words in ((0, first, child), (1, second, other_child)):
            opened = words[chosen, side][:, None] * width + np.arange(width)
            made = np.repeat(lanes[chosen][:, None], width, axis=1)
            made[..., side] = opened
            parts.append(made[all_words[opened] != int(EMPTY_LANE)])
        lanes = np.concatenate(parts)
    order, device, work = np.argsort(gap, kind="stable"), a.part.device, PairWork()
    work.boxes = wp.array(lanes[order].astype(np.int32), dtype=wp.vec2i, device=device)
    work.square = wp.array(gap[order] ** 2, dtype=wp.float64, device=device)
    work.limit = wp.float64(np.nextafter(np.float64(max_distance) ** 2, np.inf))
    work.max_square = wp.array([work.limit], dtype=wp.float64, device=device)
    work.slack, work.near_slack = wp.float64(slack), wp.float64(near_slack)
    return work
