"""Array elements without the checks of `array[i]`, for innermost loops.

Warp lets an index be negative and an array be strided; both cost instructions at every access, and where a loop only
moves memory they are most of its time. These take the i-th element of a contiguous array, 0 <= i.
"""

import warp as wp

wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@wp.func_native("return values.data[i];")
def load_int(values: wp.array(dtype=int), i: int) -> int:
    """values[i]"""
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
