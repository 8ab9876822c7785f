"""Building blocks of the native lane loops: W lanes at a time, in portable C++ for Clang and NVRTC.

Warp unrolls its own vector types instead of vectorising them. A plain loop over W floats, with selects instead of branches,
compiles to full SIMD width. Such loops are C++, with what `kernels/native/lanes.h` and `loops.h` have for them; hot traversals
and builders are whole loops of C++ in the headers beside these, and the rest of the control flow is that of Warp kernels. The
project is compiled without fused multiply-add (`fuse_fp=False`), so a triangle test gives the same bits for one triangle, for a
block, in every traversal and on every device.
"""

from functools import cache

import warp as wp

from wrt.kernels.compilation.target import lane_width
from wrt.kernels.runtime import native


@native.func_native("lanes.h", "return wrt::lowest_bit(mask);")
def lowest_bit(mask: wp.uint32) -> int:
    """Index of the lowest set bit; `mask` must not be 0."""


@native.func_native("lanes.h", "return wrt::count_bits(mask);")
def count_bits(mask: wp.uint32) -> int:
    """Number of set bits."""


@cache
def lanes(width: int) -> type:
    """The vector type of `width` floats."""
    return wp.types.vector(length=width, dtype=wp.float32)


def native_width(device: wp.Device) -> int:
    """Lane count that suits the device: `lane_width` on the CPU, 2 on CUDA, where one thread traces one ray."""
    return 2 if device.is_cuda else lane_width()
