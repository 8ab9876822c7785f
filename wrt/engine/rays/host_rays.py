"""The usual rays of a scene on the CPU: NumPy arrays that kernels read where they lie, and numbers as bounds.

A batch of rays is laid out once a call, and with many cores a call takes a millisecond or two. What follows from shapes and
strides alone is therefore remembered, and no array is made (`wrt.engine.host_arrays`).
"""

from __future__ import annotations

import ctypes
import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import warp as wp

from wrt.engine.host_arrays import HostArray
from wrt.engine.rays.rays import FLOAT32, FLOAT64, MAX_RAYS

Shape = tuple[int, ...]

Point = ctypes.c_float * 3


class Layout(NamedTuple):
    """How rays are stored in their arrays: everything that a launch must know besides the arrays themselves.

    Attributes:
        origins, directions, t_min, t_max: 1 if each ray has its own element, 0 if all share element 0.
        centered: whether the origins are already relative to the scene's centre.
        from_zero: on CUDA, whether t_min is known to be 0 for all rays.
    """

    origins: int
    directions: int
    t_min: int
    t_max: int
    centered: bool
    from_zero: bool = False


class Arrangement(NamedTuple):
    """How NumPy arrays of vectors serve as the rays of a batch.

    Attributes:
        shape: leading shape of the results.
        count: number of rays.
        layout: with numbers as bounds.
    """

    shape: Shape
    count: int  # type: ignore[assignment]
    layout: Layout


def arrange(origins: np.ndarray, directions: np.ndarray) -> Arrangement | None:
    """How origins and directions serve as rays as they lie in memory; None if they must be copied or converted first.

    Directions must be float32. Origins may be float64 if the rays share one.
    """
    is_float64 = origins.dtype == FLOAT64
    if directions.dtype != FLOAT32 or not (is_float64 or origins.dtype == FLOAT32):
        return None
    return _arrange(origins.shape, origins.strides, directions.shape, directions.strides, is_float64)


@lru_cache(maxsize=256)
def _arrange(
    origins: Shape, origin_strides: Shape, directions: Shape, direction_strides: Shape, is_float64: bool
) -> Arrangement | None:
    if origins[-1:] != (3,) or directions[-1:] != (3,):
        return None
    try:
        shape = np.broadcast_shapes(origins[:-1], directions[:-1])
    except ValueError:
        return None
    count, size = math.prod(shape), 8 if is_float64 else 4
    own = _stride(origins, origin_strides, size, shape, count), _stride(directions, direction_strides, 4, shape, count)
    if None in own or not 1 < count <= MAX_RAYS or (is_float64 and own[0]):
        return None
    return Arrangement(shape, count, Layout(*own, 0, 0, is_float64))


def _stride(values: Shape, strides: Shape, size: int, shape: Shape, count: int) -> int | None:
    """1 if vectors follow each other, one for each ray; 0 if all rays share the first; None otherwise."""
    if strides[-1] != size:
        return None
    if all(n == 1 or stride == 0 for n, stride in zip(values[:-1], strides[:-1], strict=True)):
        return 0
    step = 3 * size
    for n, stride in zip(reversed(values[:-1]), reversed(strides[:-1]), strict=True):
        if n != 1 and stride != step:
            return None
        step *= n
    return 1 if values[:-1] == shape else None


def shared_point(values: np.ndarray, center: np.ndarray) -> HostArray:
    """The first of the vectors of float64, relative to `center`."""
    x, y, z = values[(0,) * (values.ndim - 1)].tolist()
    a, b, c = center.tolist()
    point = Point(x - a, y - b, z - c)
    return HostArray(ctypes.addressof(point), 1, wp.vec3f, point)
