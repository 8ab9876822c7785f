"""Building blocks of the native lane loops: W lanes at a time, in portable C++ for Clang and NVRTC.

Warp unrolls its own vector types instead of vectorising them. A plain loop over W floats, with selects instead of branches,
compiles to full SIMD width. Control flow stays in Python kernels; only the bodies of W lanes are written in C++, here or from
the pieces here. The project is compiled without fused multiply-add (`fuse_fp=False`), so a triangle test gives the same bits
for one triangle, for a block, in every traversal and on every device.
"""

from functools import cache

import warp as wp

from wrt.kernels.compilation.target import lane_width
from wrt.kernels.runtime import native

FOR_LANES = native.read_header("loops.h")
"""Head of a lane snippet.

`WRT_FOR_LANES(i)` is a loop over W lanes that Clang must vectorise before it unrolls it; the opposite order gives much slower
code. W is a constant of the snippet. `WRT_LANES(name, pointer)` names the W floats at a pointer. On the CPU it is the pointer;
on CUDA the floats are loaded four at a time, so a block of W floats must be aligned to 16 bytes if W is a multiple of 4, to 8
bytes if W is even. `WRT_SCALAR` before a loop prevents Clang from vectorising it with gathers. `WRT_FETCH(pointer)` prefetches
a cache line, on CPUs.
"""


@native.func_native("lanes.h", "return wrt::lowest_bit(mask);")
def lowest_bit(mask: wp.uint32) -> int:
    """Index of the lowest set bit; `mask` must not be 0."""
    ...


@native.func_native("lanes.h", "return wrt::count_bits(mask);")
def count_bits(mask: wp.uint32) -> int:
    """Number of set bits."""
    ...


@cache
def lanes(width: int) -> type:
    """The vector type of `width` floats."""
    return wp.types.vector(length=width, dtype=wp.float32)


def native_width(device: wp.Device) -> int:
    """Lane count that suits the device: `lane_width` on the CPU, 2 on CUDA, where one thread traces one ray."""
    return 2 if device.is_cuda else lane_width()
