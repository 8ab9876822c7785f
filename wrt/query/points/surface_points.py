"""Points on a scene's triangles as hits, so that rays can leave them as they leave hits."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.engine.device_hits import DTYPES, DeviceHits
from wrt.engine.rays.rays import ResultForm
from wrt.kernels.answers.answer_kind import HIT_COLUMNS
from wrt.kernels.runtime.launch import use_threads
from wrt.kernels.validation import first_bad
from wrt.query.hits import Hits

if TYPE_CHECKING:
    from wrt.engine.facts.scene_state import SceneState

TOLERANCE = 1e-3
"""Greatest distance of a point from its triangle, as a fraction of the triangle's longest edge."""

ROUNDING = 1e-6
"""How far weights may lie outside of [0, 1]."""


def points_on(scene: SceneState, primitive_id: Any, uv: Any, points: Any, instance_id: Any) -> Hits:
    """Points of triangles; see `wrt.Scene.points_on`."""
    if uv is not None and points is not None:
        raise TypeError("uv and points both say where on the triangles; pass one of them")
    arrays = {"primitive_id": _integers(primitive_id, "primitive_id"), "instance_id": _which(scene, instance_id)}
    if uv is not None:
        arrays["uv"] = _numbers(uv, "uv", 2)
    if points is not None:
        arrays["points"] = _numbers(points, "points", 3)
    shapes = {name: array.shape if name.endswith("_id") else array.shape[:-1] for name, array in arrays.items()}
    try:
        shape = np.broadcast_shapes(*shapes.values())
    except ValueError:
        listed = ", ".join(f"{name} {own}" for name, own in shapes.items())
        raise ValueError(f"the leading shapes do not broadcast: {listed}") from None
    number = _numbers_in_scene(scene, *(np.broadcast_to(arrays[name], shape) for name in ("primitive_id", "instance_id")))
    weights = np.broadcast_to(np.float64(1 / 3), (*shape, 2))
    if uv is not None:
        weights = np.broadcast_to(arrays["uv"], (*shape, 2))
        _check_weights(weights[number >= 0])
    with use_threads(scene.num_threads):
        if points is not None:
            given = np.broadcast_to(arrays["points"], (*shape, 3)).reshape(-1, 3)
            weights = _weights_of(scene, number.reshape(-1), given).reshape(*shape, 2)
        return _hits(scene, number, weights, isinstance(primitive_id, wp.array))


def _hits(scene: SceneState, number: np.ndarray, weights: np.ndarray, is_warp: bool) -> Hits:
    """Hits at weights of triangles that are numbered through the scene."""
    is_hit = number.reshape(-1) >= 0
    values = {
        "t": np.where(is_hit, np.float32(0.0), np.float32(np.inf)),
        "primitive": number.reshape(-1),
        "uv": np.where(is_hit[:, None], weights.reshape(-1, 2), 0.0).astype(np.float32),
    }
    batch = DeviceHits(len(is_hit), scene.device)
    batch.__dict__.update({name: wp.array(values[name], dtype=DTYPES[name], device=scene.device) for name in HIT_COLUMNS})
    return Hits(batch, ResultForm(number.shape, is_warp, np.float64), scene, None)


def _integers(values: Any, name: str) -> np.ndarray:
    array = np.asarray(values.numpy() if isinstance(values, wp.array) else values)
    if array.dtype.kind not in "iu":
        raise TypeError(f"{name} must hold integers, not {array.dtype}")
    return array


def _numbers(values: Any, name: str, components: int) -> np.ndarray:
    """A float64 array whose last axis has this many components."""
    array = np.asarray(values.numpy() if isinstance(values, wp.array) else values)
    if array.dtype.kind not in "fiu":
        raise TypeError(f"{name} must hold real numbers, not {array.dtype}")
    if array.ndim == 0 or array.shape[-1] != components:
        raise ValueError(f"{name} must have shape (..., {components}), not {array.shape}")
    return array.astype(np.float64)


