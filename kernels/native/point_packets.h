// Packets of W points that are near each other: they walk a tree together, and each triangle is tested for all of them.
//
// A box or a triangle is left out only if its distance from the box of the points is above the limit of every point. That
// distance is rounded like those from the points, and each step is monotonous, so it is no greater than any of these.
#pragma once
#include "point_spaces.h"

namespace wrt {
namespace {

#if WRT_VECTORS
/// W points, and the nearest triangle to each. `limit`: the greatest of all; walks read it.
template <int W, int ROWS, class Triangles> struct NearestOfPacket {
    const Triangles& triangles;
    float at[3][W], slack[W], max_distance[W], distance[W], bounds[W], limits[W];
    int number[W], slot[W];
    BoxOfPoints box;
    float limit;

    explicit NearestOfPacket(const Triangles& triangles)
        : triangles(triangles)
    {
    }

    inline void visit_node() { }

    /// Takes `count` points; the other lanes, and points that find nothing, are at a point that does. False if there is none.
    template <class Space, class Points> inline bool load(Space& space, const Points& points, int begin, int count)
    {
        unsigned used = 0;
        for (int i = 0; i < W; ++i) {
            distance[i] = WRT_INFINITY, number[i] = slot[i] = -1;
            bounds[i] = limits[i] = max_distance[i] = -1.0f, slack[i] = 0.0f;
            if (i >= count) continue;
            const int own = point_at(points, begin + i);
            const float farthest = points.max_distance.data[(size_t)own * points.distance_stride];
            if (!(space.load(points, own) & (farthest >= 0.0f))) continue;
            used |= 1u << i;
            at[0][i] = space.point.x, at[1][i] = space.point.y, at[2][i] = space.point.z;
            Search search;
            search.look_up_to(farthest, space.point.slack);
            slack[i] = space.point.slack, max_distance[i] = farthest, bounds[i] = search.bound, limits[i] = search.limit;
        }
        if (!used) return false;
        const int first = lowest_bit(used);
        for (int a = 0; a < 3; ++a) {
            for (int i = 0; i < W; ++i) at[a][i] = used >> i & 1u ? at[a][i] : at[a][first];
            box.low[a] = __builtin_reduce_min(load_lanes(at[a])), box.high[a] = __builtin_reduce_max(load_lanes(at[a]));
        }
        limit = __builtin_reduce_max(load_lanes(limits));
        return true;
    }

    /// Keeps a triangle, in the slot `place`, for a point at a squared distance from it.
    inline void keep(int i, float square, int own, int place)
    {
        const float away = square_root(square);
        const bool nearer = (away < distance[i]) | ((away == distance[i]) & (own < number[i]));
        if (!((square <= bounds[i]) & (away <= max_distance[i]) & nearer)) return;
        Search search;
        search.look_up_to(away, slack[i]);
        distance[i] = away, number[i] = own, slot[i] = place, bounds[i] = search.bound, limits[i] = search.limit;
    }

    /// Tests the triangle in a slot.
    inline void test(int place)
    {
        const float* const record = triangles.records.data + (size_t)(place / W) * (ROWS * W) + place % W;
        const int own = triangles.primitive.data[place];
        float corner[9], low[3], high[3];
        for (int row = 0; row < 9; ++row) corner[row] = record[row * W];
        for (int a = 0; a < 3; ++a) {
            low[a] = smaller(smaller(corner[a], corner[3 + a]), corner[6 + a]);
            high[a] = larger(larger(corner[a], corner[3 + a]), corner[6 + a]);
        }
        int flag[W];
        WRT_FOR_LANES (i) {
            const float x = outside(low[0], high[0], at[0][i]), y = outside(low[1], high[1], at[1][i]);
            const float z = outside(low[2], high[2], at[2][i]);
            flag[i] = (x * x + y * y) + z * z <= limits[i] ? -1 : 0;
        }
        if (!bits<W>(flag)) return;
        const auto vertex = [&](int i, int k) {
            return Offset {corner[3 * k] - at[0][i], corner[3 * k + 1] - at[1][i], corner[3 * k + 2] - at[2][i]};
        };
        WRT_FOR_LANES (i) {
            const Offset a = vertex(i, 0);
            const float aa = dot(a, a), smallest = smaller(smaller(aa, dot(a, vertex(i, 1))), dot(a, vertex(i, 2)));
            flag[i] = ((smallest > MIN_DOT) & (smallest * smallest > aa * limits[i])) ? 0 : flag[i];
        }
        if (!bits<W>(flag)) return;
        WRT_FOR_LANES (i) {
            bool is_thin;
            const float square = square_in_float32(vertex(i, 0), vertex(i, 1), vertex(i, 2), is_thin),
                        away = square_root(square);
            flag[i] = is_thin ? -1 : 0;
            const bool nearer = (away < distance[i]) | ((away == distance[i]) & (own < number[i]));
            const bool counts = (square <= bounds[i]) & (away <= max_distance[i]) & nearer & !is_thin;
            const float wider = away * WIDENED + MIN_DISTANCE, widest = wider + slack[i];
            distance[i] = counts ? away : distance[i], number[i] = counts ? own : number[i];
            slot[i] = counts ? place : slot[i];
            bounds[i] = counts ? wider * wider : bounds[i], limits[i] = counts ? widest * widest * WIDENED : limits[i];
        }
        for (unsigned thin = bits<W>(flag); thin; thin &= thin - 1u) {
            const int i = lowest_bit(thin);
            keep(i, nearest_on_triangle(vertex(i, 0), vertex(i, 1), vertex(i, 2)).square, own, place);
        }
        limit = __builtin_reduce_max(load_lanes(limits));
    }

    /// A leaf.
    inline void operator()(int block, int count)
    {
        for (; count > 0; count -= W, ++block) {
            const float* const record = triangles.records.data + (size_t)block * (ROWS * W);
            int near[W];
            WRT_FOR_LANES (i) {
                float gap[3];
                for (int a = 0; a < 3; ++a) {
                    const float p = record[a * W + i], q = record[(3 + a) * W + i], r = record[(6 + a) * W + i];
                    gap[a] = distance_along(smaller(smaller(p, q), r), larger(larger(p, q), r), box, a);
                }
                near[i] = (gap[0] * gap[0] + gap[1] * gap[1]) + gap[2] * gap[2] <= limit ? -1 : 0;
            }
            unsigned left = bits<W>(near) & (count < W ? (1u << count) - 1u : ~0u);
            for (; left; left &= left - 1u) test(block * W + lowest_bit(left));
        }
    }

private:
    static inline Floats<W> load_lanes(const float* from) { return wrt::load<Floats<W>>(from); }
};

/// The nearest triangles of `count` points, at most the lanes of a node, from number `begin` of the order on; of one tree of
/// boxes.
///
/// last: slots of three triangles that are tried first, or -1; some that were found.
template <class Space, class Points, class Answers>
inline void nearest_of_packet(Space& space, const Points& points, int begin, int count, int* last, int to, Answers& answers)
{
    constexpr int W = Space::LANES, ROWS = Space::Leaves::TRIANGLE_ROWS;
    NearestOfPacket<W, ROWS, decltype(space.triangles)> kept(space.triangles);
    if (kept.load(space, points, begin, count)) {
        for (int j = 0; j < 3; ++j)
            if (last[j] >= 0 && (j == 0 || last[j] != last[j - 1])) kept.test(last[j]);
        walk_boxes<W>(space.tree, 0, kept.box, kept, kept);
        for (int j = 0; j < 3; ++j) last[j] = kept.slot[j * (count - 1) / 2];
    }
    for (int i = 0; i < count; ++i) {
        answers.distance[to + i] = kept.distance[i], answers.number[to + i] = kept.number[i];
        const SearchPoint point = {kept.at[0][i], kept.at[1][i], kept.at[2][i], 0.0f};
        if (kept.slot[i] >= 0)
            answers.put_triangle(to + i, triangle_in_slot<W, ROWS>(space.triangles.records.data, kept.slot[i], point));
    }
}
#endif

}  // namespace
}  // namespace wrt
