"""The fans of a scene's triangles on its device, and brute force over them."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from wrt.builders.triangle_fans import TriangleFans, build_fans
from wrt.engine.device_hits import DeviceHits
from wrt.engine.launch.traversal_launch import BRUTE_FORCE_TESTS
from wrt.engine.rays.device_rays import to_device
from wrt.engine.rays.rays import Rays
from wrt.kernels.runtime.launch import launch
from wrt.kernels.traversal.fan_brute_force import FanSet, make_fan_kernel


def fans_of(scene: Any, start: int | None = None) -> TriangleFans:
    """The fans of the triangles of a scene's state, vertices that coincide counting as one. start: as in `build_fans`."""
    vertices, faces = scene.device_mesh.vertices.numpy(), scene.device_mesh.faces.numpy()
    _, same = np.unique(vertices, axis=0, return_inverse=True)
    return build_fans(same.ravel()[faces], start)


def on_device(scene: Any, fans: TriangleFans, edges: bool) -> FanSet:
    """The fans with the positions of their vertices, normals and planes; `edges`: the rim from the fan's centre."""
    positions = np.unique(scene.device_mesh.vertices.numpy(), axis=0)
    centre, rim = positions[fans.centre], positions[fans.rim]
    from_centre = rim - np.repeat(centre, np.diff(fans.first), axis=0)
    inner = np.ones(len(rim), dtype=bool)
    inner[fans.first[1:] - 1] = False
    one, other = from_centre[inner], from_centre[np.flatnonzero(inner) + 1]
    made = FanSet()
    made.normal = wp.array(crossed(one, other), dtype=wp.vec3, device=scene.device)
    made.planes = wp.array(weight_planes(one, other), dtype=wp.vec3, device=scene.device)
    made.count = len(fans)
    made.centre = wp.array(centre, dtype=wp.vec3, device=scene.device)
    made.rim = wp.array(from_centre if edges else rim, dtype=wp.vec3, device=scene.device)
    made.low, made.high = (wp.vec3(*map(float, corner)) for corner in (positions.min(axis=0), positions.max(axis=0)))
    for name in ("first", "primitive", "corner"):
        setattr(made, name, wp.array(getattr(fans, name), dtype=int, device=scene.device))
    return made


def crossed(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(N, 3) cross products, with the operations of the kernels in their order."""
    (px, py, pz), (qx, qy, qz) = one.T, other.T
    return np.stack([py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx], axis=1)


def weight_planes(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(N, 2, 3) float32 normals whose products with a point are the weights of a triangle's corners `one` and `other`, from its
    third corner (Havel and Herout's N1 and N2); computed in float64.
    """
    one, other = one.astype(np.float64), other.astype(np.float64)
    normal = crossed(one, other)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = 1.0 / (normal * normal).sum(axis=1, keepdims=True)
        return np.stack([crossed(other, normal) * scale, crossed(normal, one) * scale], axis=1).astype(np.float32)


def fan_boxes(fans: TriangleFans, made: FanSet, edges: bool) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) float32 boxes of fans. With `edges` rims are centre + edge as kernels compute it, which rounds."""
    centre, rim = made.centre.numpy(), made.rim.numpy()
    if edges:
        rim = np.repeat(centre, np.diff(fans.first), axis=0) + rim
    else:
        own = np.repeat(centre, np.diff(fans.first), axis=0)
        rim = own + (rim - own)
    low, high = (end.reduceat(rim, fans.first[:-1], axis=0) for end in (np.minimum, np.maximum))
    return np.minimum(low, centre), np.maximum(high, centre)


def closest_by_fans(scene: Any, fans: FanSet, rays: Rays, form: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Closest hits of all rays with all fans, by brute force.

    Args:
        scene: whose fans they are.
        fans: made by `on_device` with the rim that the form needs.
        rays: N rays.
        form: key in `wrt.kernels.traversal.fan_brute_force.FAN_FORMS`.

    Returns:
        t (N,) float32, inf for a miss; triangle (N,) int32, -1 for a miss; uv (N, 2) float32.
    """
    buffers = to_device(rays, scene.device, scene.center)
    hits = DeviceHits.new("closest", buffers.batch.count, scene.device)
    longest = max(1, BRUTE_FORCE_TESTS // scene.triangle_count)
    inputs = [fans, buffers.batch, hits.struct()]
    launch(make_fan_kernel(form), buffers.batch.count, inputs, device=scene.device, chunk=64, longest=longest)
    return hits.t.numpy(), hits.primitive.numpy(), hits.uv.numpy()
