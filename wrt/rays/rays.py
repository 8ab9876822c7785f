"""Rays as users give them, and their way to the device: without a copy where none is needed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
import warp as wp

from wrt.kernels.layout.ray_batch import RayBatch, center_float64_points
from wrt.kernels.runtime.launch import kept, launch
from wrt.memory import keep_alive
from wrt.rays.coherence import look_at
from wrt.rays.ray_grids import columns_of_shape, one_origin

MAX_RAYS = (1 << 31) - 1
"""Rays of one call: kernels number them in 32 bits."""

NOWHERE = np.zeros(3)
"""The centre relative to which directions are taken."""

Array = Any
"""A NumPy array or anything that NumPy converts; a Warp array; or an object with `__dlpack__`."""


@dataclass(frozen=True)
class Rays:
    """Rays origin + t direction.

    Attributes:
        origins: (..., 3) float32 or float64; the leading shapes of the four broadcast against each other.
        directions: (..., 3) float32 or float64, of any length from 2^-126 on (`Scene.intersect`); t counts in units of it.
        t_min, t_max: scalars or (...) arrays: hits count if t_min <= t <= t_max (closed interval), 0 <= t_min.
    """

    origins: Array
    directions: Array
    t_min: Array = 0.0
    t_max: Array = float("inf")

    @property
    def shape(self) -> tuple[int, ...]:
        """The leading shape: that of the results."""
        return common_shape(self.origins, self.directions, self.t_min, self.t_max)

    def __len__(self) -> int:
        """Number of rays."""
        return math.prod(self.shape)


@dataclass
class RayBuffers:
    """Rays on the device.

    Attributes:
        given: the arrays, or what kernels read.
        shape: leading shape of the results.
        is_warp: whether any input was on the Warp side, so that results stay there.
        dtype: float64 if any of origins and directions was, else float32: the type of positions and normals.
        coherent: whether neighbouring rays look alike.
        scattered: whether neighbouring rays start far apart.
        keep: arrays that must live as long as the batch.
        columns: of the picture whose pixels the rays are, row by row; 0 if they are none.
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
        """What kernels read; whoever has it may change it, and then it counts in place of the arrays."""
        return self.given.batch() if isinstance(self.given, RayArrays) else self.given

    @property
    def laid_out(self) -> RayArrays | RayBatch:
        """The arrays, as long as nobody asked for the batch; both know `count`, the arrays and their strides."""
        return self.__dict__.get("batch", self.given)

    @property
    def count(self) -> int:
        """Number of rays."""
        return self.laid_out.count


class Layout(NamedTuple):
    """How rays lie in their arrays: all that a launch must know of them besides the arrays.

    Attributes:
        origins, directions, t_min, t_max: 1 where each ray has its own, 0 where all share element 0.
        centered: whether the origins are relative to the scene's centre already.
    """

    origins: int
    directions: int
    t_min: int
    t_max: int
    centered: bool


@dataclass
class RayArrays:
    """Rays as flat arrays on the device.

    Attributes:
        origins, directions: (N,) or (1,) vec3.
        t_min, t_max: (N,) or (1,) float32.
        layout: which of them have one element, and what the origins are relative to.
        count: N.
        center: (3,) float64, the scene's.
        shape, is_warp, dtype, keep: as of `RayBuffers`.
    """

    origins: wp.array
    directions: wp.array
    t_min: wp.array
    t_max: wp.array
    layout: Layout
    count: int
    center: np.ndarray
    shape: tuple[int, ...]
    is_warp: bool
    dtype: type
    keep: tuple[Any, ...]

    @property
    def origin_stride(self) -> int:
        """As of `RayBatch`."""
        return self.layout.origins

    @property
    def direction_stride(self) -> int:
        """As of `RayBatch`."""
        return self.layout.directions

    def batch(self) -> RayBatch:
        """The rays for kernels."""
        batch = new_batch(self.layout, self.center)
        batch.count = self.count
        batch.origins, batch.directions = self.origins, self.directions
        batch.t_min, batch.t_max = self.t_min, self.t_max
        return batch

    def write_to(self, arguments: Any) -> None:
        """Writes the addresses of the arrays, and how many rays they are, into the packed form of a batch of this layout."""
        arguments.origins, arguments.directions = self.origins.__ctype__(), self.directions.__ctype__()
        arguments.t_min, arguments.t_max = self.t_min.__ctype__(), self.t_max.__ctype__()
        arguments.count = self.count


