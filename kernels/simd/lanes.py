"""Building blocks of the native lane loops: W lanes at a time, in portable C++ for Clang and NVRTC.

Warp unrolls its own vector types instead of vectorising them. A plain loop over W floats, with selects instead of branches,
compiles to full SIMD width. Control flow stays in Python kernels; only the bodies of W lanes are written in C++, here or from
the pieces here. The project is compiled without fused multiply-add (`fuse_fp=False`), so a triangle test gives the same bits
for one triangle, for a block, in every traversal and on every device.
"""

from functools import cache

import warp as wp

from wrt.kernels.compilation.target import lane_width

FOR_LANES = """
#ifndef WRT_FOR_LANES
#define WRT_INFINITY __builtin_bit_cast(float, 0x7f800000)
#define WRT_NAN __builtin_bit_cast(float, 0x7fc00000)
#if defined(__clang__)
#pragma clang diagnostic ignored "-Wpass-failed"
#define WRT_FOR_LANES(i) _Pragma("clang loop vectorize(enable) unroll(disable)") for (int i = 0; i < W; ++i)
#define WRT_FOR(n, i) _Pragma("clang loop vectorize(enable) unroll(disable)") for (int i = 0; i < (n); ++i)
#define WRT_UNROLLED _Pragma("clang loop unroll(full)")
#define WRT_SCALAR _Pragma("clang loop vectorize(disable)")
#define WRT_LANES(name, pointer) const float* name = pointer
#else
#define WRT_LANES(name, pointer) float name[W]; \\
    if (W % 4 == 0) for (int j_ = 0; j_ < W / 4; ++j_) { const float4 v_ = ((const float4*)(pointer))[j_]; \\
        name[4 * j_] = v_.x; name[4 * j_ + 1] = v_.y; name[4 * j_ + 2] = v_.z; name[4 * j_ + 3] = v_.w; } \\
    else if (W % 2 == 0) for (int j_ = 0; j_ < W / 2; ++j_) { const float2 v_ = ((const float2*)(pointer))[j_]; \\
        name[2 * j_] = v_.x; name[2 * j_ + 1] = v_.y; } \\
    else for (int j_ = 0; j_ < W; ++j_) name[j_] = (pointer)[j_]
#define WRT_UNROLLED
#define WRT_SCALAR
#define WRT_FOR_LANES(i) for (int i = 0; i < W; ++i)
#define WRT_FOR(n, i) for (int i = 0; i < (n); ++i)
#endif
#if defined(__CUDA_ARCH__)
#define WRT_ABS(x) fabsf(x)
#define WRT_FETCH(pointer)
#else
#define WRT_ABS(x) __builtin_fabsf(x)
#define WRT_FETCH(pointer) __builtin_prefetch(pointer)
#endif
#endif
"""
"""Head of a lane snippet.

`WRT_FOR_LANES(i)` is a loop over W lanes that Clang must vectorise before it unrolls it; the opposite order gives much slower
code. W is a constant of the snippet. `WRT_LANES(name, pointer)` names the W floats at a pointer. On the CPU it is the pointer;
on CUDA the floats are loaded four at a time, so a block of W floats must be aligned to 16 bytes if W is a multiple of 4, to 8
bytes if W is even. `WRT_SCALAR` before a loop prevents Clang from vectorising it with gathers. `WRT_FETCH(pointer)` prefetches
a cache line, on CPUs.
"""

BITS = """
#if defined(__CUDA_ARCH__)
    auto wrt_lowest_bit = [](unsigned bits) { return __ffs(bits) - 1; };
    auto wrt_count_bits = [](unsigned bits) { return __popc(bits); };
#else
    auto wrt_lowest_bit = [](unsigned bits) { return __builtin_ctz(bits); };
    auto wrt_count_bits = [](unsigned bits) { return __builtin_popcount(bits); };
#endif
"""
"""C++ of `lowest_bit` and `count_bits`."""


def lane_bits(lanes: str = "W") -> str:
    """C++ of `wrt_bits(flags)`: one bit for each lane whose int is not 0. lanes: the name of the constant.

    This compiles to one comparison; a loop that collects bits by `|=` becomes a chain of shuffles.
    """
    return f"""
#if defined(__clang__) && !defined(__CUDA_ARCH__)
    typedef int wrt_ints __attribute__((ext_vector_type({lanes})));
    typedef bool wrt_bools __attribute__((ext_vector_type({lanes})));
    auto wrt_bits = [](const int* flags) {{
        wrt_ints v;
        __builtin_memcpy(&v, flags, sizeof(v));
        const wrt_bools set = __builtin_convertvector(v != 0, wrt_bools);
        unsigned mask = 0;
        __builtin_memcpy(&mask, &set, sizeof(set));
        return mask & ((1u << {lanes}) - 1u);
    }};
#else
    auto wrt_bits = [](const int* flags) {{
        unsigned mask = 0;
        for (int i = 0; i < {lanes}; ++i) mask |= flags[i] ? 1u << i : 0u;
        return mask;
    }};
#endif
"""


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return __ffs(mask) - 1;
#else
    return __builtin_ctz(mask);
#endif
""")
def lowest_bit(mask: wp.uint32) -> int:
    """Index of the lowest set bit; `mask` must not be 0."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return __popc(mask);
#else
    return __builtin_popcount(mask);
#endif
""")
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
