"""A light buffer around a point light, which answers whether points are in its shadow."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, overload

import numpy as np
import warp as wp

from wrt.engine.device_hits import shaped
from wrt.engine.facts.query_kinds import ANY, AUTO, Query
from wrt.engine.launch.triangle_records import records_of
from wrt.engine.memory import empty
from wrt.engine.plan.choices import find_plan
from wrt.engine.plan.plan import plan_for_query, traversal_config
from wrt.engine.rays.device_rays import DeviceRays, lay_out
from wrt.engine.rays.rays import Rays
from wrt.kernels.layout.light_cells import CELL_BYTES, ENTRY_BYTES, FACES, MAX_RESOLUTION
from wrt.kernels.runtime.launch import launch, refuse_capture, specialise, use_threads
from wrt.kernels.validation import as_bool, as_int, as_point, as_real_array
from wrt.query.skip import SceneTriangles, check_skip, skipped_triangles

if TYPE_CHECKING:
    from wrt.array_types import ArrayLike, Numbers, NumpyLike, WarpLike
    from wrt.kernels.layout.light_cells import LightCells
    from wrt.kernels.traversal.traversal_config import TraversalConfig
    from wrt.query.hits import Hits
    from wrt.scene.scene import Scene

CELLS_PER_TRIANGLE = 8
"""Cells that a light buffer has by default (notebooks/records/2026-11-22-light-buffer.md)."""

DEFAULT_RESOLUTIONS = (32, 512)
"""Least and greatest resolution by default."""

CHUNK = 4096
"""Rays that are worth a chunk of their own."""


class LightBuffer:
    """Shadows of a point light by its light buffer (Haines and Greenberg 1986).

        buffer = wrt.lights.LightBuffer(scene, (2, -3, 8))
        points = hits.spawn((2, -3, 8) - hits.position)
        dark = buffer.occluded(points)                          # bool
        same = scene.occluded(buffer.shadow_rays(points))       # bit for bit

    The directions around the light are divided into cells, and for each of them the triangles that a shadow ray can hit are
    listed by depth. A shadow ray is tested against one list, and walks no tree. This is faster than `wrt.Scene.occluded` for
    millions of points, and slower for few, because the lists are built first
    (notebooks/records/2026-11-22-light-buffer.md).

    The answers are those of `occluded` for the same rays: same triangle test, same range. Rays that start more than about four
    times the scene's extent away from it, or reach beyond the light, are traced by the scene.

    The buffer is rebuilt by the next query after the scene changes or `update` is called.

    Args:
        scene: a scene of meshes.
        position: (3,), the light.
        resolution: cells along an edge of each of the six faces, 1 to 4096; None chooses by the number of triangles. More cells
            have shorter lists and take more memory: 16 bytes a cell, and 8 bytes an entry of a list.
        triangle_test: "auto" for the scene's, or a key of `wrt.kernels.triangle.TRIANGLE_TESTS`.
        cull_backfaces: whether shadow rays hit only the front of triangles, as in `wrt.Scene.occluded`: triangles that turn
            their front to the light then cast no shadow.
        max_bytes: greatest size of cells and lists together.

    Raises:
        TypeError: `position` is not an array of real numbers; `resolution` is not an int.
        ValueError: a scene of instances or a `wrt.moving.FuzzyScene`; a position of another shape, or one that is not finite; a
            resolution out of range; an unknown triangle test, or one whose rays must share their origin.
        MemoryError: cells and lists would take more than `max_bytes`.
    """

    def __init__(
        self,
        scene: Scene,
        position: ArrayLike,
        resolution: int | None = None,
        *,
        triangle_test: str = AUTO,
        cull_backfaces: bool = False,
        max_bytes: int = 1 << 30,
    ) -> None:
        check_scene(scene.state)
        self.scene = scene
        self._resolution = check_resolution(resolution)
        self._query = Query(ANY, "brute", triangle_test, as_bool("cull_backfaces", cull_backfaces))
        self._max_bytes = as_int("max_bytes", max_bytes, 1)
        self._position = as_point("position", position)
        self._built_for: Any = None
        self._build()

    @property
    def position(self) -> np.ndarray:
        """(3,) float64: the light."""
        return self._position.copy()

    @property
    def resolution(self) -> int:
        """Cells along an edge of a face."""
        return self._cells.resolution

    @property
    def bytes(self) -> int:
        """Memory of cells and lists."""
        return FACES * self.resolution**2 * CELL_BYTES + self.entry_count * ENTRY_BYTES

    @property
    def entry_count(self) -> int:
        """Entries of all lists."""
        return int(self._words[:, 1].sum(dtype=np.int64))

    @property
    def covered_share(self) -> float:
        """Share of the cells that a triangle covers."""
        return float((self._words[:, 2].view(np.float32) < np.inf).mean())

    @property
    def _words(self) -> np.ndarray:
        return self._cells.cells.numpy().reshape(-1, 4)

    def __repr__(self) -> str:
        at = ", ".join(f"{x:.4g}" for x in self._position)
        return f"LightBuffer(({at}), resolution={self.resolution}, {self.entry_count:,} entries, {self.bytes / 1e6:.1f} MB)"

    def update(self, position: ArrayLike | None = None) -> None:
        """Builds the buffer again, for the scene as it is now.

        Args:
            position: (3,), where the light is from now on; None if it stays.

        Raises:
            TypeError, ValueError, MemoryError: as the class. The buffer is then as before.
        """
        before = self._position
        if position is not None:
            self._position = as_point("position", position)
        try:
            self._build()
        except BaseException:
            self._position = before
            raise

    def shadow_rays(self, points: ArrayLike, t_min: Numbers = 0.0, t_max: Numbers = 1.0) -> Rays:
        """The rays that `occluded` answers: from the points to the light, which they reach at t = 1.

        Args:
            points, t_min, t_max: as in `occluded`.
        """
        if isinstance(points, wp.array):
            points = points.numpy()
        points = as_real_array("points", points)
        if points.dtype.kind == "f" and points.dtype.itemsize <= 4:
            points = points.astype(np.float32)
            return Rays(points, (self._position - points.astype(np.float64)).astype(np.float32), t_min, t_max)
        center = self.scene.center
        relative = (points.astype(np.float64) - center).astype(np.float32).astype(np.float64)
        return Rays(relative + center, (self._position - center - relative).astype(np.float32), t_min, t_max)

    @overload
    def occluded(
        self, points: NumpyLike, t_min: Numbers = 0.0, t_max: Numbers = 1.0, *, skip: Hits | Numbers | None = None
    ) -> np.ndarray: ...
    @overload
    def occluded(
        self, points: WarpLike, t_min: Numbers = 0.0, t_max: Numbers = 1.0, *, skip: Hits | Numbers | None = None
    ) -> wp.array: ...
    def occluded(
        self, points: ArrayLike, t_min: Numbers = 0.0, t_max: Numbers = 1.0, *, skip: Hits | Numbers | None = None
    ) -> Any:
        """Whether each point is in shadow: (...) bool, a NumPy array if the points were, else a Warp array.

        Points with a NaN or an infinity, and the position of the light itself, are not in shadow.

        Args:
            points: (..., 3). float64 points are rounded to float32 relative to the scene's centre.
            t_min, t_max: scalars or (...) arrays, from the point at 0 to the light at 1: hits count if t_min <= t <= t_max.
            skip: each ray ignores one triangle, as in `wrt.Scene.occluded`: the one on which its point lies.

        Raises:
            TypeError, ValueError: as `wrt.Scene.occluded`.
        """
        state = self.scene.state
        if self._built_for is not state.device_mesh:
            self._build()
        with use_threads(state.num_threads):
            rays = lay_out(Rays(points, np.zeros(3, dtype=np.float32), t_min, t_max), state.device, state.center)
            return self._answer(rays, skip)

    def _answer(self, rays: DeviceRays, skip: Any) -> Any:
        from wrt.kernels.traversal.shadows.light_buffer_query import Skipped

        state, device, count = self.scene.state, self.scene.device, rays.count
        answers, undecided = empty(count, wp.uint8, device), wp.zeros(1, dtype=int, device=device)
        skipped = Skipped()
        if skip is None:
            skipped.triangles, skipped.stride = self._no_skip, 0
        else:
            check_skip(state, {"triangle_test": self._query.triangle_test})
            skipped.triangles, skipped.stride = skipped_triangles(skip, state, rays), 1
        target = self._position - (state.center if rays.layout.centered else 0.0)
        inputs = [self._cells, self._records, rays.batch, wp.vec3d(*map(float, target)), skipped, answers, undecided]
        kernel, run = self._kernel()
        launch(kernel, -(-count // run), inputs, device=device, chunk=CHUNK // run)
        occluded = wp.array(ptr=answers.ptr, dtype=wp.bool, shape=count, device=device)
        occluded.used = answers  # type: ignore[attr-defined]
        if count and undecided.numpy()[0]:
            self._trace_rest(rays, answers, skipped.triangles.numpy() if skip is not None else None)
        return shaped(occluded, rays.form)

    def _kernel(self) -> tuple[wp.Kernel, int]:
        """The kernel that answers rays, and the number of rays of its items."""
        from wrt.kernels.traversal.shadows.light_buffer_lanes import RUN, make_lane_kernel
        from wrt.kernels.traversal.shadows.light_buffer_query import make_light_buffer_kernel

        if self._in_lanes:
            return specialise(make_lane_kernel, self._config.triangle_test), RUN
        return specialise(make_light_buffer_kernel, self._config), 1

    def _trace_rest(self, rays: DeviceRays, answers: wp.array, skipped: np.ndarray | None) -> None:
        """Traces the rays that the lists do not decide, and writes their answers."""
        from wrt.kernels.traversal.shadows.light_rays import UNDECIDED

        values = answers.numpy()
        rest = np.flatnonzero(values == UNDECIDED)

        def some(array: wp.array, stride: int) -> np.ndarray:
            return array.numpy()[rest * stride]

        points = some(rays.origins, rays.layout.origins)  # type: ignore[arg-type]
        if rays.layout.centered:
            points = points.astype(np.float64) + self.scene.center
        shadow = self.shadow_rays(points, some(rays.t_min, rays.layout.t_min), some(rays.t_max, rays.layout.t_max))
        options: dict[str, Any] = {"cull_backfaces": self._query.cull_backfaces}
        if skipped is None:
            options["triangle_test"] = self._config.triangle_test
        else:
            options["skip"] = SceneTriangles(wp.array(skipped[rest], dtype=int, device=answers.device))
        values[rest] = self.scene.occluded(shadow, **options)
        if answers.device.is_cuda:
            answers.assign(values)

    def _build(self) -> None:
        from wrt.builders.lights.light_cube import LitMesh, build_light_buffer
        from wrt.kernels.triangle import TRIANGLE_TESTS

        state = self.scene.state
        check_scene(state)
        refuse_capture("building a light buffer", state.device)
        with use_threads(state.num_threads):
            ray = lay_out(Rays(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32)), state.device, state.center)
            plan = plan_for_query(find_plan(state, ray.facts, self._query).plan, self._query.kind)
            test = TRIANGLE_TESTS[plan.triangle_test]
            if test.needs_shared_origin:
                raise ValueError(f"triangle test {test.name!r} needs rays with a shared origin; choose another")
            config: TraversalConfig = traversal_config(plan, state, self._query.kind, False)
            mesh, tree = state.device_mesh, state.tree
            cells: LightCells = build_light_buffer(
                LitMesh(mesh.vertices, mesh.faces, tree.low, tree.high),
                self._position - state.center,
                self._resolution or default_resolution(state.triangle_count),
                accurate=test.accurate,
                watertight=test.watertight,
                cull_backfaces=self._query.cull_backfaces,
                max_bytes=self._max_bytes,
                allocate=empty,
            )
            self._in_lanes = bool(test.native) and not self._query.cull_backfaces and state.device.is_cpu
            records = pack_triangles(state) if self._in_lanes else records_of(state, plan, None).records
        self._cells, self._records, self._config, self._built_for = cells, records, config, mesh
        self._no_skip = wp.full(1, -1, dtype=int, device=state.device)


def pack_triangles(state: Any) -> wp.array:
    """The triangles as the kernel for lanes reads them, a cache line each."""
    from wrt.kernels.traversal.shadows.light_buffer_lanes import RECORD_FLOATS, pack_lines

    records = empty(state.triangle_count * RECORD_FLOATS, wp.float32, state.device)
    launch(pack_lines, state.triangle_count, [*state.shown, records], device=state.device, chunk=CHUNK)
    return records


def default_resolution(triangles: int) -> int:
    """A power of two, so that the lists of cells are short and cells are not many more than triangles."""
    wanted = math.sqrt(CELLS_PER_TRIANGLE * triangles / FACES)
    low, high = DEFAULT_RESOLUTIONS
    return min(max(low, 1 << math.ceil(math.log2(max(wanted, 1.0)))), high)


def check_scene(state: Any) -> None:
    """Refuses scenes whose triangles are not in one space."""
    if state.instances:
        raise ValueError("a light buffer needs a scene without instances; use wrt.Scene(scene.flattened())")
    if state.only_single:
        raise ValueError("a light buffer needs a scene with one tree; use wrt.Scene(scene.meshes)")
    state.require_opaque("a light buffer")


def check_resolution(resolution: Any) -> int | None:
    """A resolution as given, None for the default."""
    if resolution is None:
        return None
    return as_int("resolution", resolution, 1, MAX_RESOLUTION)