def to_device(rays: Rays, device: wp.Device, center: np.ndarray) -> RayBuffers:
    """Brings rays to the device, relative to `center` (origins in float64 become float32 only then).

    Raises:
        TypeError, ValueError: as `lay_out`.
    """
    arrays = lay_out(rays, device, center)
    coherent, scattered, columns = look_at(arrays, device, is_list=len(arrays.shape) == 1)
    keep, columns = list(arrays.keep), columns or columns_of_shape(arrays.shape)
    return RayBuffers(arrays, arrays.shape, arrays.is_warp, arrays.dtype, coherent, scattered, keep, columns)


def lay_out(rays: Rays, device: wp.Device, center: np.ndarray) -> RayArrays:
    """The arrays of rays on the device; float64 origins are taken relative to `center` there.

    Raises:
        TypeError: an argument is not an array of real numbers.
        ValueError: wrong shapes, shapes that do not broadcast, a range that is negative or NaN, another device, more than
            `MAX_RAYS` rays.
    """
    origins = as_vectors(rays.origins, "origins", device)
    directions = as_vectors(rays.directions, "directions", device)
    is_warp = isinstance(origins, wp.array) or isinstance(directions, wp.array)
    t_min = as_range(rays.t_min, "t_min", device)
    t_max = as_range(rays.t_max, "t_max", device)
    shape = common_shape(origins, directions, t_min, t_max)
    if math.prod(shape) > MAX_RAYS:
        raise ValueError(
            f"these are {math.prod(shape):,} rays, of shape {shape}, and one call takes {MAX_RAYS:,}; pass fewer at a time, or "
            "call scene.intersect_blocks, occluded_blocks or count_blocks"
        )
    if device.is_cpu and isinstance(origins, np.ndarray):
        origins = one_origin(origins)
    centered = _is_float64(origins)
    dtype = np.float64 if centered or _is_float64(directions) else np.float32
    given = origins, directions, t_min, t_max
    origins, origin_stride = _vectors(origins, shape, device, center)
    directions, direction_stride = _vectors(directions, shape, device, NOWHERE)
    t_min, t_min_stride = _scalars(t_min, shape, device)
    t_max, t_max_stride = _scalars(t_max, shape, device)
    layout = Layout(origin_stride, direction_stride, t_min_stride, t_max_stride, centered)
    return RayArrays(origins, directions, t_min, t_max, layout, math.prod(shape), center, shape, is_warp, dtype, given)


def new_batch(layout: Layout, center: np.ndarray) -> RayBatch:
    """A batch that waits for its arrays."""
    batch = RayBatch()
    batch.origin_stride, batch.direction_stride, batch.t_min_stride, batch.t_max_stride, centered = layout
    batch.center = wp.vec3d() if centered else wp.vec3d(*(float(x) for x in center))
    return batch


def set_mask(buffers: RayBuffers, mask: Any, device: wp.Device) -> None:
    """Gives rays their masks: an int for all, or an array of integers that broadcasts to their shape.

    Raises:
        TypeError: no integers.
        ValueError: out of 0 .. 2^32 - 1, a shape that does not broadcast, an array on another device.
    """
    if isinstance(mask, wp.array):
        if mask.dtype is not wp.uint32 or mask.device != device:
            raise ValueError(f"mask must be a Warp array of uint32 on {device}, not of {mask.dtype.__name__} on {mask.device}")
        values, stride = mask, 0 if mask.size == 1 else 1
        if stride and mask.shape != buffers.shape:
            raise ValueError(
                f"mask has the shape {mask.shape}, the rays {buffers.shape}; Warp arrays broadcast only from one element"
            )
        buffers.batch.mask, buffers.batch.mask_stride = values.flatten(), stride
        return
    values = np.asarray(mask)
    if values.dtype.kind not in "iu":
        raise TypeError(f"mask must hold integers, not {values.dtype}; combine bits as 1 << 0 | 1 << 3")
    if values.size and (values.min() < 0 or values.max() >= 1 << 32):
        raise ValueError(f"mask must be from 0 to 2**32 - 1, but ranges from {values.min()} to {values.max()}")
    try:
        each, stride = spread(np.broadcast_to(values.astype(np.uint32), buffers.shape), buffers.shape, ())
    except ValueError:
        raise ValueError(
            f"mask has the shape {values.shape}, which does not broadcast to that of the rays, {buffers.shape}"
        ) from None
    buffers.batch.mask, buffers.batch.mask_stride = wp.array(each, dtype=wp.uint32, device=device), stride