def _which(scene: SceneState, instance_id: Any) -> np.ndarray:
    """The instances, or the meshes, whose triangles are meant."""
    if instance_id is not None:
        return _integers(instance_id, "instance_id")
    if (count := len(scene.instances) or len(scene.meshes)) > 1:
        what = "instances" if scene.instances else "meshes"
        raise ValueError(f"the scene has {count} {what}; say with instance_id whose triangles these are")
    return np.zeros((), dtype=np.int64)


def _numbers_in_scene(scene: SceneState, primitive: np.ndarray, instance: np.ndarray) -> np.ndarray:
    """Checked numbers of triangles through the whole scene, int32; -1 for none."""
    first = scene.device_mesh.geometry_first.numpy().astype(np.int64)
    is_given = primitive != -1
    if bad := first_bad(is_given & ((instance < 0) | (instance > len(first) - 2)), instance):
        raise ValueError(f"instance_id{bad}, and the scene has numbers from 0 to {len(first) - 2}")
    own = np.where(is_given, instance, 0).astype(np.int64)
    count = first[own + 1] - first[own]
    if bad := first_bad(is_given & ((primitive < 0) | (primitive >= count)), primitive):
        raise ValueError(f"primitive_id{bad}; it must be from 0 to the number of its triangles less one, or -1 for none")
    return np.where(is_given, first[own] + primitive, -1).astype(np.int32)


def _check_weights(weights: np.ndarray) -> None:
    """Refuses weights that lie outside of a triangle."""
    low, high = weights.min(axis=-1, initial=np.inf), weights.sum(axis=-1)
    if bad := first_bad(~((low >= -ROUNDING) & (high <= 1.0 + ROUNDING)), weights):
        raise ValueError(f"uv{bad}, outside of its triangle; both weights must be at least 0, and their sum at most 1")


def _weights_of(scene: SceneState, number: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(N, 2) weights of the points of triangles that are nearest to given points, which must be close to them."""
    corners = [_hits(scene, number, np.broadcast_to(np.float64(uv), (len(number), 2)), False).position for uv in CORNERS]  # type: ignore[arg-type]
    a, b, c = (np.where(number[:, None] >= 0, corner, 0.0) for corner in corners)
    weights = nearest_weights(points, a, b, c)
    distance = np.linalg.norm(a + weights[:, :1] * (b - a) + weights[:, 1:] * (c - a) - points, axis=1)
    longest = np.max([np.linalg.norm(edge, axis=1) for edge in (b - a, c - b, a - c)], axis=0)
    far = (number >= 0) & ~(distance <= TOLERANCE * longest)
    if far.any():
        worst = int(np.where(far, np.nan_to_num(distance, nan=np.inf), -1.0).argmax())
        raise ValueError(
            f"{far.sum()} points are not on their triangles; the farthest, number {worst} at {points[worst]}, is "
            f"{distance[worst]:.3g} away from triangle {number[worst]}. Check primitive_id, and pass points as float64"
        )
    return weights


CORNERS = ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))
"""Weights of the corners of a triangle."""


def nearest_weights(points: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """(N, 2) weights of b and c of the points of triangles that are nearest to given points (N, 3)."""

    def dot(p: np.ndarray, q: np.ndarray) -> np.ndarray:
        return (p * q).sum(axis=-1)

    def along(p: np.ndarray, q: np.ndarray) -> np.ndarray:
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.clip(np.nan_to_num(dot(points - p, q - p) / dot(q - p, q - p)), 0.0, 1.0)

    normal = np.cross(b - a, c - a)
    with np.errstate(invalid="ignore", divide="ignore"):
        u = dot(np.cross(points - a, c - a), normal) / dot(normal, normal)
        v = dot(np.cross(b - a, points - a), normal) / dot(normal, normal)
    zero = np.zeros(len(points))
    on_bc = along(b, c)
    candidates = np.stack([np.stack(pair, axis=-1) for pair in ((along(a, b), zero), (zero, along(a, c)), (1 - on_bc, on_bc))])
    places = a + candidates[..., :1] * (b - a) + candidates[..., 1:] * (c - a)
    nearest = candidates[np.linalg.norm(places - points, axis=-1).argmin(axis=0), np.arange(len(points))]
    is_inside = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0)
    return np.where(is_inside[:, None], np.stack([u, v], axis=-1), nearest)
