"""Rays as flat arrays on the device, without a copy where none is needed, and what is detected in them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import groupby
from typing import Any

import numpy as np
import warp as wp

from wrt.engine.facts.facts import RayFacts
from wrt.engine.host_arrays import HostArray, address_of, as_array
from wrt.engine.memory import empty, keep_alive
from wrt.engine.rays.coherence import columns_of_shape, detect_coherence, detect_shared_origin
from wrt.engine.rays.host_rays import Layout, arrange, shared_point
from wrt.engine.rays.rays import FLOAT32, FLOAT64, Rays, ResultForm, as_range, as_vectors, check_number, common_shape
from wrt.kernels.layout.ray_batch import RayBatch, center_float64_points, repeat_points
from wrt.kernels.runtime.launch import kept, launch

ZERO_CENTER = np.zeros(3)
"""The centre that directions are relative to."""


FLOATS = FLOAT32, FLOAT64

MANY = 4096
"""Least number of rays whose vectors are broadcast by a kernel on the CPU, with all threads and into memory that is kept."""

ARRAYS = {"origins": wp.vec3, "directions": wp.vec3, "t_min": wp.float32, "t_max": wp.float32}
"""The arrays of rays."""

BYTES: dict[type, int] = {dtype: wp.types.type_size_in_bytes(dtype) for dtype in ARRAYS.values()}
"""Bytes of their elements."""


@dataclass(eq=False)
class DeviceRays:
    """Rays as flat arrays on the device, and what is known of them.

    Attributes:
        origins, directions: (N,) or (1,) vec3; `batch` has them as Warp arrays.
        t_min, t_max: (N,) or (1,) float32.
        layout: which arrays have one shared element, and what the origins are relative to.
        center: (3,) float64, the scene's centre.
        facts: what plans depend on; `lay_out` leaves coherence to `examine`.
        form: of results.
        keep: the arrays that were passed, which must live as long as these.
        in_place: whether the rays are read where the caller has them, which `lay_out` does in no graph capture.
    """

    origins: wp.array | HostArray
    directions: wp.array | HostArray
    t_min: wp.array
    t_max: wp.array
    layout: Layout
    center: np.ndarray
    facts: RayFacts
    form: ResultForm
    keep: tuple[Any, ...] = ()
    in_place: bool = False

    @classmethod
    def of_batch(cls, batch: RayBatch, coherent: bool, scattered: bool) -> DeviceRays:
        """Rays that kernels of this package made, or sorted: read as the batch says."""
        center = np.array(batch.center, dtype=np.float64)
        strides = batch.origin_stride, batch.direction_stride, batch.t_min_stride, batch.t_max_stride
        layout = Layout(*strides, centered=not center.any())
        facts = RayFacts(batch.count, (batch.count,), batch.origin_stride == 0, coherent, scattered)
        arrays = batch.origins, batch.directions, batch.t_min, batch.t_max
        rays = cls(*arrays, layout, center, facts, ResultForm(facts.shape, True, np.float32))
        rays.batch = batch
        return rays

    @property
    def count(self) -> int:
        """N."""
        return self.facts.count

    @property
    def shape(self) -> tuple[int, ...]:
        """Leading shape of the results."""
        return self.form.shape

    @cached_property
    def batch(self) -> RayBatch:
        """The rays as kernels read them. A caller may modify it; it then replaces the arrays."""
        return self.new_batch()

    @property
    def own_layout(self) -> Layout | None:
        """The layout for which a query is prepared; None once there is a `batch`."""
        return None if "batch" in self.__dict__ else self.layout

    def new_batch(self) -> RayBatch:
        """The rays for kernels, in a batch of the caller's."""
        batch = empty_batch(self.layout, self.center)
        batch.count = self.count
        batch.origins, batch.directions = as_array(self.origins), as_array(self.directions)
        batch.t_min, batch.t_max = as_array(self.t_min), as_array(self.t_max)
        return batch

    def part(self, begin: int, count: int) -> DeviceRays:
        """Some of the rays, which lie in no `batch`: of a picture, whole rows. The arrays stay where they are."""
        given, strides = (self.origins, self.directions, self.t_min, self.t_max), self.layout[:4]
        arrays: list[Any] = [  # a prepared query asks for no more than addresses
            HostArray((values.ptr or 0) + stride * begin * BYTES[dtype], count if stride else 1, dtype, values)
            for values, stride, dtype in zip(given, strides, ARRAYS.values(), strict=True)
        ]
        origins, directions, t_min, t_max = arrays
        facts, form = self.facts._replace(count=count, shape=(count,)), self.form._replace(shape=(count,))
        layout, center = self.layout, self.center
        return DeviceRays(origins, directions, t_min, t_max, layout, center, facts, form, self.keep, self.in_place)

    def copied(self, count: int) -> DeviceRays:
        """A copy of the first rays, which lie in no `batch`, as a flat list."""
        part = self.part(0, min(count, self.count))
        for name, dtype in ARRAYS.items():
            values = np.array(getattr(part, name).numpy())
            setattr(part, name, HostArray(address_of(values), len(values), dtype, values))
        part.facts, part.keep = part.facts._replace(columns=0), ()
        return part

    def sample(self) -> RayBatch:
        """The rays as kernels read them, for a look at some of them: the arrays stay what they are."""
        if "batch" in self.__dict__:
            return self.batch
        batch = self.new_batch()
        batch.columns = self.facts.columns
        return batch

    def write_to(self, arguments: Any) -> None:
        """Writes the addresses and lengths of the arrays and the number of rays into the packed arguments of a batch with this
        layout, which `prepare_arguments` has seen."""
        for field, values in (
            (arguments.origins, self.origins),
            (arguments.directions, self.directions),
            (arguments.t_min, self.t_min),
            (arguments.t_max, self.t_max),
        ):  # as `point_at`: four calls take longer than they do
            field.data, field.shape[0] = values.ptr or 0, values.size
        arguments.count = self.facts.count


