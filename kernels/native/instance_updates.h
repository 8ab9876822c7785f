// Moves of instances where their transforms are: boxes by a team of threads, what all boxes span, and the boxes of nodes
// (wrt.kernels.traversal.two_level.instance_updates).
#pragma once
#include "loops.h"

namespace wrt {
namespace {

/// An integer in the order of doubles, of -0 before 0.
inline CUDA_CALLABLE long long ordered_bits(double value)
{
    const long long bits = __builtin_bit_cast(long long, value);
    return bits ^ ((bits >> 63) & 0x7fffffffffffffffll);
}

inline CUDA_CALLABLE double of_ordered(long long bits)
{
    return __builtin_bit_cast(double, bits ^ ((bits >> 63) & 0x7fffffffffffffffll));
}

/// `found` becomes the least of it and of the values of all threads of a warp, which all come here on CUDA.
inline CUDA_CALLABLE void keep_min(long long* found, long long value)
{
#if defined(__CUDA_ARCH__)
    for (int step = 16; step > 0; step >>= 1) {
        const long long other = __shfl_xor_sync(0xffffffffu, value, step);
        value = other < value ? other : value;
    }
    if ((threadIdx.x & 31) == 0 && value < *(volatile long long*)found) atomicMin(found, value);
#else
    if (value < *found) *found = value;
#endif
}

/// `sum` grows by the values of all threads of a warp, which all come here on CUDA.
inline CUDA_CALLABLE void add_all(double* sum, double value)
{
#if defined(__CUDA_ARCH__)
    for (int step = 16; step > 0; step >>= 1) value += __shfl_xor_sync(0xffffffffu, value, step);
    if ((threadIdx.x & 31) == 0 && value != 0.0) atomicAdd(sum, value);
#else
    *sum += value;
#endif
}

/// As `bound_points`, by a team of a warp on CUDA, of which this is thread `lane`.
template <class Matrix, class Vec3>
inline CUDA_CALLABLE void bound_by_team(const double* points, int row, int begin, int end, const Matrix& map,
    const Vec3& origin, double* corners, int count, int i, int lane, int team)
{
    const double *const px = points, *const py = px + row, *const pz = py + row;
    double low[3], high[3];
    for (int axis = 0; axis < 3; ++axis) low[axis] = __builtin_bit_cast(double, 0x7ff0000000000000ull), high[axis] = -low[axis];
    for (int k = begin + lane; k < end; k += team)
        for (int axis = 0; axis < 3; ++axis) {
            const double at = (map.data[axis][0] * px[k] + map.data[axis][1] * py[k]) + map.data[axis][2] * pz[k];
            low[axis] = at < low[axis] ? at : low[axis];
            high[axis] = at > high[axis] ? at : high[axis];
        }
#if defined(__CUDA_ARCH__)
    for (int axis = 0; axis < 3; ++axis)
        for (int step = 16; step > 0; step >>= 1) {
            const double lower = __shfl_xor_sync(0xffffffffu, low[axis], step);
            const double upper = __shfl_xor_sync(0xffffffffu, high[axis], step);
            low[axis] = lower < low[axis] ? lower : low[axis];
            high[axis] = upper > high[axis] ? upper : high[axis];
        }
#endif
    if (lane) return;
    for (int axis = 0; axis < 3; ++axis) {
        corners[axis * count + i] = low[axis] + origin.c[axis];
        corners[(axis + 3) * count + i] = high[axis] + origin.c[axis];
    }
}

/// The power of two that is at most a positive, normal number, times 2^-4; and the one that is at least it.
inline CUDA_CALLABLE double step_below(double value)
{
    return __builtin_bit_cast(double, __builtin_bit_cast(long long, value) & 0x7ff0000000000000ll) / 16.0;
}

inline CUDA_CALLABLE double power_above(double value)
{
    const long long bits = __builtin_bit_cast(long long, value), power = bits & 0x7ff0000000000000ll;
    const double below = __builtin_bit_cast(double, power);
    return bits == power ? below : 2.0 * below;
}

/// The box of child `lane` of an inner node from those of the child's own children.
inline CUDA_CALLABLE void refit_lane(float* bounds, int node, int lane, int child, int width)
{
    float found[6];  // all loads come before the stores, for which a GPU would wait one by one
    for (int axis = 0; axis < 6; ++axis) {
        const float* const own = bounds + ((size_t)child * 6 + axis) * width;
        found[axis] = own[0];
        for (int k = 1; k < width; ++k)
            found[axis]
                = axis < 3 ? (own[k] < found[axis] ? own[k] : found[axis]) : (own[k] > found[axis] ? own[k] : found[axis]);
    }
    for (int axis = 0; axis < 6; ++axis) bounds[((size_t)node * 6 + axis) * width + lane] = found[axis];
}

/// All threads of a block wait for each other on CUDA, where they also see what others have written.
inline CUDA_CALLABLE void meet_block()
{
#if defined(__CUDA_ARCH__)
    __syncthreads();
#endif
}

}  // namespace
}  // namespace wrt
