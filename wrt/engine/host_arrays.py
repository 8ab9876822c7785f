"""Flat arrays in host memory, as kernels read and write them.

When a query of a million rays ends, the code and data of Python have left the caches, and making the Warp arrays of the next
one takes a good part of its time on many cores. A `HostArray` has what a launch needs, an address and a length, and becomes a
Warp array when one is asked for (notebooks/records/2026-11-23-large-calls.md).
"""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
import warp as wp

ELEMENTS: dict[Any, tuple[str, tuple[int, ...]]] = {
    wp.float32: ("<f4", ()),
    wp.float64: ("<f8", ()),
    wp.int32: ("<i4", ()),
    wp.int8: ("|i1", ()),
    wp.uint8: ("|u1", ()),
    wp.bool: ("|b1", ()),
    wp.vec2: ("<f4", (2,)),
    wp.vec3: ("<f4", (3,)),
    wp.vec3d: ("<f8", (3,)),
}
"""Element types of kernels: NumPy's name of the type of their numbers, and the shape of an element."""


class HostArray:
    """A flat array in host memory.

    Attributes:
        ptr: address of the first element.
        size: number of elements.
        dtype: a key of `ELEMENTS`.
        owner: keeps the memory alive.
        view: the elements as a NumPy array, where there is one already.
    """

    __slots__ = ("_array", "dtype", "owner", "ptr", "size", "view")

    def __init__(self, ptr: int, size: int, dtype: type, owner: Any, view: np.ndarray | None = None) -> None:
        self.ptr, self.size, self.dtype, self.owner, self.view = ptr, size, dtype, owner, view
        self._array: wp.array | None = None

    def __len__(self) -> int:
        return self.size

    @property
    def __array_interface__(self) -> dict[str, Any]:
        """What NumPy makes a view of; the view keeps this object alive, and so the memory."""
        number, element = ELEMENTS[self.dtype]
        return {"data": (self.ptr, False), "shape": (self.size, *element), "typestr": number, "version": 3}

    def numpy(self) -> np.ndarray:
        """The elements as a NumPy array that shares the memory."""
        return np.asarray(self) if self.view is None else self.view

    @property
    def array(self) -> wp.array:
        """The elements as a Warp array that shares the memory."""
        if self._array is None:
            self._array = wp.array(ptr=self.ptr, dtype=self.dtype, shape=self.size, device="cpu")
            self._array.used = self.owner  # type: ignore[attr-defined]
        return self._array


def as_array(values: wp.array | HostArray) -> wp.array:
    """The Warp array of an array of either kind."""
    return values.array if type(values) is HostArray else values  # type: ignore[return-value]


HEAD = object.__basicsize__
"""Bytes of an object of Python's before its own fields."""

_word_at = ctypes.c_size_t.from_address


def _field_address(values: np.ndarray) -> int:
    """The first field of NumPy's array object, `char *data` of `PyArrayObject`. Compiled extensions read it there, too, so
    NumPy cannot move it."""
    return _word_at(id(values) + HEAD).value


def _interface_address(values: np.ndarray) -> int:
    return values.__array_interface__["data"][0]


_probe = np.zeros(8)[3:]

address_of = _field_address if _field_address(_probe) == _interface_address(_probe) else _interface_address
"""Address of the first element of a NumPy array. `__array_interface__` makes fifteen objects to say it, and takes ten times as
long; `ctypes.data` takes longer still."""


def write_flat(field: Any, address: int, count: int, dtype: type) -> None:
    """Makes the packed form of an array, whatever it was, that of a contiguous flat one."""
    field.data, field.ndim, field.shape[0], field.strides[0] = address, 1, count, wp.types.type_size_in_bytes(dtype)


def point_at(field: Any, values: wp.array | HostArray) -> None:
    """Makes the packed form of a contiguous flat array refer to another array of the same element type."""
    field.data = values.ptr or 0
    field.shape[0] = values.size
