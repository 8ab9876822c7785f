// Words that many threads change at a time, whose last value does not depend on their order
// (wrt.builders.kdtree.levelwise).
#pragma once
#include "loops.h"

namespace wrt {
namespace {

/// `found` becomes the least of it and the value. Where all threads of a warp come here with one address on CUDA, one of them
/// does it for all.
inline CUDA_CALLABLE void keep_least(long long* found, long long value)
{
#if defined(__CUDA_ARCH__)
    const unsigned together = __match_any_sync(__activemask(), (unsigned long long)found);
    if (together == 0xffffffffu) {
        for (int step = 16; step > 0; step >>= 1) {
            const long long other = __shfl_xor_sync(0xffffffffu, value, step);
            value = other < value ? other : value;
        }
        if (threadIdx.x & 31) return;
    }
    if (value < *(volatile long long*)found) atomicMin(found, value);
#else
    long long known = __atomic_load_n(found, __ATOMIC_RELAXED);
    while (value < known && !__atomic_compare_exchange_n(found, &known, value, true, __ATOMIC_RELAXED, __ATOMIC_RELAXED)) { }
#endif
}

/// Adds to a word; returns what it was.
inline CUDA_CALLABLE long long add_to(long long* sum, long long value)
{
#if defined(__CUDA_ARCH__)
    return (long long)atomicAdd((unsigned long long*)sum, (unsigned long long)value);
#else
    return __atomic_fetch_add(sum, value, __ATOMIC_RELAXED);
#endif
}

}  // namespace
}  // namespace wrt
