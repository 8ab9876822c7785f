"""Memory for results and triangle records: on the CPU, large blocks use large pages and are reused.

The first access to fresh memory costs a page fault every 4 KB. The operating system handles page faults mostly one thread
at a time, which takes a tenth of the time of a million coherent rays. So blocks whose arrays and views are gone are kept
for later queries, up to a bound.

Rays that hit triangles in random order read a few cache lines here and there in the records, each in another page, and the
processor looks up the address of a page that is not in its translation buffer. A page of 2 MB has one address where small
pages have 512, so blocks request large pages, which Linux provides on request. Trees and the work space of builders do not
gain from them (notebooks/records/2026-11-22-memory.md).
"""

from __future__ import annotations

import mmap
import os
import threading
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from itertools import cycle
from typing import Any

import numpy as np
import warp as wp

from wrt.engine import device_memory
from wrt.engine.host_arrays import ELEMENTS, HostArray, address_of, write_flat
from wrt.kernels.layout.ray_batch import RayBatch
from wrt.kernels.runtime import workspace

MIN_BYTES = 1 << 20
"""Smaller arrays are allocated by Warp."""

GRAIN = 1 << 21
"""Blocks are multiples of this size, a large page."""

KEPT_BYTES = 1 << 28
"""Largest number of bytes kept for reuse; the blocks unused for longest are freed first."""

OFFERED_SHARE = 8
"""One part in this many of the machine's memory is kept in addition, but offered to the operating system, which takes it when
memory becomes scarce. Results of more than `KEPT_BYTES` would otherwise be fresh memory in every query
(notebooks/records/2026-11-22-large-results.md).
"""

STAGGER = 4096 + 1088
"""Bytes by which the start of a block in its first page is shifted against the previous one, 16 in turn. Without the shift,
arrays that a kernel accesses at the same index share the same few cache lines (notebooks/records/2026-11-22-memory.md).
"""

ALIGNED = 256
"""Bytes at whose multiples arrays of one allocation begin, as CUDA's own allocations do."""

ELEMENT_BYTES: dict[Any, int] = {dtype: wp.types.type_size_in_bytes(dtype) for dtype in ELEMENTS}

_begins = cycle(range(0, 16 * STAGGER, STAGGER))


