"""Warp arrays on the CPU against guard pages: whoever writes or reads past one is ended by the operating system.

Each array gets pages of its own between two that cannot be accessed. Every other array ends where its pages end, so that the
first byte behind it is out of bounds; the others begin where their pages begin, for indices below zero. What is left of the
pages holds a pattern, which is checked when the array is freed, and so does the array at first: whoever uses what nobody wrote
gets large negative indices. (Electric Fence, by B. Perens, 1987, is the model.)
"""

from __future__ import annotations

import ctypes
import mmap
import os

import warp as wp

PAGE = mmap.PAGESIZE
PATTERN = 0xA5
SLOTS = 64
"""Slots of a size that are mapped at a time."""

_LIBC = ctypes.CDLL(None, use_errno=True)
_LIBC.mmap.restype = ctypes.c_void_p
_LIBC.mmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int, ctypes.c_int, ctypes.c_int, ctypes.c_long]
_LIBC.mprotect.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
PROT_NONE, PROT_READ_WRITE, MAP_PRIVATE_ANONYMOUS = 0, 3, 0x22


class GuardedAllocator:
    """An allocator as Warp's devices have one, for all arrays on the CPU from `install` on."""

    deallocate_requires_context_guard = False

    def __init__(self, usual: object) -> None:
        self.memory_kind = usual.memory_kind
        self._free: dict[int, list[int]] = {}
        self._slots: dict[int, tuple[int, int]] = {}
        """Of each array that is there: where its pages begin, and how many they are."""
        self._at_end = False

    @classmethod
    def install(cls) -> None:
        """Guards every array that is made on the CPU from now on."""
        device = wp.get_device("cpu")
        device.default_allocator = cls(device.default_allocator)

    def allocate(self, size: int) -> int:
        """The address of so many bytes."""
        pages = 1 << max(0, -(-size // PAGE) - 1).bit_length()
        free = self._free.setdefault(pages, [])
        if not free:
            free.extend(self._map(pages))
        begin = free.pop()
        ctypes.memset(begin, PATTERN, pages * PAGE)
        self._at_end = not self._at_end
        pointer = begin + (pages * PAGE - size if self._at_end else 0)
        self._slots[pointer] = begin, pages
        return pointer

    def deallocate(self, pointer: int, size: int) -> None:
        """Checks what is beside the array, and frees it."""
        begin, pages = self._slots.pop(pointer)
        before, behind = pointer - begin, begin + pages * PAGE - pointer - size
        rest = ctypes.string_at(begin, before) + ctypes.string_at(pointer + size, behind)
        if rest.count(PATTERN) != len(rest):
            os.abort()  # an exception in a destructor would be ignored
        self._free[pages].append(begin)

    def _map(self, pages: int) -> list[int]:
        count = max(1, SLOTS // pages)
        stride = (pages + 1) * PAGE
        base = _LIBC.mmap(None, count * stride + PAGE, PROT_NONE, MAP_PRIVATE_ANONYMOUS, -1, 0)
        if base in (None, ctypes.c_void_p(-1).value):
            raise MemoryError(f"cannot map {count} slots of {pages} pages")
        begins = [base + PAGE + number * stride for number in range(count)]
        for begin in begins:
            if _LIBC.mprotect(begin, pages * PAGE, PROT_READ_WRITE) != 0:
                raise MemoryError(f"cannot map {pages} pages")
        return begins
