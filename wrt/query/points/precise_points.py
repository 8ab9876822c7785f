"""Closest points in float64."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.engine.device_hits import DeviceHits
from wrt.engine.facts.query_kinds import EXACT
from wrt.engine.memory import empty
from wrt.kernels.points.point_batch import make_widen
from wrt.kernels.runtime.launch import launch, specialise, use_threads
from wrt.kernels.validation import as_bool
from wrt.query.exact_hits import PreciseHits, exact_geometries, exact_mesh
from wrt.query.points.closest_point import (
    Points,
    as_distances,
    as_points,
    as_room,
    check_query,
    launch_groups,
    nearest_batch,
    point_config,
    rows_of,
    space_of,
)
from wrt.query.points.closest_points import ClosestPoints

if TYPE_CHECKING:
    from wrt.engine.facts.scene_state import SceneState
    from wrt.engine.rays.rays import ResultForm
    from wrt.kernels.points.exact_points import ExactPoints


class PreciseClosestPoints(PreciseHits, ClosestPoints):
    """Closest points in float64: as `ClosestPoints`, but distance, position, uv and normal are float64, whatever the points.

    Attributes:
        distance: (...), from the point to `position`; inf if nothing was found.
        position: (..., 3), in the scene's coordinates; NaN if nothing was found.
        uv: (..., 2), weights of the triangle's second and third vertex; 0 if nothing was found.
        normal: (..., 3), unit vectors from the triangle's winding; 0 if nothing was found and for a triangle without area.
        primitive_id, geometry_id, instance_id, feature, is_hit: as in `ClosestPoints`.
        t: the same as `distance`.
        counters: none are recorded; reading them is a ValueError.
    """

    def __init__(
        self, exact: ExactPoints, found: tuple[DeviceHits, wp.array], triangles: list[Any], form: ResultForm, scene: SceneState
    ) -> None:
        ClosestPoints.__init__(self, *found, form, scene)
        self._exact, self._exact_triangles = exact, triangles  # type: ignore[assignment]  # the same attributes, of points


def closest_point_precisely(
    scene: SceneState,
    points: Any,
    max_distance: Any,
    k: int | None = None,
    mask: Any = None,
    environment: Any = None,
    counters: bool = False,
) -> PreciseClosestPoints:
    """The closest points in float64; see `wrt.Scene.closest_point`."""
    if as_bool("counters", counters):
        raise ValueError("precise=True takes no counters; leave them out")
    check_query(scene, points)
    k = as_room(k)
    with use_threads(scene.num_threads):
        given = as_points(scene, points, max_distance, mask=mask, environment=environment)
        limits = as_distances(max_distance, given.shape, dtype=np.float64)
        return find_nearest_precisely(scene, given, limits, k)


def find_nearest_precisely(scene: SceneState, given: Points, limits: np.ndarray, k: int | None = None) -> PreciseClosestPoints:
    """The closest points in float64; lazy trees are completed.

    Args:
        scene: what `check_scene` has seen.
        given: the points.
        limits: (N,) or (1,) float64 greatest distances.
        k: triangles of each point, in another axis of the results; None for the nearest one without.

    Raises:
        ValueError: more triangles than one result holds.
    """
    from wrt.kernels.points.exact_points import ExactPoints, make_exact_points_kernel

    device, count, flat = scene.device, given.batch.count, given.flat
    rows, form = (count, given.form) if k is None else rows_of(given, k)
    if flat.dtype is not wp.vec3d:
        narrow, flat = flat, empty(count, wp.vec3d, device)
        launch(specialise(make_widen, wp.vec3), count, [wp.vec3d(), narrow, flat], device=device, chunk=4096)
    exact = ExactPoints()
    exact.point = flat
    exact.max_distance = wp.array(limits, dtype=wp.float64, device=device)
    exact.t, exact.uv, exact.room = empty(rows, wp.float64, device), empty(rows, wp.vec2d, device), k or 1
    hits, feature = DeviceHits.new(EXACT, rows, device), empty(rows, wp.int8, device)
    config = point_config(scene, "nearest" if k is None else "some")
    if scene.instances:
        triangles: Any = exact_geometries(scene)
        all_triangles = [scene.device_mesh, triangles]
    else:
        triangles = exact_mesh(scene)
        all_triangles = [triangles]
    inputs = [space_of(scene, config), given.batch, triangles, exact, nearest_batch(hits, feature)]
    launch_groups(scene, config, make_exact_points_kernel, count, inputs)
    return PreciseClosestPoints(exact, (hits, feature), all_triangles, form, scene)
