"""Closest hits in float64: rays and vertices on the device as given, and the results."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.array_types import ArrayT
from wrt.engine.device_hits import DeviceHits
from wrt.engine.executor import on_device
from wrt.engine.facts.query_kinds import AUTO, CLOSEST, EXACT, Query
from wrt.engine.launch.traversal_launch import divide
from wrt.engine.launch.triangle_records import records_of
from wrt.engine.memory import empty, keep_alive
from wrt.engine.plan.choices import find_plan
from wrt.engine.plan.plan import stack_levels, traversal_config, traversal_of
from wrt.engine.plan.planner import DEFAULT_TEST
from wrt.engine.rays.device_rays import flatten_shared
from wrt.engine.rays.rays import as_vectors, one_object
from wrt.kernels.runtime.launch import kept, launch, specialise, use_threads
from wrt.kernels.traversal.capabilities import Capabilities
from wrt.query.hits import Hits

if TYPE_CHECKING:
    from wrt.engine.facts.scene_state import SceneState
    from wrt.engine.plan.plan import Plan
    from wrt.engine.rays.device_rays import DeviceRays
    from wrt.engine.rays.rays import GivenRays, Rays, ResultForm
    from wrt.kernels.layout.ray_batch import RayBatch
    from wrt.kernels.query.exact_closest import ExactHits, ExactMesh, ExactRays


class PreciseHits(Hits[ArrayT]):
    """Closest hits in float64: as `Hits`, but t, uv, position and normal are float64, whatever the type of the rays.

    Attributes:
        t: (...), in units of the direction's length; inf for a miss.
        uv: (..., 2), weights of the triangle's second and third vertex; 0 for a miss.
        position: (..., 3); NaN for a miss.
        normal: (..., 3), unit vectors from the triangle's winding; 0 for a miss.
        primitive_id, geometry_id, instance_id, is_hit, counters: as in `wrt.Hits`.
    """

    def __init__(
        self, hits: ExactHits, rounded: DeviceHits, triangles: list[Any], form: ResultForm, scene: SceneState, plan: Plan
    ) -> None:
        super().__init__(rounded, form, scene, plan)
        self._exact, self._exact_triangles = hits, triangles

    @cached_property
    def t(self) -> ArrayT:
        return self._out(self._exact.t)

    @cached_property
    def uv(self) -> ArrayT:
        return self._out(self._exact.uv)

    @cached_property
    def position(self) -> ArrayT:
        out = self._empty(wp.vec3d)
        self._launch(self._kernels.exact_positions, *self._exact_triangles, self.batch.primitive, self._exact.uv, out)
        return self._out(out)

    @cached_property
    def normal(self) -> ArrayT:
        out = self._empty(wp.vec3d)
        self._launch(self._kernels.exact_normals, *self._exact_triangles, self.batch.primitive, out)
        return self._out(out)

    @property
    def _kernels(self) -> Any:
        """The module of the kernels for these triangles."""
        if len(self._exact_triangles) == 1:
            from wrt.kernels.query import exact_closest as kernels
        else:
            from wrt.kernels.query import instance_exact as kernels  # type: ignore[no-redef]
        return kernels


def find_precisely(scene: SceneState, given: GivenRays, query: Query) -> PreciseHits:
    """Closest hits in float64; see `wrt.Scene.intersect`.

    Raises:
        ValueError: a choice that does not go with `precise`, or a scene without float64 vertices.
    """
    from wrt.kernels.query.exact_closest import ExactHits

    if (query.traversal, query.triangle_test, query.counters, query.cull_backfaces) != (AUTO, AUTO, False, False):
        raise ValueError("precise=True takes no traversal, triangle_test, counters or cull_backfaces; leave them out")
    scene.require_opaque("precise=True")
    with use_threads(scene.num_threads):
        rays, device = one_object(given), scene.device
        buffers = on_device(scene, rays, query)
        traversal = AUTO if scene.device.is_cuda else "single"
        plan = replace(find_plan(scene, buffers.facts, Query(CLOSEST, traversal, DEFAULT_TEST)).plan, reason="in float64")
        hits = ExactHits()
        rounded = DeviceHits.new(EXACT, buffers.count, device)
        hits.rounded = rounded.struct()
        hits.t = empty(buffers.count, wp.float64, device)
        hits.uv = empty(buffers.count, wp.vec2d, device)
        center = wp.vec3d(*map(float, scene.center))
        scene.complete()
        triangles = [scene.device_mesh, exact_geometries(scene)] if scene.instances else [exact_mesh(scene)]
        trace_exactly(scene, plan, buffers.batch, exact_rays(rays, buffers, device), center, triangles[-1], hits)
    return PreciseHits(hits, rounded, triangles, buffers.form, scene, plan)


def trace_exactly(
    scene: SceneState, plan: Plan, seen: RayBatch, rays: ExactRays, center: wp.vec3d, triangles: Any, hits: ExactHits
) -> None:
    """Finds hits in float64 by a plan of single rays.

    Args:
        scene: what the rays meet.
        plan: the plan.
        seen: the rays in float32, of which only masks and environments are read.
        rays: the same in float64.
        center: of the scene.
        triangles: `exact_geometries` of a scene of instances, or `exact_mesh`.
        hits: are written.
    """
    from wrt.kernels.query.exact_closest import make_exact_kernel

    config, device, count = traversal_config(plan, scene, EXACT, False), scene.device, seen.count
    if Capabilities.PERSISTENT in traversal_of(plan).capabilities:
        from wrt.engine.launch.persistent_launch import binary_parts, binary_tree, next_ray
        from wrt.kernels.query.binary import binary_exact
        from wrt.kernels.query.instance_exact import ExactGeometry

        exact: Any
        if scene.instances:
            trees, make = [scene.upper(), binary_parts(scene)], binary_exact.make_binary_exact_instance_kernel
            exact = binary_exact.ExactInstances()
            exact.geometries = triangles
        else:
            trees, make, exact = [*binary_tree(scene)], binary_exact.make_binary_exact_kernel, ExactGeometry()
            exact.mesh = triangles
        exact.center = center
        inputs = [*trees, exact, seen, rays, hits, next_ray(device, count)]
        launch(specialise(make, config.stack.levels), divide(scene, plan, config, count)[1], inputs, device=device)
        return
    factory: Any
    if scene.instances:
        from wrt.kernels.query.instance_exact import make_exact_instance_kernel

        inputs = [scene.upper(), scene.lower(plan, seen), triangles, center, seen, rays, hits]
        factory = partial(make_exact_instance_kernel, kind=plan.accelerator, levels=stack_levels(scene.tree.depth))
    else:
        inputs = [scene.tree.struct(), records_of(scene, plan, None), triangles, center, rays, hits]
        factory = partial(make_exact_kernel, plan.accelerator)
    launch(specialise(factory, config), count, inputs, device=device)


def exact_geometries(scene: SceneState) -> wp.array:
    """The triangles that instances share in float64 on the scene's device; made once, and kept as long as the meshes."""
    from wrt.kernels.query.instance_exact import ExactGeometry

    key, tables = ("float64", ""), scene.cache.tables
    if key not in tables:
        table = []
        for part in scene.parts:
            geometry = ExactGeometry()
            geometry.mesh, geometry.center = exact_mesh(part), wp.vec3d(*part.center.tolist())
            table.append(geometry)
        with kept(scene.device):
            tables[key] = keep_alive(wp.array(table, dtype=ExactGeometry, device=scene.device), table)
    return tables[key]


