// Rays of a batch: the check on loading, by one rule for a ray and for lanes (wrt.kernels.layout.ray_batch), and what box tests
// need of a ray (wrt.kernels.simd.boxes).
#pragma once
#include "box.h"

namespace wrt {
namespace {

/// Widening of boxes as a fraction of the ray's reach.
constexpr float SLACK = 9.5367431640625e-07f;

/// Smallest normal float: a direction whose components are all smaller is no direction.
constexpr float SHORTEST = 1.1754943508222875e-38f;

/// Largest float: no ray ends beyond it.
constexpr float FARTHEST = 3.4028234663852886e38f;

/// Fraction of a direction's largest component below which another component counts as 0.
constexpr float NEGLIGIBLE = 7.888609052210118e-31f;

/// SHORTEST / NEGLIGIBLE.
constexpr float MIN_SIZE = 1.4901161193847656e-08f;

inline CUDA_CALLABLE float largest_size(float x, float y, float z)
{
    const float size_x = WRT_ABS(x), size_y = WRT_ABS(y), size_z = WRT_ABS(z);
    const float size = size_x > size_y ? size_x : size_y;
    return size > size_z ? size : size_z;
}

/// Sets the negligible components of a direction to 0; NaN is kept (`usable_direction`).
inline CUDA_CALLABLE void drop_negligible(float& x, float& y, float& z)
{
    const float size = largest_size(x, y, z), negligible = (size > MIN_SIZE ? size : MIN_SIZE) * NEGLIGIBLE;
    x = WRT_ABS(x) < negligible ? 0.0f : x;
    y = WRT_ABS(y) < negligible ? 0.0f : y;
    z = WRT_ABS(z) < negligible ? 0.0f : z;
}

/// Whether a ray is one (`checked_ray`), from its direction x, y, z, its origin and its range.
inline CUDA_CALLABLE bool is_ray(float x, float y, float z, float px, float py, float pz, float t_min, float t_max)
{
    const float size = largest_size(x, y, z);
    return (x - x == 0.0f) & (y - y == 0.0f) & (z - z == 0.0f) & (px - px == 0.0f) & (py - py == 0.0f) & (pz - pz == 0.0f)
        & (size >= SHORTEST) & (t_min >= 0.0f) & (t_min <= t_max);
}

/// How far the box from `low` to `high` extends from a point along an axis.
template <class Vec> inline CUDA_CALLABLE float reach(const Vec& low, const Vec& high, float x, float y, float z)
{
    float far = WRT_ABS(low.c[0] - x), f;
    f = WRT_ABS(high.c[0] - x), far = f > far ? f : far;
    f = WRT_ABS(low.c[1] - y), far = f > far ? f : far;
    f = WRT_ABS(high.c[1] - y), far = f > far ? f : far;
    f = WRT_ABS(low.c[2] - z), far = f > far ? f : far;
    f = WRT_ABS(high.c[2] - z), far = f > far ? f : far;
    return far;
}

/// What box tests need of a ray from (x, y, z), with 1 / direction.
inline CUDA_CALLABLE BoxRay widened_ray(float ix, float iy, float iz, float x, float y, float z, float slack)
{
    const float step_x = ix < 0.0f ? -slack : slack, step_y = iy < 0.0f ? -slack : slack, step_z = iz < 0.0f ? -slack : slack;
    return {{ix, iy, iz}, {x + step_x, y + step_y, z + step_z}, {x - step_x, y - step_y, z - step_z}};
}

/// The same from its direction and its reach, `far` (`ray_slabs`).
inline CUDA_CALLABLE BoxRay box_ray(float x, float y, float z, float px, float py, float pz, float far)
{
    return widened_ray(1.0f / x, 1.0f / y, 1.0f / z, px, py, pz, SLACK * far);
}

/// The normal of a triangle, in float64. triangle: its first component, those of a block of W triangles being W floats apart.
template <int W> inline CUDA_CALLABLE void face_normal(const float* triangle, double* normal)
{
    double u[3], v[3];
    for (int a = 0; a < 3; ++a) {
        u[a] = (double)triangle[(3 + a) * W] - triangle[a * W];
        v[a] = (double)triangle[(6 + a) * W] - triangle[a * W];
    }
    normal[0] = u[1] * v[2] - u[2] * v[1];
    normal[1] = u[2] * v[0] - u[0] * v[2];
    normal[2] = u[0] * v[1] - u[1] * v[0];
}

/// Whether a ray comes from the front of a triangle; its direction is derived from 1 / direction, which every traversal has.
inline CUDA_CALLABLE bool is_front(const double* normal, float ix, float iy, float iz)
{
    const double along_x = normal[0] * (double)(1.0f / ix), along_y = normal[1] * (double)(1.0f / iy);
    const double along_z = normal[2] * (double)(1.0f / iz);
    return (along_x + along_y) + along_z < 0.0;
}

/// A coordinate relative to the centre of the scene.
inline CUDA_CALLABLE float relative(float x, double center) { return (float)((double)x - center); }

/// L rays of a batch in lanes. given_origin, given_direction: as the caller gives them; origin: relative to the scene's centre;
/// direction: without negligible components. It is not loaded to where it is stored, as in a select between the two the
/// compiler makes a masked store, which is slow. here: how many are rays of the batch; those beyond are the first again.
/// stored: -1 for those that are valid, else 0.
template <int L> struct RayLanes {
    alignas(64) float given_direction[3][L];
    alignas(64) float longest[L];
    float given_origin[3][L], origin[3][L], direction[3][L], t_min[L], t[L];
    int stored[L], here;
};

/// Calls store(k, x, y, z) for the vectors of L rays from `first` on.
template <int L, class Vec, class Store>
inline CUDA_CALLABLE void load_vectors(const Vec* from, int stride, int first, int here, const Store& store)
{
    if (here == L && stride) {
        const float* v = (const float*)(from + first);
        WRT_FOR (L, k) {
            store(k, v[3 * k], v[3 * k + 1], v[3 * k + 2]);
        }
    } else {
        WRT_SCALAR
        for (int k = 0; k < L; ++k) {
            const Vec v = from[(first + (k < here ? k : 0)) * stride];
            store(k, v.c[0], v.c[1], v.c[2]);
        }
    }
}

/// Loads the ends of the ranges of L rays from `first` on.
template <int L> inline CUDA_CALLABLE void load_ends(const float* from, int stride, int first, int here, float* to)
{
    if (stride == 0) {
        const float all = from[0];
        WRT_FOR (L, k) {
            to[k] = all;
        }
    } else if (here == L) {
        WRT_FOR (L, k) {
            to[k] = from[first + k];
        }
    } else {
        WRT_SCALAR
        for (int k = 0; k < L; ++k) to[k] = from[first + (k < here ? k : 0)];
    }
}

/// Loads `rays.here` rays of a batch from `first` on. RELATIVE: their origins relative to the centre, or as the caller gives
/// them.
template <bool RELATIVE, int L, class Batch>
inline CUDA_CALLABLE void load_lanes(const Batch& batch, int first, RayLanes<L>& rays)
{
    const double center_x = batch.center.c[0], center_y = batch.center.c[1], center_z = batch.center.c[2];
    const int here = rays.here;
    load_vectors<L>(batch.origins.data, batch.origin_stride, first, here, [&](int k, float x, float y, float z) {
        if constexpr (RELATIVE) {
            rays.origin[0][k] = relative(x, center_x);
            rays.origin[1][k] = relative(y, center_y);
            rays.origin[2][k] = relative(z, center_z);
        } else {
            rays.given_origin[0][k] = x, rays.given_origin[1][k] = y, rays.given_origin[2][k] = z;
        }
    });
    load_vectors<L>(batch.directions.data, batch.direction_stride, first, here, [&](int k, float x, float y, float z) {
        rays.given_direction[0][k] = x, rays.given_direction[1][k] = y, rays.given_direction[2][k] = z;
    });
    load_ends<L>(batch.t_min.data, batch.t_min_stride, first, here, rays.t_min);
    load_ends<L>(batch.t_max.data, batch.t_max_stride, first, here, rays.longest);
    WRT_FOR (L, k) {
        rays.t[k] = rays.longest[k] > FARTHEST ? FARTHEST : rays.longest[k];
    }
}

/// Makes given origins relative to the centre.
template <int L, class Batch> inline CUDA_CALLABLE void center_lanes(const Batch& batch, RayLanes<L>& rays)
{
    const double center_x = batch.center.c[0], center_y = batch.center.c[1], center_z = batch.center.c[2];
    WRT_FOR (L, k) {
        rays.origin[0][k] = relative(rays.given_origin[0][k], center_x);
        rays.origin[1][k] = relative(rays.given_origin[1][k], center_y);
        rays.origin[2][k] = relative(rays.given_origin[2][k], center_z);
    }
}

/// Makes the given directions usable, and finds which rays are valid.
template <int L> inline CUDA_CALLABLE void check_lanes(RayLanes<L>& rays)
{
    WRT_FOR (L, k) {
        float x = rays.given_direction[0][k], y = rays.given_direction[1][k], z = rays.given_direction[2][k];
        drop_negligible(x, y, z);
        rays.direction[0][k] = x, rays.direction[1][k] = y, rays.direction[2][k] = z;
    }
    WRT_FOR (L, k) {
        const bool valid = is_ray(rays.direction[0][k], rays.direction[1][k], rays.direction[2][k], rays.origin[0][k],
            rays.origin[1][k], rays.origin[2][k], rays.t_min[k], rays.t[k]);
        rays.stored[k] = valid ? -1 : 0;
    }
}

/// What a stream keeps of a ray, in 4-byte words, each a row of lanes: its `RaySlabs`, range and best hit, then the state of
/// the triangle test.
struct RayRows {
    enum { INVERSE = 0, IN = 3, OUT = 6, T_MIN = 9, T = 10, PRIMITIVE = 11, U = 12, V = 13, STATE = 14 };
};

template <int L> inline CUDA_CALLABLE BoxRay box_ray(const float (*words)[L], int k)
{
    return {{words[RayRows::INVERSE][k], words[RayRows::INVERSE + 1][k], words[RayRows::INVERSE + 2][k]},
        {words[RayRows::IN][k], words[RayRows::IN + 1][k], words[RayRows::IN + 2][k]},
        {words[RayRows::OUT][k], words[RayRows::OUT + 1][k], words[RayRows::OUT + 2][k]}};
}

/// Writes the rows before the state, of rays without a hit. low, high: bounds of the scene.
template <int L, class Vec>
inline CUDA_CALLABLE void write_rows(const RayLanes<L>& rays, const Vec& low, const Vec& high, float (*words)[L])
{
    int* const primitive = (int*)words[RayRows::PRIMITIVE];
    WRT_FOR (L, k) {
        const float x = rays.direction[0][k], y = rays.direction[1][k], z = rays.direction[2][k];
        const float px = rays.origin[0][k], py = rays.origin[1][k], pz = rays.origin[2][k];
        const BoxRay ray = box_ray(x, y, z, px, py, pz, reach(low, high, px, py, pz));
        words[0][k] = ray.inverse[0], words[1][k] = ray.inverse[1], words[2][k] = ray.inverse[2];
        words[RayRows::IN][k] = ray.in[0], words[RayRows::IN + 1][k] = ray.in[1], words[RayRows::IN + 2][k] = ray.in[2];
        words[RayRows::OUT][k] = ray.out[0], words[RayRows::OUT + 1][k] = ray.out[1], words[RayRows::OUT + 2][k] = ray.out[2];
        words[RayRows::T_MIN][k] = rays.t_min[k] + 0.0f;  // turns -0 into +0: as an integer, -0 would be the least key of all
        words[RayRows::T][k] = rays.t[k];
        primitive[k] = -1;
        words[RayRows::U][k] = 0.0f, words[RayRows::V][k] = 0.0f;
    }
}

}  // namespace
}  // namespace wrt
