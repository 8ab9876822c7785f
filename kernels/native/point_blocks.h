// Blocks of W triangles, searched for what is near a point.
//
// wrt.kernels.points has the bounds of rounding by which boxes are left out. Coordinates are those of a tree.
//
// The distances of a block take five divisions and some 160 operations, and most blocks of the leaves near a point have no
// triangle that is as near as what was found. A box around each triangle tells that of most triangles by 40 operations. Those
// that are left of several blocks are packed side by side, and tested together.
#pragma once
#include "lanes.h"
#include "nearest_on_triangle.h"

namespace wrt {
namespace {

/// Distances of boxes and of triangles may be wrong by this part of the distance of the farthest point of the scene.
constexpr float POINT_SLACK = 1.9073486328125e-6f;

/// Squares of distances below this are no normal numbers.
constexpr float MIN_DISTANCE = 1e-18f;

/// A point; slack: POINT_SLACK of the distance of the farthest point of the tree's box, a NaN for a point that finds nothing.
struct SearchPoint {
    float x, y, z, slack;
};

template <class Vec3> inline CUDA_CALLABLE SearchPoint point_in(const Vec3& low, const Vec3& high, float x, float y, float z)
{
    const float at[3] = {x, y, z};
    float reach = 0.0f;
    for (int a = 0; a < 3; ++a) {
        const float below = WRT_ABS(low.c[a] - at[a]), above = WRT_ABS(high.c[a] - at[a]);
        reach += below > above ? below : above;
    }
    return {x, y, z, reach - reach == 0.0f ? reach * POINT_SLACK + MIN_DISTANCE : WRT_NAN};
}

/// The vertex of a record, less the point.
template <int W> inline CUDA_CALLABLE Offset vertex_at(const float* record, int vertex, const SearchPoint& point)
{
    const float* const from = record + 3 * W * vertex;
    return {from[0] - point.x, from[W] - point.y, from[2 * W] - point.z};
}

/// The vertices of a triangle, less the point.
struct Triangle {
    Offset vertex[3];

