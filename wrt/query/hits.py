"""Closest hits: what the traversal stored, and what is computed from it on request."""

from __future__ import annotations

import math
from functools import cached_property
from struct import unpack
from typing import TYPE_CHECKING, Any, Generic, Literal, TypeAlias, overload

import numpy as np
import warp as wp

from wrt.array_types import ArrayLike, ArrayT, NumpyLike, WarpLike
from wrt.engine.device_hits import shaped
from wrt.engine.memory import empty
from wrt.kernels.runtime.launch import launch, refuse_capture, use_threads
from wrt.kernels.validation import as_float
from wrt.tables import lookup

if TYPE_CHECKING:
    from wrt.engine.device_hits import DeviceHits
    from wrt.engine.facts.scene_state import SceneState
    from wrt.engine.plan.plan import Plan
    from wrt.engine.rays.rays import ResultForm
    from wrt.kernels.query.hit_attributes import SceneMesh
    from wrt.meshes.mesh import TriangleMesh

Side: TypeAlias = Literal["direction", "front", "back"]

SIDES: dict[str, int] = {"direction": 0, "front": 1, "back": -1}
"""Where rays may start, and how kernels are told."""


FAR = 8.0
"""Extents of a scene between 0 and its furthest coordinate up to which float32 holds its positions: rounding then moves them by
at most 8 * 2^-24 of the extent, as far as `Hits.spawn` does."""


def rounds_positions(mesh: SceneMesh) -> bool:
    """Whether float32 would move positions noticeably: a scene of 100 m that is 5 * 10^6 m from 0, as in UTM coordinates, has
    positions in float32 every 0.5 m. Its own triangles are held relative to its centre and lose nothing.

    Args:
        mesh: of a scene, with its centre and the box around it (float32, relative to the centre).
    """
    center, low, high = unpack("3d", mesh.center), unpack("3f", mesh.low), unpack("3f", mesh.high)  # type: ignore[arg-type]
    reach = max(abs(middle + end) for corner in (low, high) for middle, end in zip(center, corner, strict=True))
    return reach > FAR * math.dist(low, high)


