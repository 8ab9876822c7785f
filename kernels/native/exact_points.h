// The nearest triangles in float64: the search in float32 finds those that may be, and the vertices as they were given decide.
#pragma once
#include "point_groups.h"

namespace wrt {
namespace {

/// Distances of triangles may come out too large by this many times the slack of boxes (wrt.kernels.points).
constexpr float CANDIDATE_SLACK = 16.0f;

/// As FACE_SHARE and FACE_SLACK, for the rounding of float64.
constexpr double EXACT_SHARE = 1.0 + 1.0 / (1ull << 47), EXACT_SLACK = 1.0 / (1ull << 48) / (1ull << 48);

using ExactOffset = OffsetOf<double>;

inline CUDA_CALLABLE NearestOn<double> exactly_nearest(const ExactOffset& a, const ExactOffset& b, const ExactOffset& c)
{
    const NearestOn<double> found = nearest_on_edges(a, b, c);
    const ExactOffset e1 = b - a, e2 = c - a;
    const Foot<double> rough = foot_on_plane(a, e1, e2);  // of a thin triangle, in the wrong place
    const Foot<double> rest = foot_on_plane(moved(moved(a, rough.u, e1), rough.v, e2), e1, e2);
    const Foot<double> foot = {rough.u + rest.u, rough.v + rest.v, rough.area};
    const double square = square_of_foot(a, e1, e2, foot);
    if (square <= found.square * EXACT_SHARE + dot(a, a) * EXACT_SLACK) return {square, foot.u, foot.v, 2};
    return found;
}

/// A triangle in a scene of meshes, less the point, which is in the scene's coordinates.
template <class Space, class Mesh>
inline CUDA_CALLABLE NearestOn<double> nearest_of(const Space&, const Mesh& mesh, const ExactOffset& point, int number)
{
    const auto& face = mesh.faces.data[number];
    ExactOffset corner[3];
    for (int k = 0; k < 3; ++k) {
        const auto& at = mesh.vertices.data[face.c[k]];
        corner[k] = {at.c[0] - point.x, at.c[1] - point.y, at.c[2] - point.z};
    }
    return exactly_nearest(corner[0], corner[1], corner[2]);
}

/// The same in a scene of instances, whose `space` has the point relative to the scene's centre.
template <class Kind, int U, class Top, class Parts, class Geometries>
inline CUDA_CALLABLE NearestOn<double> nearest_of(
    const PointInstances<Kind, U, Top, Parts>& space, const Geometries& geometries, const ExactOffset&, int number)
{
    const auto& place = space.top.placements.data[space.instance_of(number)];
    const auto& geometry = geometries.data[place.geometry];
    const auto& face = geometry.mesh.faces.data[number - place.first];
    const auto& m = place.to_scene.data;
    const double x = space.x - place.origin.c[0], y = space.y - place.origin.c[1], z = space.z - place.origin.c[2];
    ExactOffset corner[3];
    for (int k = 0; k < 3; ++k) {
        const auto& at = geometry.mesh.vertices.data[face.c[k]];
        const double p = at.c[0] - geometry.center.c[0], q = at.c[1] - geometry.center.c[1], r = at.c[2] - geometry.center.c[2];
        corner[k] = {((m[0][0] * p + m[0][1] * q) + m[0][2] * r) - x, ((m[1][0] * p + m[1][1] * q) + m[1][2] * r) - y,
            ((m[2][0] * p + m[2][1] * q) + m[2][2] * r) - z};
    }
    return exactly_nearest(corner[0], corner[1], corner[2]);
}

/// A search for what is near enough in float32, with distances in float64.
template <class Space, class Triangles> struct ExactSearch : Search {
    const Space& space;
    const Triangles& triangles;
    ExactOffset point;
    double exact_max_distance;

    CUDA_CALLABLE ExactSearch(const Space& space, const Triangles& triangles, const ExactOffset& point, double max_distance)
        : space(space)
        , triangles(triangles)
        , point(point)
        , exact_max_distance(max_distance)
    {
        this->max_distance = (float)max_distance;
    }

    /// The greatest distance at which a triangle counts, if the last of those that were found is at `distance`.
    inline CUDA_CALLABLE float nearer(double distance) const
    {
        return (float)(distance < exact_max_distance ? distance : exact_max_distance) * WIDENED;
    }

    inline CUDA_CALLABLE void look_up_to(float away, float slack)
    {
        Search::look_up_to(away + CANDIDATE_SLACK * slack * scale, slack);
    }

    inline CUDA_CALLABLE NearestOn<double> measure(int number) const { return nearest_of(space, triangles, point, number); }
};

/// As `NearestTriangle`.
template <class Space, class Triangles> struct ExactNearest : ExactSearch<Space, Triangles> {
    double distance = WRT_INFINITY;
    NearestOn<double> at = {0.0, 0.0, 0.0, -1};
    int number = -1, slot = -1;

    using ExactSearch<Space, Triangles>::ExactSearch;

    inline CUDA_CALLABLE float farthest() const { return this->nearer(distance); }

    inline CUDA_CALLABLE void keep(float, int primitive, int place, const SearchPoint& from)
    {
        const int own = this->first + primitive;
        if (own == number) return;
        const NearestOn<double> on = this->measure(own);
        const double away = square_root(on.square);
        if (!(away <= this->exact_max_distance) || !((away < distance) | ((away == distance) & (own < number)))) return;
        distance = away, number = own, slot = place, at = on;
        this->look_up_to(farthest(), from.slack);
    }
};

/// As `NearestList`: the `room` nearest triangles from a place of the answers on, sorted by distance, then number.
template <class Space, class Triangles, class Exact, class Found> struct ExactList : ExactSearch<Space, Triangles> {
    const Exact& exact;
    TriangleRows<Found> rows;
    int room, size = 0;

    CUDA_CALLABLE ExactList(const ExactSearch<Space, Triangles>& search, const Exact& exact, const Found& found, int i)
        : ExactSearch<Space, Triangles>(search)
        , exact(exact)
        , rows {found, (size_t)i * exact.room}
        , room(exact.room)
    {
    }

    inline CUDA_CALLABLE double& distance(int i) const { return exact.t.data[rows.begin + i]; }
    inline CUDA_CALLABLE double& weight(int i, int which) const { return exact.uv.data[rows.begin + i].c[which]; }
    inline CUDA_CALLABLE signed char& feature(int i) const { return (signed char&)rows.found.feature.data[rows.begin + i]; }

    /// Whether triangle i comes before one of this distance and number.
    inline CUDA_CALLABLE bool before(int i, double away, int number) const
    {
        return distance(i) < away || (distance(i) == away && rows.number(i) < number);
    }

    inline CUDA_CALLABLE void put(int i, const NearestOn<double>& on, double away, int number, int slot) const
    {
        distance(i) = away, weight(i, 0) = on.u, weight(i, 1) = on.v, feature(i) = (signed char)on.feature;
        rows.put(i, (float)away, number, slot);
    }

    inline CUDA_CALLABLE float farthest() const { return this->nearer(size == room ? distance(room - 1) : WRT_INFINITY); }

    inline CUDA_CALLABLE void keep(float, int primitive, int slot, const SearchPoint& from)
    {
        const int own = this->first + primitive;
        const NearestOn<double> on = this->measure(own);
        const double away = square_root(on.square);
        if (!(away <= this->exact_max_distance)) return;
        int place = size;
        while (place > 0 && !before(place - 1, away, own)) --place;
        if (place == room || (place < size && rows.number(place) == own)) return;
        if (size < room) ++size;
        for (int i = size - 1; i > place; --i) {
            const NearestOn<double> before = {0.0, weight(i - 1, 0), weight(i - 1, 1), feature(i - 1)};
            put(i, before, distance(i - 1), rows.number(i - 1), rows.slot(i - 1));
        }
        put(place, on, away, own, slot);
        this->look_up_to(farthest(), from.slack);
    }

    /// Writes weights in place of slots, and what is not there.
    inline CUDA_CALLABLE void finish() const
    {
        for (int i = size; i < room; ++i) put(i, {0.0, 0.0, 0.0, -1}, WRT_INFINITY, -1, 0);
        for (int i = 0; i < room; ++i)
            for (int which = 0; which < 2; ++which) rows.weight(i, which) = (float)weight(i, which);
    }
};

/// The nearest triangles of GROUP points from number `first` of the order on.
template <int GROUP, class Space, class Points, class Triangles, class Exact, class Found>
inline CUDA_CALLABLE void exact_nearest_of_group(
    Space space, const Points& points, const Triangles& triangles, const Exact& exact, const Found& found, int first)
{
    int last[2] = {-1, -1};
    for (int place = first; place < first + GROUP && place < points.count; ++place) {
        const int i = point_at(points, place);
        const auto& point = exact.point.data[i];
        const double max_distance = exact.max_distance.data[(size_t)i * points.distance_stride];
        ExactNearest<Space, Triangles> kept(space, triangles, {point.c[0], point.c[1], point.c[2]}, max_distance);
        search_point(space, points, i, kept, last, last[1] >= 0);
        if (kept.slot >= 0) last[0] = kept.number, last[1] = kept.slot;
        exact.t.data[i] = kept.distance;
        exact.uv.data[i].c[0] = kept.at.u, exact.uv.data[i].c[1] = kept.at.v;
        found.distance.data[i] = (float)kept.distance;
        found.primitive.data[i] = kept.number;
        found.uv.data[i].c[0] = (float)kept.at.u, found.uv.data[i].c[1] = (float)kept.at.v;
        found.feature.data[i] = (signed char)kept.at.feature;
    }
}

/// The same, of the `exact.room` nearest triangles of each point, in rows.
template <int GROUP, class Space, class Points, class Triangles, class Exact, class Found>
inline CUDA_CALLABLE void exact_lists_of_group(
    Space space, const Points& points, const Triangles& triangles, const Exact& exact, const Found& found, int first)
{
    int last[2 * TRIED], count = 0;
    for (int place = first; place < first + GROUP && place < points.count; ++place) {
        const int i = point_at(points, place);
        const auto& point = exact.point.data[i];
        const double max_distance = exact.max_distance.data[(size_t)i * points.distance_stride];
        const ExactSearch<Space, Triangles> search(space, triangles, {point.c[0], point.c[1], point.c[2]}, max_distance);
        ExactList<Space, Triangles, Exact, Found> kept(search, exact, found, i);
        search_point(space, points, i, kept, last, count);
        if (kept.size > 0)
            for (count = 0; count < kept.size && count < TRIED; ++count)
                last[2 * count] = kept.rows.number(count), last[2 * count + 1] = kept.rows.slot(count);
        kept.finish();
    }
}

}  // namespace
}  // namespace wrt
