"""Few rays in NumPy arrays: checked, but not yet on the device.

For few rays, most of a query's time would go into making Warp arrays of them. So they stay as they are until a prepared query
copies them into memory of its own (`wrt.engine.launch.prepared`).
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp

from wrt.engine.facts.facts import RayFacts
from wrt.engine.rays.device_rays import lay_out
from wrt.engine.rays.rays import FLOAT32, FLOAT64, Rays, ResultForm, as_range, as_vectors, common_shape
from wrt.kernels.layout.ray_batch import RayBatch

STAGED, STAGED_CENTERED = "staged", "staged, centered"
"""Layouts of rays that a prepared query copies: origins in float32 as they are, and those in float64 relative to the centre."""

FLOAT32_MAX = float(np.finfo(np.float32).max)


class StagedRays:
    """Few rays on the CPU, as NumPy arrays and numbers.

    Attributes:
        origins, directions: (..., 3) float32 or float64.
        t_min, t_max: numbers, or (...) float32.
        facts, form: as in `wrt.engine.rays.device_rays.DeviceRays`.
        device: the scene's, a CPU.
        center: (3,) float64, the scene's.
    """

    in_place, sample = True, None

    def __init__(
        self,
        values: tuple[np.ndarray, np.ndarray, float | np.ndarray, float | np.ndarray],
        facts: RayFacts,
        form: ResultForm,
        device: wp.Device,
        center: np.ndarray,
    ) -> None:
        self.origins, self.directions, self.t_min, self.t_max = values
        self.facts, self.form, self.device, self.center = facts, form, device, center
        self.own_layout = STAGED if self.origins.dtype == FLOAT32 else STAGED_CENTERED

    @cached_property
    def batch(self) -> RayBatch:
        """The rays for kernels, in arrays of their own."""
        return lay_out(Rays(self.origins, self.directions, self.t_min, self.t_max), self.device, self.center).new_batch()

    def copy_to(self, origins: np.ndarray, directions: np.ndarray, t_min: np.ndarray, t_max: np.ndarray) -> None:
        """Copies the rays to arrays of float32 of their leading shape; origins in float64 relative to the scene's centre."""
        small = all(type(bound) is not float or not FLOAT32_MAX < bound < math.inf for bound in (self.t_min, self.t_max))
        if small and self.form.dtype is np.float32:  # nothing can overflow
            self._copy(origins, directions, t_min, t_max)
        else:
            with np.errstate(all="ignore"):  # what float32 does not hold misses
                self._copy(origins, directions, t_min, t_max)

    def _copy(self, origins: np.ndarray, directions: np.ndarray, t_min: np.ndarray, t_max: np.ndarray) -> None:
        if self.own_layout is STAGED:
            origins[...] = self.origins
        else:
            np.subtract(self.origins, self.center, origins)
        directions[...] = self.directions
        t_min[...] = self.t_min
        t_max[...] = self.t_max


def stage(rays: Rays, device: wp.Device, center: np.ndarray, max_rays: int) -> StagedRays | None:
    """The rays, if they are 1 to `max_rays` in NumPy arrays, lists or numbers, and no graph is being captured; else None.

    Raises:
        TypeError, ValueError: as `wrt.engine.rays.device_rays.lay_out`.
    """
    origins, directions, t_min, t_max = rays.origins, rays.directions, rays.t_min, rays.t_max
    if type(directions) is np.ndarray and directions.size > 3 * max_rays:  # usual, and soon told
        return None
    small = is_small(origins, max_rays) and is_small(directions, max_rays)
    if not (small and is_small(t_min, max_rays) and is_small(t_max, max_rays)):
        return None
    if device.is_capturing:
        return None
    origins, directions = as_vectors(origins, "origins", device), as_vectors(directions, "directions", device)
    t_min, t_max = as_range(t_min, "t_min", device), as_range(t_max, "t_max", device)
    shape = common_shape(origins, directions, t_min, t_max)
    count = math.prod(shape)
    if not 0 < count <= max_rays:
        return None
    dtype = np.float64 if FLOAT64 in (origins.dtype, directions.dtype) else np.float32
    facts, values = RayFacts(count, shape, count > 1 and shares_origin(origins)), (origins, directions, t_min, t_max)
    return StagedRays(values, facts, ResultForm(shape, False, dtype), device, center)  # type: ignore[arg-type]


def shares_origin(origins: Any) -> bool:
    """Whether vectors (..., 3) are one, repeated."""
    shape, strides = origins.shape, origins.strides
    return not any(shape[axis] > 1 and strides[axis] for axis in range(len(shape) - 1))


def is_small(values: Any, max_rays: int) -> bool:
    """Whether values are of NumPy or Python, and not too many to be looked at."""
    if isinstance(values, np.ndarray):
        return values.size <= 3 * max_rays
    return isinstance(values, (float, int, np.generic)) or (isinstance(values, (list, tuple)) and len(values) <= max_rays)