class Hits(Generic[ArrayT]):
    """Closest hits of a batch of rays, in its leading shape (...).

    The attributes are NumPy arrays if the rays were, else Warp arrays on the scene's device. The traversal stores `t`,
    `primitive_id` and `uv`; everything else is computed on first access.

    Attributes:
        t: (...) float32, in units of the direction's length; inf for a miss.
        primitive_id: (...) int32, index of the triangle within its geometry; -1 for a miss.
        geometry_id: (...) int32, index of the mesh within the scene; -1 for a miss.
        instance_id: (...) int32, index of the instance, or of the mesh in a scene without instances; -1 for a miss.
        uv: (..., 2) float32, weights of the triangle's second and third vertex; 0 for a miss.
        is_hit: (...) bool.
        position: (..., 3), in the scene's coordinates, computed in float64; NaN for a miss. float64 if the rays were, or if the
            scene is so far from 0 that float32 would move points (`is_far`), else float32.
        normal: (..., 3), unit vectors, float64 if the rays were, else float32, from the triangle's winding (counter-clockwise
            seen from the front); 0 for a miss and for a triangle without area.
        plan: how the query was answered (`wrt.results.Plan`); None for points that no ray found (`Scene.points_on`).
        counters: {"nodes", "leaves", "triangles" ...: (...) int32}, the work for each ray, if requested
            (`wrt.kernels.traversal.leaf.Counters` explains each). The work of a packet or a stream is stored at its first
            ray. Streams also count vector lanes and active lanes (`wrt.kernels.traversal.stream.stream_kernel.StreamCounters`).
    """

    _tangents: Any = None
    """`SceneState.tangents` of the scene."""

    def __init__(
        self,
        batch: DeviceHits,
        form: ResultForm,
        scene: SceneState,
        plan: Plan | None,
        counters: wp.array | None = None,
    ) -> None:
        self.batch = batch
        """What the traversal stored, flat and on the device; triangles are numbered through all meshes of the scene."""
        self.plan = plan
        self._mesh = scene.device_mesh
        self._tangents = scene.tangents
        self._meshes = scene.meshes
        self._scenes = {scene.mark}
        self._counters = counters
        self._form = form
        self._num_threads = scene.num_threads

    def __repr__(self) -> str:
        return f"Hits(shape={self.shape})"

    def __copy__(self) -> Hits[ArrayT]:
        """Hits that share the arrays and the triangles."""
        other = object.__new__(type(self))
        other.__dict__ |= self.__dict__
        return other

    @property
    def shape(self) -> tuple[int, ...]:
        """The leading shape."""
        return self._form.shape

    @property
    def is_far(self) -> bool:
        """Whether the scene is so far from 0 that positions in float32 would be moved."""
        return rounds_positions(self._mesh)

    def is_of(self, scene: SceneState) -> bool:
        """Whether these are hits of this scene, perhaps before an update, or of another scene with the same triangles."""
        if scene.mark not in self._scenes and self.same_geometry(scene):
            self._scenes.add(scene.mark)
        return scene.mark in self._scenes

    def same_geometry(self, scene: SceneState) -> bool:
        """Whether a scene has the same triangles in the same places. Scenes of instances never compare as equal."""
        ours, theirs = self._mesh, scene.device_mesh
        if ours is theirs:
            return True
        if any(mesh.vertices is None or mesh.vertices.device != self._device for mesh in (ours, theirs)):
            return False
        if tuple(ours.center) != tuple(theirs.center):  # type: ignore[arg-type]
            return False
        pairs = ((getattr(ours, name), getattr(theirs, name)) for name in ("geometry_first", "faces", "vertices"))
        return all(one.shape == other.shape and np.array_equal(one.numpy(), other.numpy()) for one, other in pairs)

    @cached_property
    def t(self) -> ArrayT:
        return self.batch.result("t", self._form)

    @cached_property
    def uv(self) -> ArrayT:
        return self.batch.result("uv", self._form)

    @cached_property
    def primitive_id(self) -> ArrayT:
        alone = self._mesh.geometry_first.shape[0] == 2  # of a single mesh, triangles are numbered as through the scene
        return self.batch.result("primitive", self._form) if alone else self._out(self.located[2])

    @cached_property
    def geometry_id(self) -> ArrayT:
        return self._out(self.located[1])

    @cached_property
    def instance_id(self) -> ArrayT:
        return self._out(self.located[0])

    @cached_property
    def is_hit(self) -> ArrayT:
        from wrt.kernels.query.hit_attributes import mark_hits

        out = self._empty(wp.bool)
        self._launch(mark_hits, self.batch.primitive, out)
        return self._out(out)

    @cached_property
    def position(self) -> ArrayT:
        from wrt.kernels.query.hit_attributes import hit_positions

        out = self._empty(wp.vec3d)
        self._launch(hit_positions, *self._surface, out)
        return self._out(out) if self.is_far else self._as_dtype(out)

    @cached_property
    def normal(self) -> ArrayT:
        from wrt.kernels.query.hit_attributes import hit_normals

        out = self._empty(wp.vec3)
        self._launch(hit_normals, *self._surface[:2], out)
        return self._as_dtype(out)

    @overload
    def spawn(self, directions: NumpyLike, side: Side = "direction") -> ArrayT: ...
    @overload
    def spawn(self, directions: WarpLike, side: Side = "direction") -> wp.array: ...
    def spawn(self, directions: ArrayLike, side: Side = "direction") -> Any:
        """Origins of rays that leave the hits: next to them, on the side of the surface that the direction points to.

        The distance from the surface is bounded by rounding (`wrt.kernels.query.spawn`): about 5e-7 times the largest extent of
        the scene as seen from the point, along an axis, whatever the shape of the triangle. A ray from there does not hit its
        own triangle again at any angle. In the corner of two walls, it starts in front of both: near edges the point is moved
        away from them, too. An origin is at most 6.7e-6 times this extent away from the point of the hit.

            d = (0.3, 0.2, 1.0)  # to the sun; or (N, 3), or (samples, N, 3)
            lit = hits.faces(d) & ~scene.occluded(hits.spawn(d), d)  # a surface is lit on its front only
            through = scene.intersect(hits.spawn(-hits.normal), -hits.normal)  # a ray that leaves the back

        A direction may point to the back of a surface. Such a ray starts behind it, as refracted light does, and what it
        meets tells nothing about the front: `faces` says which directions point to the front.

        Args:
            directions: (..., 3), of any length; their leading shape broadcasts against that of the hits, or ends with it.
            side: the side of the surface where rays start. "direction" is that to which the direction points; a direction in
                the plane of the triangle counts as pointing to its front. "front" and "back" are those of the triangle's
                winding, as in `normal`; a ray to the other side then passes through the triangle, and meets it.

        Returns:
            (..., 3) float64 in the scene's coordinates, of the broadcast shape; NaN for a miss. A NumPy array if hits and
            directions are, else a Warp array. Do not round them to float32: far from the scene's centre the offset would be
            lost.

        Raises:
            TypeError: directions are not an array of real numbers.
            ValueError: wrong shapes, an array on another device, or an unknown side.
        """
        from wrt.kernels.query.spawn import spawn_origins

        sided = lookup(SIDES, side, "side")
        rays, form = self._leaving(directions)
        out = empty(math.prod(form.shape), wp.vec3d, self._device)
        inputs = [*self._surface, rays.batch.directions, rays.batch.direction_stride, sided, out]
        with use_threads(self._num_threads):
            launch(spawn_origins, len(out), inputs, device=self._device, chunk=4096)
        return shaped(out, form._replace(dtype=np.float64))

    @overload
    def faces(self, directions: NumpyLike) -> ArrayT: ...
    @overload
    def faces(self, directions: WarpLike) -> wp.array: ...
    def faces(self, directions: ArrayLike) -> Any:
        """Whether directions point to the front of the triangles: (...) bool, of the shape that `spawn` returns.

        The front is the side of `normal`, by the triangle's winding. False for a direction in the plane of the triangle, for a
        triangle without area and for a miss. Where windings are not to be trusted, compare with a direction on the side that
        is meant, such as that from which a point was seen:

            same_side = hits.faces(sun) == hits.faces(-directions)

        Args:
            directions: as in `spawn`.

        Raises:
            TypeError: directions are not an array of real numbers.
            ValueError: wrong shapes, or an array on another device.
        """
        from wrt.kernels.query.spawn import mark_facing

        rays, form = self._leaving(directions)
        out = empty(math.prod(form.shape), wp.bool, self._device)
        inputs = [*self._surface[:2], rays.batch.directions, rays.batch.direction_stride, out]
        with use_threads(self._num_threads):
            launch(mark_facing, len(out), inputs, device=self._device, chunk=4096)
        return shaped(out, form)

    def _leaving(self, directions: Any) -> tuple[Any, ResultForm]:
        """Directions of rays that leave the hits, on the device, and the form of results for them."""
        from wrt.engine.rays.device_rays import to_device
        from wrt.engine.rays.rays import Rays, ResultForm

        if isinstance(directions, wp.array):
            rays = to_device(Rays(np.zeros(3, dtype=np.float32), directions), self._device, np.zeros(3))
            shape = rays.shape if rays.batch.direction_stride else self.shape
        else:
            origins = np.broadcast_to(np.float32(0.0), (*self.shape, 3))
            rays = to_device(Rays(origins, directions), self._device, np.zeros(3))
            shape = rays.shape
        if shape[len(shape) - len(self.shape) :] != self.shape:
            raise ValueError(f"directions have the leading shape {rays.shape}, which neither equals nor ends with {self.shape}")
        return rays, ResultForm(shape, rays.form.is_warp or self._form.is_warp, np.float32)

    def smooth_normal(self, crease_angle: float = 60.0) -> ArrayT:
        """(..., 3) float32: normals interpolated between the vertices of smooth surfaces, as `wrt.render` shades by them.

        Unit vectors on the side of `normal`; 0 for a miss. A vertex normal is the mean of the triangles around it, weighted by
        their angles (Thuermer and Wuethrich 1998).

        Args:
            crease_angle: edges between triangles whose planes differ by more stay sharp; in degrees, in (0, 90).

        Raises:
            TypeError: the angle is no number.
            ValueError: an angle out of range, or hits from a pickle.
        """
        from wrt.kernels.query.hit_interpolation import smooth_normals_at_hits
        from wrt.meshes.vertex_values import corner_normals_of

        crease_angle = as_float("crease_angle", crease_angle)
        if not 0.0 < crease_angle < 90.0:
            raise ValueError(f"crease_angle is {crease_angle}; it must be between 0 and 90 degrees")
        out = self._empty(wp.vec3)
        with use_threads(self._num_threads):
            corners = corner_normals_of(self._with_vertices(), crease_angle, self._device)
        self._launch(smooth_normals_at_hits, self._mesh, self.batch.primitive, self.batch.uv, corners, out)
        return self._out(out)

    def interpolate(self, vertex_values: ArrayLike) -> ArrayT:
        """Values of vertices, interpolated within the triangles.

            heat = hits.interpolate(temperature)        # temperature: (V,), heat: (...)

        Args:
            vertex_values: (V, ...) numbers, a row for each vertex of the mesh; for a scene of several meshes, or of instances,
                a sequence with one array for each of `scene.meshes`.

        Returns:
            (..., ...) float32, the leading shape of the rays and then that of a row; NaN for a miss. A NumPy array, or a Warp
            array if the rays were.

        Raises:
            TypeError: not real numbers.
            ValueError: another number of arrays or rows, or hits from a pickle.
        """
        from wrt.meshes.vertex_values import corner_table

        values, corners = corner_table(self._with_vertices(), vertex_values)
        return self._interpolated(values, corners)

    def uv_at(self) -> ArrayT:
        """(..., 2) float32: texture coordinates (`wrt.TriangleMesh.with_materials`); NaN for a miss.

        Raises:
            ValueError: no mesh of the scene has any, or hits from a pickle.
        """
        from wrt.meshes.vertex_values import corner_coordinates

        values = corner_coordinates(self._with_vertices()).reshape(-1, 2)
        return self._interpolated(values, np.arange(len(values), dtype=np.int32).reshape(-1, 3))

    def _interpolated(self, values: np.ndarray, corners: np.ndarray) -> Any:
        """Rows of values at the hits; `corners` are the rows of each triangle."""
        from wrt.kernels.query.hit_interpolation import interpolate_at_hits

        row = values.shape[1:]
        table = wp.array(values.reshape(len(values), -1), dtype=float, device=self._device)
        rows = wp.array(corners, dtype=wp.vec3i, device=self._device)
        out = wp.empty((self.batch.count, table.shape[1]), dtype=float, device=self._device)
        self._launch(interpolate_at_hits, self._mesh, self.batch.primitive, self.batch.uv, rows, table, out)
        shape = (*self.shape, *row)
        return out.reshape(shape or (1,)) if self._form.is_warp else out.numpy().reshape(shape)

    def _with_vertices(self) -> tuple[TriangleMesh, ...]:
        """The meshes, between whose vertices something is interpolated."""
        if self._tangents is not None:
            raise ValueError("points have no vertices between which values are interpolated; look values up by primitive_id")
        return self._meshes

    @property
    def has_counters(self) -> bool:
        """Whether the query counted its work."""
        return "counters" in self.__dict__ or getattr(self, "_counters", None) is not None

    @cached_property
    def counters(self) -> dict[str, np.ndarray]:
        if self._counters is None:
            raise ValueError("no counters were recorded; call scene.intersect(..., counters=True)")
        work = self._counters.numpy()
        return {name: np.ascontiguousarray(work[name]).reshape(self.shape) for name in work.dtype.names}

    @cached_property
    def located(self) -> tuple[wp.array, wp.array, wp.array]:
        """Instance, geometry, and triangle within the geometry."""
        from wrt.kernels.query.hit_attributes import locate_geometry

        found = (self._empty(wp.int32), self._empty(wp.int32), self._empty(wp.int32))
        self._launch(locate_geometry, self._mesh, self.batch.primitive, *found)
        return found

    @property
    def _triangles(self) -> wp.array:
        """(N,) number of each hit's triangle among those of `_mesh`; -1 for a miss."""
        return self.batch.primitive

    @cached_property
    def _surface(self) -> tuple[SceneMesh, wp.array, wp.array]:
        """The triangles in which the hits are, which of them, and the weights of its vertices."""
        return (self._mesh, self._triangles, self.batch.uv) if self._tangents is None else self._tangents(self.batch)

    @property
    def _device(self) -> wp.Device:
        return self.batch.device

    def _empty(self, dtype: type) -> wp.array:
        return empty(self.batch.count, dtype, self._device)

    def _launch(self, kernel: wp.Kernel, *inputs: Any) -> None:
        with use_threads(self._num_threads):
            launch(kernel, self.batch.count, inputs, device=self._device, chunk=4096)

    def _out(self, values: wp.array) -> Any:
        if not self._form.is_warp:
            refuse_capture("an attribute of hits in NumPy arrays", self._device)
        return shaped(values, self._form)

    def _as_dtype(self, values: wp.array) -> Any:
        """Vectors in the type of the rays; converted by all threads, unlike by `wp.utils.array_cast`."""
        from wrt.kernels.query.hit_attributes import round_vectors, widen_vectors

        wanted = wp.vec3d if self._form.dtype is np.float64 else wp.vec3f
        if values.dtype is not wanted:
            converted = self._empty(wanted)
            self._launch(round_vectors if wanted is wp.vec3f else widen_vectors, values, converted)
            values = converted
        return self._out(values)
