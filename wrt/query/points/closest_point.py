"""Closest points on a scene: from the caller's points to the kernels of `wrt.kernels.points`, and what they answer."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.engine.device_hits import DeviceHits
from wrt.engine.facts.query_kinds import CLOSEST
from wrt.engine.memory import empty
from wrt.engine.rays.rays import MAX_RAYS, ResultForm, as_vectors
from wrt.kernels.layout.mesh_placement import make_shift
from wrt.kernels.points.point_batch import NearestBatch, PointBatch
from wrt.kernels.points.tree_points import GROUP, PointConfig, make_points_kernel
from wrt.kernels.runtime.launch import launch, refuse_capture, specialise, use_threads
from wrt.kernels.validation import as_real_array
from wrt.query.points.closest_points import ClosestPoints
from wrt.query.points.instanced_points import check_maps, search_instances

if TYPE_CHECKING:
    from wrt.engine.facts.scene_state import SceneState

MIN_SORTED = 1024
"""Fewest points that are sorted."""


def closest_point(scene: SceneState, points: Any, max_distance: Any) -> ClosestPoints:
    """The closest point on the scene of each point; see `wrt.Scene.closest_point`."""
    refuse_capture("closest_point", scene.device)
    check_scene(scene)
    given = as_vectors(points, "points", scene.device)
    is_warp = isinstance(given, wp.array)
    shape = given.shape if is_warp else given.shape[:-1]
    count = math.prod(shape)
    if count > MAX_RAYS:
        raise ValueError(f"{count:,} points are more than the {MAX_RAYS:,} of one call; pass parts of them")
    most = as_distances(max_distance, shape)
    is_wide = given.dtype in (wp.vec3d, np.dtype(np.float64))
    with use_threads(scene.num_threads):
        flat = flat_points(scene, given, is_wide)
        batch = PointBatch()
        batch.count, batch.position = count, relative_points(scene, flat)
        batch.most, batch.most_stride = wp.array(most, dtype=float, device=scene.device), int(len(most) > 1)
        found, feature = find_nearest(scene, flat, batch)
    return ClosestPoints(found, feature, ResultForm(shape, is_warp, np.float64 if is_wide else np.float32), scene)


def check_scene(scene: SceneState) -> None:
    """Refuses scenes that are not triangles in trees, and instances that are not similar to their meshes.

    Raises:
        ValueError: such a scene; the message says which one to make.
    """
    if isinstance(getattr(scene, "mesh_states", None), tuple) and scene.instances:
        check_maps(scene)
    elif not scene.is_plain:
        raise ValueError("closest_point needs triangles in a single tree; use wrt.Scene(scene.meshes)")


def as_distances(values: Any, shape: tuple[int, ...]) -> np.ndarray:
    """(N,) or (1,) float32 greatest distances of points of a leading shape.

    Raises:
        TypeError: not real numbers.
        ValueError: a negative number or a NaN, or a shape that does not broadcast.
    """
    values = values.numpy() if isinstance(values, wp.array) else values
    array = as_real_array("max_distance", values)
    if not (array >= 0.0).all():
        raise ValueError("max_distance must be 0 or more, or inf for no limit")
    with np.errstate(over="ignore"):  # beyond float32 is no limit
        array = np.asarray(array).astype(np.float32)
    if array.size == 1:
        return array.reshape(1)
    try:
        return np.ascontiguousarray(np.broadcast_to(array, shape)).reshape(-1)
    except ValueError:
        raise ValueError(f"max_distance {array.shape} does not broadcast to the points' leading shape {shape}") from None


def flat_points(scene: SceneState, points: np.ndarray | wp.array, is_wide: bool) -> wp.array:
    """(N,) vec3 or vec3d on the device: the points as they are given."""
    if isinstance(points, wp.array):
        return points.flatten()
    dtype = wp.vec3d if is_wide else wp.vec3
    return wp.array(np.ascontiguousarray(points).reshape(-1, 3), dtype=dtype, device=scene.device, copy=False)


def relative_points(scene: SceneState, points: wp.array) -> wp.array:
    """(N,) vec3: points relative to the scene's centre, subtracted in float64."""
    relative, center = empty(len(points), wp.vec3, scene.device), wp.vec3d(*map(float, scene.center))
    launch(specialise(make_shift, points.dtype), len(points), [center, points, relative], device=scene.device, chunk=4096)
    return relative


def find_nearest(scene: SceneState, given: wp.array, points: PointBatch) -> tuple[DeviceHits, wp.array]:
    """What is nearest to points, with distances as t, and the features.

    Args:
        scene: triangles in one tree, or instances of such; lazy trees are completed.
        given: (N,) vec3 or vec3d, the points as the caller gave them.
        points: the same, relative to the scene's centre; their order is chosen here.
    """
    from wrt.kernels.points.point_order import morton_order

    device = scene.device
    points.order = wp.empty(0, dtype=int, device=device)
    if points.count >= MIN_SORTED:
        points.order = morton_order(points.position, scene.device_mesh.low, scene.device_mesh.high)
    hits, feature = DeviceHits.new(CLOSEST, points.count, device), empty(points.count, wp.int8, device)
    found = nearest_batch(hits, feature)
    if scene.instances:
        search_instances(scene, given, points, found, search_tree)
    else:
        search_tree(scene, points, found)
    return hits, feature


def search_tree(scene: SceneState, points: PointBatch, found: NearestBatch) -> None:
    """Fills what is nearest to points among triangles in one tree."""
    from wrt.engine.launch.triangle_records import vertex_blocks

    scene.complete()
    device, tree = scene.device, scene.tree
    kind, group = "kdtree" if scene.accelerator.kind == "kdtree" else "bvh", 1 if device.is_cuda else GROUP
    kernel = specialise(make_points_kernel, PointConfig(kind, tree.width, group))
    inputs = [tree.struct(), vertex_blocks(scene), points, found]
    launch(kernel, -(-points.count // group), inputs, device=device, chunk=max(1, 256 // group), longest=4096)


def nearest_batch(hits: DeviceHits, feature: wp.array) -> NearestBatch:
    """The arrays of answers for kernels."""
    batch = NearestBatch()
    batch.distance, batch.primitive, batch.uv, batch.feature = hits.t, hits.primitive, hits.uv, feature
    return batch
