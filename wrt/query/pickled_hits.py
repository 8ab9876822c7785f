"""Pickled hits: for other processes, and for files.

A pickle holds the results, not the scene: all attributes of the hits, and the identifier of the scene by which `skip` and
`wrt.device.differentiable_hits` recognise it. Its size depends on the number of rays, not on the mesh. `Hits.spawn`, which
needs the triangles, is not available after unpickling.
"""

from __future__ import annotations

import copyreg
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import numpy as np
import warp as wp

from wrt.engine.device_hits import DTYPES, DeviceHits
from wrt.engine.rays.rays import ResultForm
from wrt.query.all_hits import AllHits
from wrt.query.exact_hits import PreciseHits
from wrt.query.hits import Hits
from wrt.query.points.closest_points import ClosestPoints, TrianglesWithin
from wrt.query.points.precise_points import PreciseClosestPoints

if TYPE_CHECKING:
    from wrt.engine.plan.plan import Plan

ATTRIBUTES = ("t", "primitive_id", "geometry_id", "instance_id", "uv", "is_hit", "position", "normal")


class HitsState(NamedTuple):
    """The pickled state of hits.

    Attributes:
        values: `ATTRIBUTES`, as NumPy arrays.
        primitive: (N,) int32, triangles numbered through all meshes of the scene.
        counters: as in `Hits`; None if nothing was counted.
        plan, shape: as in `Hits`.
        scenes: identifiers of the scenes that the hits are known to belong to.
        is_warp, is_float64: whether the rays were Warp arrays, and float64.
        device: name of the scene's device.
    """

    values: dict[str, np.ndarray]
    primitive: np.ndarray
    counters: dict[str, np.ndarray] | None
    plan: Plan
    shape: tuple[int, ...]
    scenes: frozenset[str]
    is_warp: bool
    is_float64: bool
    device: str


class PickledHits(Hits):
    """Unpickled hits, on their scene's device if it exists here, else on the CPU."""

    def __init__(self, state: HitsState) -> None:
        dtype = np.float64 if state.is_float64 else np.float32
        self._state, self._scenes, self.plan, self._num_threads = state, set(state.scenes), state.plan, None
        self._form = ResultForm(state.shape, state.is_warp, dtype)
        available = {str(device) for device in wp.get_devices()}
        self._home = wp.get_device(state.device if state.device in available else "cpu")
        for name, values in state.values.items():
            setattr(self, name, self._as_given(values) if state.is_warp else values)
        if state.counters is not None:
            self.counters = state.counters

    def _as_given(self, values: np.ndarray) -> wp.array:
        """A Warp array as queries return it: of vectors if values are rows."""
        rows = values.ndim > max(1, len(self.shape))
        if not rows:
            return wp.array(values, device=self._home)
        vectors = {(2, 4): wp.vec2, (2, 8): wp.vec2d, (3, 4): wp.vec3, (3, 8): wp.vec3d}
        return wp.array(values, dtype=vectors[values.shape[-1], values.itemsize], device=self._home)

    @cached_property
    def batch(self) -> DeviceHits:  # type: ignore[override]
        """As in `Hits`."""
        values = self._state.values
        arrays = {"t": values["t"].reshape(-1), "primitive": self._state.primitive, "uv": values["uv"].reshape(-1, 2)}
        if self._home.is_cpu:
            return DeviceHits.of_host(self._state.primitive.size, self._home, arrays)
        hits = DeviceHits(self._state.primitive.size, self._home)
        hits.__dict__.update({name: wp.array(arrays[name], dtype=DTYPES[name], device=self._home) for name in arrays})
        return hits

    @cached_property
    def counters(self) -> dict[str, Any]:
        raise ValueError("no counters were recorded; call scene.intersect(..., counters=True)")

    def spawn(self, directions: Any, side: str = "direction") -> NoReturn:
        """Not available: the pickle does not contain the triangles.

        Raises:
            ValueError: always; the message names the alternative.
        """
        raise ValueError(
            "hits from a pickle do not hold the triangles that spawn needs; call spawn before pickling, or intersect again"
        )

    @property
    def _surface(self) -> NoReturn:  # type: ignore[override]
        """Not available, as `spawn`."""
        self.spawn(None)

    def faces(self, directions: Any) -> NoReturn:
        """Not available: the pickle does not contain the triangles.

        Raises:
            ValueError: always; the message names the alternative.
        """
        raise ValueError(
            "hits from a pickle do not hold the triangles that faces needs; call faces before pickling, or intersect again"
        )

    @property
    def is_far(self) -> bool:
        """Whether positions are float64 though the rays were not."""
        return not self._state.is_float64 and self._state.values["position"].dtype == np.float64

    @property
    def _meshes(self) -> NoReturn:  # type: ignore[override]
        """Not available, and so neither are the attributes that are interpolated.

        Raises:
            ValueError: always; the message names the alternative.
        """
        raise ValueError(
            "hits from a pickle do not hold the triangles between whose vertices values are interpolated; call smooth_normal, "
            "interpolate or uv_at before pickling, or intersect again"
        )

    def same_geometry(self, scene: Any) -> bool:
        """False: without the triangles, only identifiers are compared."""
        return False


