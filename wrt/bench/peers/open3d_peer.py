"""Open3D as a contender."""

from __future__ import annotations

from typing import Any

import numpy as np

from wrt.bench.core.workloads import Workload
from wrt.bench.peers.peer import Answer, Lists, Peer, Query
from wrt.meshes.mesh import TriangleMesh


class Open3D(Peer):
    """Open3D's RaycastingScene: Embree behind a tensor interface. It also computes normals and geometry ids."""

    name = "Open3D"
    package = "open3d"
    note = "Embree; cast_rays computes normals and geometry ids too"

    def load(self, mesh: TriangleMesh) -> None:
        from open3d import core

        self._mesh = core.Tensor(mesh.vertices.astype(np.float32)), core.Tensor(mesh.faces.astype(np.uint32))  # type: ignore[call-overload]
        self._first_ray = core.Tensor(np.array([[*mesh.center, 1.0, 0.0, 0.0]], dtype=np.float32))  # type: ignore[call-overload]

    def construct(self) -> Any:
        from open3d.t.geometry import RaycastingScene

        self._scene = RaycastingScene(nthreads=self.threads)
        self._scene.add_triangles(*self._mesh)
        return self._scene.cast_rays(self._first_ray, nthreads=self.threads)

    def _native(self, rays: Workload) -> Any:
        from open3d import core

        return core.Tensor(np.concatenate([rays.origins, rays.directions], axis=1))  # type: ignore[call-overload]

    def closest(self, rays: Workload) -> Query:
        scene, native = self._scene, self._native(rays)

        def read(result: dict[str, Any]) -> Answer:
            primitive = result["primitive_ids"].numpy().astype(np.int32)  # its mark of a miss, 2^32 - 1, becomes -1
            return Answer(result["t_hit"].numpy(), primitive, result["primitive_uvs"].numpy())

        return Query(lambda: scene.cast_rays(native, nthreads=self.threads), read)

    def occluded(self, rays: Workload) -> Query:
        scene, native = self._scene, self._native(rays)
        run = lambda: scene.test_occlusions(native, 0.0, rays.t_max, self.threads)  # noqa: E731
        return Query(run, lambda result: result.numpy())

    def all_hits(self, rays: Workload) -> Query:
        scene, native = self._scene, self._native(rays)

        def read(result: dict[str, Any]) -> Lists:
            return Lists(result["ray_ids"].numpy().astype(np.int64), result["primitive_ids"].numpy().astype(np.int64))

        return Query(lambda: scene.list_intersections(native, nthreads=self.threads), read)

    def inside(self, points: Workload) -> Query:
        from open3d import core

        scene, native = self._scene, core.Tensor(points.origins)  # type: ignore[call-overload]
        return Query(lambda: scene.compute_occupancy(native, nthreads=self.threads), lambda result: result.numpy() > 0.5)