def to_device(rays: Rays, device: wp.Device, center: np.ndarray, few: int = 0) -> DeviceRays:
    """`lay_out`, then `examine`, unless there are only this many rays."""
    brought = lay_out(rays, device, center)
    return examine(brought, device) if brought.facts.count > few else brought


def examine(rays: DeviceRays, device: wp.Device) -> DeviceRays:
    """The rays, after a look whether they are coherent, and the pixels of an image."""
    count, shape, shared_origin, *_ = rays.facts
    axes = shape if 1 not in shape else tuple(length for length in shape if length > 1)
    may_be_image = len(axes) == 1 and shared_origin and rays.layout.directions == 1
    coherent, scattered, columns = detect_coherence(rays.origins, rays.directions, device, may_be_image)
    if len(axes) == 2:
        columns = columns_of_shape(axes)
    rays.facts = RayFacts(count, shape, shared_origin, coherent, scattered, columns)
    return rays


def lay_out(rays: Rays, device: wp.Device, center: np.ndarray) -> DeviceRays:
    """The arrays of rays on the device. Float64 origins become float32 relative to `center`.

    Raises:
        TypeError: an argument is not an array of real numbers.
        ValueError: wrong shapes, shapes that do not broadcast, a range that is negative or NaN, another device, or more
            than `MAX_RAYS` rays.
    """
    origins, directions, t_min, t_max = rays.origins, rays.directions, rays.t_min, rays.t_max
    if not are_usual(origins, directions, t_min, t_max):
        origins, directions = as_vectors(origins, "origins", device), as_vectors(directions, "directions", device)
        t_min, t_max = as_range(t_min, "t_min", device), as_range(t_max, "t_max", device)
    if device.is_cpu and isinstance(origins, np.ndarray):
        origins = detect_shared_origin(origins)
        if (arrays := _in_place(origins, directions, t_min, t_max, device, center)) is not None:
            return arrays
    shape = common_shape(origins, directions, t_min, t_max)
    check_number(shape)
    is_warp = isinstance(origins, wp.array) or isinstance(directions, wp.array)
    centered = _is_float64(origins)
    dtype = np.float64 if centered or _is_float64(directions) else np.float32
    given = origins, directions, t_min, t_max
    origins, origin_stride = _vectors(origins, shape, device, center)
    directions, direction_stride = _vectors(directions, shape, device, ZERO_CENTER)
    from_zero = device.is_cuda and type(t_min) is float and t_min == 0.0
    t_min, t_min_stride = _scalars(t_min, shape, device)
    t_max, t_max_stride = _scalars(t_max, shape, device)
    layout = Layout(origin_stride, direction_stride, t_min_stride, t_max_stride, centered, from_zero)
    facts, form = RayFacts(math.prod(shape), shape, origin_stride == 0), ResultForm(shape, is_warp, dtype)
    return DeviceRays(origins, directions, t_min, t_max, layout, center, facts, form, given)


