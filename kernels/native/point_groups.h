// Answers of groups of points. Each point begins with what was nearest to the one before it.
#pragma once
#include "point_lists.h"
#include "point_packets.h"

namespace wrt {
namespace {

/// Triangles of a list that are tried for the next point.
constexpr int TRIED = 8;

template <class Work> inline CUDA_CALLABLE void store_work(const NearestTriangle&, const Work&, int) { }

template <class Work> inline CUDA_CALLABLE void store_work(const CountedNearest& found, const Work& work, int i)
{
    auto& row = work.rows.data[i];
    row.nodes = found.nodes, row.leaves = found.leaves, row.triangles = found.triangles;
}

/// Fetches the position of the point at a place in the order, and where its answer goes.
template <class Points, class Found> inline CUDA_CALLABLE void fetch_ahead(const Points& points, const Found& found, int place)
{
    if (place >= points.count) return;
    const int i = point_at(points, place);
    WRT_FETCH(points.position.data + i);
    if (points.exact.shape[0]) WRT_FETCH(points.exact.data + i);
    if (points.distance_stride) WRT_FETCH(points.max_distance.data + i);
    WRT_FETCH_TO_WRITE(found.distance.data + i);
    WRT_FETCH_TO_WRITE(found.primitive.data + i);
    WRT_FETCH_TO_WRITE(found.uv.data + i);
    WRT_FETCH_TO_WRITE(found.feature.data + i);
}

/// Searches a point, if it can find anything.
template <class Space, class Points, class Kept>
inline CUDA_CALLABLE void search_point(Space& space, const Points& points, int i, Kept& kept, const int* tried, int count)
{
    if (!(space.load(points, i) & (kept.max_distance >= 0.0f))) return;
    space.start(kept);
    for (int j = 0; j < count; ++j) space.try_near(tried[2 * j], tried[2 * j + 1], kept);
    space.search(kept);
}

/// What was found for W points, and the vertices of the triangles less the points.
template <int W> struct GroupAnswers {
    float distance[W], vertices[9 * W] = {};
    float u[W], v[W];
    int number[W], feature[W];

    template <class Space, class Kept> inline CUDA_CALLABLE void put(int i, const Space& space, const Kept& kept)
    {
        distance[i] = kept.distance, number[i] = kept.number;
        if (kept.slot >= 0) put_triangle(i, space.triangle(kept.number, kept.slot));
    }

    inline CUDA_CALLABLE void put_triangle(int i, const Triangle& found)
    {
        for (int vertex = 0; vertex < 3; ++vertex) {
            float* const to = vertices + 3 * W * vertex + i;
            to[0] = found.vertex[vertex].x, to[W] = found.vertex[vertex].y, to[2 * W] = found.vertex[vertex].z;
        }
    }

    inline CUDA_CALLABLE Offset at(int i, int vertex) const
    {
        const float* const from = vertices + 3 * W * vertex + i;
        return {from[0], from[W], from[2 * W]};
    }

    inline CUDA_CALLABLE void set(int i, bool has, const OnTriangle& on)
    {
        u[i] = has ? on.u : 0.0f, v[i] = has ? on.v : 0.0f, feature[i] = has ? on.feature : -1;
    }

    /// Computes weights and features, all lanes at once, but for the few flat triangles.
    inline CUDA_CALLABLE void finish()
    {
        int flat[W];
        WRT_FOR_LANES (i) {
            bool is_thin;
            const OnTriangle on = nearest_in_float32(at(i, 0), at(i, 1), at(i, 2), is_thin);
            set(i, number[i] >= 0, on);
            flat[i] = (is_thin & (number[i] >= 0)) ? -1 : 0;
        }
        for (unsigned thin = bits<W>(flat); thin; thin &= thin - 1u) {
            const int i = lowest_bit(thin);
            set(i, true, nearest_on_triangle(at(i, 0), at(i, 1), at(i, 2)));
        }
    }

    /// Writes the answers of `count` points from number `begin` of the order on.
    template <class Points, class Found>
    inline CUDA_CALLABLE void store(const Points& points, const Found& found, int begin, int count) const
    {
        for (int j = 0; j < count; ++j) {
            const int i = point_at(points, begin + j);
            found.distance.data[i] = distance[j];
            found.primitive.data[i] = number[j];
            found.uv.data[i].c[0] = u[j], found.uv.data[i].c[1] = v[j];
            found.feature.data[i] = (signed char)feature[j];
        }
    }
};

/// The nearest triangles of GROUP points from number `first` of the order on. Kept: `NearestTriangle` or `CountedNearest`.
///
/// Points of a tree of boxes begin together, below what all of them can leave out, and walk it in packets where they are dense.
template <class Kept, int GROUP, class Space, class Points, class Found, class Work>
inline CUDA_CALLABLE void nearest_of_group(Space space, const Points& points, const Found& found, const Work& work, int first)
{
    constexpr int LANES = GROUP > 1 ? Space::LANES : 0, MAX_WIDTH = LANES > 2 ? LANES : 16,
                  W = GROUP < MAX_WIDTH ? GROUP : MAX_WIDTH;
    int number = -1, last[3] = {-1, -1, -1};  // slots
    typename Space::Start start;
    for (int begin = first; begin < first + GROUP && begin < points.count; begin += W) {
        GroupAnswers<W> answers;
        const int count = points.count - begin < W ? points.count - begin : W;
        for (int j = 0; j < W; ++j) answers.number[j] = -1;
        for (int j = 0; j < count; ++j) {
            if constexpr (LANES > 0) {
                if ((j == (begin == first)) & (last[1] >= 0)) {
                    const GroupBounds all = space.bounds_of_group(points, begin + j, count - j, last[1]);
#if WRT_VECTORS
                    if constexpr (!Kept::COUNTS && LANES > 2)
                        if (all.are_dense) {
                            for (int k = j; k < count; ++k) fetch_ahead(points, found, begin + k + W);
                            nearest_of_packet(space, points, begin + j, count - j, last, j, answers);
                            break;
                        }
#endif
                    space.start_at = nullptr;
                    if (all.limit < WRT_INFINITY) start.gather(space.tree, all.box, all.limit), space.start_at = &start;
                }
            }
            const int i = point_at(points, begin + j), tried[2] = {number, last[1]};
            fetch_ahead(points, found, begin + j + W);
            Kept kept(points.max_distance.data[(size_t)i * points.distance_stride]);
            search_point(space, points, i, kept, tried, last[1] >= 0);
            if (kept.slot >= 0) number = kept.number, last[0] = last[1] = last[2] = kept.slot;
            answers.put(j, space, kept);
            store_work(kept, work, i);
        }
        answers.finish();
        answers.store(points, found, begin, count);
    }
}

/// The same, of the `room` nearest triangles of each point, in rows.
template <int GROUP, class Space, class Points, class Found>
inline CUDA_CALLABLE void nearest_lists_of_group(Space space, const Points& points, const Found& found, int room, int first)
{
    int last[2 * TRIED], count = 0;
    for (int place = first; place < first + GROUP && place < points.count; ++place) {
        const int i = point_at(points, place);
        NearestList<Found> kept(points.max_distance.data[(size_t)i * points.distance_stride], found, (size_t)i * room, room);
        search_point(space, points, i, kept, last, count);
        if (kept.size > 0)
            for (count = 0; count < kept.size && count < TRIED; ++count)
                last[2 * count] = kept.rows.number(count), last[2 * count + 1] = kept.rows.slot(count);
        kept.rows.finish(space, kept.size);
        for (int j = kept.size; j < room; ++j) {
            kept.rows.put(j, WRT_INFINITY, -1, 0);
            kept.rows.weight(j, 1) = 0.0f;
            found.feature.data[kept.rows.begin + j] = -1;
        }
    }
}

/// Writes the number of triangles within the distance of GROUP points, some of them several times.
template <int GROUP, class Space, class Points, class Lists>
inline CUDA_CALLABLE void count_within_group(Space space, const Points& points, const Lists& lists, int first)
{
    for (int place = first; place < first + GROUP && place < points.count; ++place) {
        const int i = point_at(points, place);
        TriangleCount kept(points.max_distance.data[(size_t)i * points.distance_stride]);
        search_point(space, points, i, kept, nullptr, 0);
        lists.count.data[i] = kept.size;
    }
}

/// Writes these triangles from `begin` of each point on, sorted, each once, and their numbers.
template <int GROUP, class Space, class Points, class Lists>
inline CUDA_CALLABLE void list_within_group(Space space, const Points& points, const Lists& lists, int first)
{
    for (int place = first; place < first + GROUP && place < points.count; ++place) {
        const int i = point_at(points, place);
        const float max_distance = points.max_distance.data[(size_t)i * points.distance_stride];
        TriangleList<decltype(lists.found)> kept(max_distance, lists.found, (size_t)lists.begin.data[i]);
        search_point(space, points, i, kept, nullptr, 0);
        kept.rows.sort(kept.size);
        const int size = kept.rows.drop_repeated(kept.size);
        kept.rows.finish(space, size);
        lists.count.data[i] = size;
    }
}

}  // namespace
}  // namespace wrt
