"""The libraries that wrt is compared with, and the table of them all.

To add a peer: write its class, add one line to `PEERS`; the command line, the tests and the report pick it up.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import warp as wp

from wrt.bench.contract import Answer, Lists, Peer, Query, device_rays, spread_rays
from wrt.bench.embree_native import Embree
from wrt.bench.engines import all_engines, default_engine, plain_engine
from wrt.bench.workloads import Workload
from wrt.meshes.mesh import TriangleMesh
from wrt.tables import lookup


class Open3D(Peer):
    """Open3D's RaycastingScene: Embree behind a tensor interface. It also computes normals and geometry ids."""

    name = "Open3D"
    package = "open3d"
    note = "Embree; cast_rays computes normals and geometry ids too"

    def load(self, mesh: TriangleMesh) -> None:
        from open3d import core

        self._mesh = core.Tensor(mesh.vertices.astype(np.float32)), core.Tensor(mesh.faces.astype(np.uint32))
        self._first_ray = core.Tensor(np.array([[*mesh.center, 1.0, 0.0, 0.0]], dtype=np.float32))

    def construct(self) -> Any:
        from open3d.t.geometry import RaycastingScene

        self._scene = RaycastingScene(nthreads=self.threads)
        self._scene.add_triangles(*self._mesh)
        return self._scene.cast_rays(self._first_ray, nthreads=self.threads)

    def _native(self, rays: Workload) -> Any:
        from open3d import core

        return core.Tensor(np.concatenate([rays.origins, rays.directions], axis=1))

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

        scene, native = self._scene, core.Tensor(points.origins)
        return Query(lambda: scene.compute_occupancy(native, nthreads=self.threads), lambda result: result.numpy() > 0.5)


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


class WarpMesh(Peer):
    """Warp's own mesh queries. On the CPU Warp runs a kernel on one thread; launched plainly, as its examples do."""

    name = "wp.Mesh"
    package = "warp"

    def __init__(self, threads: int = 1, device: str = "cpu") -> None:
        super().__init__(1, device)
        self._constructor = "sah" if wp.get_device(device).is_cpu else "cubql"
        self.note = f"{'Warp runs it on one thread; ' if wp.get_device(device).is_cpu else ''}constructor {self._constructor!r}"

    def load(self, mesh: TriangleMesh) -> None:
        self._points = wp.array(mesh.vertices.astype(np.float32), dtype=wp.vec3, device=self.device)
        self._indices = wp.array(mesh.faces.ravel(), dtype=int, device=self.device)
        self._first_ray = Workload("first", "closest", np.array([mesh.center]), np.array([[1.0, 0.0, 0.0]]))

    def construct(self) -> Any:
        self._mesh = wp.Mesh(self._points, self._indices, bvh_constructor=self._constructor)
        return self.closest(self._first_ray).run()

    def _native(self, rays: Workload) -> tuple[wp.array, int, wp.array, float]:
        origins, directions = device_rays(rays, self.device)
        return origins, 0 if rays.shares_origin else 1, directions, rays.t_max

    def closest(self, rays: Workload) -> Query:
        from wrt.bench.warp_mesh import mesh_closest

        def read(result: list[wp.array]) -> Answer:
            return Answer(*(values.numpy() for values in result))

        return Query(self._asking(mesh_closest, rays, (float, int, wp.vec2)), read)

    def occluded(self, rays: Workload) -> Query:
        from wrt.bench.warp_mesh import mesh_occluded

        return Query(self._asking(mesh_occluded, rays, (wp.bool,)), lambda result: result[0].numpy())

    def _asking(self, kernel: wp.Kernel, rays: Workload, outputs: tuple[type, ...]) -> Callable[[], list[wp.array]]:
        mesh, native = self._mesh, self._native(rays)

        def run() -> list[wp.array]:
            results = [wp.empty(len(rays), dtype=dtype, device=self.device) for dtype in outputs]
            wp.launch(kernel, len(rays), inputs=[mesh.id, *native, *results], device=self.device)
            wp.synchronize_device(self.device)
            return results

        return run


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
        self._intersector = RayMeshIntersector(mesh)
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


PEERS: dict[str, Callable[[int, str], list[Peer]]] = {
    "wrt": lambda threads, device: [default_engine(threads, device)],
    "plain": lambda threads, device: [plain_engine(threads, device)],
    "engines": all_engines,
    "open3d": lambda threads, device: [Open3D(threads)],
    "embree": lambda threads, device: [Embree(threads)],
    "embreex": lambda threads, device: [Embreex()],
    "warp_mesh": lambda threads, device: [WarpMesh(device=device)],
    "trimesh": lambda threads, device: [Trimesh()],
    "trimesh_embreex": lambda threads, device: [TrimeshEmbreex()],
}
"""Contenders by the name that the command line knows; "plain" is wrt with a triangle test that leaks, "engines" are its
traversals, each by itself."""


def make_peers(names: Iterable[str], threads: int, device: str) -> tuple[list[Peer], dict[str, str]]:
    """The peers that can run here, wrt first whether named or not, and the reasons of those that cannot.

    Raises:
        ValueError: unknown name.
    """
    peers: list[Peer] = []
    missing: dict[str, str] = {}
    for name in dict.fromkeys(["wrt", *names]):
        for peer in lookup(PEERS, name, "peer")(threads, device):
            reason = peer.available()
            if reason is None:
                peers.append(peer)
            else:
                missing[peer.name] = reason
    return peers, missing
