// Rays of a batch loaded into a packet, and their bounds (wrt.kernels.traversal.packet.rays.packet_load).
#pragma once
#include "packet_bounds.h"

namespace wrt {
namespace {

/// Rays to be loaded: directions, origins relative to the scene's centre, t_min and t_max. With a shared origin, only the first
/// element of `from` is used.
template <int P> struct RayArrays {
    float to_x[P], to_y[P], to_z[P], from_x[P], from_y[P], from_z[P], t_min[P], t_max[P];
};

/// What a triangle test's state is computed from: direction, origin, 1 / direction, slopes along the two axes after the main
/// one.
struct LoadedRay {
    float x, y, z, ox, oy, oz, ix, iy, iz, sx, sy;
    bool main_x, main_y;
};

/// Computes what of ray k only tests need: 1 / direction, slopes, slack, no hit so far and, by `prepare(k, ray)`, the state of
/// the test. Returns the bit of the main axis.
template <int P, int W, bool SHARED, class Vec3, class Prepare>
inline CUDA_CALLABLE int set_tested(const Packet<P, W, SHARED>& packet, int k, float x, float y, float z, float ox, float oy,
    float oz, const Vec3& low, const Vec3& high, const Prepare& prepare)
{
    if (!SHARED) packet.slack[k] = SLACK * reach(low, high, ox, oy, oz);
    packet.primitive[k] = -1;
    packet.u[k] = 0.0f;
    packet.v[k] = 0.0f;
    const int main = largest_axis(size_bits(x), size_bits(y), size_bits(z));
    const bool main_x = main == 1, main_y = main == 2;
    const float major = main_x ? x : main_y ? y : z;
    const float sx = (main_x ? y : main_y ? z : x) / major, sy = (main_x ? z : main_y ? x : y) / major;
    const float ix = 1.0f / x, iy = 1.0f / y, iz = 1.0f / z;
    packet.slope_x[k] = sx;
    packet.slope_y[k] = sy;
    packet.main_axis[k] = axis_of(main);
    packet.inverse_x[k] = ix;
    packet.inverse_y[k] = iy;
    packet.inverse_z[k] = iz;
    prepare(k, LoadedRay {x, y, z, ox, oy, oz, ix, iy, iz, sx, sy, main_x, main_y});
    return main;
}

/// Fills the components of a packet. LATER: values that only the triangle test reads are left for `finish_packet`, and the
/// components of 1 / direction hold the direction. low, high: bounds of the tree.
template <bool LATER, int P, int W, bool SHARED, class Vec3, class Prepare>
inline CUDA_CALLABLE void fill_packet(
    const Packet<P, W, SHARED>& packet, const RayArrays<P>& rays, const Vec3& low, const Vec3& high, const Prepare& prepare)
{
    const float ox0 = rays.from_x[0], oy0 = rays.from_y[0], oz0 = rays.from_z[0];
    WRT_FOR (P, k) {
        float x = rays.to_x[k], y = rays.to_y[k], z = rays.to_z[k];
        drop_negligible(x, y, z);
        const float last = rays.t_max[k] > FARTHEST ? FARTHEST : rays.t_max[k];
        const float ox = SHARED ? ox0 : rays.from_x[k], oy = SHARED ? oy0 : rays.from_y[k], oz = SHARED ? oz0 : rays.from_z[k];
        const bool valid = is_direction(x, y, z) & (ox - ox == 0.0f) & (oy - oy == 0.0f) & (oz - oz == 0.0f)
            & (rays.t_min[k] >= 0.0f) & (rays.t_min[k] <= last);
        if (!SHARED) {
            packet.origin_x[k] = ox;
            packet.origin_y[k] = oy;
            packet.origin_z[k] = oz;
        }
        packet.t_min[k] = rays.t_min[k];
        packet.t[k] = valid ? last : -WRT_INFINITY;
        if (LATER) {
            packet.inverse_x[k] = x;
            packet.inverse_y[k] = y;
            packet.inverse_z[k] = z;
        } else set_tested(packet, k, x, y, z, ox, oy, oz, low, high, prepare);
    }
}

/// Fills a packet with rays and bounds them; see `bound_packet`.
template <class What, int P, int W, bool SHARED, class Vec3, class Bounds, class Prepare>
inline CUDA_CALLABLE void load_arrays(const Packet<P, W, SHARED>& packet, const RayArrays<P>& rays, bool ranged,
    const Vec3& low, const Vec3& high, Bounds& bounds, const Prepare& prepare)
{
    fill_packet<What::LATER>(packet, rays, low, high, prepare);
    float lows[3], highs[3];
    if (SHARED) {
        lows[0] = highs[0] = rays.from_x[0];
        lows[1] = highs[1] = rays.from_y[0];
        lows[2] = highs[2] = rays.from_z[0];
    }
    bound_packet<What>(packet, bounds, lows, highs, ranged, SlackOfEnds<Vec3> {low, high});
}

/// Loads the P rays of a batch from place `first` on; low, high: bounds of the scene.
template <class What, int P, int W, bool SHARED, class Batch, class Vec3, class Bounds, class Prepare>
inline CUDA_CALLABLE void load_packet(const Packet<P, W, SHARED>& packet, const Batch& batch, int first, const Vec3& low,
    const Vec3& high, Bounds& bounds, const Prepare& prepare)
{
    const PacketRays<P> numbers(batch, first);
    RayArrays<P> rays;
    numbers.directions(batch, rays.to_x, rays.to_y, rays.to_z);
    const double center_x = batch.center.c[0], center_y = batch.center.c[1], center_z = batch.center.c[2];
    if (SHARED) {
        const float* o = (const float*)batch.origins.data;
        rays.from_x[0] = o[0], rays.from_y[0] = o[1], rays.from_z[0] = o[2];
    } else
        numbers.fetch(batch.origin_stride, [&](int k, int n) {
            const float* o = (const float*)batch.origins.data + 3 * (size_t)n;
            rays.from_x[k] = o[0], rays.from_y[k] = o[1], rays.from_z[k] = o[2];
        });
    if (!SHARED && batch.origin_stride) numbers.fetch_next(batch.origins.data);
    numbers.fetch(batch.t_min_stride, [&](int k, int n) { rays.t_min[k] = batch.t_min.data[n]; });
    numbers.fetch(batch.t_max_stride, [&](int k, int n) { rays.t_max[k] = batch.t_max.data[n]; });
    WRT_FOR (SHARED ? 1 : P, k) {
        rays.from_x[k] = (float)((double)rays.from_x[k] - center_x);
        rays.from_y[k] = (float)((double)rays.from_y[k] - center_y);
        rays.from_z[k] = (float)((double)rays.from_z[k] - center_z);
    }
    load_arrays<What>(packet, rays, batch.t_min_stride || batch.t_max_stride, low, high, bounds, prepare);
}

/// Computes what `load_packet` left for later, unless that is done. PASSES: those of the triangle test.
template <int PASSES, int P, int W, bool SHARED, class Vec3, class Bounds, class Prepare>
inline CUDA_CALLABLE void finish_packet(
    const Packet<P, W, SHARED>& packet, const Vec3& low, const Vec3& high, Bounds& bounds, const Prepare& prepare)
{
    if (bounds.finished) return;
    bounds.finished = 1;
    const float ox0 = bounds.origin_low.c[0], oy0 = bounds.origin_low.c[1], oz0 = bounds.origin_low.c[2];
    int main_axes = 0;
    WRT_FOR (P, k) {
        const float x = packet.inverse_x[k], y = packet.inverse_y[k], z = packet.inverse_z[k];
        const float ox = SHARED ? ox0 : packet.origin_x[k], oy = SHARED ? oy0 : packet.origin_y[k];
        const float oz = SHARED ? oz0 : packet.origin_z[k];
        const int main = set_tested(packet, k, x, y, z, ox, oy, oz, low, high, prepare);
        main_axes |= packet.t[k] >= -0.0f ? main : 0;
    }
    bounds.main_axes = main_axes;
    bounds.passes = PASSES == 1 ? 1 : main_axes;
}

/// Ends of the numbers of rays that are loaded RUN at a time.
struct RunIntervals {
    OrderedInterval to_x, to_y, to_z, from_x, from_y, from_z, start, end;
    int active = 0;
};

/// Widens intervals by the valid ones of the `here` rays from number `begin` on.
template <int RUN, class Batch>
inline CUDA_CALLABLE void widen_by_run(const Batch& batch, int begin, int here, RayArrays<RUN>& rays, RunIntervals& all)
{
    const float* from = (const float*)batch.origins.data + 3 * (size_t)begin;
    const float* to = (const float*)batch.directions.data + 3 * (size_t)begin * batch.direction_stride;
    const double center[3] = {batch.center.c[0], batch.center.c[1], batch.center.c[2]};
    float* const o[3] = {rays.from_x, rays.from_y, rays.from_z};
    if (batch.origin_stride) {
        for (int a = 0; a < 3; ++a) {
            WRT_FOR (here, k) {
                o[a][k] = (float)((double)from[3 * k + a] - center[a]);
            }
        }
    }
    if (batch.direction_stride) {
        WRT_FOR (here, k) {
            rays.to_x[k] = to[3 * k], rays.to_y[k] = to[3 * k + 1], rays.to_z[k] = to[3 * k + 2];
        }
    } else {
        WRT_FOR (here, k) {
            rays.to_x[k] = to[0], rays.to_y[k] = to[1], rays.to_z[k] = to[2];
        }
    }
    if (batch.t_min_stride) {
        WRT_FOR (here, k) {
            rays.t_min[k] = batch.t_min.data[begin + k];
        }
    }
    if (batch.t_max_stride) {
        WRT_FOR (here, k) {
            rays.t_max[k] = batch.t_max.data[begin + k];
        }
    }
    RunIntervals own = all;
    WRT_FOR (here, k) {
        float x = rays.to_x[k], y = rays.to_y[k], z = rays.to_z[k];
        drop_negligible(x, y, z);
        rays.t_max[k] = rays.t_max[k] > FARTHEST ? FARTHEST : rays.t_max[k];
        const float px = rays.from_x[k], py = rays.from_y[k], pz = rays.from_z[k];
        const bool valid = is_ray(x, y, z, px, py, pz, rays.t_min[k], rays.t_max[k]);
        own.active += valid ? 1 : 0;
        own.to_x.widen(x, valid), own.to_y.widen(y, valid), own.to_z.widen(z, valid);
        own.from_x.widen(px, valid), own.from_y.widen(py, valid), own.from_z.widen(pz, valid);
        own.start.widen(rays.t_min[k], valid), own.end.widen(rays.t_max[k], valid);
    }
    all = own;
}

/// Bounds the slopes of rays and the points in which they cross a plane near their origins, if all have one main axis. lower,
/// upper: ends of the directions; wide, narrow: of their sizes.
template <class Bounds>
inline CUDA_CALLABLE void bound_run_slopes(Bounds& bounds, const float* lows, const float* highs, const float* lower,
    const float* upper, const float* wide, const float* narrow)
{
    bounds.main_axes = 7;
    for (int z = 0; z < 3; ++z) {
        const int x = z == 2 ? 0 : z + 1, y = x == 2 ? 0 : x + 1;
        if (!((narrow[z] > wide[x]) & (narrow[z] > wide[y]))) continue;
        bounds.main_axes = 1 << z;
        bounds.plane = 0.5f * (lows[z] + highs[z]);
        const float near = lows[z] - bounds.plane, far = highs[z] - bounds.plane;
        for (int side = 0; side < 2; ++side) {
            const int a = side ? y : x;
            const float slopes[4] = {lower[a] / lower[z], lower[a] / upper[z], upper[a] / lower[z], upper[a] / upper[z]};
            float s0 = slopes[0], s1 = slopes[0];
            for (int e = 1; e < 4; ++e) s0 = slopes[e] < s0 ? slopes[e] : s0, s1 = slopes[e] > s1 ? slopes[e] : s1;
            const float shifts[4] = {s0 * near, s0 * far, s1 * near, s1 * far};
            float m0 = shifts[0], m1 = shifts[0];
            for (int e = 1; e < 4; ++e) m0 = shifts[e] < m0 ? shifts[e] : m0, m1 = shifts[e] > m1 ? shifts[e] : m1;
            bounds.slope_low.c[side] = s0;
            bounds.slope_high.c[side] = s1;
            bounds.through_low.c[side] = (lows[a] - m1) - bounds.slack;
            bounds.through_high.c[side] = (highs[a] - m0) + bounds.slack;
        }
    }
}

/// Bounds rays first .. first + count - 1 of a batch, RUN at a time (wrt.kernels.traversal.packet.rays.packet_load); low, high:
/// bounds of the scene.
template <int RUN, class Batch, class Vec3, class Bounds>
inline CUDA_CALLABLE void bound_rays(
    const Batch& batch, int first, int count, const Vec3& low, const Vec3& high, Bounds& bounds)
{
    RayArrays<RUN> rays;
    RunIntervals all;
    const float* origin = (const float*)batch.origins.data;
    if (!batch.origin_stride) {
        const float ox = (float)((double)origin[0] - batch.center.c[0]), oy = (float)((double)origin[1] - batch.center.c[1]);
        const float oz = (float)((double)origin[2] - batch.center.c[2]);
        WRT_FOR (RUN, k) {
            rays.from_x[k] = ox, rays.from_y[k] = oy, rays.from_z[k] = oz;
        }
    }
    if (!batch.t_min_stride) {
        WRT_FOR (RUN, k) {
            rays.t_min[k] = batch.t_min.data[0];
        }
    }
    if (!batch.t_max_stride) {
        WRT_FOR (RUN, k) {
            rays.t_max[k] = batch.t_max.data[0];
        }
    }
    const int last = first + count < batch.count ? first + count : batch.count;
    for (int begin = first; begin < last; begin += RUN)
        widen_by_run<RUN>(batch, begin, last - begin < RUN ? last - begin : RUN, rays, all);
    bounds.active = all.active;
    if (!all.active) return;
    const float lows[3] = {all.from_x.lower(), all.from_y.lower(), all.from_z.lower()};
    const float highs[3] = {all.from_x.upper(), all.from_y.upper(), all.from_z.upper()};
    const float lower[3] = {all.to_x.lower(), all.to_y.lower(), all.to_z.lower()};
    const float upper[3] = {all.to_x.upper(), all.to_y.upper(), all.to_z.upper()};
    float far = 0.0f, wide[3], narrow[3];
    for (int a = 0; a < 3; ++a) {
        const float ends[4] = {low.c[a] - lows[a], low.c[a] - highs[a], high.c[a] - lows[a], high.c[a] - highs[a]};
        for (int e = 0; e < 4; ++e) far = WRT_ABS(ends[e]) > far ? WRT_ABS(ends[e]) : far;
        const float p = WRT_ABS(lower[a]), q = WRT_ABS(upper[a]);
        wide[a] = p > q ? p : q;
        narrow[a] = (lower[a] < 0.0f) != (upper[a] < 0.0f) ? 0.0f : p < q ? p : q;
    }
    bounds.slack = SLACK * far;
    bounds.t_min = all.start.lower();
    bounds.t_max = all.end.upper();
    bounds.passes = 7;
    bounds.mixed_axes = 0;
    for (int a = 0; a < 3; ++a) {
        // the sign bit, not < 0: 1 / -0 is -inf
        const bool backward = __builtin_bit_cast(int, upper[a]) < 0,
                   mixed = (__builtin_bit_cast(int, lower[a]) < 0) & !backward;
        set_inverses(bounds, a, lower[a], upper[a], backward, mixed);
        set_sides(bounds, a, backward, mixed, lows, highs, bounds.slack);
    }
    bound_run_slopes(bounds, lows, highs, lower, upper, wide, narrow);
}

}  // namespace
}  // namespace wrt
