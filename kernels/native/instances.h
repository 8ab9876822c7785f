// Packets in scenes of instances (wrt.kernels.traversal.two_level.instance_rays).
#pragma once
#include "packet_load.h"

namespace wrt {
namespace {

/// The rays of a packet in the scene and their best hits, with the packet itself, in the memory of a run of packets. number: of
/// each ray in the batch; bound: t of the best hit, t_max before it, or -inf for a ray that is invalid or done.
template <int P, int W, bool SHARED> struct SceneRays {
    static constexpr int ROWS = 8;
    Packet<P, W, SHARED> packet;
    int* number;
    float *bound, *to_x, *to_y, *to_z, *t_min, *t;
    int* primitive;
    float *u, *v;
    double *from_x, *from_y, *from_z;

    template <class Memory>
    explicit CUDA_CALLABLE SceneRays(const Memory& memory)
        : packet(memory.packet.data)
        , number(memory.number.data)
        , bound(memory.bound.data)
    {
        float* const rows = memory.scene.data;
        to_x = rows, to_y = rows + P, to_z = rows + 2 * P, t_min = rows + 3 * P, t = rows + 4 * P;
        primitive = (int*)(rows + 5 * P), u = rows + 6 * P, v = rows + 7 * P;
        from_x = memory.origin.data, from_y = from_x + P, from_z = from_y + P;
    }

    /// take(k, n): ray k has what is at place n.
    template <class Take> inline CUDA_CALLABLE void fetch(int stride, Take take) const
    {
        if (stride) {
            WRT_SCALAR
            for (int k = 0; k < P; ++k) take(k, number[k]);
        } else {
            WRT_FOR (P, k) {
                take(k, 0);
            }
        }
    }
};

/// Fetches the rays of a packet, without hits; returns the greatest absolute value of a coordinate of their origins.
template <int P, int W, bool SHARED, class Batch>
inline CUDA_CALLABLE float keep_rays(const SceneRays<P, W, SHARED>& scene, const Batch& batch, int first)
{
    const PacketRays<P> rays(batch, first);
    const double center_x = batch.center.c[0], center_y = batch.center.c[1], center_z = batch.center.c[2];
    rays.each([&](int k, int n) { scene.number[k] = n; });
    for (int k = rays.here; k < P; ++k) scene.number[k] = scene.number[0];
    scene.fetch(batch.direction_stride, [&](int k, int n) {
        const float* d = (const float*)batch.directions.data + 3 * (size_t)n;
        scene.to_x[k] = d[0];
        scene.to_y[k] = d[1];
        scene.to_z[k] = d[2];
    });
    scene.fetch(batch.t_min_stride, [&](int k, int n) { scene.t_min[k] = batch.t_min.data[n]; });
    const auto centred = [&](int k, int n) {
        const float* o = (const float*)batch.origins.data + 3 * (size_t)n;
        scene.from_x[k] = (double)o[0] - center_x;
        scene.from_y[k] = (double)o[1] - center_y;
        scene.from_z[k] = (double)o[2] - center_z;
    };
    if (SHARED) centred(0, 0);
    else scene.fetch(batch.origin_stride, centred);
    WRT_FOR (P, k) {
        drop_negligible(scene.to_x[k], scene.to_y[k], scene.to_z[k]);
        scene.t[k] = WRT_INFINITY;
        scene.primitive[k] = -1;
        scene.u[k] = 0.0f;
        scene.v[k] = 0.0f;
    }
    int max_bits = 0;  // NaN and infinity do not count
    WRT_FOR (SHARED ? 1 : P, k) {
        const int x = size_bits((float)scene.from_x[k]), y = size_bits((float)scene.from_y[k]);
        const int z = size_bits((float)scene.from_z[k]);
        int size = x > y ? x : y;
        size = size > z ? size : z;
        size = size < 0x7f800000 ? size : 0;
        max_bits = size > max_bits ? size : max_bits;
    }
    return __builtin_bit_cast(float, max_bits);
}

/// Loads the rays into the packet in the space of an instance; low, high: bounds of its tree. Those that its mask hides are
/// inactive.
template <class What, int P, int W, bool SHARED, class Batch, class Place, class Vec3, class Bounds, class Prepare>
inline CUDA_CALLABLE void load_instance(const SceneRays<P, W, SHARED>& scene, const Batch& batch, const Place& place,
    const Vec3& low, const Vec3& high, Bounds& bounds, const Prepare& prepare)
{
    const double* m = &place.to_object.data[0][0];
    const double m0 = m[0], m1 = m[1], m2 = m[2], m3 = m[3], m4 = m[4], m5 = m[5], m6 = m[6], m7 = m[7], m8 = m[8];
    const double px = place.origin.c[0], py = place.origin.c[1], pz = place.origin.c[2];
    RayArrays<P> rays;
    WRT_FOR (P, k) {
        const double x = scene.to_x[k], y = scene.to_y[k], z = scene.to_z[k];
        rays.to_x[k] = (float)((m0 * x + m1 * y) + m2 * z);
        rays.to_y[k] = (float)((m3 * x + m4 * y) + m5 * z);
        rays.to_z[k] = (float)((m6 * x + m7 * y) + m8 * z);
    }
    WRT_FOR (SHARED ? 1 : P, k) {
        const double x = scene.from_x[k] - px, y = scene.from_y[k] - py, z = scene.from_z[k] - pz;
        rays.from_x[k] = (float)((m0 * x + m1 * y) + m2 * z);
        rays.from_y[k] = (float)((m3 * x + m4 * y) + m5 * z);
        rays.from_z[k] = (float)((m6 * x + m7 * y) + m8 * z);
    }
    WRT_FOR (P, k) {
        rays.t_min[k] = scene.t_min[k];
        rays.t_max[k] = scene.bound[k];
    }
    if (batch.mask.shape[0] > 0)
        for (int k = 0; k < P; ++k)
            if (!(place.mask & batch.mask.data[scene.number[k] * batch.mask_stride])) rays.t_max[k] = -WRT_INFINITY;
    load_arrays<What>(scene.packet, rays, true, low, high, bounds, prepare);
}

/// `bound` becomes the t of the packet that was loaded.
template <int P, int W, bool SHARED> inline CUDA_CALLABLE void keep_ranges(const SceneRays<P, W, SHARED>& scene)
{
    WRT_FOR (P, k) {
        scene.bound[k] = scene.packet.t[k];
    }
}

/// Merges the hits of the packet in an instance whose first triangle is number `first`, and shortens the rays; returns the
/// greatest t at which a hit still counts.
template <bool ANY_HIT, int P, int W, bool SHARED>
inline CUDA_CALLABLE float merge_hits(const SceneRays<P, W, SHARED>& scene, int first)
{
    const int* found = scene.packet.primitive;
    const float *t = scene.packet.t, *u = scene.packet.u, *v = scene.packet.v;
    WRT_FOR (P, k) {
        const int id = first + found[k];
        const float best_t = scene.t[k];
        const int best = scene.primitive[k];
        const bool nearer = (t[k] < best_t) | ((t[k] == best_t) & ((unsigned)id < (unsigned)best));
        const bool hit = (found[k] >= 0) & (ANY_HIT | nearer);
        scene.t[k] = hit ? t[k] : best_t;
        scene.primitive[k] = hit ? id : best;
        scene.u[k] = hit ? u[k] : scene.u[k];
        scene.v[k] = hit ? v[k] : scene.v[k];
        scene.bound[k] = hit ? t[k] : scene.bound[k];
    }
    return farthest<P>(scene.bound);
}

/// Writes the hits of the rays to a batch.
template <bool ANY_HIT, int P, int W, bool SHARED, class Batch, class Hits>
inline CUDA_CALLABLE void store_rays(const SceneRays<P, W, SHARED>& scene, const Batch& batch, int first, const Hits& hits)
{
    const PacketRays<P> rays(batch, first);
    if (ANY_HIT) {
        rays.each([&](int k, int n) { hits.occluded.data[n] = scene.primitive[k] >= 0; });
        return;
    }
    float* __restrict__ t = hits.t.data;
    int* __restrict__ primitive = hits.primitive.data;
    float* __restrict__ uv = (float*)hits.uv.data;
    rays.each([&](int k, int n) { t[n] = scene.t[k]; });
    rays.each([&](int k, int n) { primitive[n] = scene.primitive[k]; });
    rays.each([&](int k, int n) { uv[2 * (size_t)n] = scene.u[k], uv[2 * (size_t)n + 1] = scene.v[k]; });
}

/// Writes the box of the points begin .. end - 1, mapped, as that of instance i: lowest x of all `count` instances, then lowest
/// y and z, then highest ones. points: all x of `row` points, then all y, then all z; begin is a multiple of W, and so is the
/// end.
template <int W, class Matrix, class Vec3>
inline CUDA_CALLABLE void bound_points(
    const double* points, int row, int begin, int end, const Matrix& map, const Vec3& origin, double* corners, int count, int i)
{
    const double far = __builtin_bit_cast(double, 0x7ff0000000000000ull);
    const double *const px = points, *const py = px + row, *const pz = py + row;
    for (int axis = 0; axis < 3; ++axis) {
        const double x = map.data[axis][0], y = map.data[axis][1], z = map.data[axis][2];
        double low[W], high[W];
        WRT_FOR_LANES (j) {
            low[j] = far, high[j] = -far;
        }
        for (int k = begin; k < end; k += W) {
            WRT_FOR_LANES (j) {
                const double at = (x * px[k + j] + y * py[k + j]) + z * pz[k + j];
                low[j] = at < low[j] ? at : low[j];
                high[j] = at > high[j] ? at : high[j];
            }
        }
        for (int j = 1; j < W; ++j) {
            low[0] = low[j] < low[0] ? low[j] : low[0];
            high[0] = high[j] > high[0] ? high[j] : high[0];
        }
        corners[axis * count + i] = low[0] + origin.c[axis];
        corners[(axis + 3) * count + i] = high[0] + origin.c[axis];
    }
}

}  // namespace
}  // namespace wrt
