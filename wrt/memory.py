"""Memory for results: on the CPU, large blocks are used again.

The first touch of fresh memory costs a page fault every 4 KB, in the kernel and mostly one thread at a time: for a million
coherent rays, whose hits take 16 MB, a tenth of the time (measured: 1 of 12 ns a ray). So blocks of arrays that nobody holds
any longer, and no view of them, are kept for the next query, up to a bound.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from typing import Any

import numpy as np
import warp as wp

from wrt.kernels.rays import RayBatch

LEAST_BYTES = 1 << 20
"""Smaller arrays are allocated as usual."""

GRAIN = 1 << 21
"""Blocks are multiples of this: a large page."""

KEPT_BYTES = 1 << 28
"""Most memory that is kept for later; the blocks unused for longest go first."""


class BlockPool:
    """Blocks of host memory that wait to be used again; safe to use from several threads."""

    def __init__(self, kept_bytes: int = KEPT_BYTES) -> None:
        self.kept_bytes = kept_bytes
        # reentrant: the collector may free an array, and so give a block back, while a block is taken
        self._lock = threading.RLock()
        self._waiting: OrderedDict[int, np.ndarray] = OrderedDict()

    @property
    def waiting_bytes(self) -> int:
        """Memory of the blocks that wait."""
        with self._lock:
            return sum(block.nbytes for block in self._waiting.values())

    def take(self, size: int) -> np.ndarray:
        """A block of at least `size` bytes, and not more than twice as many if it was used before."""
        size = -(-size // GRAIN) * GRAIN
        with self._lock:
            fitting = [(block.nbytes, key) for key, block in self._waiting.items() if size <= block.nbytes <= 2 * size]
            if fitting:
                return self._waiting.pop(min(fitting)[1])
        return np.empty(size, dtype=np.uint8)

    def give_back(self, block: np.ndarray) -> None:
        """Keeps a block that nobody uses any longer."""
        with self._lock:
            self._waiting[id(block)] = block
            while self._waiting and self.waiting_bytes > self.kept_bytes:
                self._waiting.popitem(last=False)

    def release(self) -> None:
        """Frees all blocks that wait."""
        with self._lock:
            self._waiting.clear()


_pool = BlockPool()


def empty(count: int, dtype: type, device: wp.Device) -> wp.array:
    """A flat array whose contents are undefined; its memory may have been used before."""
    size = count * wp.types.type_size_in_bytes(dtype)
    if not device.is_cpu or size < LEAST_BYTES:
        return wp.empty(count, dtype=dtype, device=device)
    block = _pool.take(size)

    def give_back(pointer: int, size: int) -> None:
        _pool.give_back(block)

    pointer = block.__array_interface__["data"][0]  # a tenth of the code of `ctypes.data`
    return wp.array(ptr=pointer, dtype=dtype, shape=count, capacity=size, device=device, deleter=give_back)


def keep_alive(array: wp.array, used: Any) -> wp.array:
    """An array that lies in the memory of others, or holds addresses of theirs, with what owns these: it may outlive them."""
    array.used = used
    return array


def new_rays(count: int, device: wp.Device) -> RayBatch:
    """Memory for rays relative to the scene's centre, each with a range of its own."""
    rays = RayBatch()
    rays.count = count
    rays.origin_stride = rays.direction_stride = rays.t_min_stride = rays.t_max_stride = 1
    rays.origins, rays.directions = empty(count, wp.vec3, device), empty(count, wp.vec3, device)
    rays.t_min, rays.t_max = empty(count, wp.float32, device), empty(count, wp.float32, device)
    return rays


def release() -> None:
    """Frees the memory that is kept for later results."""
    _pool.release()
