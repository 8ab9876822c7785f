"""Memory of answers on CUDA, which is used again.

Warp's pool returns what is free to the driver at each synchronisation, and the next allocation maps it anew, which is a good
part of the time of a call (notebooks/records/2026-11-27-gpu-traversal.md). So blocks of answers that nobody holds any more wait
here for the next call.

A block is used again on the stream for which it was allocated, so that what ran there comes first. Arrays that another stream
reads must be held until that has been waited for, as with all of Warp's arrays.

This module refers to all memory, also while a block has it. What Python's collector finds in a cycle is finalised, all of it,
before anything of it may come back to life: if a block in a cycle were the only holder of its memory, Warp would free that, and
the block would then let it wait here for the next call.
"""

from __future__ import annotations

import os
import threading
from collections import defaultdict

import warp as wp

KEPT_BYTES = 1 << 28
"""Bytes that wait, at most: answers to four million rays are 64 MB."""

SMALLEST, STEP = 1 << 12, 1 << 20
"""Blocks have a power of two bytes from SMALLEST up to STEP, and beyond that a multiple of STEP."""

Key = tuple[str, int, int]
"""Alias of a device, handle of a stream, bytes."""

_lock = threading.RLock()  # the garbage collector may drop a block while the lock is held
_waiting: defaultdict[Key, list[wp.array]] = defaultdict(list)
_taken: dict[int, wp.array] = {}
"""Memory of blocks, by its address."""
_bytes = 0


class DeviceBlock:
    """A block of memory, for one holder; the memory waits for the next one when this object is gone.

    Attributes:
        ptr: its address.
    """

    __slots__ = ("_key", "ptr")

    def __init__(self, key: Key, ptr: int) -> None:
        self._key, self.ptr = key, ptr

    def __del__(self) -> None:
        if give_back is not None:  # nothing is left of this module when the interpreter exits
            give_back(self._key, self.ptr)


def take_block(size: int, device: wp.Device) -> DeviceBlock:
    """A block of at least `size` bytes with undefined contents, on a device that captures no graph."""
    rounded = -(-size // STEP) * STEP if size > STEP else max(SMALLEST, 1 << (size - 1).bit_length())
    key = device.alias, device.stream.cuda_stream if device.is_cuda else 0, rounded
    with _lock:
        memory = _waiting[key].pop() if _waiting.get(key) else None
        if memory is not None:
            _count(-rounded)
            _taken[memory.ptr] = memory
    if memory is None:
        memory = wp.empty(rounded, dtype=wp.uint8, device=device)
        _taken[memory.ptr] = memory
    return DeviceBlock(key, memory.ptr)


def give_back(key: Key, ptr: int) -> None:
    """Lets the memory of a block wait, unless enough does."""
    with _lock:
        memory = _taken.pop(ptr)
        if _bytes + key[-1] <= KEPT_BYTES:
            _count(key[-1])
            _waiting[key].append(memory)


def _count(size: int) -> None:
    global _bytes
    _bytes += size


def waiting_bytes() -> int:
    """Bytes that wait."""
    return _bytes


def release() -> None:
    """Frees what waits."""
    with _lock:
        _count(-_bytes)
        _waiting.clear()


def _renew_lock() -> None:
    """A lock that another thread held while the process was forked would never be released in the child."""
    global _lock
    _lock = threading.RLock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_renew_lock)
