"""trimesh as a contender, with its own rays and with Embree's, and embreex, its binding of Embree, by itself."""

from __future__ import annotations

from typing import Any

import numpy as np

from wrt.bench.core.workloads import Workload
from wrt.bench.peers.peer import Answer, Lists, Peer, Query, spread_rays
from wrt.meshes.mesh import TriangleMesh


class Embreex(Peer):
    """embreex, the binding of Embree that trimesh uses; asked directly, without trimesh's own work around it."""

    name = "embreex"
    package = "embreex"
    note = "Embree; always one thread"

    def __init__(self, threads: int = 1, device: str = "cpu") -> None:
        super().__init__(1)

    def load(self, mesh: TriangleMesh) -> None:
        self._mesh = mesh.vertices.astype(np.float32), np.array(mesh.faces)
        self._first_ray = np.array([mesh.center], dtype=np.float32), np.array([[1.0, 0.0, 0.0]], dtype=np.float32)

    def construct(self) -> Any:
        from embreex.mesh_construction import TriangleMesh as EmbreeMesh
        from embreex.rtcore_scene import EmbreeScene

        self._scene = EmbreeScene()
        self._geometry = EmbreeMesh(self._scene, *self._mesh)
        return self._scene.run(*self._first_ray)

    def closest(self, rays: Workload) -> Query:
        scene, (origins, directions) = self._scene, spread_rays(rays)

        def read(result: dict[str, np.ndarray]) -> Answer:
            hit = result["primID"] >= 0
            return Answer(np.where(hit, result["tfar"], np.inf), result["primID"], np.stack([result["u"], result["v"]], axis=1))

        return Query(lambda: scene.run(origins, directions, output=1), read)

    def occluded(self, rays: Workload) -> Query:
        scene, (origins, directions) = self._scene, spread_rays(rays)
        reach = np.full(len(rays), rays.t_max, dtype=np.float32)
        return Query(lambda: scene.run(origins, directions, reach, query="OCCLUDED"), lambda result: result >= 0)


class Trimesh(Peer):
    """trimesh's own rays: NumPy and an R-tree. Asked a thousand rays only; figures are per ray."""

    name = "trimesh"
    package = "rtree"
    note = "NumPy and an R-tree; asked 1024 rays only, figures are per ray"

    def __init__(self, threads: int = 1, device: str = "cpu") -> None:
        super().__init__(1)

    def load(self, mesh: TriangleMesh) -> None:
        self._source = mesh.to_trimesh()

    def construct(self) -> Any:
        from trimesh.ray.ray_triangle import RayMeshIntersector

        mesh = self._source.copy()
        self._intersector = RayMeshIntersector(mesh)
        return self._intersector.intersects_first([mesh.bounds.mean(axis=0)], [[1.0, 0.0, 0.0]])

    def closest(self, rays: Workload) -> Query:
        intersector, (origins, directions) = self._intersector, spread_rays(rays)

        def read(result: tuple[np.ndarray, ...]) -> Answer:
            position, ray, triangle = result
            t, primitive = np.full(len(rays), np.inf), np.full(len(rays), -1)
            offset = position - origins[ray]
            t[ray] = np.sum(offset * directions[ray], axis=1) / np.sum(directions[ray] ** 2, axis=1)
            primitive[ray] = triangle
            return Answer(t, primitive)

        return Query(lambda: intersector.intersects_location(origins, directions, multiple_hits=False), read)

    def ray_limit(self, triangles: int) -> int | None:
        return 1024


class TrimeshEmbreex(Trimesh):
    """trimesh with embreex: several hits of a ray are found by shooting it again from behind each."""

    name = "trimesh+embreex"
    package = "embreex"
    note = "trimesh's own work around Embree; always one thread"

    def construct(self) -> Any:
        from trimesh.ray.ray_pyembree import RayMeshIntersector

        mesh = self._source.copy()
        self._intersector = RayMeshIntersector(mesh)  # type: ignore[assignment]
        return self._intersector.intersects_first([mesh.bounds.mean(axis=0)], [[1.0, 0.0, 0.0]])

    def all_hits(self, rays: Workload) -> Query:
        intersector, native = self._intersector, spread_rays(rays)
        run = lambda: intersector.intersects_id(*native, multiple_hits=True, return_locations=True)  # noqa: E731
        return Query(run, lambda result: Lists(result[1], result[0]))

    def inside(self, points: Workload) -> Query:
        intersector, native = self._intersector, np.ascontiguousarray(points.origins)
        return Query(lambda: intersector.contains_points(native), lambda result: result)

    def ray_limit(self, triangles: int) -> int | None:
        return None
