"""Which part of an area light points see: shadow rays to samples of the light, traced in frusta."""

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
from wrt.engine.rays.rays import Rays, ResultForm, check_number
from wrt.kernels.layout.light_samples import GROUP, LightSamples, pattern_of
from wrt.kernels.runtime.launch import launch, specialise, use_threads
from wrt.kernels.validation import as_int, as_numbers, as_point, as_real_array, first_bad, host_array

if TYPE_CHECKING:
    from wrt.array_types import ArrayLike, Numbers, NumpyLike, WarpLike
    from wrt.scene.scene import Scene

MAX_SAMPLES = 4096
"""Most samples of a pattern."""

MAX_PATTERNS = 1024

FARTHEST_SAMPLE = 1e37
"""Greatest coordinate of a sample."""

CHUNK = 16
"""Items of the kernel, each of at least 16 frusta, that are worth a chunk of their own."""


class AreaLightVisibility:
    """Soft shadows of an area light: which of its samples each point sees.

        light = wrt.lights.AreaLightVisibility.rectangle(scene, (-1, -1, 5), (2, 0, 0), (0, 2, 0), samples=16)
        fraction = light.visible(hits.position, t_min=1e-3)         # float32, 0 in the umbra, 1 in full light
        dark = light.occluded(hits.position, t_min=1e-3)            # bool for each sample
        same = scene.occluded(light.shadow_rays(hits.position, t_min=1e-3))  # bit for bit

    The rays of a point are made on the way, so none of them takes memory. On the CPU, scenes with a BVH trace them by
    multi-frusta (Benthin and Wald 2009, `wrt.kernels.traversal.shadows.multi_frusta`); others make the rays and call
    `wrt.Scene.occluded`. The answers are the same. It pays from 16 samples on, for lights that
    are large as seen from the points from 64 on (notebooks/records/2026-11-23-multi-frusta.md).

    Args:
        scene: what casts shadows.
        positions: (K, S, 3) or (S, 3): K patterns of S samples on the light. Point i (in the order of the flattened points)
            uses pattern `patterns_of(i)`. Samples that are near each other should follow each other: 16 of them are a frustum.
        triangle_test: "auto" for the scene's, or a key of `wrt.kernels.triangle.TRIANGLE_TESTS`.

    Raises:
        TypeError: positions are not an array of real numbers.
        ValueError: positions of another shape, without a sample or with more than 4096, more than 1024 patterns, coordinates
            that are not finite or above 1e37; an unknown triangle test, or one whose rays must share their origin.
    """

    def __init__(self, scene: Scene, positions: ArrayLike, *, triangle_test: str = AUTO) -> None:
        self.scene = scene
        self._positions = check_samples(positions)
        self._query = Query(ANY, "packet", triangle_test)
        self._arrays: dict[tuple[Any, ...], LightSamples] = {}
        if triangle_test != AUTO:
            check_test(triangle_test)

    @classmethod
    def rectangle(
        cls,
        scene: Scene,
        corner: ArrayLike,
        edge_u: ArrayLike,
        edge_v: ArrayLike,
        samples: int = 16,
        *,
        patterns: int = 16,
        seed: int = 0,
        triangle_test: str = AUTO,
    ) -> AreaLightVisibility:
        """A light that is a rectangle or another parallelogram, with jittered samples: one in each cell of a grid.

        Args:
            scene: what casts shadows.
            corner: (3,) a corner.
            edge_u, edge_v: (3,) the edges from there.
            samples: samples of a pattern, 1 to 4096. The grid has as many cells, as square as its divisors allow.
            patterns: number of patterns, 1 to 1024.
            seed: of the jitter; the same arguments give the same samples.
            triangle_test: as in the class.

        Raises:
            TypeError, ValueError: as the class.
        """
        samples, patterns = as_int("samples", samples, 1, MAX_SAMPLES), as_int("patterns", patterns, 1, MAX_PATTERNS)
        seed = as_int("seed", seed, 0)
        start, u, v = (as_point(name, value) for value, name in ((corner, "corner"), (edge_u, "edge_u"), (edge_v, "edge_v")))
        places = jittered(samples, patterns, seed)
        return cls(scene, start + places[..., :1] * u + places[..., 1:] * v, triangle_test=triangle_test)

    @property
    def samples(self) -> int:
        """Samples of a pattern."""
        return self._positions.shape[1]

    @property
    def patterns(self) -> int:
        """Number of patterns."""
        return self._positions.shape[0]

    @property
    def positions(self) -> np.ndarray:
        """(K, S, 3) float64: the samples."""
        return self._positions.copy()

    def __repr__(self) -> str:
        return f"AreaLightVisibility({self.samples} samples, {self.patterns} patterns)"

    def patterns_of(self, count: int) -> np.ndarray:
        """(N,) int64: the pattern that each point uses.

        Args:
            count: N.
        """
        return pattern_of(np.arange(as_int("count", count, 0), dtype=np.int64), self.patterns)

    def shadow_rays(self, points: ArrayLike, t_min: Numbers = 0.0, t_max: Numbers = 1.0) -> Rays:
        """The rays that `occluded` answers: (..., S) rays from the points to their samples, which they reach at t = 1.

        Args:
            points, t_min, t_max: as in `occluded`.
        """
        points = as_real_array("points", points.numpy() if isinstance(points, wp.array) else points)
        flat = points.reshape(-1, 3)
        chosen = self.patterns_of(len(flat))
        if is_narrow(points):
            flat = flat.astype(np.float32)
            origins, to = flat, self._positions.astype(np.float32)[chosen]
            directions = to - flat[:, None]
        else:
            center = self.scene.center
            near = (flat.astype(np.float64) - center).astype(np.float32)
            directions = (self._positions - center).astype(np.float32)[chosen] - near[:, None]
            origins = near.astype(np.float64) + center
        shape = (*points.shape[:-1], self.samples)
        arrays = [host_array("t_min or t_max", bound) for bound in (t_min, t_max)]
        ranges = [array if array.ndim == 0 else array[..., None] for array in arrays]
        each = np.broadcast_to(origins[:, None], directions.shape)
        return Rays(each.reshape(*shape, 3), directions.reshape(*shape, 3), *ranges)

    @overload
    def occluded(self, points: NumpyLike, t_min: Numbers = 0.0, t_max: Numbers = 1.0) -> np.ndarray: ...
    @overload
    def occluded(self, points: WarpLike, t_min: Numbers = 0.0, t_max: Numbers = 1.0) -> wp.array: ...
    def occluded(self, points: ArrayLike, t_min: Numbers = 0.0, t_max: Numbers = 1.0) -> Any:
        """Whether each sample is hidden from each point: (..., S) bool, a NumPy array if the points were, else a Warp array.

        A point with a NaN or an infinity sees all samples, as its rays hit nothing.

        Args:
            points: (..., 3). float64 points are rounded to float32 relative to the scene's centre; for float32 points, which
                lose more where the scene is far from 0, the samples are rounded to float32, too.
            t_min, t_max: scalars or (...) arrays, from the point at 0 to the sample at 1: hits count if t_min <= t <= t_max.

        Raises:
            TypeError, ValueError: as `wrt.Scene.occluded`.
        """
        return self._answer(points, t_min, t_max, True)

    @overload
    def visible(self, points: NumpyLike, t_min: Numbers = 0.0, t_max: Numbers = 1.0) -> np.ndarray: ...
    @overload
    def visible(self, points: WarpLike, t_min: Numbers = 0.0, t_max: Numbers = 1.0) -> wp.array: ...
    def visible(self, points: ArrayLike, t_min: Numbers = 0.0, t_max: Numbers = 1.0) -> Any:
        """The fraction of the samples that each point sees: (...) float32. Arguments and errors as in `occluded`."""
        return self._answer(points, t_min, t_max, False)

    def _answer(self, points: Any, t_min: Any, t_max: Any, each: bool) -> Any:
        state = self.scene.state
        with use_threads(state.num_threads):
            rays = lay_out(Rays(points, np.zeros(3, dtype=np.float32), t_min, t_max), state.device, state.center)
            check_number((rays.count, self.samples))
            if not self._in_frusta():
                return self._traced(rays, points, t_min, t_max, each)
            device = state.device
            count = rays.count * self.samples if each else rays.count
            answers, counts = empty(count if each else 0, wp.uint8, device), empty(0 if each else count, wp.int32, device)
            self._launch(rays, each, answers, counts)
        shape = (*rays.shape, self.samples) if each else rays.shape
        if each:
            occluded = wp.array(ptr=answers.ptr, dtype=wp.bool, shape=count, device=device)
            occluded.used = answers  # type: ignore[attr-defined]
            return shaped(occluded, ResultForm(shape, rays.form.is_warp, rays.form.dtype))
        fraction = (1.0 - counts.numpy().astype(np.float32) / np.float32(self.samples)).reshape(shape)
        return wp.array(fraction, dtype=wp.float32, device=device) if rays.form.is_warp else fraction

    def _in_frusta(self) -> bool:
        """Whether the scene's tree and device suit multi-frusta."""
        state = self.scene.state
        one_tree = not (state.instances or state.only_single or state.area_trees is not None or state.facts.has_masks)
        return state.device.is_cpu and one_tree and state.accelerator.kind == "bvh"

    def _traced(self, rays: DeviceRays, points: Any, t_min: Any, t_max: Any, each: bool) -> Any:
        """The same answers by `wrt.Scene.occluded`."""
        values = self.scene.occluded(self.shadow_rays(points, t_min, t_max), triangle_test=self._query.triangle_test)
        if not each:
            dark = np.asarray(values).sum(axis=-1)
            values = (1.0 - dark.astype(np.float32) / np.float32(self.samples)).astype(np.float32)
        return wp.array(values, device=self.scene.device) if rays.form.is_warp else values

    def _launch(self, rays: DeviceRays, each: bool, answers: wp.array, counts: wp.array) -> None:
        from wrt.kernels.traversal.shadows.multi_frusta import FRUSTA, make_multi_frusta_kernel

        state = self.scene.state
        plan = plan_for_query(find_plan(state, rays.facts, self._query).plan, self._query.kind)
        config = traversal_config(plan, state, self._query.kind, False)
        light = self._samples(rays.layout.centered)
        items = -(-rays.count // max(FRUSTA // light.groups, 1))
        inputs = [state.tree.struct(), records_of(state, plan, rays.batch), rays.batch, light, answers, counts]
        kernel = specialise(lambda config: make_multi_frusta_kernel(plain(config), each), config)
        launch(kernel, items, inputs, device=state.device, chunk=CHUNK)

    def _samples(self, centered: bool) -> LightSamples:
        """The samples in the coordinates of points, on the scene's device."""
        device, center = self.scene.device, self.scene.center if centered else np.zeros(3)
        key = (tuple(center.tolist()), device.alias)
        if key not in self._arrays:
            self._arrays[key] = pack_samples((self._positions - center).astype(np.float32), device)
        return self._arrays[key]


def plain(config: Any) -> Any:
    """A configuration without what multi-frusta do not read, so that one kernel serves all plans."""
    from wrt.kernels.traversal.traversal_config import TraversalConfig

    return TraversalConfig(config.triangle_test, config.width, config.query, stack=config.stack)


def pack_samples(positions: np.ndarray, device: wp.Device) -> LightSamples:
    """Patterns of samples (K, S, 3) float32 as the kernel reads them."""
    patterns, samples, _ = positions.shape
    groups = -(-samples // GROUP)
    number = np.arange(groups * GROUP)
    number = np.where(number < samples, number, number // GROUP * GROUP)
    grouped = positions[:, number].reshape(patterns, groups, GROUP, 3)
    light = LightSamples()
    light.samples, light.groups, light.patterns = samples, groups, patterns
    lanes = np.ascontiguousarray(grouped.transpose(0, 1, 3, 2)).reshape(-1)
    bounds = np.concatenate([grouped.min(axis=2), grouped.max(axis=2)], axis=-1).reshape(-1)
    light.positions = wp.array(lanes, dtype=float, device=device)
    light.bounds = wp.array(bounds, dtype=float, device=device)
    return light


def jittered(samples: int, patterns: int, seed: int) -> np.ndarray:
    """(patterns, samples, 2) in [0, 1): one in each cell of a grid, cells in tiles of up to 4 x 4, as square as they can be."""
    across = max(n for n in range(1, math.isqrt(samples) + 1) if samples % n == 0)
    down = samples // across
    rows, columns = np.divmod(np.arange(samples), across)
    order = np.lexsort((columns, rows, columns // 4, rows // 4))
    cells = np.stack([columns[order], rows[order]], axis=-1)
    return (cells + np.random.default_rng(seed).random((patterns, samples, 2))) / (across, down)


def is_narrow(points: np.ndarray) -> bool:
    """Whether points are float32, so that rays are made in the caller's coordinates."""
    return points.dtype.kind == "f" and points.dtype.itemsize <= 4


def check_samples(positions: Any) -> np.ndarray:
    """(K, S, 3) float64."""
    array = as_numbers("positions", positions, finite=False)
    array = array[None] if array.ndim == 2 else array
    if array.ndim != 3 or array.shape[2] != 3:
        raise ValueError(f"positions must have shape (K, S, 3) or (S, 3), not {np.shape(positions)}")
    if not (1 <= array.shape[1] <= MAX_SAMPLES and 1 <= array.shape[0] <= MAX_PATTERNS):
        raise ValueError(
            f"positions hold {array.shape[0]} patterns of {array.shape[1]} samples; pass 1 to {MAX_PATTERNS} patterns of 1 to "
            f"{MAX_SAMPLES} samples"
        )
    if bad := first_bad(~(np.abs(array) <= FARTHEST_SAMPLE), array):
        raise ValueError(f"positions{bad}; they must be finite and at most {FARTHEST_SAMPLE:g} in size")
    return array


def check_test(name: str) -> None:
    """Refuses a triangle test whose rays must share their origin."""
    from wrt.kernels.triangle import TRIANGLE_TESTS
    from wrt.tables import lookup

    if lookup(TRIANGLE_TESTS, name, "triangle_test").needs_shared_origin:
        raise ValueError(f"triangle test {name!r} needs rays with a shared origin; shadow rays start at many points")
