"""Closest points to many points in a Warp array, in one tree on CUDA: launches that are packed once, and kept with the state.

Until the search is launched the device waits for Python, which took up to half as long as the search
(notebooks/records/2026-11-28-gpu-calls.md).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import warp as wp

from wrt.engine.device_hits import DTYPES, DeviceHits
from wrt.engine.facts.query_kinds import CLOSEST
from wrt.engine.host_arrays import write_flat
from wrt.engine.memory import empty
from wrt.engine.plan.plan import stack_levels
from wrt.engine.rays.device_rays import number_on
from wrt.engine.rays.rays import MAX_RAYS
from wrt.kernels.layout.mesh_placement import make_shift
from wrt.kernels.points.point_order import find_cells, grid_scale, sort_cells
from wrt.kernels.runtime.launch import Chunks, specialise
from wrt.kernels.runtime.recorded_launch import RecordedLaunch
from wrt.query.points.few_points import FIELDS

if TYPE_CHECKING:
    from wrt.engine.facts.scene_state import SceneState

GIVEN, SHIFTED = 2, 3
"""Numbers of the arguments of `make_shift` that are others in each call."""

POSITION, CELL, NUMBER = 1, 5, 6
"""Those of `find_cells`."""

POINTS, FOUND, NEXT = 3, 4, 5
"""Those of the search."""

CHUNKS = Chunks(256)


def may_be_kept(scene: SceneState, points: Any, max_distance: Any, min_count: int) -> bool:
    """Whether a kept launch searches points, as `wrt.engine.rays.rays.as_vectors` gives them; min_count: fewest points."""
    if type(points) is not wp.array or type(max_distance) is not float or not max_distance >= 0.0:
        return False
    is_one_tree = not scene.instances and scene.lazy_tree is None
    return is_one_tree and min_count <= points.size <= MAX_RAYS and not scene.device.is_capturing


class KeptSearch:
    """Launches that find the nearest triangle to each of many points. They serve one caller at a time.

    Args:
        scene: a tree of width 2, which is searched.
        dtype: of the points, vec3 or vec3d.
    """

    def __init__(self, scene: SceneState, dtype: type) -> None:
        from wrt.engine.launch.persistent_launch import binary_tree, next_ray
        from wrt.kernels.points.packed_points import make_packed_points_kernel
        from wrt.kernels.points.point_batch import NearestBatch, PointBatch

        scene.require_opaque("a query of points")
        device, mesh, self._dtype = scene.device, scene.device_mesh, dtype
        nowhere, nobody = wp.empty(0, dtype=wp.vec3, device=device), wp.empty(0, dtype=int, device=device)
        center = wp.vec3d(*map(float, scene.center))
        shift = [center, wp.empty(0, dtype=dtype, device=device), nowhere]
        self._shift = RecordedLaunch(specialise(make_shift, dtype), shift, device, (GIVEN, SHIFTED))
        cells = [wp.empty_like(nowhere), 1, mesh.low, grid_scale(mesh.low, mesh.high), nobody, wp.empty_like(nobody)]
        self._cells = RecordedLaunch(find_cells, cells, device, (POSITION, CELL, NUMBER))
        search = [*binary_tree(scene), PointBatch(), NearestBatch(), next_ray(device, 0)]
        kernel = specialise(make_packed_points_kernel, stack_levels(scene.tree.depth))
        self._search = RecordedLaunch(kernel, search, device, (POINTS, FOUND, NEXT))

    def find(self, points: wp.array, max_distance: float) -> tuple[DeviceHits, wp.array]:
        """What is nearest to points, with distances as t, and the features."""
        from wrt.kernels.points.packed_points import BLOCKS
        from wrt.kernels.traversal.persistent.next_ray import counter_of
        from wrt.kernels.traversal.persistent.persistent_bvh import launch_threads

        device, count = points.device, points.size
        position, cell, order = empty(count, wp.vec3, device), empty(2 * count, int, device), empty(2 * count, int, device)
        write_flat(self._shift.argument(GIVEN), points.ptr, count, self._dtype)
        for launch, place, values in (
            (self._shift, SHIFTED, position),
            (self._cells, POSITION, position),
            (self._cells, CELL, cell),
            (self._cells, NUMBER, order),
        ):
            write_flat(launch.argument(place), values.ptr, count, values.dtype)
        self._shift.run(count, CHUNKS)
        self._cells.run(count, CHUNKS)
        sort_cells(cell, order, count)
        limits, counter, batch = number_on(device, max_distance), counter_of(device), self._search.argument(POINTS)
        batch.count = count
        for field, values, size in (
            (batch.position, position, count),
            (batch.order, order, count),
            (batch.max_distance, limits, 1),
        ):
            write_flat(field, values.ptr, size, values.dtype)
        hits, feature = DeviceHits.new(CLOSEST, count, device), empty(count, wp.int8, device)
        found, next_point = self._search.argument(FOUND), self._search.argument(NEXT)
        for name, field in FIELDS.items():
            address = feature.ptr if name == "feature" else hits.address(name)
            write_flat(getattr(found, field), address, count, DTYPES.get(name, wp.int8))
        write_flat(next_point.number, counter.ptr, counter.size, int)
        next_point.threads = launch_threads(device, count, BLOCKS) if device.is_cuda else 0
        self._search.run(next_point.threads or count, CHUNKS)
        return hits, feature