class PickledClosestPoints(PickledHits):
    """Unpickled closest points."""

    def __init__(self, state: HitsState, feature: np.ndarray) -> None:
        super().__init__(state)
        self.feature = wp.array(feature, dtype=wp.int8, device=self._home) if state.is_warp else feature

    @property
    def distance(self) -> Any:
        """As in `wrt.results.ClosestPoints`."""
        return self.t


def unpickle_all_hits(flat: HitsState, offsets: np.ndarray, shape: tuple[int, ...]) -> AllHits:
    """Unpickles lists of hits."""
    lists = object.__new__(AllHits)
    lists._flat = PickledHits(flat)
    lists._form = lists._flat._form._replace(shape=shape)
    lists._offsets = wp.array(offsets, dtype=wp.int64, device=lists._flat._home)
    lists.plan, lists._num_threads = flat.plan, None
    return lists


def unpickle_within(flat: HitsState, feature: np.ndarray, offsets: np.ndarray, shape: tuple[int, ...]) -> TrianglesWithin:
    """Unpickles lists of triangles within a distance."""
    lists = object.__new__(TrianglesWithin)
    lists.__dict__ |= unpickle_all_hits(flat, offsets, shape).__dict__
    lists._feature = wp.array(feature, dtype=wp.int8, device=lists._flat._home)  # type: ignore[attr-defined]
    return lists


def hits_state(hits: Hits) -> HitsState:
    """The pickled state of hits, with all attributes computed."""
    values = {name: as_numpy(getattr(hits, name)) for name in ATTRIBUTES}
    counters = hits.counters if hits.has_counters else None
    primitive, form = hits.batch.primitive.numpy(), hits._form
    is_float64 = form.dtype is np.float64
    marks = frozenset(hits._scenes)
    return HitsState(values, primitive, counters, hits.plan, hits.shape, marks, form.is_warp, is_float64, str(hits._device))


def as_numpy(values: Any) -> np.ndarray:
    """A result as a NumPy array."""
    return values.numpy() if isinstance(values, wp.array) else values


def reduce_hits(hits: Hits) -> tuple[Any, ...]:
    """How closest hits are pickled."""
    return PickledHits, (hits_state(hits),)


def reduce_points(points: ClosestPoints | PickledClosestPoints) -> tuple[Any, ...]:
    """How closest points are pickled."""
    return PickledClosestPoints, (hits_state(points), as_numpy(points.feature))


def reduce_lists(lists: AllHits) -> tuple[Any, ...]:
    """How lists of all hits are pickled."""
    return unpickle_all_hits, (hits_state(lists._flat), lists._offsets.numpy(), lists.shape)


def reduce_within(lists: TrianglesWithin) -> tuple[Any, ...]:
    """How lists of triangles within a distance are pickled."""
    flat, offsets, shape = reduce_lists(lists)[1]
    return unpickle_within, (flat, lists._feature.numpy(), offsets, shape)


for _kind in (Hits, PreciseHits, PickledHits):
    copyreg.pickle(_kind, reduce_hits)
for _points in (ClosestPoints, PreciseClosestPoints, PickledClosestPoints):
    copyreg.pickle(_points, reduce_points)  # type: ignore[arg-type]
copyreg.pickle(AllHits, reduce_lists)
copyreg.pickle(TrianglesWithin, reduce_within)
