"""Array elements without the checks of `array[i]`, for innermost loops.

Warp lets an index be negative and an array be strided; both cost instructions at every access, and where a loop only
moves memory they are most of its time. These take the i-th element of a contiguous array, 0 <= i.
"""

import warp as wp

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

CACHE_LINE = 16
"""Floats or ints of a cache line: vectors that lie across two lines take longer to load and to store."""


@wp.func_native(f"return start + (int)(-((size_t)(values.data + start) / 4) & {CACHE_LINE - 1});")
def first_line(values: wp.array(dtype=int), start: int) -> int:
    """The first element from `start` on that begins a cache line."""
    ...


@wp.func_native("return values.data[i];")
def load_int(values: wp.array(dtype=int), i: int) -> int:
    """values[i]"""
    ...


@wp.func_native("values.data[i] = value;")
def store_int(values: wp.array(dtype=int), i: int, value: int):
    """values[i] = value"""
    ...


@wp.func_native("return values.data[i];")
def load_float(values: wp.array(dtype=float), i: int) -> float:
    """values[i]"""
    ...


@wp.func_native("values.data[i] = value;")
def store_float(values: wp.array(dtype=float), i: int, value: float):
    """values[i] = value"""
    ...


@wp.func_native("return values.data[i];")
def load_pair(values: wp.array(dtype=wp.vec2i), i: int) -> wp.vec2i:
    """values[i]"""
    ...


@wp.func_native("values.data[i] = value;")
def store_pair(values: wp.array(dtype=wp.vec2i), i: int, value: wp.vec2i):
    """values[i] = value"""
    ...


@wp.func_native("return values.data[i];")
def load_byte(values: wp.array(dtype=wp.uint8), i: int) -> wp.uint8:
    """values[i]"""
    ...


@wp.func_native("values.data[i] = value;")
def store_byte(values: wp.array(dtype=wp.uint8), i: int, value: wp.uint8):
    """values[i] = value"""
    ...
