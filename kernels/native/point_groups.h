// Answers of groups of points. Each point begins with what was nearest to the one before it.
#pragma once
#include "point_lists.h"

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

/// Number of the point at a place in the order.
template <class Points> inline CUDA_CALLABLE int point_at(const Points& points, int place)
{
    return points.order.shape[0] ? points.order.data[place] : place;
}

/// Searches a point, if it can find anything.
template <class Space, class Points, class Kept>
inline CUDA_CALLABLE void search_point(Space& space, const Points& points, int i, Kept& kept, const int* tried, int count)
{
    if (!(space.load(points, i) & (kept.most >= 0.0f))) return;
    space.start(kept);
    for (int j = 0; j < count; ++j) space.try_near(tried[2 * j], tried[2 * j + 1], kept);
    space.search(kept);
}

/// The nearest triangles of GROUP points from number `first` of the order on. Kept: `NearestTriangle` or `CountedNearest`.
template <class Kept, int GROUP, class Space, class Points, class Found, class Work>
inline CUDA_CALLABLE void nearest_of_group(Space space, const Points& points, const Found& found, const Work& work, int first)
{
    int last[2] = {-1, -1};
    for (int place = first; place < first + GROUP && place < points.count; ++place) {
        const int i = point_at(points, place);
        Kept kept(points.most.data[(size_t)i * points.most_stride]);
        search_point(space, points, i, kept, last, last[1] >= 0);
        OnTriangle at = {0.0f, 0.0f, 0.0f, -1};
        if (kept.slot >= 0) {
            last[0] = kept.number, last[1] = kept.slot;
            at = space.nearest(kept.number, kept.slot);
        }
        found.distance.data[i] = kept.distance;
        found.primitive.data[i] = kept.number;
        found.uv.data[i].c[0] = at.u, found.uv.data[i].c[1] = at.v;
        found.feature.data[i] = (signed char)at.feature;
        store_work(kept, work, i);
    }
}

/// The same, of the `room` nearest triangles of each point, in rows.
template <int GROUP, class Space, class Points, class Found>
inline CUDA_CALLABLE void nearest_lists_of_group(Space space, const Points& points, const Found& found, int room, int first)
{
    int last[2 * TRIED], count = 0;
    for (int place = first; place < first + GROUP && place < points.count; ++place) {
        const int i = point_at(points, place);
        NearestList<Found> kept(points.most.data[(size_t)i * points.most_stride], found, (size_t)i * room, room);
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
        TriangleCount kept(points.most.data[(size_t)i * points.most_stride]);
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
        const float most = points.most.data[(size_t)i * points.most_stride];
        TriangleList<decltype(lists.found)> kept(most, lists.found, (size_t)lists.begin.data[i]);
        search_point(space, points, i, kept, nullptr, 0);
        kept.rows.sort(kept.size);
        const int size = kept.rows.drop_repeated(kept.size);
        kept.rows.finish(space, size);
        lists.count.data[i] = size;
    }
}

}  // namespace
}  // namespace wrt