def are_usual(origins: Any, directions: Any, t_min: Any, t_max: Any) -> bool:
    """Whether rays are as `as_vectors` and `as_range` would return them, in NumPy arrays with numbers as bounds: one look,
    where these are four."""
    if not (type(origins) is type(directions) is np.ndarray and type(t_min) is type(t_max) is float):
        return False
    in_place = origins.dtype in FLOATS and directions.dtype in FLOATS and origins.shape[-1:] == directions.shape[-1:] == (3,)
    return in_place and 0.0 <= t_min < math.inf and t_max >= 0.0


def relative_rays(
    origins: wp.array, directions: wp.array, t_max: float, shape: tuple[int, ...], device: wp.Device, center: np.ndarray
) -> DeviceRays:
    """The arrays of rays that kernels of this package made on the device, relative to the scene's centre; t_min is 0.

    Args:
        origins: (N,) or (1,) vec3.
        directions: (N,) vec3.
        t_max: of all rays.
        shape: leading shape, of N elements.
        device: where they are.
        center: (3,) float64, the scene's.
    """
    count = len(directions)
    each = int(count == 1)
    layout = Layout(each if len(origins) == 1 else 1, 1, each, each, True, device.is_cuda)
    low, high = (_scalars(value, shape, device)[0] for value in (0.0, t_max))
    facts, form = RayFacts(count, shape, not layout.origins), ResultForm(shape, True, np.float64)
    return DeviceRays(origins, directions, low, high, layout, center, facts, form, (origins, directions))


def _in_place(
    origins: np.ndarray, directions: Any, t_min: Any, t_max: Any, device: wp.Device, center: np.ndarray
) -> DeviceRays | None:
    """The arrays of rays that need no copy, quickly; None for other rays."""
    if type(directions) is not np.ndarray or type(t_min) is not float or type(t_max) is not float or device.is_capturing:
        return None
    found = arrange(origins, directions)
    if found is None:
        return None
    shape, count, layout = found
    points: wp.array | HostArray
    dtype: type
    given, centered = (origins, directions, t_min, t_max), layout.centered
    if centered:
        points, dtype = shared_point(origins, center), np.float64
    else:
        points, dtype = HostArray(address_of(origins), count if layout.origins else 1, wp.vec3f, origins), np.float32
    vectors = HostArray(address_of(directions), count if layout.directions else 1, wp.vec3f, directions)
    low, high = _number(t_min, device.alias), _number(t_max, device.alias)
    facts, form = RayFacts(count, shape, not layout.origins), ResultForm(shape, False, dtype)
    return DeviceRays(points, vectors, low, high, layout, center, facts, form, given, True)


def empty_batch(layout: Layout, center: np.ndarray) -> RayBatch:
    """A batch with this layout whose arrays are still to be set."""
    batch = RayBatch()
    batch.origin_stride, batch.direction_stride, batch.t_min_stride, batch.t_max_stride, centered, _ = layout
    batch.center = wp.vec3d() if centered else wp.vec3d(*(float(x) for x in center))
    return batch


def prepare_arguments(arguments: Any) -> None:
    """Writes what all contiguous flat arrays have in common into the packed arguments of a batch."""
    for name, dtype in ARRAYS.items():
        field = getattr(arguments, name)
        field.ndim, field.strides[0] = 1, wp.types.type_size_in_bytes(dtype)


def _is_float64(values: np.ndarray | wp.array) -> bool:
    return values.dtype == np.float64 if isinstance(values, np.ndarray) else values.dtype is wp.vec3d


def flatten_shared(values: np.ndarray, shape: tuple[int, ...], trailing: tuple[int, ...]) -> tuple[np.ndarray, int]:
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
    """Vectors as a flat (N,) or (1,) vec3 array, and its stride. Float64 vectors become relative to `center`."""
    stride = 1
    if isinstance(values, wp.array):
        stride = 0 if values.size == 1 else 1
        if stride and values.shape != shape:
            raise ValueError(f"Warp arrays broadcast only from one element: {values.shape} against {shape}")
        values = values if values.ndim == 1 else values.flatten()
    elif (device.is_cuda or math.prod(shape) >= MANY) and (repeats := repeats_of(values, shape)) is not None:
        return repeated(values, shape, repeats, device, center), 1
    else:
        values, stride = flatten_shared(values, shape, (3,))  # type: ignore[arg-type]
        if len(values) == 1 and values.dtype == np.float64 and device.is_cpu:  # a launch would take longer
            with np.errstate(over="ignore"):
                values = (values - center).astype(np.float32)
        dtype = wp.vec3f if values.dtype == np.float32 else wp.vec3d
        values = _upload(values, dtype, device)  # type: ignore[arg-type]
    if values.dtype is wp.vec3d:
        out = wp.empty(len(values), dtype=wp.vec3f, device=device)
        launch(center_float64_points, len(values), [values, wp.vec3d(*map(float, center)), out], device=device, chunk=4096)
        values = out
    return values, stride


