"""Flat arrays in host memory, as kernels read and write them.

When a query of a million rays ends, the code and data of Python have left the caches, and making the Warp arrays of the next
one takes a good part of its time on many cores. A `HostArray` has what a launch needs, an address and a length, and becomes a
Warp array when one is asked for (notebooks/records/2026-11-23-large-calls.md).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

SCALARS = {wp.float32: "<f4", wp.int32: "<i4", wp.bool: "|b1"}
"""NumPy's names of element types that are one number."""

VECTORS = {wp.vec2: 2, wp.vec3: 3}
"""Numbers of an element of other types, float32 each."""


class HostArray:
    """A flat array in host memory.

    Attributes:
        ptr: address of the first element.
        size: number of elements.
        dtype: a key of `SCALARS` or `VECTORS`.
        owner: keeps the memory alive.
    """

    __slots__ = ("_array", "dtype", "owner", "ptr", "size")

    def __init__(self, ptr: int, size: int, dtype: type, owner: Any) -> None:
        self.ptr, self.size, self.dtype, self.owner = ptr, size, dtype, owner
        self._array: wp.array | None = None

    def __len__(self) -> int:
        return self.size

    @property
    def __array_interface__(self) -> dict[str, Any]:
        """What NumPy makes a view of; the view keeps this object alive, and so the memory."""
        components = VECTORS.get(self.dtype)
        shape = (self.size,) if components is None else (self.size, components)
        return {"data": (self.ptr, False), "shape": shape, "typestr": SCALARS.get(self.dtype, "<f4"), "version": 3}

    def numpy(self) -> np.ndarray:
        """The elements as a NumPy array that shares the memory."""
        return np.asarray(self)

    @property
    def array(self) -> wp.array:
        """The elements as a Warp array that shares the memory."""
        if self._array is None:
            self._array = wp.array(ptr=self.ptr, dtype=self.dtype, shape=self.size, device="cpu")
            self._array.used = self.owner
        return self._array


def as_array(values: wp.array | HostArray) -> wp.array:
    """The Warp array of an array of either kind."""
    return values.array if type(values) is HostArray else values


def write_flat(field: Any, address: int, count: int, dtype: type) -> None:
    """Makes the packed form of an array, whatever it was, that of a contiguous flat one."""
    field.data, field.ndim, field.shape[0], field.strides[0] = address, 1, count, wp.types.type_size_in_bytes(dtype)


def point_at(field: Any, values: wp.array | HostArray) -> None:
    """Makes the packed form of a contiguous flat array refer to another array of the same element type."""
    field.data = values.ptr or 0
    field.shape[0] = len(values)
