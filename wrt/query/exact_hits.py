"""Closest hits in float64: rays and vertices on the device as given, and the results."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.execution.executor import on_device
from wrt.execution.triangle_records import records_of
from wrt.kernels.runtime.launch import launch, specialise, use_threads
from wrt.memory import empty
from wrt.planning.plan import traversal_config
from wrt.planning.planner import DEFAULT_TEST, find_plan
from wrt.query.hits import Hits
from wrt.rays.ray_arrays import flatten_shared
from wrt.rays.rays import as_vectors
from wrt.state.device_hits import DeviceHits
from wrt.state.query_kinds import AUTO, CLOSEST, EXACT, Query

if TYPE_CHECKING:
    from wrt.kernels.query.exact_closest import ExactHits, ExactMesh, ExactRays
    from wrt.planning.plan import Plan
    from wrt.rays.ray_buffers import RayBuffers
    from wrt.rays.rays import Rays, ResultForm
    from wrt.state.scene_state import SceneState


class PreciseHits(Hits):
    """Closest hits in float64: as `Hits`, but t, uv, position and normal are float64, whatever the type of the rays."""

    def __init__(
        self, hits: ExactHits, rounded: DeviceHits, mesh: ExactMesh, form: ResultForm, scene: SceneState, plan: Plan
    ) -> None:
        super().__init__(rounded, form, scene, plan)
        self._exact, self._exact_mesh = hits, mesh

    @cached_property
    def t(self) -> Any:
        return self._out(self._exact.t)

    @cached_property
    def uv(self) -> Any:
        return self._out(self._exact.uv)

    @cached_property
    def position(self) -> Any:
        from wrt.kernels.query.exact_closest import exact_positions

        out = self._empty(wp.vec3d)
        self._launch(exact_positions, self._exact_mesh, self.batch.primitive, self._exact.uv, out)
        return self._out(out)

    @cached_property
    def normal(self) -> Any:
        from wrt.kernels.query.exact_closest import exact_normals

        out = self._empty(wp.vec3d)
        self._launch(exact_normals, self._exact_mesh, self.batch.primitive, out)
        return self._out(out)


def find_precisely(scene: SceneState, rays: Rays, query: Query) -> PreciseHits:
    """Closest hits in float64; see `wrt.Scene.intersect`.

    Raises:
        ValueError: a choice that does not go with `precise`, or a scene without float64 vertices.
    """
    from wrt.kernels.query.exact_closest import ExactHits, make_kernel

    if (query.traversal, query.triangle_test, query.counters, query.cull_backfaces) != (AUTO, AUTO, False, False):
        raise ValueError("precise=True takes no traversal, triangle_test, counters or cull_backfaces; leave them out")
    with use_threads(scene.num_threads):
        buffers, device = on_device(scene, rays, query), scene.device
        plan = replace(find_plan(scene, buffers, Query(CLOSEST, "single", DEFAULT_TEST)).plan, reason="in float64")
        hits, mesh = ExactHits(), exact_mesh(scene)
        rounded = DeviceHits.new(EXACT, buffers.count, device)
        hits.rounded = rounded.struct()
        hits.t = empty(buffers.count, wp.float64, device)
        hits.uv = empty(buffers.count, wp.vec2d, device)
        center = wp.vec3d(*map(float, scene.center))
        scene.complete()
        triangles = records_of(scene, plan, None)
        inputs = [scene.tree.struct(), triangles, mesh, center, exact_rays(rays, buffers, device), hits]
        kernel = specialise(partial(make_kernel, plan.accelerator), traversal_config(plan, scene, EXACT, False))
        launch(kernel, buffers.count, inputs, device=device)
    return PreciseHits(hits, rounded, mesh, buffers.form, scene, plan)


def exact_mesh(scene: SceneState) -> ExactMesh:
    """The scene's triangles in float64 on its device."""
    from wrt.kernels.query.exact_closest import ExactMesh

    mesh = ExactMesh()
    mesh.vertices, mesh.faces = scene.exact_vertices, scene.device_mesh.faces
    return mesh


def exact_rays(rays: Rays, buffers: RayBuffers, device: wp.Device) -> ExactRays:
    """Rays in float64 on the device; they were checked when `buffers` were made."""
    from wrt.kernels.query.exact_closest import ExactRays

    exact = ExactRays()
    exact.origins, exact.origin_stride = _exact_array(as_vectors(rays.origins, "origins", device), buffers, (3,), device)
    directions = as_vectors(rays.directions, "directions", device)
    exact.directions, exact.direction_stride = _exact_array(directions, buffers, (3,), device)
    exact.t_min, exact.t_min_stride = _exact_array(rays.t_min, buffers, (), device)
    exact.t_max, exact.t_max_stride = _exact_array(rays.t_max, buffers, (), device)
    return exact


def _exact_array(values: Any, buffers: RayBuffers, trailing: tuple[int, ...], device: wp.Device) -> tuple[wp.array, int]:
    """(float64 array of N elements, 1), or (array of one element, 0) if all rays share it."""
    dtype = wp.vec3d if trailing else wp.float64
    if isinstance(values, wp.array):
        flat = values.flatten()
        if flat.dtype is not dtype:
            flat, source = wp.empty(flat.shape, dtype=dtype, device=device), flat
            wp.utils.array_cast(source, flat)
        return flat, 0 if flat.size == 1 else 1
    flat, stride = flatten_shared(np.asarray(values, dtype=np.float64), buffers.shape, trailing)
    return wp.array(flat, dtype=dtype, device=device, copy=False), stride