def repeats_of(values: np.ndarray, shape: tuple[int, ...]) -> tuple[bool, ...] | None:
    """Along which axes of `shape` vectors are repeated; None if along none, or all, or there are more than four axes."""
    missing = len(shape) - values.ndim + 1
    axes = zip(shape[missing:], values.shape[:-1], values.strides[:-1], strict=True)
    found = (*(n > 1 for n in shape[:missing]), *(n > 1 and (own == 1 or stride == 0) for n, own, stride in axes))
    lengthens = [n > 1 for n in shape]
    return found if len(shape) <= 4 and any(found) and list(found) != lengthens and math.prod(shape) else None  # type: ignore[arg-type]


def repeated(
    values: np.ndarray, shape: tuple[int, ...], repeats: tuple[bool, ...], device: wp.Device, center: np.ndarray
) -> wp.array:
    """Vectors broadcast by a kernel: only those that differ are copied to the device and made relative to the centre.

    To write them all takes the host longer than tracing takes a GPU, and several GPUs share the host's memory.
    """
    missing = len(shape) - values.ndim + 1
    few = values[tuple(slice(0, 1) if again else slice(None) for again in repeats[missing:])]
    joined = [
        (math.prod(n for n, _ in axes), again) for again, axes in groupby(zip(shape, repeats, strict=True), lambda x: x[1])
    ]
    lengths, strides, step = [1] * 4, [0] * 4, 1
    for axis, (length, again) in zip((3, 2, 1, 0), reversed(joined), strict=False):
        lengths[axis] = length
        if not again:
            strides[axis] = step
            step *= length
    points, _ = _vectors(few, few.shape[:-1], device, center)
    out = empty(math.prod(shape), wp.vec3f, device)
    run = lengths[3] if device.is_cpu else 1
    inputs = [points, wp.vec4i(*lengths), wp.vec4i(*strides), run, out]
    launch(repeat_points, len(out) // run, inputs, device=device, chunk=max(1, MANY // run))
    return out


def _scalars(values: float | np.ndarray | wp.array, shape: tuple[int, ...], device: wp.Device) -> tuple[wp.array, int]:
    """Bounds of t as a flat (N,) or (1,) float array, and its stride."""
    if isinstance(values, float):
        return number_on(device, values), int(math.prod(shape) == 1)
    if isinstance(values, wp.array):
        if values.size != 1 and values.shape != shape:
            raise ValueError(f"Warp arrays broadcast only from one element: {values.shape} against {shape}")
        return values.flatten(), 0 if values.size == 1 else 1
    values, stride = flatten_shared(values, shape, ())
    return _upload(values, float, device), stride


def _upload(values: np.ndarray, dtype: type, device: wp.Device) -> wp.array:
    """An array on the device; on the CPU it shares the memory of `values`.

    Raises:
        RuntimeError: a graph is being captured on the device. It would record a copy from memory that is freed before it is
            launched.
    """
    if device.is_capturing:
        raise RuntimeError(
            "rays must be Warp arrays while a graph is captured; copy them to the device before the capture, "
            f"with wp.array(..., dtype=wp.vec3, device={str(device)!r})"
        )
    if not device.is_cpu:
        return wp.array(values, dtype=dtype, device=device)
    pointer, count = values.__array_interface__["data"][0], len(values)
    return keep_alive(wp.array(ptr=pointer, dtype=dtype, shape=count, capacity=values.nbytes, device=device), values)


def number_on(device: wp.Device, value: float) -> wp.array:
    """(1,) float32 with a value, which nobody writes to."""
    if device.is_capturing:  # what is kept for others may be dropped before the graph is
        return wp.full(1, value, dtype=float, device=device)
    return _number(value, device.alias)


@lru_cache(maxsize=64)
def _number(value: float, device: str) -> wp.array:
    """A cached array of one float32: most batches have the same bounds."""
    with np.errstate(over="ignore"), kept(wp.get_device(device)):
        return wp.array(np.array([value], dtype=np.float32), dtype=float, device=device)


def shared_origin(batch: RayBatch) -> tuple[float, float, float]:
    """The point at which all rays start, relative to the scene's centre, rounded as in
    `wrt.kernels.layout.ray_batch.load_ray`."""
    if len(batch.origins) == 0:
        return (0.0, 0.0, 0.0)
    origin = batch.origins[:1].numpy()[0].astype(np.float64) - np.array(batch.center, dtype=np.float64)
    return tuple(origin.astype(np.float32).tolist())