def shares_origin(batch: RayBatch) -> bool:
    """Whether all rays are known to start at one point; one ray does."""
    return batch.origin_stride == 0 or batch.count <= 1


def shared_origin(batch: RayBatch) -> tuple[float, float, float]:
    """The point at which all rays start, relative to the scene's centre, rounded as `wrt.kernels.layout.ray_batch.load_ray`
    does."""
    if len(batch.origins) == 0:
        return (0.0, 0.0, 0.0)
    origin = batch.origins[:1].numpy()[0].astype(np.float64) - np.array(batch.center, dtype=np.float64)
    return tuple(origin.astype(np.float32).tolist())


def leading_shape(values: Array) -> tuple[int, ...]:
    if isinstance(values, wp.array):
        return values.shape if values.dtype in (wp.vec3f, wp.vec3d) else values.shape[:-1]
    return np.shape(values)[:-1]


def _is_float64(values: np.ndarray | wp.array) -> bool:
    return values.dtype == np.float64 if isinstance(values, np.ndarray) else values.dtype is wp.vec3d


def as_vectors(values: Array, name: str, device: wp.Device) -> np.ndarray | wp.array:
    """`values` as a Warp array of vectors or a NumPy array (..., 3) of float32 or float64."""
    if not isinstance(values, (np.ndarray, wp.array)) and hasattr(values, "__dlpack__"):
        values = wp.from_dlpack(values)
    if isinstance(values, wp.array):
        if values.device != device:
            raise ValueError(f"{name} is on {values.device}, the scene on {device}: copy it there with .to({str(device)!r})")
        if values.dtype in (wp.float32, wp.float64) and values.shape and values.shape[-1] == 3:
            values = values.contiguous().view(wp.vec3f if values.dtype is wp.float32 else wp.vec3d)
        if values.dtype not in (wp.vec3f, wp.vec3d):
            raise TypeError(f"{name} must hold vec3f, vec3d or (..., 3) float32 or float64, not {values.dtype.__name__}")
        return values.contiguous()
    values = _as_real(values, name)
    if values.ndim == 0 or values.shape[-1] != 3:
        raise ValueError(f"{name} must have shape (..., 3), not {values.shape}")
    return values


def _as_real(values: Array, name: str) -> np.ndarray:
    """A NumPy array of float32 or float64; narrower floats become float32, integers and wider floats float64."""
    try:
        values = np.asarray(values)
    except ValueError as error:
        raise TypeError(f"{name} is no array: {error}") from error
    if values.dtype.kind not in "fiu":
        raise TypeError(f"{name} must hold real numbers, not {values.dtype}; convert it to float32 or float64")
    if values.dtype in (np.float32, np.float64):
        return values
    return values.astype(np.float32 if values.dtype == np.float16 else np.float64)


def as_range(values: Array, name: str, device: wp.Device) -> float | np.ndarray | wp.array:
    """A bound of t: a number as it is, else float32. Of Warp arrays no value is looked at: a bad one makes its ray miss."""
    if isinstance(values, wp.array):
        if values.dtype is not wp.float32:
            raise TypeError(f"{name} must hold float32, not {values.dtype.__name__}")
        if values.device != device:
            raise ValueError(f"{name} is on {values.device}, the scene on {device}: copy it there with .to({str(device)!r})")
        return values.contiguous()
    is_number = type(values) in (float, int)
    try:
        values = float(values) if is_number else _as_real(values, name)
    except OverflowError:
        raise ValueError(f"{name} is an int that no float64 holds; pass float('inf') for no bound") from None
    low = values if is_number else values.min(initial=np.inf)
    if not low >= 0.0:
        raise ValueError(f"{name} must not be negative or NaN, but its least value is {low}; pass distances from 0 up")
    if name == "t_min" and (math.isinf(values) if is_number else np.isinf(values).any()):
        raise ValueError("t_min must be finite: no hit lies at infinity; leave it at 0 to count all hits")
    if is_number:
        return values
    with np.errstate(over="ignore"):
        return np.asarray(values, dtype=np.float32)


