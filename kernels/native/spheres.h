// Points as surfaces for rays: spheres, discs across a normal, and boxes along the axes (wrt.kernels.clouds).
#pragma once
#include "box.h"
#include "square_root.h"

namespace wrt {
namespace {

/// Components of a point's record: its centre and radius, and the normal of a disc; of a box its centre and half its edges.
constexpr int SPHERE = 4, BOX = 6, DISC = 7;

/// Writes the record of point `id`, its components `width` apart; NaN for an unused lane, id < 0. normals: of boxes the halves
/// of their edges.
inline CUDA_CALLABLE void copy_point(const float* points, const float* radii, bool one_radius, const float* normals,
    int components, int id, int width, float* to)
{
    for (int c = 0; c < components; ++c) {
        const size_t at = 3 * (size_t)id;
        const int own = components == BOX ? 3 : 4;
        to[c * width] = id < 0 ? WRT_NAN
            : c < 3            ? points[at + c]
            : c >= own         ? normals[at + c - own]
                               : radii[one_radius ? 0 : id];
    }
}

/// The box of a point whose components are `width` apart. That of a disc is enlarged by more than the rounding of its normal.
inline CUDA_CALLABLE void point_box(const float* record, int components, int width, float* low, float* high)
{
    for (int a = 0; a < 3; ++a) {
        float extent = record[(components == BOX ? 3 + a : 3) * width];
        if (components == DISC) {
            const float p = record[(4 + (a + 1) % 3) * width], q = record[(4 + (a + 2) % 3) * width];
            extent *= square_root(p * p + q * q) * 1.000001f;
        }
        low[a] = record[a * width] - extent;
        high[a] = record[a * width] + extent;
    }
}

/// By which the filter enlarges points, as a fraction of their distance and radius; `wrt.kernels.clouds` has the proof.
constexpr float POINT_MARGIN = 3.8146973e-6f;  // 2^-18

/// The lanes of a block whose spheres, or those around their boxes, the line of a ray may meet: none that it meets is left out.
template <int W, int COMPONENTS, class Ray>
inline CUDA_CALLABLE unsigned points_near(const float* records, int block, const Ray& ray)
{
    const float* const record = records + (size_t)block * (COMPONENTS * W);
    const float *const o = ray.origin.c, *const e = ray.unit.c;
    int near[block_lanes(W)] = {};
    WRT_FOR_LANES (i) {
        const float x = record[i] - o[0], y = record[W + i] - o[1], z = record[2 * W + i] - o[2];
        float radius = record[3 * W + i];
        if (COMPONENTS == BOX) {
            const float p = radius, q = record[4 * W + i], r = record[5 % COMPONENTS * W + i];
            radius = square_root(p * p + q * q + r * r) + 1e-22f;
        }
        const float size = ((WRT_ABS(x) + WRT_ABS(y)) + WRT_ABS(z)) + radius;
        const float limit = radius + POINT_MARGIN * size;
        const float along = x * e[0] + y * e[1] + z * e[2];
        const float p = x - along * e[0], q = y - along * e[1], r = z - along * e[2];
        near[i] = ((radius > 0.0f) & !(p * p + q * q + r * r > limit * limit)) ? -1 : 0;
    }
    return bits<block_lanes(W)>(near);
}

inline CUDA_CALLABLE double dot3(const double* a, const double* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

/// Two unit vectors that make a right-handed frame with a unit vector (Duff et al. 2017).
inline CUDA_CALLABLE void frame_of(const double* n, double* s, double* t)
{
    const double sign = n[2] < 0.0 ? -1.0 : 1.0, a = -1.0 / (sign + n[2]), b = n[0] * n[1] * a;
    s[0] = 1.0 + sign * n[0] * n[0] * a, s[1] = sign * b, s[2] = -sign * n[0];
    t[0] = b, t[1] = sign + n[1] * n[1] * a, t[2] = -n[1];
}

/// The unit vector along v, on an octahedron that is unfolded to a square: u, v from -1 to 1 (Cigolle et al. 2014).
inline CUDA_CALLABLE void fold(const double* v, float& x, float& y)
{
    const auto size = [](double a) { return a < 0.0 ? -a : a; };
    const double all = size(v[0]) + size(v[1]) + size(v[2]), p = v[0] / all, q = v[1] / all;
    const bool below = v[2] < 0.0;
    x = (float)(below ? (p < 0.0 ? size(q) - 1.0 : 1.0 - size(q)) : p);
    y = (float)(below ? (q < 0.0 ? size(p) - 1.0 : 1.0 - size(p)) : q);
}

/// The inverse of `fold`.
inline CUDA_CALLABLE void unfold(double x, double y, double* v)
{
    const auto size = [](double a) { return a < 0.0 ? -a : a; };
    const double z = 1.0 - size(x) - size(y), out = z < 0.0 ? -z : 0.0;
    v[0] = x < 0.0 ? x + out : x - out;
    v[1] = y < 0.0 ? y + out : y - out;
    v[2] = z;
    const double scale = 1.0 / square_root(dot3(v, v));
    for (int a = 0; a < 3; ++a) v[a] *= scale;
}

/// Where a line meets a point: none, one or two t, in order.
struct Roots {
    double t[2];
    int count;
};

/// The line t d and a sphere.
inline CUDA_CALLABLE Roots sphere_roots(const double* centre, const double* d, double radius)
{
    const double squared = dot3(d, d), middle = dot3(centre, d) / squared;
    const double beside[3] = {centre[0] - middle * d[0], centre[1] - middle * d[1], centre[2] - middle * d[2]};
    const double rest = radius * radius - dot3(beside, beside);
    if (!(rest >= 0.0)) return {{0.0, 0.0}, 0};
    const double half = square_root(rest / squared);
    return {{middle - half, middle + half}, 2};
}

/// The line t d and a disc.
inline CUDA_CALLABLE Roots disc_root(const double* centre, const double* d, double radius, const double* normal)
{
    const double slope = dot3(normal, d), t = dot3(normal, centre) / slope;
    const double beside[3] = {t * d[0] - centre[0], t * d[1] - centre[1], t * d[2] - centre[2]};
    const bool met = (slope != 0.0) & (dot3(beside, beside) <= radius * radius);
    return {{t, t}, met ? 1 : 0};
}

/// The line t d and a box. Along an axis in whose direction the line does not move, it is between both sides or misses.
inline CUDA_CALLABLE Roots box_roots(const double* centre, const double* d, const double* half)
{
    Roots found = {{-WRT_INFINITY, WRT_INFINITY}, 2};
    for (int a = 0; a < 3; ++a) {
        const double low = centre[a] - half[a], high = centre[a] + half[a];
        if (d[a] == 0.0) {
            if (low > 0.0 || high < 0.0) found.count = 0;
            continue;
        }
        const double in = (d[a] > 0.0 ? low : high) / d[a], out = (d[a] > 0.0 ? high : low) / d[a];
        found.t[0] = in > found.t[0] ? in : found.t[0];
        found.t[1] = out < found.t[1] ? out : found.t[1];
    }
    if (!(found.t[0] <= found.t[1])) found.count = 0;
    return found;
}

/// t of a ray's first meeting with the point in a slot from t_min on; NaN for none. Writes the surface coordinates u and v.
template <int W, int COMPONENTS, class Ray, class Slabs>
inline CUDA_CALLABLE float meet_point(
    const float* records, int slot, const Ray& ray, const Slabs& slabs, float t_min, float& u, float& v)
{
    const float* const record = records + (size_t)(slot / W) * (COMPONENTS * W) + slot % W;
    double centre[3], d[3], normal[3];
    for (int a = 0; a < 3; ++a) {
        centre[a] = (double)record[a * W] - (double)ray.origin.c[a];
        d[a] = ray.direction.c[a];
        normal[a] = COMPONENTS == DISC ? record[(COMPONENTS - 3 + a) * W] : 0.0f;
    }
    const double radius = record[3 * W], half[3] = {radius, record[4 % COMPONENTS * W], record[5 % COMPONENTS * W]};
    const Roots roots = COMPONENTS == DISC ? disc_root(centre, d, radius, normal)
        : COMPONENTS == BOX                ? box_roots(centre, d, half)
                                           : sphere_roots(centre, d, radius);
    if (roots.count == 0) return WRT_NAN;
    float low[3], high[3];
    point_box(record, COMPONENTS, W, low, high);
    const Interval own = meet_box(low, high, box_ray(slabs), -WRT_INFINITY, WRT_INFINITY);
    if (!(own.enter <= own.leave)) return WRT_NAN;
    float t = clamped((float)roots.t[0], own);
    const bool is_inside = (roots.count == 2) & !(t >= t_min);
    if (is_inside) t = clamped((float)roots.t[1], own);
    const double root = roots.t[is_inside ? 1 : 0];
    const double from[3] = {root * d[0] - centre[0], root * d[1] - centre[1], root * d[2] - centre[2]};
    if (COMPONENTS == DISC) {
        double side[3], other[3];
        frame_of(normal, side, other);
        u = (float)(dot3(from, side) / radius);
        v = (float)(dot3(from, other) / radius);
    } else if (COMPONENTS == BOX) {
        const double cube[3] = {from[0] / half[0], from[1] / half[1], from[2] / half[2]};
        fold(cube, u, v);
    } else fold(from, u, v);
    return t;
}

/// The place on a box, whose centre is 0, in the direction of a point of the cube of edge 2, and the normal of its side.
inline CUDA_CALLABLE void box_point(const float* half, const double* toward, double* place, double* across)
{
    int side = 0;
    double max_size = 0.0;
    for (int a = 0; a < 3; ++a) {
        const double size = toward[a] < 0.0 ? -toward[a] : toward[a];
        side = size > max_size ? a : side;
        max_size = size > max_size ? size : max_size;
    }
    for (int a = 0; a < 3; ++a) {
        place[a] = half[a] * (toward[a] / max_size);
        across[a] = a != side ? 0.0 : toward[a] < 0.0 ? -1.0 : 1.0;
    }
}

/// The place and the unit normal of a surface point, by its coordinates; normal: that of a disc, null for a sphere.
inline CUDA_CALLABLE void surface_point(
    const float* centre, double radius, const float* normal, double u, double v, double* place, double* across)
{
    double side[3], other[3];
    if (normal == nullptr) {
        unfold(u, v, across);
    } else {
        for (int a = 0; a < 3; ++a) across[a] = normal[a];
        frame_of(across, side, other);
    }
    for (int a = 0; a < 3; ++a) place[a] = centre[a] + radius * (normal == nullptr ? across[a] : u * side[a] + v * other[a]);
}

/// A triangle at a surface point, whose plane touches the surface there: three corners, the first of which is the point.
/// normal: as in `surface_point`, or half the edges of a box.
inline CUDA_CALLABLE void tangent_triangle(
    const float* centre, double radius, const float* normal, bool is_box, double u, double v, double size, float* corners)
{
    double place[3], across[3], side[3], other[3];
    if (is_box) {
        unfold(u, v, other);
        box_point(normal, other, place, across);
        for (int a = 0; a < 3; ++a) place[a] += centre[a];
    } else surface_point(centre, radius, normal, u, v, place, across);
    frame_of(across, side, other);
    for (int a = 0; a < 3; ++a) {
        corners[a] = (float)place[a];
        corners[3 + a] = (float)(place[a] + size * side[a]);
        corners[6 + a] = (float)(place[a] + size * other[a]);
    }
}

}  // namespace
}  // namespace wrt
