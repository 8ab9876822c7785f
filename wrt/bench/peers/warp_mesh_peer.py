"""Warp's own `wp.Mesh` as a contender."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp

from wrt.bench.core.workloads import Workload
from wrt.bench.peers.peer import Answer, Peer, Query, device_rays
from wrt.meshes.mesh import TriangleMesh


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
        from wrt.bench.peers.warp_mesh_kernels import mesh_closest

        def read(result: list[wp.array]) -> Answer:
            return Answer(*(values.numpy() for values in result))

        return Query(self._asking(mesh_closest, rays, (float, int, wp.vec2)), read)

    def occluded(self, rays: Workload) -> Query:
        from wrt.bench.peers.warp_mesh_kernels import mesh_occluded

        return Query(self._asking(mesh_occluded, rays, (wp.bool,)), lambda result: result[0].numpy())

    def _asking(self, kernel: wp.Kernel, rays: Workload, outputs: tuple[type, ...]) -> Callable[[], list[wp.array]]:
        mesh, native = self._mesh, self._native(rays)

        def run() -> list[wp.array]:
            results = [wp.empty(len(rays), dtype=dtype, device=self.device) for dtype in outputs]
            wp.launch(kernel, len(rays), inputs=[mesh.id, *native, *results], device=self.device)
            wp.synchronize_device(self.device)
            return results

        return run
