// Rays of sensors, and what a ray alone says of its pixel: loops over blocks of rays that Clang vectorises.
//
// Vectors and quaternions are Warp's, and so are normalize and quat_rotate: a ray has the bits that
// wrt.kernels.sensors.lidar_beams gives one alone.
#pragma once
#include "loops.h"

namespace wrt {
namespace {

/// The directions begin .. end - 1 of axes, normalised and turned.
template <class Vec3d, class Vec3, class Quat>
inline CUDA_CALLABLE void turn_axes(const Vec3* __restrict axes, const Quat& turn, int begin, int end, Vec3* __restrict turned)
{
    const int n = end - begin;
    WRT_FOR (n, i) {
        const Vec3 axis = axes[begin + i];
        const Vec3d v = quat_rotate(turn, normalize(Vec3d(axis.c[0], axis.c[1], axis.c[2])));
        turned[begin + i] = Vec3(float(v.c[0]), float(v.c[1]), float(v.c[2]));
    }
}

/// Distance and depth of the rays begin .. end - 1; null for an image that is not asked for. `order` is null if ray i is that of
/// pixel place + i; `own` is the number of pixels of a camera.
template <class Vec3>
inline CUDA_CALLABLE void write_depths(const float* __restrict t, const int* __restrict primitive, const Vec3* __restrict axes,
    const int* __restrict order, int place, int own, float miss, int begin, int end, float* __restrict distance,
    float* __restrict depth)
{
    const int n = end - begin, pixel = place + begin;
    if (order == nullptr && pixel + n <= own) {
        if (distance)
            WRT_FOR (n, i) distance[pixel + i] = primitive[begin + i] >= 0 ? t[begin + i] : miss;
        if (depth)
            WRT_FOR (n, i) {
                const float seen = t[begin + i] * axes[pixel + i].c[2];
                depth[pixel + i] = primitive[begin + i] >= 0 ? seen : miss;
            }
        return;
    }
    for (int i = begin; i < end; ++i) {
        const int at = order ? order[place + i] : place + i;
        const bool hit = primitive[i] >= 0;
        if (distance) distance[at] = hit ? t[i] : miss;
        if (depth) depth[at] = hit ? t[i] * axes[at % own].c[2] : miss;
    }
}

/// The points of the rays begin .. end - 1; NaN for a miss. `shared` says whether all rays have the first origin.
template <class Vec3, class Vec3d>
inline CUDA_CALLABLE void write_positions(const float* __restrict t, const int* __restrict primitive,
    const Vec3* __restrict directions, const Vec3d* __restrict origins, bool shared, const int* __restrict order, int place,
    int begin, int end, Vec3d* __restrict position)
{
    const double nan = WRT_NAN;
    const int n = end - begin;
    if (order == nullptr && shared) {
        const double x = origins[0].c[0], y = origins[0].c[1], z = origins[0].c[2];
        WRT_FOR (n, i) {
            const double far = t[begin + i];
            const Vec3 d = directions[begin + i];
            const bool hit = primitive[begin + i] >= 0;
            const double px = x + far * double(d.c[0]), py = y + far * double(d.c[1]), pz = z + far * double(d.c[2]);
            position[place + begin + i] = Vec3d(hit ? px : nan, hit ? py : nan, hit ? pz : nan);
        }
        return;
    }
    for (int i = begin; i < end; ++i) {
        const Vec3d from = origins[shared ? 0 : i];
        const double far = t[i];
        const Vec3 d = directions[i];
        const Vec3d point(from.c[0] + far * double(d.c[0]), from.c[1] + far * double(d.c[1]), from.c[2] + far * double(d.c[2]));
        position[order ? order[place + i] : place + i] = primitive[i] >= 0 ? point : Vec3d(nan, nan, nan);
    }
}

}  // namespace
}  // namespace wrt
