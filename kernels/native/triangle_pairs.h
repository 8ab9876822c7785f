// Two triangles in float64: whether they meet, exactly, and their nearest points.
//
// wrt.kernels.pairs has the cases and the errors. Triangles are closed, and those without an area are segments or points.
#pragma once
#include "exact_signs.h"
#include "square_root.h"

namespace wrt {
namespace {
namespace pairs {

struct Corners {
    Place v[3];
    Place low, high;  // of their box

    inline CUDA_CALLABLE void bound()
    {
        low = high = v[0];
        for (int i = 1; i < 3; ++i) {
            low = {v[i].x < low.x ? v[i].x : low.x, v[i].y < low.y ? v[i].y : low.y, v[i].z < low.z ? v[i].z : low.z};
            high = {v[i].x > high.x ? v[i].x : high.x, v[i].y > high.y ? v[i].y : high.y, v[i].z > high.z ? v[i].z : high.z};
        }
    }
};

/// The number after one of a triangle's vertices.
inline CUDA_CALLABLE int after(int vertex) { return vertex == 2 ? 0 : vertex + 1; }

/// The distance of two intervals.
inline CUDA_CALLABLE double gap(double low, double high, double other_low, double other_high)
{
    const double above = other_low - high, below = low - other_high, outside = above > below ? above : below;
    return outside > 0.0 ? outside : 0.0;
}

/// The squared distance of two boxes.
inline CUDA_CALLABLE double box_square(const Corners& a, const Corners& b)
{
    const double x = gap(a.low.x, a.high.x, b.low.x, b.high.x), y = gap(a.low.y, a.high.y, b.low.y, b.high.y);
    const double z = gap(a.low.z, a.high.z, b.low.z, b.high.z);
    return (x * x + y * y) + z * z;
}

inline CUDA_CALLABLE bool is_same(const Place& p, const Place& q) { return (p.x == q.x) & (p.y == q.y) & (p.z == q.z); }

/// Whether the boxes of two segments meet along an axis.
inline CUDA_CALLABLE bool overlap_along(const Place& p, const Place& q, const Place& a, const Place& b, int axis)
{
    const double p_at = coordinate(p, axis), q_at = coordinate(q, axis), a_at = coordinate(a, axis), b_at = coordinate(b, axis);
    const double low = p_at < q_at ? p_at : q_at, high = p_at < q_at ? q_at : p_at;
    return ((a_at < b_at ? a_at : b_at) <= high) & (low <= (a_at < b_at ? b_at : a_at));
}

/// Whether two closed segments meet, seen along an axis.
inline CUDA_CALLABLE bool segments_meet_in_plane(const Place& p, const Place& q, const Place& a, const Place& b, int axis)
{
    for (int other = 0; other < 3; ++other)
        if (other != axis && !overlap_along(p, q, a, b, other)) return false;
    return side_in_plane(p, q, a, axis) * side_in_plane(p, q, b, axis) <= 0
        && side_in_plane(a, b, p, axis) * side_in_plane(a, b, q, axis) <= 0;
}

/// Whether two closed segments meet.
WRT_SEPARATE CUDA_CALLABLE bool segments_meet(const Place& p, const Place& q, const Place& a, const Place& b)
{
    for (int axis = 0; axis < 3; ++axis)
        if (!overlap_along(p, q, a, b, axis)) return false;
    if (side_of(p, q, a, b) != 0) return false;
    for (int axis = 0; axis < 3; ++axis)
        if (side_in_plane(p, q, a, axis) | side_in_plane(p, q, b, axis) | side_in_plane(a, b, p, axis)
            | side_in_plane(a, b, q, axis))
            return segments_meet_in_plane(p, q, a, b, axis);  // their plane is not seen edge on
    return true;  // on one line, and in each other's boxes
}

/// Whether a segment in the plane of a triangle meets it; the triangle may have no area.
WRT_SEPARATE CUDA_CALLABLE bool meets_in_plane(const Place& p, const Place& q, const Corners& t)
{
    for (int axis = 0; axis < 3; ++axis) {
        const int turn = side_in_plane(t.v[0], t.v[1], t.v[2], axis);
        if (turn == 0) continue;
        bool inside = true;
        for (int i = 0; i < 3; ++i) {
            if (segments_meet_in_plane(p, q, t.v[i], t.v[after(i)], axis)) return true;
            inside = inside && side_in_plane(t.v[i], t.v[after(i)], p, axis) * turn > 0;
        }
        return inside;
    }
    for (int i = 0; i < 3; ++i)
        if (segments_meet(p, q, t.v[i], t.v[after(i)])) return true;
    return false;
}

/// Whether a closed segment meets a triangle. above, below: the sides of the triangle's plane on which its ends are.
WRT_SEPARATE CUDA_CALLABLE bool segment_meets(const Place& p, const Place& q, const Corners& t, int above, int below)
{
    if (above * below > 0) return false;
    if (above == 0 && below == 0) return meets_in_plane(p, q, t);
    const int first = side_of(p, q, t.v[0], t.v[1]), second = side_of(p, q, t.v[1], t.v[2]);
    if (first * second < 0) return false;
    const int third = side_of(p, q, t.v[2], t.v[0]);
    return first * third >= 0 && second * third >= 0;
}

/// The sides of a triangle's plane on which the vertices of another one are; whether these may meet it.
inline CUDA_CALLABLE bool sides_of(const Corners& plane, const Corners& other, int* side)
{
    for (int i = 0; i < 3; ++i) side[i] = side_of(plane.v[0], plane.v[1], plane.v[2], other.v[i]);
    return side[0] * side[1] <= 0 || side[1] * side[2] <= 0;
}

/// Whether two triangles have a point in common.
WRT_SEPARATE CUDA_CALLABLE bool meet(const Corners& a, const Corners& b)
{
    if (box_square(a, b) > 0.0) return false;
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j)
            if (is_same(a.v[i], b.v[j])) return true;
    int of_a[3], of_b[3];
    if (!sides_of(b, a, of_a) || !sides_of(a, b, of_b)) return false;
    for (int i = 0; i < 3; ++i)
        if (segment_meets(a.v[i], a.v[after(i)], b, of_a[i], of_a[after(i)])) return true;
    for (int i = 0; i < 3; ++i)
        if (segment_meets(b.v[i], b.v[after(i)], a, of_b[i], of_b[after(i)])) return true;
    return false;
}

/// Points of two triangles, and the square of their distance.
struct Nearest {
    double square;
    Place p, q;