def common_shape(origins: Array, directions: Array, t_min: Array, t_max: Array) -> tuple[int, ...]:
    ranges = [() if type(bound) is float else np.shape(bound) for bound in (t_min, t_max)]  # np.shape takes a microsecond
    shapes = [leading_shape(origins), leading_shape(directions), *ranges]
    if shapes[0] in (shapes[1], ()) and shapes[2:] == [(), ()]:
        return shapes[1]
    try:
        return np.broadcast_shapes(*shapes)
    except ValueError:
        names = ("origins", "directions", "t_min", "t_max")
        listed = ", ".join(f"{name} {shape}" for name, shape in zip(names, shapes, strict=True))
        raise ValueError(f"the leading shapes do not broadcast: {listed}") from None


def spread(values: np.ndarray, shape: tuple[int, ...], trailing: tuple[int, ...]) -> tuple[np.ndarray, int]:
    """(array of N elements, 1), or (array of one element, 0) if all rays share it."""
    leading = values.ndim - len(trailing)
    if values.shape == shape + trailing and values.flags.c_contiguous:
        return values.reshape(-1, *trailing), 1
    shared = all(n == 1 or stride == 0 for n, stride in zip(values.shape[:leading], values.strides[:leading], strict=True))
    if shared and math.prod(shape) > 1:
        return np.ascontiguousarray(values[(0,) * leading]).reshape(1, *trailing), 0
    return np.ascontiguousarray(np.broadcast_to(values, shape + trailing)).reshape(-1, *trailing), 1


def _vectors(
    values: np.ndarray | wp.array, shape: tuple[int, ...], device: wp.Device, center: np.ndarray
) -> tuple[wp.array, int]:
    """Vectors as a flat (N,) or (1,) vec3 array; float64 ones are taken relative to `center`."""
    stride = 1
    if isinstance(values, wp.array):
        stride = 0 if values.size == 1 else 1
        if stride and values.shape != shape:
            raise ValueError(f"Warp arrays broadcast only from one element: {values.shape} against {shape}")
        values = values if values.ndim == 1 else values.flatten()
    else:
        values, stride = spread(values, shape, (3,))
        dtype = wp.vec3f if values.dtype == np.float32 else wp.vec3d
        values = _upload(values, dtype, device)
    if values.dtype is wp.vec3d:
        out = wp.empty(len(values), dtype=wp.vec3f, device=device)
        launch(center_float64_points, len(values), [values, wp.vec3d(*map(float, center)), out], device=device, chunk=4096)
        values = out
    return values, stride


def _scalars(values: float | np.ndarray | wp.array, shape: tuple[int, ...], device: wp.Device) -> tuple[wp.array, int]:
    """Bounds of t as a flat (N,) or (1,) float array."""
    if isinstance(values, float):
        stride = int(math.prod(shape) == 1)
        if device.is_capturing:  # what is kept for others may be dropped before the graph is
            return wp.full(1, values, dtype=float, device=device), stride
        return _number(values, device.alias), stride
    if isinstance(values, wp.array):
        if values.size != 1 and values.shape != shape:
            raise ValueError(f"Warp arrays broadcast only from one element: {values.shape} against {shape}")
        return values.flatten(), 0 if values.size == 1 else 1
    values, stride = spread(values, shape, ())
    return _upload(values, float, device), stride


def _upload(values: np.ndarray, dtype: type, device: wp.Device) -> wp.array:
    """An array on the device, on the CPU in the same memory.

    Raises:
        RuntimeError: a graph is being captured on the device: it would copy from memory that is gone when it is launched.
    """
    if device.is_capturing:
        raise RuntimeError(
            "rays must be Warp arrays while a graph is captured; copy them to the device before the capture, "
            f"by wp.array(..., dtype=wp.vec3, device={str(device)!r})"
        )
    if not device.is_cpu:
        return wp.array(values, dtype=dtype, device=device)
    pointer, count = values.__array_interface__["data"][0], len(values)
    return keep_alive(wp.array(ptr=pointer, dtype=dtype, shape=count, capacity=values.nbytes, device=device), values)


@lru_cache(maxsize=64)
def _number(value: float, device: str) -> wp.array:
    """An array of one float32, made once: most batches have the same bounds."""
    with np.errstate(over="ignore"), kept(wp.get_device(device)):
        return wp.array(np.float32([value]), dtype=float, device=device)
