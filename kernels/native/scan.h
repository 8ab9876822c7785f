// Loops over the references of a kd-tree's node: sides of a plane, bins, samples (`wrt.builders.kdtree.scan`).
#pragma once
#include "reference.h"

namespace wrt {
namespace {

/// Whether a reference lies on the left and on the right of a plane, 1 or 0 each.
struct OnSides {
    int left, right;
};

inline CUDA_CALLABLE OnSides classify(const float* from, int axis, float position, bool planar_left)
{
    const float low = from[axis], high = -from[4 + axis];
    const bool planar = low == position && high == position;
    return {planar ? planar_left : low < position, planar ? !planar_left : high > position};
}

/// Adds a reference to the boxes of its sides.
inline CUDA_CALLABLE void grow_sides(float* low_side, float* high_side, const float* reference, OnSides on)
{
    constexpr int W = 8;
    // lifts the others out of the minimum
    const float a = on.left ? -WRT_INFINITY : WRT_INFINITY, b = on.right ? -WRT_INFINITY : WRT_INFINITY;
    WRT_FOR_LANES (j) {
        const float x = reference[j] > a ? reference[j] : a, y = reference[j] > b ? reference[j] : b;
        low_side[j] = x < low_side[j] ? x : low_side[j];
        high_side[j] = y < high_side[j] ? y : high_side[j];
    }
}

/// Stores the boxes of both sides in `wrt.builders.core.reference_lists.Sides`.
template <class Sides> inline CUDA_CALLABLE void store_sides(const float* low_side, const float* high_side, Sides& sides)
{
    for (int j = 0; j < 3; ++j) {
        sides.left_low.c[j] = low_side[j];
        sides.left_high.c[j] = -low_side[4 + j];
        sides.right_low.c[j] = high_side[j];
        sides.right_high.c[j] = -high_side[4 + j];
    }
}

/// Counts the references of a range on both sides of a plane, and computes their boxes.
template <class Sides>
inline CUDA_CALLABLE void measure_sides(const float* from, int count, int axis, float position, bool planar_left, Sides& sides)
{
    float low_side[8], high_side[8];
    set_empty(low_side);
    set_empty(high_side);
    sides.left = 0;
    sides.right = 0;
    for (int i = 0; i < count; ++i, from += 8) {
        const OnSides on = classify(from, axis, position, planar_left);
        float reference[8];
        copy_box(reference, from);
        grow_sides(low_side, high_side, reference, on);
        sides.left += on.left;
        sides.right += on.right;
    }
    store_sides(low_side, high_side, sides);
}

/// Moves a range to the two sides of a plane, in order. One side may begin where the range begins.
template <class Sides>
inline CUDA_CALLABLE void move_range(
    const float* from, int count, int axis, float position, bool planar_left, float* to_left, float* to_right, Sides& sides)
{
    float low_side[8], high_side[8], unwanted[8];
    set_empty(low_side);
    set_empty(high_side);
    float *low_end = to_left, *high_end = to_right;
    for (int i = 0; i < count; ++i, from += 8) {
        const OnSides on = classify(from, axis, position, planar_left);
        float reference[8];
        copy_box(reference, from);
        copy_box(on.left ? low_end : unwanted, reference);  // no branch to mispredict
        low_end += on.left ? 8 : 0;
        copy_box(on.right ? high_end : unwanted, reference);
        high_end += on.right ? 8 : 0;
        grow_sides(low_side, high_side, reference, on);
    }
    sides.left = (int)((low_end - to_left) / 8);
    sides.right = (int)((high_end - to_right) / 8);
    store_sides(low_side, high_side, sides);
}

/// Counts every `step`-th reference of a range in 6 rows of bins; see `wrt.builders.kdtree.scan.kdtree_bins`.
template <class Binning>
inline CUDA_CALLABLE void count_ends(
    const float* __restrict__ from, int count, int step, const Binning& binning, int* __restrict__ to)
{
    constexpr int W = 8;
    const int bins = binning.bins;
    for (int i = 0; i < 6 * bins; ++i) to[i] = 0;
    float origin[W], scale[W];
    for (int j = 0; j < 3; ++j) {
        origin[j] = binning.low.c[j];
        origin[4 + j] = -binning.high.c[j];
        scale[j] = scale[4 + j] = binning.scale.c[j];
    }
    origin[3] = origin[7] = scale[3] = scale[7] = 0.0f;
    const float last = (float)(bins - 1);
    for (int i = 0; i < count; i += step, from += 8 * (size_t)step) {
        int bin[W];
        WRT_FOR_LANES (j) {
            float t = (from[j] - origin[j]) * scale[j];
            t = t > 0.0f ? t : 0.0f;
            t = t < last ? t : last;
            bin[j] = (int)t;
        }
        for (int j = 0; j < 3; ++j) {
            ++to[j * bins + bin[j]];
            ++to[(3 + j) * bins + bin[4 + j]];
        }
    }
}

/// Replaces the counters of a slot, `stride` apart, by the sums of those of the slots first .. end - 1.
inline CUDA_CALLABLE void sum_counters(int* counters, size_t stride, int slot, int first, int end, int count)
{
    int* to = counters + slot * stride;
    for (int i = 0; i < count; ++i) to[i] = 0;
    for (int other = first; other < end; ++other) {
        const int* from = counters + other * stride;
        for (int i = 0; i < count; ++i) to[i] += from[i];
    }
}

/// Writes the intervals of a range along one axis: a row of lower ends, a row of upper ends, filled up with NaN.
inline CUDA_CALLABLE void gather_axis(
    const float* __restrict__ from, int count, int axis, float* __restrict__ low, float* __restrict__ high, int padded)
{
    for (int i = 0; i < count; ++i, from += 8) {
        low[i] = from[axis];
        high[i] = -from[4 + axis];
    }
    for (int i = count; i < padded; ++i) {
        low[i] = WRT_NAN;
        high[i] = WRT_NAN;
    }
}

/// Numbers of intervals to the left of a plane, in it, and to the right. Straddlers count on both sides.
template <int W, class Vec3i>
inline CUDA_CALLABLE Vec3i count_sides(
    const float* __restrict__ low, const float* __restrict__ high, int padded, float position)
{
    int left[W], planar[W], right[W];
    WRT_FOR_LANES (j) {
        left[j] = 0;
        planar[j] = 0;
        right[j] = 0;
    }
    for (int i = 0; i < padded; i += W) {
        WRT_FOR_LANES (j) {
            left[j] += low[i + j] < position;
            right[j] += high[i + j] > position;
            planar[j] += (low[i + j] == position) & (high[i + j] == position);
        }
    }
    Vec3i sum;
    for (int j = 0; j < W; ++j) {
        sum.c[0] += left[j];
        sum.c[1] += planar[j];
        sum.c[2] += right[j];
    }
    return sum;
}

/// For each of W positions, counts the references to its left; the counts to the right follow all of these.
template <int W>
inline CUDA_CALLABLE void count_samples(
    const float* __restrict__ from, int count, int axis, const float* __restrict__ position, int* to)
{
    int left[W], right[W];
    WRT_FOR_LANES (j) {
        left[j] = 0;
        right[j] = 0;
    }
    for (int i = 0; i < count; ++i, from += 8) {
        const float low = from[axis], high = -from[4 + axis];
        WRT_FOR_LANES (j) {
            left[j] += low < position[j];
            right[j] += high > position[j];
        }
    }
    for (int j = 0; j < W; ++j) {
        to[j] = left[j];
        to[W + j] = right[j];
    }
}

}  // namespace
}  // namespace wrt
