// The nearest point of a triangle.
//
// wrt.kernels.points has the formulas and the bounds of their rounding, and point_triangle.py the same operations in plain
// Warp. Everything is relative to the point, which is the origin.
#pragma once
#include "lanes.h"

namespace wrt {
namespace {

/// A triangle whose doubled area squared is less than this part of its edges' product has its weights computed in float64.
constexpr float FLAT = 0.0009765625f;

/// The same for areas outside of this range, in which float32 keeps all digits.
constexpr float MIN_AREA = 1e-30f, MAX_AREA = 1e30f;

/// A foot on the face is nearer than all edges, so it is taken although rounding makes it farther, by no more than this part of
/// its squared distance and this part of that of the triangle's first vertex.
constexpr float FACE_SHARE = 1.000003814697265625f, FACE_SLACK = 3.637978807091713e-12f;

template <class T> struct OffsetOf {
    T x, y, z;
};

using Offset = OffsetOf<float>;

template <class T> inline CUDA_CALLABLE OffsetOf<T> operator-(const OffsetOf<T>& p, const OffsetOf<T>& q)
{
    return {p.x - q.x, p.y - q.y, p.z - q.z};
}

template <class T> inline CUDA_CALLABLE T dot(const OffsetOf<T>& p, const OffsetOf<T>& q)
{
    return (p.x * q.x + p.y * q.y) + p.z * q.z;
}

template <class T> inline CUDA_CALLABLE OffsetOf<T> cross(const OffsetOf<T>& p, const OffsetOf<T>& q)
{
    return {p.y * q.z - p.z * q.y, p.z * q.x - p.x * q.z, p.x * q.y - p.y * q.x};
}

template <class T> inline CUDA_CALLABLE OffsetOf<T> moved(const OffsetOf<T>& p, T t, const OffsetOf<T>& e)
{
    return {p.x + t * e.x, p.y + t * e.y, p.z + t * e.z};
}

/// The nearest point of an edge: the square of its distance, and its place from the nearer end, whichever that is.
template <class T> struct OnEdge {
    T square, place;
    bool from_second;
};

/// pp, qq: squared lengths of the ends p and q. Both triangles at an edge get the same square.
template <class T> inline CUDA_CALLABLE OnEdge<T> nearest_on_edge(const OffsetOf<T>& p, const OffsetOf<T>& q, T pp, T qq)
{
    const bool second = qq < pp;
    const OffsetOf<T> d = q - p, base = {second ? q.x : p.x, second ? q.y : p.y, second ? q.z : p.z};
    const OffsetOf<T> e = {second ? -d.x : d.x, second ? -d.y : d.y, second ? -d.z : d.z};
    T t = -dot(base, e) / dot(e, e);
    t = t > 0.0f ? t : 0.0f;
    t = t < 1.0f ? t : 1.0f;
    const OffsetOf<T> at = moved(base, t, e);
    return {dot(at, at), t, second};
}

/// The nearest point of a triangle: the square of its distance, the weights of b and c, and the dimension of what it is on.
template <class T> struct NearestOn {
    T square, u, v;
    int feature;
};

using OnTriangle = NearestOn<float>;

/// Weights of b and c at the foot of the perpendicular on the plane, and the doubled area squared. No area: NaN, or an
/// infinity.
template <class T> struct Foot {
    T u, v, area;
};

template <class T>
inline CUDA_CALLABLE Foot<T> foot_on_plane(const OffsetOf<T>& a, const OffsetOf<T>& ab, const OffsetOf<T>& ac)
{
    const OffsetOf<T> n = cross(ab, ac);
    const T area = dot(n, n);
    return {dot(n, cross(ac, a)) / area, dot(n, cross(a, ab)) / area, area};
}

/// Whether float32 is not enough for the weights of a foot.
inline CUDA_CALLABLE bool is_flat(const Foot<float>& foot, const Offset& ab, const Offset& ac)
{
    const bool sure = foot.area >= FLAT * (dot(ab, ab) * dot(ac, ac));
    return !(sure & (foot.area > MIN_AREA) & (foot.area < MAX_AREA));
}

inline CUDA_CALLABLE OffsetOf<double> widened(const Offset& p) { return {p.x, p.y, p.z}; }

/// The squared distance of the foot if it is inside the face; infinity if not.
template <class T>
inline CUDA_CALLABLE T square_of_foot(const OffsetOf<T>& a, const OffsetOf<T>& ab, const OffsetOf<T>& ac, const Foot<T>& foot)
{
    const OffsetOf<T> at = moved(moved(a, foot.u, ab), foot.v, ac);
    const bool within = (foot.u > 0.0f) & (foot.v > 0.0f) & (foot.u + foot.v < 1.0f);
    return within ? dot(at, at) : WRT_INFINITY;
}

/// The nearest point of the edges of a triangle.
template <class T>
inline CUDA_CALLABLE NearestOn<T> nearest_on_edges(const OffsetOf<T>& a, const OffsetOf<T>& b, const OffsetOf<T>& c)
{
    const T aa = dot(a, a), bb = dot(b, b), cc = dot(c, c), one = 1.0f, zero = 0.0f;
    const OnEdge<T> ab = nearest_on_edge(a, b, aa, bb), bc = nearest_on_edge(b, c, bb, cc), ca = nearest_on_edge(c, a, cc, aa);
    const bool on_bc = bc.square < ab.square;
    const T nearest_edge = on_bc ? bc.square : ab.square;
    const bool on_ca = ca.square < nearest_edge, second = on_ca ? ca.from_second : on_bc ? bc.from_second : ab.from_second;
    const T place = on_ca ? ca.place : on_bc ? bc.place : ab.place, rest = one - place;
    const T of_first = second ? place : rest, of_second = second ? rest : place;
    const T u = on_ca ? zero : on_bc ? of_first : of_second, v = on_ca ? of_first : on_bc ? of_second : zero;
    return {on_ca ? ca.square : nearest_edge, u, v, ((place > 0.0f) & (place < 1.0f)) ? 1 : 0};
}

/// The better of the nearest point of the edges and the foot on the face.
inline CUDA_CALLABLE OnTriangle nearer_of(
    const OnTriangle& on_edges, const Offset& a, const Offset& e1, const Offset& e2, const Foot<float>& foot)
{
    const float square = square_of_foot(a, e1, e2, foot);
    const bool on_face = square <= on_edges.square * FACE_SHARE + dot(a, a) * FACE_SLACK;
    return {on_face ? square : on_edges.square, on_face ? foot.u : on_edges.u, on_face ? foot.v : on_edges.v,
        on_face ? 2 : on_edges.feature};
}

/// The nearest point of one triangle.
inline CUDA_CALLABLE OnTriangle nearest_on_triangle(const Offset& a, const Offset& b, const Offset& c)
{
    const Offset e1 = b - a, e2 = c - a;
    Foot<float> foot = foot_on_plane(a, e1, e2);
    if (is_flat(foot, e1, e2)) {
        const Foot<double> exact = foot_on_plane(widened(a), widened(e1), widened(e2));
        foot = {(float)exact.u, (float)exact.v, foot.area};
    }
    return nearer_of(nearest_on_edges(a, b, c), a, e1, e2, foot);
}

/// The same without float64; `is_thin` tells that it would need it.
inline CUDA_CALLABLE OnTriangle nearest_in_float32(const Offset& a, const Offset& b, const Offset& c, bool& is_thin)
{
    const Offset e1 = b - a, e2 = c - a;
    const Foot<float> foot = foot_on_plane(a, e1, e2);
    is_thin = is_flat(foot, e1, e2);
    return nearer_of(nearest_on_edges(a, b, c), a, e1, e2, foot);
}

/// The same, the square only.
inline CUDA_CALLABLE float square_in_float32(const Offset& a, const Offset& b, const Offset& c, bool& is_thin)
{
    const float aa = dot(a, a), bb = dot(b, b), cc = dot(c, c);
    const float ab = nearest_on_edge(a, b, aa, bb).square, bc = nearest_on_edge(b, c, bb, cc).square;
    const float ca = nearest_on_edge(c, a, cc, aa).square;
    float nearest_edge = bc < ab ? bc : ab;
    nearest_edge = ca < nearest_edge ? ca : nearest_edge;
    const Offset e1 = b - a, e2 = c - a;
    const Foot<float> foot = foot_on_plane(a, e1, e2);
    is_thin = is_flat(foot, e1, e2);
    const float face = square_of_foot(a, e1, e2, foot);
    return face <= nearest_edge * FACE_SHARE + aa * FACE_SLACK ? face : nearest_edge;
}

}  // namespace
}  // namespace wrt
