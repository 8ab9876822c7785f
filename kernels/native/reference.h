// References: the records of triangles that builders move, 8 floats each, (low, id, -high, size); the union of two boxes is one
// minimum. Boxes of nodes have the same layout. See `wrt.builders.triangle_references`.
#pragma once
#include "lanes.h"

namespace wrt {
namespace {

/// Added to a triangle's id so that its bits are those of a normal float.
constexpr int ID_OFFSET = 0x00800000;

inline CUDA_CALLABLE int id_of(const float* reference) { return __builtin_bit_cast(int, reference[3]) - ID_OFFSET; }

inline CUDA_CALLABLE void copy_box(float* to, const float* from)
{
#if WRT_VECTORS
    __builtin_memcpy(to, from, 8 * sizeof(float));
#else
    memcpy(to, from, 8 * sizeof(float));
#endif
}

inline CUDA_CALLABLE void set_empty(float* box)
{
    constexpr int W = 8;
    WRT_FOR_LANES (j) {
        box[j] = WRT_INFINITY;
    }
}

inline CUDA_CALLABLE void unite(float* box, const float* other)
{
    constexpr int W = 8;
    WRT_FOR_LANES (j) {
        box[j] = other[j] < box[j] ? other[j] : box[j];
    }
}

/// The sides of a box.
struct SideLengths {
    float x, y, z;

    CUDA_CALLABLE float half_area() const { return x * y + y * z + z * x; }

    CUDA_CALLABLE bool is_flat(float thin) const
    {
        const float longest = x > y ? (x > z ? x : z) : (y > z ? y : z);
        const float shortest = x < y ? (x < z ? x : z) : (y < z ? y : z);
        return shortest <= longest * thin;
    }
};

inline CUDA_CALLABLE SideLengths sides_of(const float* box)
{
    return {-(box[0] + box[4]), -(box[1] + box[5]), -(box[2] + box[6])};
}

/// The sides of the box around two boxes.
inline CUDA_CALLABLE SideLengths sides_of_both(const float* p, const float* q)
{
    float size[3];
    for (int k = 0; k < 3; ++k) {
        const float low = p[k] < q[k] ? p[k] : q[k], high = p[4 + k] < q[4 + k] ? p[4 + k] : q[4 + k];
        size[k] = -(low + high);
    }
    return {size[0], size[1], size[2]};
}

/// The box around the boxes p and q.
inline CUDA_CALLABLE void join_boxes(float* to, const float* p, const float* q)
{
    for (int k = 0; k < 8; ++k) to[k] = p[k] < q[k] ? p[k] : q[k];
}

/// Reads the box of a triangle from rows of components; the lanes 3 and 7 are left as they are.
template <class Boxes> inline CUDA_CALLABLE void read_box(const Boxes& boxes, size_t triangle, float* to)
{
    const size_t n = boxes.low.shape[1];
    for (size_t axis = 0; axis < 3; ++axis) {
        to[axis] = boxes.low.data[axis * n + triangle];
        to[4 + axis] = -boxes.high.data[axis * n + triangle];
    }
}

template <class Boxes> inline CUDA_CALLABLE void write_reference(const Boxes& boxes, int triangle, float* to)
{
    read_box(boxes, triangle, to);
    to[3] = __builtin_bit_cast(float, triangle + ID_OFFSET);
    to[7] = 0.0f;
}

/// Writes the references of the triangles begin .. end - 1.
template <class Boxes> inline CUDA_CALLABLE void write_references(const Boxes& boxes, int begin, int end, float* references)
{
    WRT_SCALAR
    for (int i = begin; i < end; ++i) write_reference(boxes, i, references + (size_t)i * 8);
}

/// Writes the sizes of references; see `wrt.builders.triangle_references.write_sizes`.
inline CUDA_CALLABLE void write_sizes(float* references, int begin, int end)
{
    WRT_SCALAR
    for (int i = begin; i < end; ++i) {
        float* to = references + (size_t)i * 8;
        const float area = sides_of(to).half_area();
        to[7] = area > 0.0f ? (float)__builtin_bit_cast(int, area) * 0x1p-23f : 0.0f;
    }
}

inline CUDA_CALLABLE void write_ids(const float* references, int count, int* ids)
{
    WRT_SCALAR
    for (int i = 0; i < count; ++i) ids[i] = id_of(references + (size_t)i * 8);
}

/// Writes the box of triangle i; adding 0 turns -0 into +0, so that equal positions have equal bits.
template <class Boxes> inline CUDA_CALLABLE void write_box(const float* vertices, const int* faces, const Boxes& boxes, int i)
{
    const int* face = faces + (size_t)i * 3;
    const size_t n = boxes.low.shape[1];
    const float* p[3];
    for (int corner = 0; corner < 3; ++corner) p[corner] = vertices + (size_t)face[corner] * 3;
    for (int axis = 0; axis < 3; ++axis) {
        const float a = p[0][axis], b = p[1][axis], c = p[2][axis];
        const float lower = b < c ? b : c, upper = b > c ? b : c;
        boxes.low.data[axis * n + i] = (a < lower ? a : lower) + 0.0f;
        boxes.high.data[axis * n + i] = (a > upper ? a : upper) + 0.0f;
    }
}

/// Writes a triangle's box, clipped to a cell, as a reference.
template <class Boxes, class Vec3>
inline CUDA_CALLABLE void write_clipped(const Boxes& boxes, int triangle, const Vec3& low, const Vec3& high, float* to)
{
    const size_t n = boxes.low.shape[1];
    for (size_t axis = 0; axis < 3; ++axis) {
        const float from_low = boxes.low.data[axis * n + triangle], from_high = boxes.high.data[axis * n + triangle];
        to[axis] = from_low > low.c[axis] ? from_low : low.c[axis];
        to[4 + axis] = -(from_high < high.c[axis] ? from_high : high.c[axis]);
    }
    to[3] = __builtin_bit_cast(float, triangle + ID_OFFSET);
    to[7] = 0.0f;
}

}  // namespace
}  // namespace wrt