def large_pages(size: int) -> np.ndarray:
    """(size,) fresh bytes in large pages, if the operating system provides them; `size` is a multiple of `GRAIN`."""
    if not hasattr(mmap, "MADV_HUGEPAGE"):
        return np.empty(size, dtype=np.uint8)
    try:
        space = mmap.mmap(-1, size + GRAIN, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    except OSError as error:
        raise MemoryError(f"cannot allocate {size} bytes") from error
    with suppress(OSError):  # a Linux without large pages
        space.madvise(mmap.MADV_HUGEPAGE)
    begin = next(_begins)
    return np.frombuffer(space, dtype=np.uint8)[begin : begin + size]


def offer(block: np.ndarray) -> bool:
    """Allows the operating system to take the pages of a block of `large_pages` until they are written again.

    Returns:
        Whether it could be offered.
    """
    space = getattr(block.base, "base", None)
    space = getattr(space, "obj", space)  # with some versions of NumPy, a memoryview is in between
    if not isinstance(space, mmap.mmap) or not hasattr(mmap, "MADV_FREE"):
        return False
    try:
        space.madvise(mmap.MADV_FREE)
    except OSError:  # a Linux before 4.5
        return False
    return True


class BlockPool:
    """A pool of free blocks of host memory; safe to use from several threads.

    Args:
        kept_bytes: largest number of bytes of free blocks.
        offered_bytes: largest number of bytes beyond that, of blocks that are offered to the operating system (`offer`).

    Attributes:
        free_bytes: bytes of all free blocks.
    """

    def __init__(self, kept_bytes: int = KEPT_BYTES, offered_bytes: int = 0) -> None:
        self.kept_bytes, self.offered_bytes = kept_bytes, offered_bytes
        # reentrant: the garbage collector may free an array, which returns a block, while a block is taken
        self._lock = threading.RLock()
        self._free: OrderedDict[int, np.ndarray] = OrderedDict()
        self.free_bytes = 0

    def take(self, size: int) -> np.ndarray:
        """A block of at least `size` bytes; a reused one has at most twice as many."""
        size = -(-size // GRAIN) * GRAIN
        with self._lock:
            fitting = [(block.nbytes, key) for key, block in self._free.items() if size <= block.nbytes <= 2 * size]
            if fitting:
                nbytes, key = min(fitting)
                self.free_bytes -= nbytes
                return self._free.pop(key)
        return large_pages(size)

    def give_back(self, block: np.ndarray) -> None:
        """Returns an unused block to the pool."""
        with self._lock:
            limit = self.kept_bytes
            if self.offered_bytes and self.free_bytes + block.nbytes > limit and offer(block):
                limit += self.offered_bytes
            self._free[id(block)] = block
            self.free_bytes += block.nbytes
            while self._free and self.free_bytes > limit:
                self.free_bytes -= self._free.popitem(last=False)[1].nbytes

    def release(self) -> None:
        """Frees all free blocks."""
        with self._lock:
            self._free.clear()
            self.free_bytes = 0


def machine_bytes() -> int:
    """Bytes of the machine's memory; 0 if the system does not say."""
    try:
        return max(0, os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, ValueError, OSError):
        return 0


_pool = BlockPool(offered_bytes=machine_bytes() // OFFERED_SHARE)


class Lease:
    """A block of the pool, which returns there when nothing refers to this object any more."""

    __slots__ = ("block",)

    def __init__(self, size: int) -> None:
        self.block = _pool.take(size)

    def __del__(self) -> None:
        if hasattr(self, "block"):  # taking it may have failed
            _pool.give_back(self.block)


def empty_host(count: int, *dtypes: type) -> list[HostArray]:
    """Flat arrays of `count` elements with undefined contents; their memory may be reused."""
    made = []
    for dtype in dtypes:
        size = count * ELEMENT_BYTES[dtype]
        if size < MIN_BYTES:
            number, element = ELEMENTS[dtype]
            values = np.empty((count, *element), number)
            made.append(HostArray(address_of(values), count, dtype, values, values))
        else:
            lease = Lease(size)
            made.append(HostArray(address_of(lease.block), count, dtype, lease))
    return made


def empty(count: int, dtype: type, device: wp.Device) -> wp.array:
    """A flat array with undefined contents; its memory may be reused."""
    size = count * wp.types.type_size_in_bytes(dtype)
    if size < MIN_BYTES or (device.is_cuda and device.is_capturing):
        return wp.empty(count, dtype=dtype, device=device)
    if device.is_cuda:
        waiting = device_memory.take_block(size, device)
        return keep_alive(wp.array(ptr=waiting.ptr, dtype=dtype, shape=count, capacity=size, device=device), waiting)
    lease = Lease(size)
    pointer = lease.block.__array_interface__["data"][0]
    return keep_alive(wp.array(ptr=pointer, dtype=dtype, shape=count, capacity=size, device=device), lease)


class ArraysOfBlock:
    """Flat arrays of one length, cut from one allocation, each at a multiple of `ALIGNED` bytes; undefined at first.

    An array is made when it is asked for, by its name: a kernel only needs addresses. On the CPU it is a `HostArray`, unless a
    graph is being captured, which is made of Warp's arrays.

    Args:
        kinds: type of each array.
        count: their length.
        device: where they are.
    """

    def __init__(self, kinds: Mapping[str, type], count: int, device: wp.Device) -> None:
        self._kinds, self._count, self._begins, size = kinds, count, {}, 0
        for name, dtype in kinds.items():
            self._begins[name], size = size, size + -(-count * ELEMENT_BYTES[dtype] // ALIGNED) * ALIGNED
        self._on_host = device.is_cpu and not device.is_capturing
        self._device = device
        self._block: wp.array | HostArray
        self._block = empty_host(size, wp.uint8)[0] if self._on_host else empty(size, wp.uint8, device)

    def __getitem__(self, name: str) -> wp.array | HostArray:
        """The array of a name."""
        begin, dtype = (self._block.ptr or 0) + self._begins[name], self._kinds[name]
        if self._on_host:
            return HostArray(begin, self._count, dtype, self._block)
        return keep_alive(wp.array(ptr=begin, dtype=dtype, shape=self._count, device=self._device), self._block)

    def write_to(self, struct: Any) -> None:
        """Writes all addresses into the packed form of a struct that has these arrays, and keeps this object alive with it."""
        if self._device.is_capturing:
            for name in self._kinds:
                setattr(struct, name, self[name])
            return
        packed, first = struct.__ctype__(), self._block.ptr or 0
        for name, dtype in self._kinds.items():
            write_flat(getattr(packed, name), first + self._begins[name], self._count, dtype)
        struct.__dict__["owner"] = self


def outputs_of(struct: Any, kinds: Mapping[str, type], count: int, device: wp.Device) -> ArraysOfBlock:
    """New flat arrays of `count` elements, with undefined contents, which are written into a struct of the kernels.

    They are cut from one allocation: a device waits for Python once and not for each, and on the CPU it is large enough to be
    reused.

    Args:
        struct: has fields of these names.
        kinds: type of each.
        count: of elements.
        device: of the arrays.
    """
    arrays = ArraysOfBlock(kinds, count, device)
    arrays.write_to(struct)
    return arrays


def keep_alive(array: wp.array, used: Any) -> wp.array:
    """Makes an array keep the owner of its memory, or of the addresses that it holds, alive."""
    array.used = used  # type: ignore[attr-defined]
    return array


def new_rays(count: int, device: wp.Device) -> RayBatch:
    """Allocates rays relative to the scene's centre, each with its own range."""
    rays = RayBatch()
    rays.count = count
    rays.origin_stride = rays.direction_stride = rays.t_min_stride = rays.t_max_stride = 1
    rays.origins, rays.directions = empty(count, wp.vec3, device), empty(count, wp.vec3, device)
    rays.t_min, rays.t_max = empty(count, wp.float32, device), empty(count, wp.float32, device)
    return rays


@contextmanager
def memory_for(what: str, size: int) -> Iterator[None]:
    """Turns every allocation failure inside the `with` block into a MemoryError that says what the memory was for.

    Args:
        what: the purpose, as the continuation of "too little memory for".
        size: bytes of the input.
    """
    try:
        yield
    except (MemoryError, RuntimeError) as error:
        if not isinstance(error, MemoryError) and " bytes on device " not in str(error):  # Warp's message
            raise
        raise MemoryError(
            f"too little memory for {what}, which take {size / 1e6:,.1f} MB themselves ({error}); free some, or make several "
            "scenes with fewer triangles"
        ) from error


def release() -> None:
    """Frees the memory that is kept for later results, records and builds."""
    _pool.release()
    workspace.release()
    device_memory.release()
