// The box around the corners of triangles, as the least of their coordinates and of the negated ones
// (wrt.builders.triangle_boxes).
#pragma once
#include "loops.h"

namespace wrt {
namespace {

/// An integer in the order of floats, of -0 before 0.
inline CUDA_CALLABLE int ordered(float value)
{
    const int bits = __builtin_bit_cast(int, value);
    return bits ^ ((bits >> 31) & 0x7fffffff);
}

/// Folds share i of `items` into `found`: the six minima as `ordered` integers, and the bits of the largest absolute
/// coordinate, which are the greatest if it is NaN. All threads of a warp come here on CUDA.
template <class Vertex, class Face>
inline CUDA_CALLABLE void reduce_corners(const Vertex* vertices, const Face* faces, int count, int items, int i, int* found)
{
    int best[6], largest = 0;
    for (int k = 0; k < 6; ++k) best[k] = 0x7fffffff;
    for (int triangle = i; triangle < count; triangle += items) {
        const Face face = faces[triangle];
        for (int corner = 0; corner < 3; ++corner) {
            const Vertex vertex = vertices[face.c[corner]];
            for (int axis = 0; axis < 3; ++axis) {
                const float at = vertex.c[axis];
                const int low = ordered(at), high = ordered(-at), size = __builtin_bit_cast(int, at) & 0x7fffffff;
                best[axis] = low < best[axis] ? low : best[axis];
                best[3 + axis] = high < best[3 + axis] ? high : best[3 + axis];
                largest = size > largest ? size : largest;
            }
        }
    }
#if defined(__CUDA_ARCH__)
    for (int k = 0; k < 7; ++k) {
        int value = k < 6 ? best[k] : largest;
        for (int step = 16; step > 0; step >>= 1) {
            const int other = __shfl_xor_sync(0xffffffffu, value, step);
            value = k < 6 ? min(value, other) : max(value, other);
        }
        if ((threadIdx.x & 31) == 0 && value != (k < 6 ? 0x7fffffff : 0)) {
            if (k < 6) atomicMin(found + k, value);
            else atomicMax(found + k, value);
        }
    }
#else
    for (int k = 0; k < 6; ++k) found[k] = best[k] < found[k] ? best[k] : found[k];
    found[6] = largest > found[6] ? largest : found[6];
#endif
}

}  // namespace
}  // namespace wrt