    inline CUDA_CALLABLE void take(const Place& x, const Place& y)
    {
        const Place apart = x - y;
        const double other = dot(apart, apart);
        if (other < square) square = other, p = x, q = y;
    }

    inline CUDA_CALLABLE void take_turned(const Place& x, const Place& y, bool turned) { turned ? take(y, x) : take(x, y); }
};

inline CUDA_CALLABLE Place along(const Place& a, double s, const Place& e)
{
    return {a.x + s * e.x, a.y + s * e.y, a.z + s * e.z};
}

/// The point of a segment that is nearest to p, measured from its nearer end.
WRT_SEPARATE CUDA_CALLABLE Place nearest_on_segment(const Place& p, const Place& a, const Place& b)
{
    const Place to_a = p - a, to_b = p - b;
    const bool second = dot(to_b, to_b) < dot(to_a, to_a);
    const Place from = second ? b : a, e = second ? a - b : b - a;
    const double s = dot(second ? to_b : to_a, e) / dot(e, e);
    if (!(s > 0.0)) return from;  // a segment without a length gives a NaN
    return s < 1.0 ? along(from, s, e) : second ? a : b;
}

/// The nearest points of two edges if both are inside; twice, as edges that are nearly parallel leave an error the first time.
WRT_SEPARATE CUDA_CALLABLE void take_edges(const Place& a, const Place& b, const Place& c, const Place& d, Nearest& found)
{
    const Place e = b - a, f = d - c, n = cross(e, f);
    const double square = dot(n, n);
    double s = 0.0, t = 0.0;
    Place x = a, y = c;
    for (int i = 0; i < 2; ++i) {
        const Place apart = y - x;
        s += dot(cross(apart, f), n) / square, t += dot(cross(apart, e), n) / square;
        x = along(a, s, e), y = along(c, t, f);
    }
    if ((s > 0.0) & (s < 1.0) & (t > 0.0) & (t < 1.0)) found.take(x, y);
}

/// The foot of a point on a face if it is inside, also in two steps.
WRT_SEPARATE CUDA_CALLABLE void take_foot(const Place& p, const Corners& t, bool turned, Nearest& found)
{
    const Place e = t.v[1] - t.v[0], f = t.v[2] - t.v[0], n = cross(e, f);
    const double square = dot(n, n);
    double v = 0.0, w = 0.0;
    Place x = t.v[0];
    for (int i = 0; i < 2; ++i) {
        const Place apart = p - x;
        v += dot(cross(apart, f), n) / square, w += dot(cross(e, apart), n) / square;
        x = along(along(t.v[0], v, e), w, f);
    }
    if ((v > 0.0) & (w > 0.0) & (v + w < 1.0)) found.take_turned(p, x, turned);
}

/// What the vertices of a have nearest to b; turned: whether b is the first triangle.
WRT_SEPARATE CUDA_CALLABLE void take_vertices(const Corners& a, const Corners& b, bool turned, Nearest& found)
{
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) found.take_turned(a.v[i], nearest_on_segment(a.v[i], b.v[j], b.v[after(j)]), turned);
        take_foot(a.v[i], b, turned, found);
    }
}

/// Where edges of a pass through b, and the feet of these points on b; turned: whether b is the first triangle.
WRT_SEPARATE CUDA_CALLABLE void take_crossings(const Corners& a, const Corners& b, bool turned, Nearest& found)
{
    const Place n = cross(b.v[1] - b.v[0], b.v[2] - b.v[0]);
    for (int i = 0; i < 3; ++i) {
        const Place p = a.v[i], e = a.v[after(i)] - p;
        const double s = dot(n, b.v[0] - p) / dot(n, e);
        if ((s > 0.0) & (s < 1.0)) take_foot(along(p, s, e), b, turned, found);
    }
}

/// Moves a triangle and its box.
inline CUDA_CALLABLE Corners less(const Corners& t, const Place& by)
{
    return {{t.v[0] - by, t.v[1] - by, t.v[2] - by}, t.low - by, t.high - by};
}

/// The nearest points of two triangles. Those of triangles that meet are the same but for rounding, and their distance is 0.
WRT_SEPARATE CUDA_CALLABLE Nearest nearest_of(const Corners& first, const Corners& second)
{
    const Place base = first.v[0];
    const Corners a = less(first, base), b = less(second, base);
    Nearest found = {__builtin_bit_cast(double, 0x7ff0000000000000ull), {0.0, 0.0, 0.0}, {0.0, 0.0, 0.0}};
    take_vertices(a, b, false, found), take_vertices(b, a, true, found);
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) take_edges(a.v[i], a.v[after(i)], b.v[j], b.v[after(j)], found);
    if (meet(first, second)) {
        take_crossings(a, b, false, found), take_crossings(b, a, true, found);
        found.square = 0.0;
    }
    found.p = along(base, 1.0, found.p), found.q = along(base, 1.0, found.q);
    return found;
}

}  // namespace pairs
}  // namespace
}  // namespace wrt
