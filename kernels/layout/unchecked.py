"""Array elements without the index handling of `array[i]`, for innermost loops.

Warp supports negative indices and strided arrays; both cost instructions at every access, which dominate loops that only move
memory. The functions here access the i-th element of a contiguous array, 0 <= i, without a bounds check.
"""

import warp as wp

CACHE_LINE = 16
"""Floats or ints per cache line. Vectors that straddle two lines take longer to load and to store."""


@wp.func_native(f"return start + (int)(-((size_t)(values.data + start) / 4) & {CACHE_LINE - 1});")
def first_line(values: wp.array(dtype=int), start: int) -> int:
    """Index of the first element at or after `start` that begins a cache line."""


@wp.func_native("return values.data[i];")
def load_int(values: wp.array(dtype=int), i: int) -> int:
    """values[i]"""


@wp.func_native("values.data[i] = value;")
def store_int(values: wp.array(dtype=int), i: int, value: int):
    """values[i] = value"""


@wp.func_native("return values.data[i];")
def load_float(values: wp.array(dtype=float), i: int) -> float:
    """values[i]"""


@wp.func_native("values.data[i] = value;")
def store_float(values: wp.array(dtype=float), i: int, value: float):
    """values[i] = value"""


@wp.func_native("return values.data[i];")
def load_pair(values: wp.array(dtype=wp.vec2i), i: int) -> wp.vec2i:
    """values[i]"""


@wp.func_native("values.data[i] = value;")
def store_pair(values: wp.array(dtype=wp.vec2i), i: int, value: wp.vec2i):
    """values[i] = value"""


@wp.func_native("return values.data[i];")
def load_byte(values: wp.array(dtype=wp.uint8), i: int) -> wp.uint8:
    """values[i]"""


@wp.func_native("values.data[i] = value;")
def store_byte(values: wp.array(dtype=wp.uint8), i: int, value: wp.uint8):
    """values[i] = value"""
