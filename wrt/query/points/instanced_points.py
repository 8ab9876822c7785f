"""Closest points in scenes of instances: the trees of the meshes are searched one instance after the other."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from wrt.engine.memory import empty
from wrt.kernels.points.instance_points import PointMap, leave_instance, make_enter
from wrt.kernels.points.point_batch import NearestBatch, PointBatch
from wrt.kernels.runtime.launch import launch, specialise

if TYPE_CHECKING:
    from wrt.engine.facts.scene_state import SceneState

UNEVEN = 1e-6
"""How far the axes of a map may differ in length and from right angles, relative to their length."""


def scale_of(transform: np.ndarray) -> float | None:
    """The factor by which a (4, 4) map multiplies all distances; None if there is none."""
    linear = np.asarray(transform, dtype=np.float64)[:3, :3]
    lengths = linear.T @ linear
    square = np.trace(lengths) / 3.0
    return float(np.sqrt(square)) if np.abs(lengths / square - np.eye(3)).max() <= UNEVEN else None


def check_maps(scene: SceneState) -> None:
    """Refuses instances whose maps do not multiply all distances alike.

    Raises:
        ValueError: there is one; the message names it.
    """
    for number, instance in enumerate(scene.instances):
        if instance.mask and scale_of(instance.transform) is None:
            raise ValueError(
                f"closest_point needs instances that are moved, turned, mirrored or scaled alike along all axes, and instance "
                f"{number} is not; use wrt.Scene(scene.flattened())"
            )


def search_instances(
    scene: SceneState,
    given: wp.array,
    points: PointBatch,
    so_far: NearestBatch,
    search: Callable[[SceneState, PointBatch, NearestBatch], None],
) -> None:
    """What is nearest to points in any instance, in the order of instances; those with mask 0 are left out.

    Args:
        scene: of instances whose maps are checked (`check_maps`).
        given: (N,) vec3 or vec3d, the points as the caller gave them.
        points: their order and limits.
        so_far: filled here.
        search: finds what is nearest in the tree of one mesh.
    """
    device, count = scene.device, points.count
    so_far.distance.fill_(float("inf"))
    so_far.primitive.fill_(-1)
    so_far.uv.zero_()
    so_far.feature.fill_(-1)
    own, found = PointBatch(), NearestBatch()
    own.count, own.order, own.most_stride = count, points.order, 1
    own.position, own.most = empty(count, wp.vec3, device), empty(count, wp.float32, device)
    found.distance, found.primitive = empty(count, wp.float32, device), empty(count, wp.int32, device)
    found.uv, found.feature = empty(count, wp.vec2, device), empty(count, wp.int8, device)
    firsts = scene.device_mesh.geometry_first.numpy()
    for number, instance in enumerate(scene.instances):
        if instance.mask == 0:
            continue
        part = scene.mesh_states[scene.geometry_ids[number]]  # type: ignore[attr-defined]
        to_mesh = map_of(instance.transform, part.center, int(firsts[number]))
        inputs = [given, to_mesh, points, so_far, own]
        launch(specialise(make_enter, given.dtype), count, inputs, device=device, chunk=4096)
        search(part, own, found)
        launch(leave_instance, count, [found, to_mesh, points, so_far], device=device, chunk=4096)


def map_of(transform: np.ndarray, center: np.ndarray, first: int) -> PointMap:
    """The map to an instance's mesh."""
    made, inverse = PointMap(), np.linalg.inv(np.asarray(transform, dtype=np.float64))
    made.linear, made.shift = wp.mat33d(*inverse[:3, :3].ravel().tolist()), wp.vec3d(*(inverse[:3, 3] - center).tolist())
    made.scale, made.first = scale_of(transform), first
    return made
