// The nearest point of a triangle.
//
// wrt.kernels.points has the formulas and the bounds of their rounding, and point_triangle.py the same operations in plain Warp.
// Everything is relative to the point, which is the origin.
#pragma once
#include "lanes.h"

namespace wrt {
namespace {

/// A triangle whose doubled area squared is less than this part of its edges' product has its weights computed in float64.
constexpr float FLAT = 0.0009765625f;

/// The same for areas outside of this range, in which float32 keeps all digits.
constexpr float LEAST_AREA = 1e-30f, GREATEST_AREA = 1e30f;

/// A foot on the face is nearer than all edges, so it is taken although rounding makes it farther, by no more than this part of its
/// squared distance and this part of that of the triangle's first vertex.
constexpr float FACE_SHARE = 1.000003814697265625f, FACE_SLACK = 3.637978807091713e-12f;

struct Offset {
    float x, y, z;
};

inline CUDA_CALLABLE Offset operator-(const Offset& p, const Offset& q) { return {p.x - q.x, p.y - q.y, p.z - q.z}; }
inline CUDA_CALLABLE float dot(const Offset& p, const Offset& q) { return (p.x * q.x + p.y * q.y) + p.z * q.z; }

inline CUDA_CALLABLE Offset cross(const Offset& p, const Offset& q)
{
    return {p.y * q.z - p.z * q.y, p.z * q.x - p.x * q.z, p.x * q.y - p.y * q.x};
}

inline CUDA_CALLABLE Offset moved(const Offset& p, float t, const Offset& e)
{
    return {p.x + t * e.x, p.y + t * e.y, p.z + t * e.z};
}

/// The nearest point of an edge: the square of its distance, and its place from the nearer end, whichever that is.
struct OnEdge {
    float square, place;
    bool from_second;
};

/// pp, qq: squared lengths of the ends p and q. Both triangles at an edge get the same square.
inline CUDA_CALLABLE OnEdge nearest_on_edge(const Offset& p, const Offset& q, float pp, float qq)
{
    const bool second = qq < pp;
    const Offset d = q - p, base = {second ? q.x : p.x, second ? q.y : p.y, second ? q.z : p.z};
    const Offset e = {second ? -d.x : d.x, second ? -d.y : d.y, second ? -d.z : d.z};
    float t = -dot(base, e) / dot(e, e);
    t = t > 0.0f ? t : 0.0f;
    t = t < 1.0f ? t : 1.0f;
    const Offset at = moved(base, t, e);
    return {dot(at, at), t, second};
}

/// The nearest point of a triangle: the square of its distance, the weights of b and c, and the dimension of what it is on.
struct OnTriangle {
    float square, u, v;
    int feature;
};

/// Weights of b and c at the foot of the perpendicular on the plane. The triangle has no area: NaN, or an infinity.
struct Foot {
    float u, v;
    bool flat;
};

inline CUDA_CALLABLE Foot foot_on_plane(const Offset& a, const Offset& ab, const Offset& ac)
{
    const Offset n = cross(ab, ac);
    const float area = dot(n, n);
    const bool sure = (area >= FLAT * (dot(ab, ab) * dot(ac, ac))) & (area > LEAST_AREA) & (area < GREATEST_AREA);
    return {dot(n, cross(ac, a)) / area, dot(n, cross(a, ab)) / area, !sure};
}

/// The same in float64, for triangles without much of an area.
inline CUDA_CALLABLE Foot exact_foot(const Offset& a, const Offset& ab, const Offset& ac)
{
    const double ax = a.x, ay = a.y, az = a.z, bx = ab.x, by = ab.y, bz = ab.z, cx = ac.x, cy = ac.y, cz = ac.z;
    const double nx = by * cz - bz * cy, ny = bz * cx - bx * cz, nz = bx * cy - by * cx;
    const double area = (nx * nx + ny * ny) + nz * nz;
    const double b = (nx * (cy * az - cz * ay) + ny * (cz * ax - cx * az)) + nz * (cx * ay - cy * ax);
    const double c = (nx * (ay * bz - az * by) + ny * (az * bx - ax * bz)) + nz * (ax * by - ay * bx);
    return {(float)(b / area), (float)(c / area), false};
}

/// The squared distance of the foot if it is inside the face; infinity if not.
inline CUDA_CALLABLE float square_of_foot(const Offset& a, const Offset& ab, const Offset& ac, const Foot& foot)
{
    const Offset at = moved(moved(a, foot.u, ab), foot.v, ac);
    const bool within = (foot.u > 0.0f) & (foot.v > 0.0f) & (foot.u + foot.v < 1.0f);
    return within ? dot(at, at) : WRT_INFINITY;
}

/// The nearest point of one triangle.
inline CUDA_CALLABLE OnTriangle nearest_on_triangle(const Offset& a, const Offset& b, const Offset& c)
{
    const float aa = dot(a, a), bb = dot(b, b), cc = dot(c, c);
    const OnEdge ab = nearest_on_edge(a, b, aa, bb), bc = nearest_on_edge(b, c, bb, cc), ca = nearest_on_edge(c, a, cc, aa);
    const float from_a = 1.0f - ab.place, from_b = 1.0f - bc.place, from_c = 1.0f - ca.place;
    OnTriangle found = {ab.square, ab.from_second ? from_a : ab.place, 0.0f, 0};
    float place = ab.place;
    if (bc.square < found.square) {
        found = {bc.square, bc.from_second ? bc.place : from_b, bc.from_second ? from_b : bc.place, 0};
        place = bc.place;
    }
    if (ca.square < found.square) {
        found = {ca.square, 0.0f, ca.from_second ? ca.place : from_c, 0};
        place = ca.place;
    }
    found.feature = ((place > 0.0f) & (place < 1.0f)) ? 1 : 0;
    const Offset e1 = b - a, e2 = c - a;
    Foot foot = foot_on_plane(a, e1, e2);
    if (foot.flat) foot = exact_foot(a, e1, e2);
    const float square = square_of_foot(a, e1, e2, foot);
    if (square <= found.square * FACE_SHARE + aa * FACE_SLACK) found = {square, foot.u, foot.v, 2};
    return found;
}

}  // namespace
}  // namespace wrt
