"""Closest points to few points on the CPU: launches that are prepared once, and kept with the scene's state."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.engine.device_hits import DTYPES, DeviceHits
from wrt.engine.host_arrays import address_of, write_flat
from wrt.engine.memory import empty_host
from wrt.kernels.answers.answer_kind import HIT_COLUMNS
from wrt.kernels.runtime.launch import Chunks, PreparedLaunch, specialise
from wrt.kernels.traversal.leaf import Counters

if TYPE_CHECKING:
    from wrt.engine.facts.scene_state import SceneState
    from wrt.kernels.points.tree_points import PointConfig

POINTS, LISTS = 2, 3
"""Numbers of the arguments of a kernel that are others in each call."""

FIELDS = {"t": "distance", "primitive": "primitive", "uv": "uv", "feature": "feature"}
"""Fields of `wrt.kernels.points.point_batch.NearestBatch`, by the name of the answer."""


def may_be_few(scene: SceneState, points: Any, max_distance: Any, limit: int) -> bool:
    """Whether a kept launch finds what is nearest to points: fewer than `limit` in a NumPy array, in one complete tree."""
    if type(points) is not np.ndarray or type(max_distance) is not float or not max_distance >= 0.0:
        return False
    is_array = points.dtype in (np.float64, np.float32) and points.ndim > 0 and points.shape[-1] == 3
    is_one_tree = scene.device.is_cpu and not scene.instances and scene.lazy_tree is None
    return is_array and is_one_tree and 0 < points.size < 3 * limit


class FewPoints:
    """A launch of the search for the nearest triangles. It serves one caller at a time.

    Args:
        scene: where points are searched.
        config: of the kernel.
        space: what the kernel searches.
    """

    def __init__(self, scene: SceneState, config: PointConfig, space: Any) -> None:
        from wrt.engine.launch.traversal_launch import no_work
        from wrt.kernels.points.point_batch import NearestBatch, PointBatch
        from wrt.kernels.points.tree_points import as_lists, make_points_kernel
        from wrt.kernels.traversal.leaf import CounterRows

        rows, self._group, self._chunks = CounterRows(), config.group, Chunks(max(1, 256 // config.group), 4096)
        rows.rows = no_work(Counters, scene.device.alias)
        inputs = [space, PointBatch(), as_lists(NearestBatch()), rows]
        self._launch = PreparedLaunch(specialise(make_points_kernel, config), inputs, scene.device)
        self._points, self._found = self._launch.argument(POINTS), self._launch.argument(LISTS).found
        self._max_distance = np.zeros(1, dtype=np.float32)
        write_flat(self._points.max_distance, address_of(self._max_distance), 1, wp.float32)

    def find(self, scene: SceneState, points: np.ndarray, max_distance: float) -> tuple[DeviceHits, wp.array]:
        """What is nearest to points (..., 3), with distances as t, and the features."""
        with np.errstate(over="ignore", invalid="ignore"):
            relative = (points.reshape(-1, 3) - scene.center).astype(np.float32, order="C")
            self._max_distance[0] = max_distance
        count = self._points.count = len(relative)
        write_flat(self._points.position, address_of(relative), count, wp.vec3)
        *columns, feature = empty_host(count, *map(DTYPES.__getitem__, HIT_COLUMNS), wp.int8)
        found = dict(zip(HIT_COLUMNS, columns, strict=True))
        for name, values in {**found, "feature": feature}.items():
            write_flat(getattr(self._found, FIELDS[name]), values.ptr, count, values.dtype)
        self._launch.run(-(-count // self._group), self._chunks, (relative, found, feature))
        return DeviceHits.of_host(count, scene.device, found), feature.array
