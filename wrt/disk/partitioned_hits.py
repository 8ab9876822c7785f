"""Closest hits in a partitioned scene: `wrt.Hits` that hold the triangles that were hit, not the scene."""

from __future__ import annotations

import copyreg
from functools import cached_property
from typing import TYPE_CHECKING, NoReturn

import numpy as np
import warp as wp

from wrt.array_types import ArrayT
from wrt.kernels.query.hit_attributes import SceneMesh
from wrt.query.hits import Hits
from wrt.query.pickled_hits import reduce_hits

if TYPE_CHECKING:
    from wrt.disk.partition_files import PartList
    from wrt.engine.device_hits import DeviceHits
    from wrt.engine.plan.plan import Plan
    from wrt.engine.rays.rays import ResultForm


class PartitionedHits(Hits[ArrayT]):
    """As `wrt.Hits`. What is interpolated between vertices (`smooth_normal`, `interpolate`, `uv_at`) is not available.

    Args:
        batch: the hits; triangles are numbered through all meshes of the scene.
        form: of results.
        parts: the list of the scene's parts.
        corners: (3 N,) vec3, the corners of the triangle of each hit, relative to the scene's centre.
        plan: how rays were traced in the first part.
        num_threads: of the scene.

    Attributes:
        t, uv, primitive_id, geometry_id, instance_id, is_hit, position, normal, counters: as in `wrt.Hits`.
    """

    def __init__(
        self,
        batch: DeviceHits,
        form: ResultForm,
        parts: PartList,
        corners: wp.array,
        plan: Plan | None,
        num_threads: int | None,
    ) -> None:
        self.batch, self.plan, self._form, self._num_threads = batch, plan, form, num_threads
        self._scenes, self._counters = {parts.mark}, None
        self._mesh = mesh = SceneMesh()
        faces = np.arange(3 * batch.count, dtype=np.int32).reshape(-1, 3)
        mesh.vertices, mesh.faces = corners, wp.array(faces, dtype=wp.vec3i, device=batch.device)
        mesh.center = wp.vec3d(*map(float, parts.center))
        mesh.low, mesh.high = (wp.vec3(*corner.tolist()) for corner in parts.bounds)
        mesh.geometry_first = wp.array(parts.first.astype(np.int32), dtype=int, device=batch.device)

    @cached_property
    def _triangles(self) -> wp.array:
        """Each hit has its own copy of its triangle."""
        primitive = self.batch.primitive.numpy()
        rows = np.where(primitive < 0, np.int32(-1), np.arange(len(primitive), dtype=np.int32))
        return wp.array(rows, dtype=int, device=self.batch.device)

    @property
    def _meshes(self) -> NoReturn:  # type: ignore[override]
        """Not available.

        Raises:
            ValueError: always; the message names the alternative.
        """
        raise ValueError(
            "hits in a partitioned scene do not hold the meshes between whose vertices values are interpolated; "
            "interpolate with geometry_id, primitive_id and uv"
        )

    def same_geometry(self, scene: object) -> bool:
        """False: without the scene's triangles, only identifiers are compared."""
        return False


copyreg.pickle(PartitionedHits, reduce_hits)
