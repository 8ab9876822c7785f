"""The range of t checked by floats or by one integer, for W triangles at once: for measurements.

The functions made here take the place of the check in `wrt.kernels.classics.studies.bare_triangle_tests.make_blocks`.

**Idea** (Waechter 2004). Floats of the same sign are ordered as their bits are. As unsigned integers, negative floats and NaN
are larger than infinity. So one comparison of integers, bits(t) - 1 < bits(t_max) - 1, replaces 0 < t and t < t_max. It
excludes 0, which wraps around, everything negative, NaN, and what lies at t_max or beyond.

References: waechter-2004.
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.simd.lanes import lanes

_CHECKS = {
    False: "(t.c[i] > 0.0f) & (t.c[i] < best)",
    True: "__builtin_bit_cast(unsigned, t.c[i]) - 1u < __builtin_bit_cast(unsigned, best) - 1u",
}


@cache
def in_range(width: int, integers: bool) -> wp.Function:
    """`wp.func(t, mask, best) -> mask`: the lanes of a mask with 0 < t < best."""
    Lanes = lanes(width)
    constants = f"    constexpr int W = {width};"

    @native.func_native(
        "lanes.h",
        f"{constants}    int hit[W];\n"
        f"    WRT_FOR_LANES(i) hit[i] = {_CHECKS[integers]} ? -1 : 0;\n    return wrt::bits<W>(hit) & mask;",
    )
    def check(t: wp.ref[Lanes], mask: wp.uint32, best: float) -> wp.uint32: ...

    return check
