"""Integers that a query may pass with its rays: masks and environments."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import warp as wp

from wrt.engine.rays.device_rays import flatten_shared
from wrt.kernels.validation import host_array

if TYPE_CHECKING:
    from wrt.engine.rays.device_rays import DeviceRays


class Integers(NamedTuple):
    """Integers of rays, a value for each or one for all, that a query may pass.

    Attributes:
        name: of the argument, and of the array in a `RayBatch`.
        dtype: of the array.
        low, high: smallest and largest value.
        hint: the end of the message if they are no integers.
    """

    name: str
    dtype: type
    low: int
    high: int
    hint: str = ""

    def set(self, rays: DeviceRays, values: Any, device: wp.Device) -> None:
        """Gives rays an int for all, or integers that broadcast to their shape; their batch then replaces their arrays.

        Raises:
            TypeError: other values than integers.
            ValueError: values out of range, a shape that does not broadcast, or an array on another device.
        """
        name, shape = self.name, rays.shape
        if isinstance(values, wp.array):
            if values.dtype is not self.dtype or values.device != device:
                wanted = f"{self.dtype.__name__} on {device}"
                raise ValueError(f"{name} must be a Warp array of {wanted}, not of {values.dtype.__name__} on {values.device}")
            stride = 0 if values.size == 1 else 1
            if stride and values.shape != shape:
                text = f"{name} has the shape {values.shape}, the rays {shape}; Warp arrays broadcast only from one element"
                raise ValueError(text)
            each = values.flatten()
        else:
            number = as_integers(name, values, self.low, self.high, self.hint).astype(wp.dtype_to_numpy(self.dtype))
            flat, stride = flatten_shared(broadcast(name, number, shape), shape, ())
            each = self.on_device(flat, device)
        setattr(rays.batch, name, each)
        setattr(rays.batch, f"{name}_stride", stride)

    def on_device(self, flat: np.ndarray, device: wp.Device) -> wp.array:
        """Values of the host; one of them can be part of a graph.

        Raises:
            RuntimeError: several, and a graph is being captured, which would copy from memory that is freed before its launch.
        """
        if not device.is_capturing:
            return wp.array(flat, dtype=self.dtype, device=device)
        if len(flat) != 1:
            raise RuntimeError(
                f"{self.name} must be one number or a Warp array of {self.dtype.__name__} on {device} while a graph is "
                "captured; copy it there before the capture"
            )
        return wp.full(1, flat[0].item(), dtype=self.dtype, device=device)


MASKS = Integers("mask", wp.uint32, 0, (1 << 32) - 1, "; combine bits as 1 << 0 | 1 << 3")
ENVIRONMENTS = Integers("environment", wp.int32, -1, (1 << 31) - 1)


def as_integers(name: str, given: Any, low: int, high: int, hint: str = "") -> np.ndarray:
    """Integers from low to high, of any type and shape.

    Raises:
        TypeError: other values; the message ends with the hint.
        ValueError: values out of range.
    """
    values = given.numpy() if isinstance(given, wp.array) else host_array(name, given)
    if values.dtype.kind not in "iu":
        raise TypeError(f"{name} must hold integers, not {values.dtype}{hint}")
    if values.size and (values.min() < low or values.max() > high):
        maximum = f"2**{high.bit_length()} - 1" if high >= (1 << 31) - 1 else str(high)
        raise ValueError(f"{name} must be from {low} to {maximum}, but ranges from {values.min()} to {values.max()}")
    return values


def broadcast(name: str, values: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Values of an argument in the shape of the rays.

    Raises:
        ValueError: their shape does not broadcast.
    """
    try:
        return np.broadcast_to(values, shape)
    except ValueError:
        text = f"{name} has the shape {values.shape}, which does not broadcast to that of the rays, {shape}"
        raise ValueError(text) from None
