"""The clusters of a scene's triangles by which winding numbers are computed: made by the first query, and cached."""

from __future__ import annotations

import math
import threading
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
import warp as wp

from wrt.accelerators.accelerator import resolve_accelerator
from wrt.engine.launch.triangle_records import vertex_blocks
from wrt.kernels.fields.cluster_moments import MOMENTS, Sums, gather_radii, store_moments, sum_children, sum_leaves, vec10d
from wrt.kernels.fields.winding_walk import Clusters, set_far
from wrt.kernels.runtime.launch import launch
from wrt.scene.mesh_state import build_state

if TYPE_CHECKING:
    from wrt.engine.facts.scene_state import SceneState
    from wrt.kernels.layout.bvh_nodes import WideNodes
    from wrt.kernels.triangle.support.record_blocks import TriangleBlocks
    from wrt.meshes.mesh import TriangleMesh


class WindingTree(NamedTuple):
    """A wide BVH of the triangles of a scene, each in one leaf, and its clusters.

    Attributes:
        other: the state that was built for winding numbers; None if the scene's own has such a tree.
        moments, scale: as in `wrt.kernels.fields.winding_walk.Clusters`.
    """

    other: SceneState | None  # not the scene's own, which would keep itself alive
    moments: wp.array
    scale: float


_known: WeakKeyDictionary[SceneState, WindingTree] = WeakKeyDictionary()
_lock = threading.Lock()


def winding_tree(scene: SceneState) -> WindingTree:
    """The clusters of a scene, made at the first call."""
    with _lock:
        if scene not in _known:
            state = state_of_one_bvh(scene)
            tree, other = state.tree.struct(), None if state is scene else state
            scale = scale_of(tree)
            _known[scene] = WindingTree(other, moments_of(tree, vertex_blocks(state), state.width, scale), scale)
        return _known[scene]


def state_of_one_bvh(scene: SceneState) -> SceneState:
    """The state if it is a BVH whose leaves share no triangles; else another one of the same triangles."""
    if scene.is_plain and scene.accelerator.kind == "bvh" and not scene.shares_leaves and scene.lazy_tree is None:
        return scene
    return build_state((visible_mesh(scene),), replace(scene.settings, accelerator=resolve_accelerator("bvh")), None)


def visible_mesh(scene: SceneState) -> TriangleMesh:
    """All triangles as one mesh, but those of instances with mask 0.

    Raises:
        ValueError: no instance is left.
    """
    if not any(instance.mask == 0 for instance in scene.instances):
        return scene.flattened()
    seen = tuple(instance for instance in scene.instances if instance.mask)
    if not seen:
        raise ValueError("all instances have mask 0, so that the scene has no surface; set the mask of one")
    from wrt.scene.scene import Scene

    return Scene(seen, device=scene.device.alias).flattened()


def scale_of(tree: WideNodes) -> float:
    """The power of two by which the farthest coordinate of a tree's box becomes one from 1 to 2."""
    _, exponent = math.frexp(max(map(abs, (*tree.low, *tree.high))))
    return math.ldexp(1.0, min(1 - exponent, 126))


def moments_of(tree: WideNodes, triangles: TriangleBlocks, width: int, scale: float) -> wp.array:
    """(nodes * MOMENTS * W,) the moments of every lane."""
    device, lanes = tree.child.device, tree.child.shape[0]
    sums = Sums()
    sums.area = wp.empty(lanes, dtype=wp.float64, device=device)
    sums.area_vector, sums.weighted = (wp.empty(lanes, dtype=wp.vec3d, device=device) for _ in range(2))
    sums.outer = wp.empty(lanes, dtype=wp.mat33d, device=device)
    sums.third = wp.empty(lanes, dtype=vec10d, device=device)
    moments = wp.empty(lanes * int(MOMENTS), dtype=float, device=device)
    levels = levels_of(tree.child.numpy().reshape(-1, width))
    launch(sum_leaves, lanes, [width, tree, triangles, sums], device=device)
    for begin, count in reversed(levels):
        launch(sum_children, count, [width, begin, tree, sums], device=device, chunk=16)
    launch(store_moments, lanes, [width, scale, tree, triangles, sums, moments], device=device)
    for begin, count in reversed(levels):
        launch(gather_radii, count, [width, begin, tree, moments], device=device, chunk=16)
    return moments


def levels_of(child: np.ndarray) -> list[tuple[int, int]]:
    """(first node, number of nodes) of each level of a tree in breadth-first order, by its child words (nodes, W)."""
    levels, begin, count = [], 0, 1
    while count:
        levels.append((begin, count))
        begin, count = begin + count, int((child[begin : begin + count] >= 0).sum())
    return levels


def clusters_of(tree: WindingTree, state: SceneState, accuracy: float) -> Clusters:
    """The clusters for an accuracy above 0; `state`: whose tree they are of."""
    clusters = Clusters()
    lanes = len(tree.moments) // int(MOMENTS)
    clusters.moments, clusters.scale = tree.moments, tree.scale
    clusters.far = wp.empty(lanes, dtype=float, device=state.device)
    factor = 1.0 / farthest_share(accuracy)
    launch(set_far, lanes, [state.width, factor, clusters], device=state.device, chunk=4096)
    return clusters


def farthest_share(accuracy: float) -> float:
    """The greatest q, a radius over a distance, at which 4 q^3 / (1 - q)^2, the bound of an error, is at most `accuracy`;
    2^-60 where it is smaller, at which nothing is far."""
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if 4.0 * middle**3 <= accuracy * (1.0 - middle) ** 2 else (low, middle)
    return max(low, 2.0**-60)
