"""Local memory of kernels on CUDA: what a card cannot hold is refused before the launch.

Stacks and packets that do not fit into registers are in local memory. The driver reserves it for as many threads as the
card can hold at a time, whatever the number that is launched, and keeps it. If there is too little, a launch may end without
having run, which only a later call notices, or none.
"""

import ctypes
import sys
from functools import cache
from typing import Any

import warp as wp

LOCAL_SIZE = 3
"""CU_FUNC_ATTRIBUTE_LOCAL_SIZE_BYTES"""

THREADS_OF_PROCESSOR = 39
"""CU_DEVICE_ATTRIBUTE_MAX_THREADS_PER_MULTIPROCESSOR"""

MIN_CHECKED = 1 << 28
"""Bytes of all threads from which a kernel is looked at."""

_reserved: dict[str, int] = {}
"""Bytes that the kernels loaded so far need, by device."""


@cache
def driver() -> Any:
    """CUDA's driver; None if it cannot be opened by its name."""
    try:
        return ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
    except OSError:
        return None


def local_bytes(kernel: wp.Kernel, device: wp.Device, block: int) -> int:
    """Bytes of local memory of a thread of a kernel, loaded on a CUDA device for blocks of `block` threads; 0 if not known."""
    if kernel.is_generic or driver() is None:
        return 0
    loaded = kernel.module.execs.get((device.context, block))
    if loaded is None:
        return 0
    value, function = ctypes.c_int(), ctypes.c_void_p(loaded.get_kernel_hooks(kernel).forward)
    failed = driver().cuFuncGetAttribute(ctypes.byref(value), LOCAL_SIZE, function)
    return 0 if failed else value.value


@cache
def resident_threads(ordinal: int) -> int:
    """Threads that a CUDA device can hold at a time."""
    value = ctypes.c_int(2048)
    if driver() is not None:
        driver().cuDeviceGetAttribute(ctypes.byref(value), THREADS_OF_PROCESSOR, ordinal)
    return value.value * wp.get_device(f"cuda:{ordinal}").sm_count


def reserve_local_memory(kernel: wp.Kernel, device: wp.Device, block: int) -> None:
    """Checks that a card has the local memory that a kernel needs beyond that of the kernels before it.

    block: as in `local_bytes`.

    Raises:
        MemoryError: it has not.
    """
    needed = local_bytes(kernel, device, block) * resident_threads(device.ordinal)
    reserved = _reserved.get(device.alias, 0)
    if needed <= max(reserved, MIN_CHECKED):
        return
    free = device.free_memory
    if needed - reserved > free and not device.is_capturing:
        wp.synchronize_device(device)  # memory that was freed goes from Warp's pool back to the driver
        free = device.free_memory
    if needed - reserved > free:
        raise MemoryError(
            f"{kernel.key} needs {needed / 1e9:.1f} GB of local memory for all threads of {device.alias}, which has "
            f"{free / 1e9:.1f} GB free; free some, or use the traversal 'persistent' or 'single' there"
        )
    _reserved[device.alias] = needed
