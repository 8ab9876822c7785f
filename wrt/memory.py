"""Memory for results and triangle records: on the CPU, large blocks lie in large pages and are used again.

The first touch of fresh memory costs a page fault every 4 KB, in the kernel and mostly one thread at a time: for a million
coherent rays, whose hits take 16 MB, a tenth of the time (measured: 1 of 12 ns a ray). So blocks of arrays that nobody holds
any longer, and no view of them, are kept for the next query, up to a bound.

Rays that meet triangles anywhere read a few lines of the cache here and there in the records, each of them in another page,
and a processor that does not have that page's address at hand looks it up first. A page of 2 MB has one address where 4 KB have
512, so blocks ask for such pages; Linux gives them to those who ask. (Measured on one thread of a Zen 4, meshes of 0.8 and 3.2
million triangles, whose records take 34 and 136 MB: random, ambient and shadow rays 0.93 and 0.88 of the time, camera rays the
same. The tree in such pages as well gained nothing: it is a sixth as large, and most rays see the same few nodes of it. The
work space of builds gained a tenth or more where the memory had been in use before, but in a virtual machine whose host had yet
to provide it the first build took up to twice as long; so builders have it as it comes.)
"""

from __future__ import annotations

import mmap
import threading
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import cycle
from typing import Any

import numpy as np
import warp as wp

from wrt.kernels.layout.ray_batch import RayBatch

LEAST_BYTES = 1 << 20
"""Smaller arrays are allocated as usual."""

GRAIN = 1 << 21
"""Blocks are multiples of this: a large page."""

KEPT_BYTES = 1 << 28
"""Most memory that is kept for later; the blocks unused for longest go first."""

STAGGER = 4096 + 1088
"""Bytes by which a block begins later in its first page than the one before, 16 in turn. Arrays that a kernel reads and writes
at the same index would otherwise share the same few lines of the cache (measured: camera rays took 1.26 times as long)."""

_begins = cycle(range(0, 16 * STAGGER, STAGGER))


def large_pages(size: int) -> np.ndarray:
    """(size,) fresh bytes in large pages, if the operating system has any to give; `size` is a multiple of `GRAIN`."""
    if not hasattr(mmap, "MADV_HUGEPAGE"):
        return np.empty(size, dtype=np.uint8)
    try:
        space = mmap.mmap(-1, size + GRAIN, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    except OSError as error:
        raise MemoryError(f"no {size} bytes are left") from error
    with suppress(OSError):  # a Linux that has only small ones
        space.madvise(mmap.MADV_HUGEPAGE)
    begin = next(_begins)
    return np.frombuffer(space, dtype=np.uint8)[begin : begin + size]


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
        return large_pages(size)

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


@contextmanager
def memory_for(what: str, size: int) -> Iterator[None]:
    """Makes every failure to get memory inside the `with` block a MemoryError that says what it was for.

    Args:
        what: it, as "for ..." goes on.
        size: bytes of what is there to work on.
    """
    try:
        yield
    except (MemoryError, RuntimeError) as error:
        if not isinstance(error, MemoryError) and " bytes on device " not in str(error):  # as Warp says it
            raise
        raise MemoryError(
            f"too little memory for {what}, which take {size / 1e6:,.1f} MB themselves ({error}); free some, or make several "
            "scenes of fewer triangles"
        ) from error


def release() -> None:
    """Frees the memory that is kept for later results and records."""
    _pool.release()