def exact_mesh(scene: SceneState) -> ExactMesh:
    """The scene's triangles in float64 on its device, as rays meet them (`SceneState.shown`)."""
    from wrt.kernels.query.exact_closest import ExactMesh

    mesh, key, tables = ExactMesh(), ("float64", "shown"), scene.cache.tables
    mesh.vertices, mesh.faces = scene.exact_vertices, scene.shown[1]
    if scene.leaves_out:
        if key not in tables:
            vertices = np.concatenate([mesh.vertices.numpy(), np.full((1, 3), np.nan)])
            with kept(scene.device):
                tables[key] = wp.array(vertices, dtype=wp.vec3d, device=scene.device)
        mesh.vertices = tables[key]
    return mesh


def exact_rays(rays: Rays, buffers: DeviceRays, device: wp.Device) -> ExactRays:
    """Rays in float64 on the device; they were checked when `buffers` were made."""
    from wrt.kernels.query.exact_closest import ExactRays

    exact = ExactRays()
    exact.origins, exact.origin_stride = _exact_array(as_vectors(rays.origins, "origins", device), buffers, (3,), device)
    directions = as_vectors(rays.directions, "directions", device)
    exact.directions, exact.direction_stride = _exact_array(directions, buffers, (3,), device)
    exact.t_min, exact.t_min_stride = _exact_array(rays.t_min, buffers, (), device)
    exact.t_max, exact.t_max_stride = _exact_array(rays.t_max, buffers, (), device)
    return exact


def _exact_array(values: Any, buffers: DeviceRays, trailing: tuple[int, ...], device: wp.Device) -> tuple[wp.array, int]:
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
