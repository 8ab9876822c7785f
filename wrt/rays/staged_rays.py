"""Few rays in NumPy arrays: checked, but not yet on the device.

For few rays, most of a query's time would go into making Warp arrays of them. So they stay as they are until a prepared query
copies them into memory of its own (`wrt.execution.prepared`).
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp

from wrt.kernels.layout.ray_batch import RayBatch
from wrt.rays.ray_arrays import lay_out
from wrt.rays.rays import Rays, ResultForm, as_range, as_vectors, common_shape

STAGED = "staged"
"""Layout of rays that a prepared query copies."""


class StagedRays:
    """Few rays on the CPU, as NumPy arrays and numbers; read as `wrt.rays.ray_buffers.RayBuffers` are.

    Attributes:
        origins, directions: (..., 3) float32 or float64.
        t_min, t_max: numbers, or (...) float32.
        form: of the results; its shape is the leading shape that the four broadcast to.
        count: number of rays.
        device: the scene's, a CPU.
        center: (3,) float64, the scene's.
    """

    layout, is_warp, coherent, scattered, columns = STAGED, False, True, False, 0

    def __init__(
        self,
        values: tuple[np.ndarray, np.ndarray, float | np.ndarray, float | np.ndarray],
        form: ResultForm,
        count: int,
        device: wp.Device,
        center: np.ndarray,
    ) -> None:
        self.origins, self.directions, self.t_min, self.t_max = values
        self.form, self.count, self.device, self.center = form, count, device, center

    @property
    def shape(self) -> tuple[int, ...]:
        """Leading shape of the results."""
        return self.form.shape

    @property
    def given(self) -> StagedRays:
        """As of `RayBuffers`."""
        return self

    @property
    def arrays_or_batch(self) -> StagedRays:
        """As of `RayBuffers`."""
        return self

    @property
    def origin_stride(self) -> int:
        """0 where all of several rays share their origin, else 1."""
        if self.count == 1:
            return 1
        leading = zip(self.origins.shape[:-1], self.origins.strides[:-1], strict=True)
        return 0 if all(n == 1 or stride == 0 for n, stride in leading) else 1

    @cached_property
    def batch(self) -> RayBatch:
        """The rays for kernels, in arrays of their own."""
        return lay_out(Rays(self.origins, self.directions, self.t_min, self.t_max), self.device, self.center).batch()

    def copy_to(self, origins: np.ndarray, directions: np.ndarray, t_min: np.ndarray, t_max: np.ndarray) -> None:
        """Copies the rays, relative to the scene's centre, to the first elements of arrays of their number or more."""
        shape, count = self.form.shape, self.count
        with np.errstate(all="ignore"):  # what float32 does not hold misses
            out = origins[:count].reshape((*shape, 3))
            np.subtract(self.origins, self.center, out=out, dtype=np.float64, casting="unsafe")
            directions[:count].reshape((*shape, 3))[...] = self.directions
            t_min[:count].reshape(shape)[...] = self.t_min
            t_max[:count].reshape(shape)[...] = self.t_max


def stage(rays: Rays, device: wp.Device, center: np.ndarray, most: int) -> StagedRays | None:
    """The rays, if they are 1 to `most` in NumPy arrays, lists or numbers; else None.

    Raises:
        TypeError, ValueError: as `wrt.rays.ray_arrays.lay_out`.
    """
    given = rays.origins, rays.directions, rays.t_min, rays.t_max
    if not all(is_small(values, most) for values in given):
        return None
    origins, directions = as_vectors(given[0], "origins", device), as_vectors(given[1], "directions", device)
    t_min, t_max = as_range(given[2], "t_min", device), as_range(given[3], "t_max", device)
    shape = common_shape(origins, directions, t_min, t_max)
    count = math.prod(shape)
    if not 0 < count <= most:
        return None
    dtype = np.float64 if np.float64 in (origins.dtype, directions.dtype) else np.float32
    return StagedRays((origins, directions, t_min, t_max), ResultForm(shape, False, dtype), count, device, center)


def is_small(values: Any, most: int) -> bool:
    """Whether values are of NumPy or Python, and not too many to be looked at."""
    if isinstance(values, np.ndarray):
        return values.size <= 3 * most
    return isinstance(values, (float, int, np.generic)) or (isinstance(values, (list, tuple)) and len(values) <= most)
