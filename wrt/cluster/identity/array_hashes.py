"""Hashes of arrays, and of whatever has a shape and slices: whole, or of pieces that are spread evenly over a large one."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import warp as wp

from wrt.kernels.compilation.cores import available_cores

PIECE = 1 << 20
"""Bytes of an array that are hashed at a time."""

PIECES = 64
"""Number of pieces of a large array, and of rays that a function makes, that are hashed."""


def array_hash(values: Any) -> str:
    """SHA-256 of type, shape and all elements of an array, or of whatever has a shape and slices."""
    values = values.numpy() if isinstance(values, wp.array) else values
    shape = np.shape(values)
    if not shape:
        return hashed(["scalar", np.asarray(values).dtype.str, np.asarray(values).tobytes().hex()])
    return hashed(["array", type_of(values), list(shape), *map_threads(piece_hash, row_pieces(values, shape))])


def sampled_hash(values: Any) -> str:
    """As `array_hash`, of pieces that are spread evenly over a large array; of a file with its size and time of change."""
    values = values.numpy() if isinstance(values, wp.array) else values
    shape = np.shape(values)
    rows = max(1, PIECE * shape[0] // size_of(values))
    begins = np.unique(np.linspace(0, max(shape[0] - rows, 0), PIECES).astype(np.int64)).tolist()
    found = [values[begin : begin + rows] for begin in begins]
    file = []
    if isinstance(values, np.memmap) and values.filename is not None:
        status = os.stat(values.filename)
        file = [status.st_size, status.st_mtime_ns]
    return hashed(["samples", type_of(values), list(shape), file, *map_threads(piece_hash, found)])


def type_of(values: Any) -> str:
    """NumPy's name of the type of an array's elements."""
    return np.asarray(values[:0]).dtype.str


def size_of(values: Any) -> int:
    """Bytes of an array, or of whatever has a shape."""
    itemsize = getattr(getattr(values, "dtype", None), "itemsize", 8)
    if isinstance(values, wp.array):
        itemsize = wp.types.type_size_in_bytes(values.dtype)
    return math.prod(np.shape(values)) * itemsize


def row_pieces(values: Any, shape: tuple[int, ...]) -> Iterator[Any]:
    """The rows of an array in pieces of `PIECE` bytes or a row."""
    rows = max(1, PIECE * shape[0] // max(size_of(values), 1))
    return (values[begin : begin + rows] for begin in range(0, shape[0], rows))


def piece_hash(piece: Any) -> str:
    """SHA-256 of the bytes of an array."""
    return hashlib.sha256(np.ascontiguousarray(piece).reshape(-1).view(np.uint8)).hexdigest()  # type: ignore[arg-type]


def map_threads(function: Callable[[Any], str], pieces: Iterator[Any] | list[Any]) -> list[str]:
    """The hashes of pieces; hashlib lets other threads run meanwhile."""
    pieces = list(pieces)
    if len(pieces) < 4:
        return [function(piece) for piece in pieces]
    with ThreadPoolExecutor(min(available_cores(), len(pieces))) as executor:
        return list(executor.map(function, pieces))


def hashed(parts: list[Any]) -> str:
    """SHA-256 of plain values."""
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()
