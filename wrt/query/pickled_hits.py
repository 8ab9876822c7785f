"""Hits in pickles: for other processes, and for files.

A pickle holds the numbers, not the scene: all attributes of the hits, and the mark of the scene by which `skip` and
`wrt.differentiable_hits` know it. It grows with the rays and not with the mesh. So what needs the triangles themselves,
`Hits.spawn`, has to be asked before.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import numpy as np
import warp as wp

from wrt.kernels.layout.ray_batch import HitBatch, RayBatch
from wrt.query.hits import Hits
from wrt.rays.rays import RayBuffers

if TYPE_CHECKING:
    from wrt.execution.plan import Plan
    from wrt.query.all_hits import AllHits

ATTRIBUTES = ("t", "primitive_id", "geometry_id", "instance_id", "uv", "is_hit", "position", "normal")


class KeptHits(NamedTuple):
    """What a pickle holds of hits.

    Attributes:
        values: `ATTRIBUTES`, as NumPy arrays.
        primitive: (N,) int32, triangles numbered through the scene.
        counters: as of `Hits`; None if nothing was counted.
        plan, shape: as of `Hits`.
        scenes: marks of the scenes that the hits are known to be of.
        is_warp, is_float64: whether the rays were Warp arrays, and float64.
        device: of the scene.
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
    """Hits that come out of a pickle, on their scene's device if it is there, else on the CPU."""

    def __init__(self, kept: KeptHits) -> None:
        dtype = np.float64 if kept.is_float64 else np.float32
        self._kept, self._scenes, self.plan, self._num_threads = kept, set(kept.scenes), kept.plan, None
        self._rays = RayBuffers(RayBatch(), kept.shape, kept.is_warp, dtype, True, False, [])
        there = {str(device) for device in wp.get_devices()}
        self._home = wp.get_device(kept.device if kept.device in there else "cpu")
        for name, values in kept.values.items():
            setattr(self, name, self._as_given(values) if kept.is_warp else values)
        if kept.counters is not None:
            self.counters = kept.counters

    def _as_given(self, values: np.ndarray) -> wp.array:
        """A Warp array as queries return them: of vectors where values are rows."""
        rows = values.ndim > max(1, len(self.shape))
        if not rows:
            return wp.array(values, device=self._home)
        vectors = {(2, 4): wp.vec2, (2, 8): wp.vec2d, (3, 4): wp.vec3, (3, 8): wp.vec3d}
        return wp.array(values, dtype=vectors[values.shape[-1], values.itemsize], device=self._home)

    @cached_property
    def batch(self) -> HitBatch:
        """As of `Hits`."""
        hits, values = HitBatch(), self._kept.values
        hits.t = wp.array(values["t"].reshape(-1), dtype=float, device=self._home)
        hits.primitive = wp.array(self._kept.primitive, dtype=int, device=self._home)
        hits.uv = wp.array(values["uv"].reshape(-1, 2), dtype=wp.vec2, device=self._home)
        return hits

    @cached_property
    def counters(self) -> dict[str, Any]:
        raise ValueError("no work was counted; call scene.intersect(..., counters=True)")

    def spawn(self, directions: Any) -> NoReturn:
        """Not of hits from a pickle, which have no triangles with them.

        Raises:
            ValueError: always; the message says what to do instead.
        """
        raise ValueError(
            "hits from a pickle do not hold the triangles that spawn needs; call spawn before pickling, or intersect again"
        )

    def same_geometry(self, scene: Any) -> bool:
        """Nothing is known but the marks."""
        return False


def revive_lists(flat: KeptHits, offsets: np.ndarray, shape: tuple[int, ...]) -> AllHits:
    """The lists of a pickle."""
    from wrt.query.all_hits import AllHits

    lists, rays = object.__new__(AllHits), RayBatch()
    lists._flat, rays.count = PickledHits(flat), len(offsets) - 1
    lists._rays = replace(lists._flat._rays, given=rays, shape=shape)
    lists._offsets = wp.array(offsets, dtype=wp.int64, device=lists._flat._home)
    lists.plan, lists._num_threads = flat.plan, None
    return lists


def keep(hits: Hits) -> KeptHits:
    """What a pickle holds of hits; computes what is not computed yet."""
    values = {name: as_numpy(getattr(hits, name)) for name in ATTRIBUTES}
    counters = hits.counters if hits.has_counters else None
    primitive, rays = hits.batch.primitive.numpy(), hits._rays
    is_float64 = rays.dtype is np.float64
    marks = frozenset(hits._scenes)
    return KeptHits(values, primitive, counters, hits.plan, hits.shape, marks, rays.is_warp, is_float64, str(hits._device))


def as_numpy(values: Any) -> np.ndarray:
    """A NumPy array of a result."""
    return values.numpy() if isinstance(values, wp.array) else values