    inline CUDA_CALLABLE OnTriangle nearest() const { return nearest_on_triangle(vertex[0], vertex[1], vertex[2]); }
};

/// The triangle in a slot of blocks.
template <int W, int ROWS>
inline CUDA_CALLABLE Triangle triangle_in_slot(const float* records, int slot, const SearchPoint& point)
{
    const float* const record = records + (size_t)(slot / W) * (ROWS * W) + slot % W;
    return {{vertex_at<W>(record, 0, point), vertex_at<W>(record, 1, point), vertex_at<W>(record, 2, point)}};
}

/// The first of the lanes in a mask that has the least of W numbers, none of which is negative or a NaN there.
template <int W> inline CUDA_CALLABLE int min_lane(const float* numbers, unsigned mask)
{
    if (!(mask & (mask - 1u))) return lowest_bit(mask);
#if WRT_VECTORS
    const auto own = load<Ints<W>>(numbers);
    const Ints<W> numbered = (lane_bits<W>() & (int)mask) != 0 ? own : Ints<W>(0x7fffffff);
    return lowest_bit(bits_of(numbered == __builtin_reduce_min(numbered)));
#else
    int smallest = lowest_bit(mask);
    for (int i = smallest + 1; i < W; ++i) smallest = (mask >> i & 1u) && numbers[i] < numbers[smallest] ? i : smallest;
    return smallest;
#endif
}

/// Those of W lanes whose numbers are not above a bound.
template <int W> inline CUDA_CALLABLE unsigned lanes_up_to(const float* numbers, float bound)
{
    int near[W];
    WRT_FOR_LANES (i) near[i] = numbers[i] <= bound ? -1 : 0;
    return bits<W>(near);
}

/// W triangles. at(i, vertex): a vertex of the triangle in a lane, less the point. slot(i): where it is in the blocks. used: a
/// bit for each lane that has one.
template <int W, class At, class Slot, class Kept>
inline CUDA_CALLABLE void search_lanes(
    const At& at, const Slot& slot, unsigned used, const int* ids, const SearchPoint& point, Kept& kept)
{
    float square[W];
    int flat[W], near[W];
    const float bound = kept.bound;
    WRT_FOR_LANES (i) {
        bool is_thin;
        square[i] = square_in_float32(at(i, 0), at(i, 1), at(i, 2), is_thin);
        flat[i] = (is_thin & (square[i] == square[i])) ? -1 : 0;  // lanes that are not used are NaN
        near[i] = ((square[i] <= bound) & !is_thin) ? -1 : 0;
    }
    unsigned left = bits<W>(near) & used;
    for (unsigned thin = bits<W>(flat) & used; thin; thin &= thin - 1u) {
        const int i = lowest_bit(thin);
        square[i] = nearest_on_triangle(at(i, 0), at(i, 1), at(i, 2)).square;
        left |= square[i] <= bound ? 1u << i : 0u;
    }
    while (left) {
        const int i = Kept::NARROWS ? min_lane<W>(square, left) : lowest_bit(left), own = slot(i);
        kept.keep(square[i], ids[own], own, point);
        left &= ~(1u << i);
        if (Kept::NARROWS) left = left ? left & lanes_up_to<W>(square, kept.bound) : 0u;
    }
}

/// The W triangles of a block. records: of ROWS rows of W lanes, the first nine of which are vertices.
template <int W, int ROWS, class Kept>
inline CUDA_CALLABLE void search_block(const float* records, const int* ids, int block, const SearchPoint& point, Kept& kept)
{
    const float* const record = records + (size_t)block * (ROWS * W);
    const auto at = [&](int i, int vertex) { return vertex_at<W>(record + i, vertex, point); };
    search_lanes<W>(at, [&](int i) { return block * W + i; }, ~0u, ids, point, kept);
}

#if WRT_VECTORS
/// Squares of dot products above this are normal numbers.
constexpr float MIN_DOT = 1e-15f;

/// The vertices of the W triangles of a record, less the point; returns a bit for each triangle that may be within the limit:
/// its box is, and the nearest of its vertices along the line from the point to the first of them.
template <int W> inline unsigned near_triangles(const float* record, const SearchPoint& point, float limit, Floats<W>* from)
{
    const float at[3] = {point.x, point.y, point.z};
    Floats<W> square[3];
    WRT_UNROLLED
    for (int a = 0; a < 3; ++a) {
        WRT_UNROLLED
        for (int vertex = 0; vertex < 3; ++vertex)
            from[3 * vertex + a] = load<Floats<W>>(record + (3 * vertex + a) * W) - at[a];
        const Floats<W> low = smaller(smaller(from[a], from[3 + a]), from[6 + a]);
        const Floats<W> high = larger(larger(from[a], from[3 + a]), from[6 + a]);
        const Floats<W> outside = larger(larger(low, -high), Floats<W>(0.0f));
        square[a] = outside * outside;
    }
    const unsigned near = bits_of((square[0] + square[1]) + square[2] <= limit);
    if (!near) return 0u;
    const auto a_dot = [&](int vertex) {
        return (from[0] * from[3 * vertex] + from[1] * from[3 * vertex + 1]) + from[2] * from[3 * vertex + 2];
    };
    const Floats<W> aa = a_dot(0), smallest = smaller(smaller(aa, a_dot(1)), a_dot(2));
    return near & ~bits_of((smallest > MIN_DOT) & (smallest * smallest > aa * limit));
}
#endif

/// The search of the leaves of a tree. Triangles whose boxes are near wait until there are W of them. tried: a slot whose block
/// has been tested; -1 for none.
template <int W, int ROWS, class Triangles, class Kept> struct LeafSearch {
    const Triangles& triangles;
    const SearchPoint& point;
    Kept& kept;
    const int passed;
#if WRT_VECTORS
    float rows[9 * 2 * W];
    int slots[2 * W], size = 0;
#endif

    CUDA_CALLABLE LeafSearch(const Triangles& triangles, const SearchPoint& point, Kept& kept, int tried)
        : triangles(triangles)
        , point(point)
        , kept(kept)
        , passed(tried < 0 ? -1 : tried / W)
    {
#if WRT_VECTORS
        for (int row = 0; row < 9; ++row) save(rows + row * 2 * W, Floats<W>(0.0f));  // lanes that are not used yet
#endif
    }

    /// A leaf of some triangles, whose blocks begin at `block`.
    inline CUDA_CALLABLE void operator()(int block, int count)
    {
        kept.visit_leaf(count);
        for (; count > 0; count -= W, ++block) {
            if (block == passed) continue;
#if WRT_VECTORS
            const unsigned used = count < W ? (1u << count) - 1u : ~0u;
            Floats<W> from[9];
            const float* const record = triangles.records.data + (size_t)block * (ROWS * W);
            const unsigned near = near_triangles<W>(record, point, kept.limit, from) & used;
            if (!near) continue;
            if constexpr (can_pack<W>()) add(near, from, block * W);
            else
#endif
                search_block<W, ROWS>(triangles.records.data, triangles.primitive.data, block, point, kept);
        }
    }

    /// Tests those that wait.
    inline CUDA_CALLABLE void finish()
    {
#if WRT_VECTORS
        if (size > 0) test((1u << size) - 1u);
#endif
    }

#if WRT_VECTORS
private:
    inline void add(unsigned near, const Floats<W>* from, int first)
    {
        WRT_UNROLLED
        for (int row = 0; row < 9; ++row) save(rows + row * 2 * W + size, packed(from[row], near));
        save(slots + size, packed(lane_numbers<W>() + first, near));
        size += count_bits(near);
        if (size < W) return;
        test(~0u);
        size -= W;
        WRT_UNROLLED
        for (int row = 0; row < 9; ++row) save(rows + row * 2 * W, load<Floats<W>>(rows + row * 2 * W + W));
        save(slots, load<Ints<W>>(slots + W));
    }

    inline void test(unsigned used)
    {
        const auto at = [&](int i, int vertex) {
            const float* const from = rows + 6 * W * vertex + i;
            return Offset {from[0], from[2 * W], from[4 * W]};
        };
        search_lanes<W>(at, [&](int i) { return slots[i]; }, used, triangles.primitive.data, point, kept);
    }
#endif
};

}  // namespace
}  // namespace wrt
