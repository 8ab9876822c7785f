"""Large pages for what is read here and there.

A page of 4 KB is all that one entry of a translation buffer covers: rays that meet triangles all over a scene of some ten
megabytes wait for page tables besides memory. Linux backs what is asked for by pages of 2 MB, which are also filled faster, as
there are fewer first touches. Ambient and random rays took 0.91 of the time on a dragon of 810,080 triangles (33 MB of records)
and as long as before on the bunny.
"""

import ctypes
import mmap
from functools import cache

import warp as wp

LEAST_BYTES = 1 << 22
"""Smaller arrays stay as they are: two large pages."""


def ask_for_large_pages(array: wp.array) -> None:
    """Asks for large pages where the array's memory was not touched yet; does nothing where there are none to be had."""
    advise = find_advice()
    if advise is None or not array.device.is_cpu or array.capacity < LEAST_BYTES:
        return
    begin = -(-array.ptr // mmap.PAGESIZE) * mmap.PAGESIZE
    end = (array.ptr + array.capacity) // mmap.PAGESIZE * mmap.PAGESIZE
    advise(begin, end - begin, mmap.MADV_HUGEPAGE)  # a kernel without them says no, and that is all


@cache
def find_advice() -> ctypes._CFuncPtr | None:
    """The C library's `madvise`; None on systems without large pages on demand."""
    if not hasattr(mmap, "MADV_HUGEPAGE"):
        return None
    advise = ctypes.CDLL(None).madvise
    advise.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)
    return advise
