// The innermost loops of binned builds of BVHs: `wrt.builders.bvh.phases.bvh_bins`.
//
// A bin is 8 floats, as a reference is: adding a box to it is one minimum over 8 lanes. SLOT_BINS: bins of a slot.
#pragma once
#include "cost.h"
#include "reference.h"

namespace wrt {
namespace {

/// The doubled centroid of a reference, and its negative.
inline CUDA_CALLABLE void read_centroid(const float* from, float* centroid)
{
    for (int j = 0; j < 4; ++j) {
        centroid[j] = from[j] - from[4 + j];
        centroid[4 + j] = from[4 + j] - from[j];
    }
}

/// Writes the box of the doubled centroids of a range.
inline CUDA_CALLABLE void centroid_domain(const float* __restrict__ from, int count, float* domain)
{
    float grown[8];
    set_empty(grown);
    for (int i = 0; i < count; ++i, from += 8) {
        float centroid[8];
        read_centroid(from, centroid);
        unite(grown, centroid);
    }
    copy_box(domain, grown);
}

/// Writes the box of a range of boxes.
inline CUDA_CALLABLE void range_box(const float* __restrict__ from, int count, float* box)
{
    float grown[8];
    set_empty(grown);
    for (int i = 0; i < count; ++i, from += 8) unite(grown, from);
    copy_box(box, grown);
}

/// The bin of a doubled centroid along an axis.
inline CUDA_CALLABLE int bin_of(float centroid, float low, float scale, float last)
{
    float t = (centroid - low) * scale;
    t = t > 0.0f ? t : 0.0f;
    t = t < last ? t : last;
    return (int)t;
}

/// A bin of no triangles. The last lane counts them down.
inline CUDA_CALLABLE void clear_bin(float* bin)
{
    const float empty[8]
        = {WRT_INFINITY, WRT_INFINITY, WRT_INFINITY, WRT_INFINITY, WRT_INFINITY, WRT_INFINITY, WRT_INFINITY, 0.0f};
    copy_box(bin, empty);
}

/// Bins ranges along AXES axes; low, scale, last: see `bin_of`.
template <int AXES, int SLOT_BINS> struct Binner {
    /// Triangles that a lane can count: float32 has 24 bits.
    static constexpr int PIECE = 1 << 23;
    /// Triangles up to which a second grid takes longer to clear than it saves.
    static constexpr int ONE_GRID = 64;

    float low[4], scale[4], last;
    int bins;

    template <class Binning>
    CUDA_CALLABLE explicit Binner(const Binning& binning)
        : last((float)(binning.bins - 1))
        , bins(binning.bins)
    {
        for (int j = 0; j < 4; ++j) {
            low[j] = binning.low.c[j];
            scale[j] = binning.scale.c[j];
        }
    }

    /// Adds a triangle to its bin of each axis: a minimum, and one less in the last lane, by the instruction that adds -0 to
    /// the others.
    CUDA_CALLABLE void add(float* into, const float* from) const
    {
        constexpr int W = 8;
        const float one_more[W] = {-0.0f, -0.0f, -0.0f, -0.0f, -0.0f, -0.0f, -0.0f, -1.0f};
        float reference[W];
        copy_box(reference, from);
        int bin[4];
        WRT_FOR (4, j) {
            bin[j] = bin_of(from[j] - from[4 + j], low[j], scale[j], last);
        }
        for (int axis = 0; axis < AXES; ++axis) {
            float* box = into + (axis * bins + bin[axis]) * 8;
            float grown[W];
            copy_box(grown, box);
            WRT_FOR_LANES (j) {
                grown[j] = (reference[j] < grown[j] ? reference[j] : grown[j]) + one_more[j];
            }
            copy_box(box, grown);
        }
    }

    CUDA_CALLABLE void add_few(const float* __restrict__ from, int count, float* __restrict__ grid, int* counts) const
    {
        for (int i = 0; i < count; ++i, from += 8) add(grid, from);
        WRT_SCALAR
        for (int i = 0; i < AXES * bins; ++i) counts[i] -= (int)grid[i * 8 + 7];
    }

    /// Every other triangle goes to a second grid, which is merged with the first: neighbours in a mesh often fall into the
    /// same bins, and each would wait for the last one's store.
    CUDA_CALLABLE void add_many(const float* __restrict__ from, int count, float* __restrict__ grid, int* counts) const
    {
        const int all = AXES * bins;
        float other[SLOT_BINS * 8];
        for (int done = 0; done < count; done += PIECE) {
            const int piece = count - done < PIECE ? count - done : PIECE;
            for (int i = 0; i < all; ++i) {
                clear_bin(other + i * 8);
                grid[i * 8 + 7] = 0.0f;
            }
            for (int i = 0; i < piece - 1; i += 2, from += 16) {
                add(grid, from);
                add(other, from + 8);
            }
            if (piece & 1) {
                add(grid, from);
                from += 8;
            }
            for (int i = 0; i < all; ++i) {
                float* box = grid + i * 8;
                const float* more = other + i * 8;
                counts[i] -= (int)box[7] + (int)more[7];
                unite(box, more);
            }
        }
    }

    CUDA_CALLABLE void bin(const float* from, int count, float* grid, int* counts) const
    {
        for (int i = 0; i < AXES * bins; ++i) clear_bin(grid + i * 8);
        for (int i = 0; i < AXES * bins; ++i) counts[i] = 0;
        if (count <= ONE_GRID) add_few(from, count, grid, counts);
        else add_many(from, count, grid, counts);
    }
};

/// Bins a range of triangles along all axes: boxes to `grid`, numbers of triangles to `counts`.
template <int SLOT_BINS, class Binning>
inline CUDA_CALLABLE void bin_range(const float* from, int count, const Binning& binning, float* grid, int* counts)
{
    if (binning.axes == 4) Binner<4, SLOT_BINS>(binning).bin(from, count, grid, counts);
    else Binner<3, SLOT_BINS>(binning).bin(from, count, grid, counts);
}

/// Replaces `all` bins of a slot by the union of those of the slots first .. end - 1.
template <int SLOT_BINS> inline CUDA_CALLABLE void merge_bins(float* boxes, int* counts, int slot, int first, int end, int all)
{
    float* to = boxes + (size_t)slot * (SLOT_BINS * 8);
    int* count = counts + (size_t)slot * SLOT_BINS;
    for (int i = 0; i < all * 8; ++i) to[i] = WRT_INFINITY;
    for (int i = 0; i < all; ++i) count[i] = 0;
    for (int other = first; other < end; ++other) {
        const float* from = boxes + (size_t)other * (SLOT_BINS * 8);
        for (int i = 0; i < all * 8; ++i) to[i] = from[i] < to[i] ? from[i] : to[i];
        for (int i = 0; i < all; ++i) count[i] += counts[(size_t)other * SLOT_BINS + i];
    }
}

/// What lies on both sides of the planes before the bins of an axis. MOST: greatest number of bins, a multiple of 8.
template <int BINS> struct PlaneSides {
    float left_area[BINS], right_area[BINS];
    int left[BINS];

    CUDA_CALLABLE void sweep(const float* grid, const int* counts, int bins, int padded)
    {
        float low_side[8], high_side[8];
        set_empty(low_side);
        set_empty(high_side);
        left[0] = 0;
        for (int b = bins; b < padded; ++b) left[b] = 0;
        for (int b = 1; b < bins; ++b) {
            unite(low_side, grid + (b - 1) * 8);
            left_area[b] = sides_of(low_side).half_area();
            left[b] = left[b - 1] + counts[b - 1];
            unite(high_side, grid + (bins - b) * 8);
            right_area[bins - b] = sides_of(high_side).half_area();
        }
    }
};

/// Sweeps the bins of a slot from both ends, and finds the plane of least cost. Lane j keeps the best of the bins j, j + 8, ...
/// of all axes, so the costs of eight planes are computed at once.
template <int BINS, class Cost, class Plane>
inline CUDA_CALLABLE void find_best_plane(
    const Cost& cost, const float* grid, const int* counts, int bins, int axes, int count, Plane& plane)
{
    constexpr int W = 8;
    static_assert(BINS % W == 0, "lanes of the last vector are cleared");
    const int padded = (bins + W - 1) / W * W;
    float best_cost[W];
    int where[W];
    WRT_FOR_LANES (j) {
        best_cost[j] = WRT_INFINITY;
        where[j] = 0;
    }
    for (int axis = 0; axis < axes; ++axis) {
        PlaneSides<BINS> sides;
        sides.sweep(grid + axis * bins * 8, counts + axis * bins, bins, padded);
        for (int first = 0; first < padded; first += W)
            WRT_FOR_LANES (j) {
                const int b = first + j, before = sides.left[b];
                const float found
                    = sides.left_area[b] * leaf_cost(cost, before) + sides.right_area[b] * leaf_cost(cost, count - before);
                const bool better = before > 0 && before < count && found < best_cost[j];
                best_cost[j] = better ? found : best_cost[j];
                where[j] = better ? axis * BINS + b : where[j];
            }
    }
    int lane = 0;
    for (int j = 1; j < W; ++j)
        if (best_cost[j] < best_cost[lane] || (best_cost[j] == best_cost[lane] && where[j] < where[lane])) lane = j;
    plane.cost = best_cost[lane];
    plane.axis = where[lane] / BINS;
    plane.bin = where[lane] % BINS;
    plane.left = 0;
    for (int b = 0; b < plane.bin; ++b) plane.left += counts[plane.axis * bins + b];
}

/// Writes the boxes of the bins of an axis on both sides of a plane.
inline CUDA_CALLABLE void write_child_boxes(const float* grid, int bins, int plane, float* boxes)
{
    range_box(grid, plane, boxes);
    range_box(grid + plane * 8, bins - plane, boxes + 8);
}

/// Moves a range to the two sides of a plane, in order, and writes the boxes of their doubled centroids.
template <class Binning>
inline CUDA_CALLABLE void partition_range(const float* __restrict__ from, int count, const Binning& binning, int axis,
    int plane, float* left, float* right, float* left_domain, float* right_domain)
{
    constexpr int W = 8;
    const float low = binning.low.c[axis], scale = binning.scale.c[axis], last = (float)(binning.bins - 1);
    const float floors[2] = {WRT_INFINITY, -WRT_INFINITY};
    float low_side[W], high_side[W];
    set_empty(low_side);
    set_empty(high_side);
    for (int i = 0; i < count; ++i, from += 8) {
        const bool on_left = bin_of(from[axis] - from[4 + axis], low, scale, last) < plane;
        float reference[W], centroid[W];
        copy_box(reference, from);
        read_centroid(from, centroid);
        copy_box(on_left ? left : right, reference);
        left += on_left ? 8 : 0;
        right += on_left ? 0 : 8;
        const float floor = floors[on_left];  // lifts what is on the other side out of the minimum, without a branch
        WRT_FOR_LANES (j) {
            const float a = centroid[j] > floor ? centroid[j] : floor;
            const float b = centroid[j] > -floor ? centroid[j] : -floor;
            low_side[j] = a < low_side[j] ? a : low_side[j];
            high_side[j] = b < high_side[j] ? b : high_side[j];
        }
    }
    copy_box(left_domain, low_side);
    copy_box(right_domain, high_side);
}

/// Writes boxes and counts on both sides of the planes of an axis; see `wrt.builders.bvh.projected_binned.sweep_axis`.
inline CUDA_CALLABLE void sweep_axis(
    const float* grid, const int* counts, int* left, int bins, float others, float* to, float* weights)
{
    const int stride = 2 * bins;
    float grown[8];
    set_empty(grown);
    int before = 0;
    for (int b = 0; b < bins; ++b) {
        for (int j = 0; j < 3; ++j) {
            to[j * stride + b] = grown[j];
            to[(j + 3) * stride + b] = -grown[4 + j];
        }
        left[b] = before;
        unite(grown, grid + b * 8);
        before += counts[b];
    }
    set_empty(grown);
    for (int b = bins - 1; b >= 0; --b) {
        unite(grown, grid + b * 8);
        for (int j = 0; j < 3; ++j) {
            to[j * stride + bins + b] = grown[j];
            to[(j + 3) * stride + bins + b] = -grown[4 + j];
        }
    }
    WRT_FOR (stride, i) {
        const float x = to[3 * stride + i] - to[i], y = to[4 * stride + i] - to[stride + i];
        const float z = to[5 * stride + i] - to[2 * stride + i];
        weights[i] = others * (x * y + y * z + z * x);
    }
}

/// Writes the least costs of a pair's parent in 1 .. W - 1 lanes; see `wrt.builders.bvh.phases.collapse.combine`. left, right:
/// costs of the pair's nodes, or 0 for leaves.
template <int W>
inline CUDA_CALLABLE void combine(float* to, int width, const float* left, float left_leaf, const float* right,
    float right_leaf, float inner, float leaf, bool holds_large)
{
    float shifted[2 * W], best[W];
    WRT_FOR_LANES (i) {
        shifted[i] = WRT_INFINITY;
        best[i] = WRT_INFINITY;
    }
    if (right) {
        WRT_FOR_LANES (i) {
            shifted[W + i] = right[i];
        }
    } else {
        WRT_FOR_LANES (i) {
            shifted[W + i] = right_leaf;
        }
    }
    for (int k = 0; k < width - 1; ++k) {
        const float own = left ? left[k] : left_leaf;
        WRT_FOR_LANES (i) {
            const float sum = own + shifted[W - 1 - k + i];
            best[i] = sum < best[i] ? sum : best[i];
        }
    }
    const float node = inner + best[width - 1];
    const float one = leaf < node ? leaf : node;
    WRT_FOR_LANES (i) {
        to[i] = best[i] < one ? best[i] : one;
    }
    to[W - 1] = holds_large ? 1.0f : 0.0f;
}

/// Inserts the W triangles from `begin` on into the tree of a subset; see `wrt.builders.classics.bvh.subset_levels.find_block`.
template <int W, class Range>
inline CUDA_CALLABLE void find_block(const float* references, int begin, int end, const float* planes, const int* pairs,
    const Range* ranges, int limit, float* keys, int* values)
{
    float center[3][W];
    int node[W], pair[W];
    for (int i = 0; i < W; ++i) {
        const int triangle = begin + i < end ? begin + i : end - 1;
        const float* from = references + (size_t)triangle * 8;
        for (int j = 0; j < 3; ++j) center[j][i] = from[j] - from[4 + j];
        node[i] = 0;
        pair[i] = pairs[0];
    }
    int open = pair[0];
    for (int depth = 0; open && depth < limit; ++depth) {
        WRT_FOR_LANES (i) {
            const float* plane = planes + (size_t)pair[i] * 4;
            const float at = plane[0] * center[0][i] + plane[1] * center[1][i] + plane[2] * center[2][i];
            const int right = at > plane[3];
            node[i] = pair[i] ? 2 * pair[i] + right : node[i];
            pair[i] = pairs[node[i]];
        }
        open = 0;
        WRT_FOR_LANES (i) {
            open |= pair[i];
        }
    }
    for (int i = 0; i < W && begin + i < end; ++i) {
        keys[begin + i] = __builtin_bit_cast(float, ranges[node[i]].c[0]);
        values[begin + i] = begin + i;
    }
}

}  // namespace
}  // namespace wrt
