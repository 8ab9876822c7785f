// Nodes of two children in 64 bytes, and one ray (wrt.kernels.layout.binary_nodes). On CUDA a node is four loads of 16 bytes.
//
// Boxes are a filter here: they are tested by fused operations, with twice the slack of wrt.kernels.simd.boxes, which pays for
// the roundings of this form. Where a ray meets a box by that rule, it meets it by this one, so hits are the same.
#pragma once
#include "ray.h"

namespace wrt {
namespace {

/// Widening of boxes as a fraction of the ray's reach.
constexpr float FILTER_SLACK = 2.0f * SLACK;

/// Largest 1 / direction, for a direction whose largest component is from 1 to 2. Limiting it moves a plane by 2^-26 reach.
constexpr float MAX_INVERSE = 67108864.0f;

/// Least bound of t, 2^-100: positive, so that it may be compared as an integer, and above what may be lost in scaling.
constexpr float MIN_BOUND = 7.888609052210118e-31f;

/// Words of a triangle: three vertices, each followed by a word; that of the first is the triangle's id.
constexpr int TRIANGLE_WORDS = 12;

/// What 16 bytes hold.
struct Quad {
    float x, y, z, w;
};

inline CUDA_CALLABLE Quad load_quad(const float* from)
{
#if defined(__CUDA_ARCH__)
    const float4 v = __ldg((const float4*)from);
    return {v.x, v.y, v.z, v.w};
#else
    return {from[0], from[1], from[2], from[3]};
#endif
}

inline CUDA_CALLABLE int int_of(float x) { return __builtin_bit_cast(int, x); }

inline CUDA_CALLABLE float fused(float a, float b, float c)
{
#if defined(__CUDA_ARCH__)
    return __fmaf_rn(a, b, c);
#else
    return a * b + c;
#endif
}

/// One instruction each on CUDA; which of a NaN and a number they return does not matter to their users.
inline CUDA_CALLABLE float min_of(float a, float b)
{
#if defined(__CUDA_ARCH__)
    return fminf(a, b);
#else
    return smaller(a, b);
#endif
}

inline CUDA_CALLABLE float max_of(float a, float b)
{
#if defined(__CUDA_ARCH__)
    return fmaxf(a, b);
#else
    return larger(a, b);
#endif
}

inline CUDA_CALLABLE int min_of(int a, int b, int c, int d)
{
#if defined(__CUDA_ARCH__)
    return min(__vimin3_s32(a, b, c), d);
#else
    return smaller(smaller(a, b), smaller(c, d));
#endif
}

inline CUDA_CALLABLE int max_of(int a, int b, int c, int d)
{
#if defined(__CUDA_ARCH__)
    return max(__vimax3_s32(a, b, c), d);
#else
    return larger(larger(a, b), larger(c, d));
#endif
}

/// The power of two up to the largest component of a direction: divided by it, directions of any length are from 1 to 2 long.
inline CUDA_CALLABLE float scale_of(float x, float y, float z)
{
    return __builtin_bit_cast(float, int_of(largest_size(x, y, z)) & 0x7f800000);
}

/// Bits of a bound of t, for the scaled direction; a t of -0, which is the least integer of all, is no bound.
inline CUDA_CALLABLE int bound_of(float t, float scale) { return int_of(max_of(t * scale, MIN_BOUND)); }

/// What the test of a node needs of a ray, for its scaled direction. low, high: of the planes of these names. t_min, t_max: the
/// interval in which boxes are met, as bits of floats that are not negative.
struct FilterRay {
    float inverse[3], low[3], high[3];
    int t_min, t_max;
};

inline CUDA_CALLABLE void begin_axis(FilterRay& ray, int axis, float direction, float origin, float slack, float scale)
{
    const float inverse = scale / direction;
    const bool steep = WRT_ABS(inverse) <= MAX_INVERSE;
    ray.inverse[axis] = steep ? inverse : inverse < 0.0f ? -MAX_INVERSE : MAX_INVERSE;
    ray.low[axis] = -((origin + slack) * ray.inverse[axis]);
    ray.high[axis] = -((origin - slack) * ray.inverse[axis]);
}

/// A ray of the direction x, y, z, without negligible components, from px, py, pz, whose reach is `far`.
inline CUDA_CALLABLE FilterRay filter_ray(
    float x, float y, float z, float px, float py, float pz, float far, float t_min, float t_max)
{
    const float scale = scale_of(x, y, z), slack = FILTER_SLACK * far;
    FilterRay ray;
    begin_axis(ray, 0, x, px, slack, scale);
    begin_axis(ray, 1, y, py, slack, scale);
    begin_axis(ray, 2, z, pz, slack, scale);
    const float first = min_of(t_min * scale, FARTHEST);
    ray.t_min = first < MIN_BOUND ? 0 : int_of(first);
    ray.t_max = bound_of(t_max, scale);
    return ray;
}

/// The children of a node that a ray meets: the nearer one, and the other.
struct NearAndFar {
    bool any, both;
    int near, far;
};

/// The interval of t of a box: bits of floats, of which those that are negative are less than all that are not.
struct Bits {
    int enter, leave;
};

/// The interval in which a ray meets a child's box: a low and a high plane for each axis. FROM_ZERO: whether t_min is 0.
template <bool FROM_ZERO>
inline CUDA_CALLABLE Bits filtered(const FilterRay& ray, float x0, float x1, float y0, float y1, float z0, float z1)
{
    const float low_x = fused(x0, ray.inverse[0], ray.low[0]), high_x = fused(x1, ray.inverse[0], ray.high[0]);
    const float low_y = fused(y0, ray.inverse[1], ray.low[1]), high_y = fused(y1, ray.inverse[1], ray.high[1]);
    const float low_z = fused(z0, ray.inverse[2], ray.low[2]), high_z = fused(z1, ray.inverse[2], ray.high[2]);
    return {max_of(int_of(min_of(low_x, high_x)), int_of(min_of(low_y, high_y)), int_of(min_of(low_z, high_z)),
                FROM_ZERO ? 0 : ray.t_min),
        min_of(int_of(max_of(low_x, high_x)), int_of(max_of(low_y, high_y)), int_of(max_of(low_z, high_z)), ray.t_max)};
}

/// The boxes of a node's children, and their words: x and y of the first child, of the second one, and z of both.
struct TwoBoxes {
    Quad first, second, both;
    int left, right;
};

/// A node of 16 words (wrt.kernels.layout.binary_nodes).
inline CUDA_CALLABLE TwoBoxes load_boxes(const float* nodes, int node)
{
    const float* const at = nodes + 16 * (size_t)node;
    const Quad p = load_quad(at), q = load_quad(at + 4), r = load_quad(at + 8);
#if defined(__CUDA_ARCH__)
    const int2 child = __ldg((const int2*)(at + 12));
    return {p, q, r, child.x, child.y};
#else
    return {p, q, r, int_of(at[12]), int_of(at[13])};
#endif
}

/// A node of a wide tree of width 2 (wrt.kernels.layout.bvh_nodes).
inline CUDA_CALLABLE TwoBoxes load_wide_boxes(const float* bounds, const int* child, int node)
{
    const float* const at = bounds + 12 * (size_t)node;
    const Quad p = load_quad(at), q = load_quad(at + 4), r = load_quad(at + 8);
    return {
        {p.x, q.z, p.z, r.x}, {p.y, q.w, p.w, r.y}, {q.x, r.z, q.y, r.w}, child[2 * (size_t)node], child[2 * (size_t)node + 1]};
}

template <bool FROM_ZERO> inline CUDA_CALLABLE NearAndFar meet_children(const TwoBoxes& at, const FilterRay& ray)
{
    const Quad &p = at.first, &q = at.second, &r = at.both;
    const Bits a = filtered<FROM_ZERO>(ray, p.x, p.y, p.z, p.w, r.x, r.y),
               b = filtered<FROM_ZERO>(ray, q.x, q.y, q.z, q.w, r.z, r.w);
    const bool meets_a = a.enter <= a.leave, meets_b = b.enter <= b.leave;
    const bool swaps = meets_b & (!meets_a | (b.enter < a.enter));
    const bool any = meets_a | meets_b, both = meets_a & meets_b;
    return {any, both, swaps ? at.right : at.left, swaps ? at.left : at.right};
}

}  // namespace
}  // namespace wrt
