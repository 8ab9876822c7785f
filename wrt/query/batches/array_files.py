"""Arrays that a worker can open itself: memory-mapped files, and objects that say so. Others travel with the tasks, row by row.

A `np.memmap` would be pickled with all its bytes. What travels instead is the file's path, the place of the array in it, and
the file's size and time of change, by which a worker notices that it opens another file.
"""

from __future__ import annotations

import mmap
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wrt.query.batches.block_rows import GeneratedRays

SMALL = 1 << 16
"""Bytes up to which an array is sent whole with the batch, even if all rows do not share it."""


@dataclass(frozen=True)
class MappedArray:
    """An array in a memory-mapped file, as workers open it.

    Attributes:
        path: of the file.
        size: bytes of the file.
        changed: time of the file's last change, in ns; None for a file that the batch itself writes.
        offset: of the first element in the file, in bytes.
        shape, strides, dtype: as in a NumPy array.
    """

    path: str
    size: int
    changed: int | None
    offset: int
    shape: tuple[int, ...]
    strides: tuple[int, ...]
    dtype: str

    def open(self) -> np.ndarray:
        """The array, memory-mapped here.

        Raises:
            FileNotFoundError: the file is not here.
            ValueError: the file has changed.
        """
        if not Path(self.path).is_file():
            raise FileNotFoundError(
                f"the worker does not see the file '{self.path}'; put it into a folder that the client and all workers share, "
                "or pass np.asarray(array), whose rows are sent"
            )
        found = os.stat(self.path)
        if found.st_size != self.size or self.changed not in (None, found.st_mtime_ns):
            raise ValueError(f"the file '{self.path}' has changed since the batch began; start again")
        whole = np.memmap(self.path, np.uint8, "r" if self.changed is not None else "r+")
        return np.ndarray(self.shape, self.dtype, whole, self.offset, self.strides)


def mapped_array(values: Any, is_written: bool = False) -> MappedArray | None:
    """How workers open an array of a memory-mapped file; None for other arrays."""
    base = values
    while isinstance(base, np.ndarray) and not isinstance(base, mmap.mmap):
        base = base.base
    if not isinstance(values, np.memmap) or not isinstance(base, mmap.mmap) or values.filename is None:
        return None
    if values.mode == "c" or not values.size or (is_written and not values.flags.writeable):
        return None
    path = os.path.abspath(values.filename)
    start = np.frombuffer(base, dtype=np.uint8).ctypes.data
    skipped = values.offset - values.offset % mmap.ALLOCATIONGRANULARITY
    place = values.ctypes.data - start + skipped
    found = os.stat(path)
    changed = None if is_written or values.mode != "r" else found.st_mtime_ns
    if not is_written and values.mode != "r":
        values.flush()
    return MappedArray(path, found.st_size, changed, place, values.shape, values.strides, values.dtype.str)


def opened_by_workers(values: Any, is_written: bool = False) -> Any:
    """What to send in place of an array that workers can open themselves; None if they cannot.

    Objects with an attribute `is_shared` say for themselves, and are pickled as they are. Of zarr, arrays in folders and in
    object stores can be opened, those in memory cannot.
    """
    if isinstance(values, GeneratedRays):
        return values
    if isinstance(values, np.memmap):
        return mapped_array(values, is_written)
    if hasattr(values, "is_shared"):
        return values if values.is_shared else None
    if type(values).__module__.startswith("zarr."):
        return values if type(values.store).__name__ in ("LocalStore", "FsspecStore", "ObjectStore") else None
    return None


def opened(values: Any) -> Any:
    """The array that was sent, on a worker."""
    return values.open() if isinstance(values, MappedArray) else values
