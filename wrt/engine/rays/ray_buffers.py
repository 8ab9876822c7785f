"""Rays on the device together with what was detected in them: what plans are made for."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, overload

import numpy as np
import warp as wp

from wrt.engine.host_arrays import HostArray
from wrt.engine.rays.coherence import detect_coherence
from wrt.engine.rays.ray_arrays import Layout, RayArrays, flatten_shared, lay_out
from wrt.engine.rays.ray_grids import columns_of_shape
from wrt.engine.rays.rays import Rays, ResultForm
from wrt.engine.rays.staged_rays import StagedRays, stage
from wrt.kernels.layout.ray_batch import RayBatch
from wrt.kernels.validation import host_array


@dataclass
class RayBuffers:
    """Rays on the device.

    Attributes:
        given: the arrays, or the batch that kernels read.
        shape: leading shape of the results.
        is_warp: whether any input was a Warp or DLPack array, so that results are Warp arrays.
        dtype: type of positions and normals: float64 if origins or directions were, else float32.
        coherent: whether neighbouring rays are similar.
        scattered: whether neighbouring rays start far apart.
        keep: arrays that must live as long as the batch.
        columns: columns of the image whose pixels, row by row, the rays belong to; 0 if they are not those of an image.
    """

    given: RayArrays | RayBatch
    shape: tuple[int, ...]
    is_warp: bool
    dtype: type
    coherent: bool
    scattered: bool
    keep: list[Any]
    columns: int = 0

    @cached_property
    def batch(self) -> RayBatch:
        """The rays as kernels read them. A caller may modify it; it then replaces the arrays."""
        return self.given.batch() if isinstance(self.given, RayArrays) else self.given

    def to_sample(self) -> RayBatch:
        """The rays as kernels read them, for a look at some of them: the arrays stay what they are."""
        if "batch" in self.__dict__ or not isinstance(self.given, RayArrays):
            return self.batch
        batch = self.given.batch()
        batch.columns = self.columns
        return batch

    @property
    def arrays_or_batch(self) -> RayArrays | RayBatch:
        """The arrays, or the batch once it was made; both have `count` and tell whether rays share their origin."""
        return self.__dict__.get("batch", self.given)

    @property
    def layout(self) -> Layout | str | None:
        """How the rays are stored in their arrays; None once the batch was made."""
        return None if "batch" in self.__dict__ else getattr(self.given, "layout", None)

    @property
    def form(self) -> ResultForm:
        """The form of results."""
        return ResultForm(self.shape, self.is_warp, self.dtype)

    @property
    def in_place(self) -> bool:
        """Whether the rays are read where the caller has them, which no graph capture may do: there is none
        (`wrt.engine.rays.ray_arrays.lay_out`)."""
        return type(self.given.directions) is HostArray

    @property
    def count(self) -> int:
        """Number of rays."""
        return self.given.count


@overload
def to_device(rays: Rays, device: wp.Device, center: np.ndarray) -> RayBuffers: ...
@overload
def to_device(rays: Rays, device: wp.Device, center: np.ndarray, staged: int) -> RayBuffers | StagedRays: ...
def to_device(rays: Rays, device: wp.Device, center: np.ndarray, staged: int = 0) -> RayBuffers | StagedRays:
    """Brings rays to the device, relative to `center` (origins in float64 become float32 only then).

    Args:
        rays: the rays.
        device: the scene's.
        center: (3,) float64, the scene's.
        staged: number of rays up to which they go one by one on the CPU: those in NumPy arrays are left to a prepared query
            to copy, and in no others coherence is looked for.

    Raises:
        TypeError, ValueError: as `lay_out`.
    """
    if staged and (few := stage(rays, device, center, staged)) is not None:
        return few
    return buffers_of(lay_out(rays, device, center), device, staged)


def buffers_of(arrays: RayArrays, device: wp.Device, staged: int = 0) -> RayBuffers:
    """Rays that are on the device, and whether they are coherent; arguments as in `to_device`."""
    if arrays.count <= staged:  # rays that go one by one need not look alike
        return RayBuffers(arrays, arrays.shape, arrays.is_warp, arrays.dtype, True, False, list(arrays.keep))
    coherent, scattered, columns = detect_coherence(arrays, device, is_list=len(arrays.shape) == 1)
    keep, columns = list(arrays.keep), columns or columns_of_shape(arrays.shape)
    return RayBuffers(arrays, arrays.shape, arrays.is_warp, arrays.dtype, coherent, scattered, keep, columns)


def set_mask(buffers: RayBuffers, mask: Any, device: wp.Device) -> None:
    """Sets the masks of rays: an int for all, or an array of integers that broadcasts to their shape.

    Raises:
        TypeError: the mask does not hold integers.
        ValueError: values outside 0 .. 2^32 - 1, a shape that does not broadcast, or an array on another device.
    """
    if isinstance(mask, wp.array):
        if mask.dtype is not wp.uint32 or mask.device != device:
            raise ValueError(f"mask must be a Warp array of uint32 on {device}, not of {mask.dtype.__name__} on {mask.device}")
        stride = 0 if mask.size == 1 else 1
        if stride and mask.shape != buffers.shape:
            raise ValueError(
                f"mask has the shape {mask.shape}, the rays {buffers.shape}; Warp arrays broadcast only from one element"
            )
        buffers.batch.mask, buffers.batch.mask_stride = mask.flatten(), stride
        return
    values = host_array("mask", mask)
    if values.dtype.kind not in "iu":
        raise TypeError(f"mask must hold integers, not {values.dtype}; combine bits as 1 << 0 | 1 << 3")
    if values.size and (values.min() < 0 or values.max() >= 1 << 32):
        raise ValueError(f"mask must be from 0 to 2**32 - 1, but ranges from {values.min()} to {values.max()}")
    try:
        each, stride = flatten_shared(np.broadcast_to(values.astype(np.uint32), buffers.shape), buffers.shape, ())
    except ValueError:
        raise ValueError(
            f"mask has the shape {values.shape}, which does not broadcast to that of the rays, {buffers.shape}"
        ) from None
    buffers.batch.mask, buffers.batch.mask_stride = wp.array(each, dtype=wp.uint32, device=device), stride


def set_environment(buffers: RayBuffers, environment: Any, device: wp.Device) -> None:
    """Sets the environments of rays: an int for all, or an array of integers that broadcasts to their shape.

    Raises:
        TypeError: the array does not hold integers.
        ValueError: values outside -1 .. 2^31 - 1, a shape that does not broadcast, or an array on another device.
    """
    batch = buffers.batch
    if isinstance(environment, wp.array):
        if environment.dtype is not wp.int32 or environment.device != device:
            raise ValueError(
                f"environment must be a Warp array of int32 on {device}, not of {environment.dtype.__name__} on "
                f"{environment.device}"
            )
        stride = 0 if environment.size == 1 else 1
        if stride and environment.shape != buffers.shape:
            raise ValueError(
                f"environment has the shape {environment.shape}, the rays {buffers.shape}; Warp arrays broadcast only from one "
                "element"
            )
        batch.environment, batch.environment_stride = environment.flatten(), stride
        return
    values = host_array("environment", environment)
    if values.dtype.kind not in "iu":
        raise TypeError(f"environment must hold integers, not {values.dtype}")
    if values.size and (values.min() < -1 or values.max() >= 1 << 31):
        raise ValueError(f"environment must be from -1 to 2**31 - 1, but ranges from {values.min()} to {values.max()}")
    try:
        each, stride = flatten_shared(np.broadcast_to(values.astype(np.int32), buffers.shape), buffers.shape, ())
    except ValueError:
        raise ValueError(
            f"environment has the shape {values.shape}, which does not broadcast to that of the rays, {buffers.shape}"
        ) from None
    batch.environment, batch.environment_stride = wp.array(each, dtype=int, device=device), stride


def shares_origin(batch: Any) -> bool:
    """Whether all rays are known to start at one point, as a single ray does."""
    return batch.origin_stride == 0 or batch.count <= 1


def shared_origin(batch: RayBatch) -> tuple[float, float, float]:
    """The point at which all rays start, relative to the scene's centre, rounded as in
    `wrt.kernels.layout.ray_batch.load_ray`."""
    if len(batch.origins) == 0:
        return (0.0, 0.0, 0.0)
    origin = batch.origins[:1].numpy()[0].astype(np.float64) - np.array(batch.center, dtype=np.float64)
    return tuple(origin.astype(np.float32).tolist())
