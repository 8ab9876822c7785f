"""Rays as callers pass them, and the checks of their values and shapes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, Union, overload

import numpy as np
import warp as wp

from wrt.array_types import ArrayLike, ArrayT, Numbers, NumpyLike, WarpLike
from wrt.kernels.validation import as_real_array, resolved, unreadable

MAX_RAYS = (1 << 31) - 1
"""Largest number of rays of one call: kernels number them with 32 bits."""

FLOAT32, FLOAT64 = np.dtype(np.float32), np.dtype(np.float64)

Array = Any
"""A NumPy array or anything that NumPy converts; a Warp array; or an object with `__dlpack__`."""


@dataclass(frozen=True)
class Rays(Generic[ArrayT]):
    """Rays origin + t direction.

    Attributes:
        origins: (..., 3) float32 or float64; the leading shapes of all four arrays broadcast against each other.
        directions: (..., 3) float32 or float64, of any length from 2^-126 up (`Scene.intersect`); t is in units of it.
        t_min, t_max: scalars or (...) arrays: hits count if t_min <= t <= t_max (closed interval), 0 <= t_min.
    """

    origins: Array
    directions: Array
    t_min: Array = 0.0
    t_max: Array = float("inf")

    if TYPE_CHECKING:  # the kind of the results

        @overload
        def __init__(
            self: Rays[np.ndarray], origins: NumpyLike, directions: NumpyLike, t_min: Numbers = 0.0, t_max: Numbers = ...
        ) -> None: ...
        @overload
        def __init__(
            self: Rays[wp.array], origins: WarpLike, directions: ArrayLike, t_min: Numbers = 0.0, t_max: Numbers = ...
        ) -> None: ...
        @overload
        def __init__(
            self: Rays[wp.array], origins: NumpyLike, directions: WarpLike, t_min: Numbers = 0.0, t_max: Numbers = ...
        ) -> None: ...
        def __init__(self, origins: Array, directions: Array, t_min: Array = 0.0, t_max: Array = ...) -> None: ...

    @property
    def shape(self) -> tuple[int, ...]:
        """The leading shape, which is also that of the results."""
        return common_shape(self.origins, self.directions, self.t_min, self.t_max)

    def __len__(self) -> int:
        """Number of rays."""
        return math.prod(self.shape)


GivenRays = Union[Rays, "tuple[Any, Any, Any, Any]"]
"""Rays as a caller passed them: in one object, or the arguments of `as_rays`."""


class ResultForm(NamedTuple):
    """The form of results for some rays.

    Attributes:
        shape: leading shape.
        is_warp: whether they are Warp arrays, not NumPy's.
        dtype: np.float32 or np.float64, of positions and normals.
    """

    shape: tuple[int, ...]
    is_warp: bool
    dtype: type


def as_rays(origins: Any, directions: Any, t_min: Any, t_max: Any) -> Rays:
    """The rays that a caller passed.

    Raises:
        TypeError: directions are missing, or given twice.
    """
    if isinstance(origins, Rays):
        if directions is not None:
            raise TypeError("pass either a wrt.Rays, or origins and directions, not both")
        return origins
    if directions is None:
        raise TypeError("directions is missing; pass origins and directions, or a wrt.Rays")
    rays = object.__new__(Rays)  # the __init__ of a frozen dataclass is three times slower, which matters for small batches
    values = rays.__dict__
    values["origins"], values["directions"], values["t_min"], values["t_max"] = origins, directions, t_min, t_max
    return rays


def one_object(rays: GivenRays) -> Rays:
    """The rays that a caller passed; errors as those of `as_rays`."""
    return as_rays(*rays) if isinstance(rays, tuple) else rays


def check_number(shape: tuple[int, ...]) -> None:
    """Refuses more rays than a call takes.

    Raises:
        ValueError: there are more than `MAX_RAYS`.
    """
    if math.prod(shape) > MAX_RAYS:
        raise ValueError(
            f"these are {math.prod(shape):,} rays, of shape {shape}, and one call takes {MAX_RAYS:,}; pass fewer at a time, or "
            "call scene.intersect_blocks, occluded_blocks or count_blocks"
        )


def leading_shape(values: Array) -> tuple[int, ...]:
    if isinstance(values, np.ndarray):
        return values.shape[:-1]
    if isinstance(values, wp.array):
        return values.shape if values.dtype in (wp.vec3f, wp.vec3d) else values.shape[:-1]
    return np.shape(values)[:-1]


def as_vectors(values: Array, name: str, device: wp.Device) -> np.ndarray | wp.array:
    """`values` as a Warp array of vectors or a NumPy array (..., 3) of float32 or float64."""
    if type(values) is np.ndarray and values.dtype in (FLOAT32, FLOAT64) and values.shape[-1:] == (3,):
        return values
    if not isinstance(values, (np.ndarray, wp.array)) and hasattr(values, "__dlpack__"):
        values = _from_dlpack(values, name)
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


def _from_dlpack(values: Any, name: str) -> wp.array:
    """A Warp array in the memory of another library's array.

    Raises:
        TypeError: the library does not hand it out, such as a tensor that records gradients or is sparse; or a type that Warp
            does not have.
    """
    try:
        return wp.from_dlpack(resolved(values))  # type: ignore[return-value]
    except MemoryError:
        raise
    except Exception as error:  # each library has its own
        raise TypeError(unreadable(name, values, error)) from error


def _as_real(values: Array, name: str) -> np.ndarray:
    """A NumPy array of float32 or float64; narrower floats become float32, integers and wider floats float64."""
    values = as_real_array(name, values)
    if values.dtype in (np.float32, np.float64):
        return values
    return values.astype(np.float32 if values.dtype == np.float16 else np.float64)


def as_range(values: Array, name: str, device: wp.Device) -> float | np.ndarray | wp.array:
    """A bound of t: a number as it is, else float32. Values in Warp arrays are not checked; a bad one makes its ray miss."""
    if type(values) is float and values >= 0.0 and (values < math.inf or name == "t_max"):
        return values
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
        raise ValueError(f"{name} is an int beyond the range of float64; pass float('inf') for no bound") from None
    low = values if is_number else values.min(initial=np.inf)
    if not low >= 0.0:
        raise ValueError(f"{name} must not be negative or NaN, but its smallest value is {low}; pass distances from 0 up")
    if name == "t_min" and (math.isinf(values) if is_number else np.isinf(values).any()):
        raise ValueError("t_min is infinite, and no hit lies at infinity; leave it at 0 to count all hits")
    if is_number:
        return values
    with np.errstate(over="ignore"):
        return np.asarray(values, dtype=np.float32)


def common_shape(origins: Array, directions: Array, t_min: Array, t_max: Array) -> tuple[int, ...]:
    shape, other = leading_shape(origins), leading_shape(directions)
    if type(t_min) is float and type(t_max) is float and shape in (other, ()):
        return other
    shapes = [shape, other, np.shape(t_min), np.shape(t_max)]
    try:
        return np.broadcast_shapes(*shapes)
    except ValueError:
        names = ("origins", "directions", "t_min", "t_max")
        listed = ", ".join(f"{name} {shape}" for name, shape in zip(names, shapes, strict=True))
        raise ValueError(f"the leading shapes do not broadcast: {listed}") from None
