"""Visibility between pairs of points: by the nearest hit between them, or by all hits where that one is at an end point."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.engine.executor import trace
from wrt.engine.facts.query_kinds import ALL, AUTO, CLOSEST
from wrt.engine.memory import empty, new_rays
from wrt.engine.plan.choices import make_plan
from wrt.engine.rays.coherence import detect_coherence
from wrt.engine.rays.device_rays import DeviceRays
from wrt.engine.rays.rays import as_vectors
from wrt.kernels.runtime.launch import launch, refuse_capture, use_threads

if TYPE_CHECKING:
    from wrt.engine.facts.scene_state import SceneState

BLOCK = 1 << 20
"""Pairs traced at a time, which takes about 60 MB."""

ROUNDING = 2.0**-23
"""Relative error of a float32 coordinate after a computation with one or two roundings."""


def visible(scene: SceneState, points_a: Any, points_b: Any) -> Any:
    """Whether pairs of points see each other; see `wrt.Scene.visible`."""
    refuse_capture("visible", scene.device)
    scene.require("count")
    is_warp = isinstance(points_a, wp.array) or isinstance(points_b, wp.array)
    a, b = _as_points(points_a, "points_a", scene.device), _as_points(points_b, "points_b", scene.device)
    try:
        shape = np.broadcast_shapes(a.shape[:-1], b.shape[:-1])
    except ValueError:
        raise ValueError(f"points_a {a.shape} and points_b {b.shape} do not broadcast; try a[:, None] and b[None, :]") from None
    narrow = a.dtype == np.float32 or b.dtype == np.float32
    rounding = ROUNDING * float(np.abs(scene.center).max()) if narrow else 0.0
    ends = [
        (
            wp.array(points.reshape(-1, 3).astype(np.float64), dtype=wp.vec3d, device=scene.device),
            np.broadcast_to(np.arange(points[..., 0].size, dtype=np.int32).reshape(points.shape[:-1]), shape).flat,
        )
        for points in (a, b)
    ]
    count = int(np.prod(shape))
    result = np.empty(count, dtype=bool)
    with use_threads(scene.num_threads):
        for begin in range(0, count, BLOCK):
            block = slice(begin, min(begin + BLOCK, count))
            chosen = [(points, wp.array(index[block], dtype=int, device=scene.device)) for points, index in ends]
            result[block] = visible_block(scene, chosen, rounding)
    pairs = result.reshape(shape)
    return wp.array(pairs, dtype=wp.bool, device=scene.device) if is_warp else pairs


def visible_block(scene: SceneState, ends: list[tuple[wp.array, wp.array]], rounding: float) -> np.ndarray:
    """(N,) bool for N pairs, given as the points and the indices of both ends."""
    from wrt.kernels.query.open_segments import UNDECIDED, VISIBLE, classify_by_all_hits, classify_by_nearest, connect_points
    from wrt.kernels.query.ordering.ray_order import sort_rays
    from wrt.query.all_hits import MAX_TOTAL, find_all

    (from_points, from_index), (to_points, to_index) = ends
    device, count = scene.device, len(from_index)
    verdict, targets, rays = empty(count, wp.int32, device), empty(count, wp.vec3, device), new_rays(count, device)
    center = wp.vec3d(*map(float, scene.center))
    pairs = [from_points, to_points, from_index, to_index, center, rounding, rays, targets, verdict]
    launch(connect_points, count, pairs, device=device, chunk=4096)
    coherent, scattered, _ = detect_coherence(rays.origins, rays.directions, device)
    known = DeviceRays.of_batch(rays, coherent, scattered)
    nearest, _ = trace(scene, make_plan(scene, known, AUTO, AUTO, CLOSEST), known, CLOSEST)
    pairs = [scene.device_mesh, rays, targets]
    launch(classify_by_nearest, count, [*pairs, nearest.primitive, rounding, verdict], device=device, chunk=4096)
    undecided = np.flatnonzero(verdict.numpy() == UNDECIDED).astype(np.int32)
    if len(undecided):
        order = wp.array(undecided, dtype=int, device=device)
        few = sort_rays(rays, order, empty)
        hits, offsets = find_all(scene, make_plan(scene, known, AUTO, AUTO, ALL), few, MAX_TOTAL)
        lists = [*pairs, order, offsets, hits.primitive, rounding, verdict]
        launch(classify_by_all_hits, len(undecided), lists, device=device, chunk=1024)
    return verdict.numpy() == VISIBLE


def _as_points(points: Any, name: str, device: wp.Device) -> np.ndarray:
    """Points (..., 3) as float32 or float64 on the host."""
    array = as_vectors(points, name, device)
    return array.numpy() if isinstance(array, wp.array) else array
