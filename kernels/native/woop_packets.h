// The watertight test for packets: W rays x one triangle, and W rays x a triangle for each, with the same results bit for bit.
#pragma once
#include "triangle.h"

namespace wrt {
namespace {

/// What the test reads of the rays of a packet, component by component. origin: of rays with own origins; shared: of all rays.
/// Ray k has the slopes x and y along the axes that follow its main axis, and 1 / direction along that one, `along`.
struct WoopRays {
    const float *origin[3], *shared;
    const float *slope_x, *slope_y, *along;
    const int* main_axis;
};

/// 1 / direction along the main axis, which the test keeps of a ray.
inline CUDA_CALLABLE float along_main_axis(bool main_x, bool main_y, float ix, float iy, float iz)
{
    return main_x ? ix : main_y ? iy : iz;
}

/// Ray k as `ShearedRay`, for the test of one ray.
template <bool SHARED, class Ray> inline CUDA_CALLABLE void woop_ray(const WoopRays& rays, int k, Ray& ray)
{
    ray.z = rays.main_axis[k], ray.x = ray.z == 2 ? 0 : ray.z + 1, ray.y = ray.x == 2 ? 0 : ray.x + 1;
    const int axes[3] = {ray.x, ray.y, ray.z};
    for (int a = 0; a < 3; ++a) ray.origin.c[a] = SHARED ? rays.shared[axes[a]] : rays.origin[axes[a]][k];
    ray.shear.c[0] = rays.slope_x[k], ray.shear.c[1] = rays.slope_y[k], ray.shear.c[2] = rays.along[k];
}

/// W rays x one triangle. The test of a triangle takes a pass for each main axis that occurs among the rays (`PASSES`): `begin`
/// for each, then `meet` for W rays after the other, and `hit` for those of them whose line meets the triangle.
template <int W, bool SHARED> struct WoopPacket {
    static constexpr int PASSES = 3;

    WoopRays rays;
    int main_axis;
    float vertex[3][3], shared[3];
    const float* origin[3];
    alignas(4 * W) float area_a[W];
    alignas(4 * W) float area_b[W];
    alignas(4 * W) float area_c[W];

    explicit CUDA_CALLABLE WoopPacket(const WoopRays& of)
        : rays(of)
    {
    }

    /// corner: the nine components of the triangle, W apart. pass: the main axis.
    CUDA_CALLABLE void begin(const float* corner, int pass)
    {
        const int z = pass, x = z == 2 ? 0 : z + 1, y = x == 2 ? 0 : x + 1;
        const int axes[3] = {x, y, z};
        main_axis = z;
        WRT_UNROLLED
        for (int a = 0; a < 3; ++a) {
            const int axis = axes[a];
            for (int v = 0; v < 3; ++v) vertex[v][a] = corner[(3 * v + axis) * W];
            origin[a] = axis == 0 ? rays.origin[0] : axis == 1 ? rays.origin[1] : rays.origin[2];
            shared[a] = rays.shared[axis];
        }
    }

    CUDA_CALLABLE float from(int axis, int k) const { return SHARED ? shared[axis] : origin[axis][k]; }

    CUDA_CALLABLE Sheared<float> sheared(int k) const
    {
        const float o[3] = {from(0, k), from(1, k), from(2, k)};
        return wrt::sheared<float>(
            rays.slope_x[k], rays.slope_y[k], [&](int v, int axis) { return vertex[v][axis] - o[axis]; });
    }

    /// The rays from f on. inside: 1 for those whose line meets the triangle. Returns whether there are any.
    CUDA_CALLABLE bool meet(int f, int* inside)
    {
        alignas(4 * W) float sizes[W];
        int some = 0, edges = 0;
        WRT_FOR_LANES (i) {
            const int k = f + i;
            const Sheared<float> s = sheared(k);
            const Areas<float> w = areas_of(s);
            area_a[i] = w.a, area_b[i] = w.b, area_c[i] = w.c;
            sizes[i] = size_of(s);
            inside[i] = (on_one_side(w) & (rays.main_axis[k] == main_axis)) ? 1 : 0;
            some |= inside[i];
            edges |= some_zero(w) ? 1 : 0;
        }
        if (edges) {
            some = 0;
            for (int i = 0; i < W; ++i) {
                Areas<float> w = {area_a[i], area_b[i], area_c[i]};
                if (some_zero(w)) {
                    const bool in = Inclusive::decide(sheared(f + i), w);
                    area_a[i] = w.a, area_b[i] = w.b, area_c[i] = w.c;
                    inside[i] = in && rays.main_axis[f + i] == main_axis ? 1 : 0;
                }
                some |= inside[i];
            }
        }
        if (!some) return false;
        alignas(4 * W) int thin[W];
        int some_thin = 0;
        WRT_FOR_LANES (i) {
            thin[i] = is_thin<float>({area_a[i], area_b[i], area_c[i]}, sizes[i]) ? inside[i] : 0;
            some_thin |= thin[i];
        }
        if (some_thin) {
            for (int i = 0; i < W; ++i) {
                if (!thin[i]) continue;
                const Areas<float> w = precise_areas(sheared(f + i), {area_a[i], area_b[i], area_c[i]});
                area_a[i] = w.a, area_b[i] = w.b, area_c[i] = w.c;
            }
        }
        return true;
    }

    /// The hit of ray k = f + i.
    CUDA_CALLABLE TriangleHit<float> hit(int i, int k) const
    {
        const Areas<float> w = {area_a[i], area_b[i], area_c[i]};
        const float o = from(2, k);
        return weighed<float>(w, vertex[0][2] - o, vertex[1][2] - o, vertex[2][2] - o, rays.along[k]);
    }
};

#if WRT_VECTORS
/// W rays x a triangle for each, in vectors. Areas of 0 are recomputed only for rays that the signs leave inside: the sign of
/// an area that is not 0 is exact, so that a ray with areas of both signs is outside whatever a third area is.
template <int W, bool SHARED> struct WoopPairs {
    static constexpr int PASSES = 3;

    WoopRays rays;
    int x, y, z;

    explicit CUDA_CALLABLE WoopPairs(const WoopRays& of)
        : rays(of)
    {
    }

    CUDA_CALLABLE void begin(int pass) { z = pass, x = z == 2 ? 0 : z + 1, y = x == 2 ? 0 : x + 1; }

    CUDA_CALLABLE Floats<W> origin(int axis, int f) const
    {
        if constexpr (SHARED) return (Floats<W>)rays.shared[axis];
        else return load<Floats<W>>(rays.origin[axis] + f);
    }

    CUDA_CALLABLE int axis_of(int turn) const { return turn == 0 ? x : turn == 1 ? y : z; }

    /// The triangle at `corner` and the rays from f on: 0 only where the ray's line certainly misses the triangle.
    CUDA_CALLABLE Ints<W> may_meet(const float* corner, int f) const
    {
        const Floats<W> o[3] = {origin(x, f), origin(y, f), origin(z, f)};
        const Sheared<Floats<W>> s = sheared<Floats<W>>(load<Floats<W>>(rays.slope_x + f), load<Floats<W>>(rays.slope_y + f),
            [&](int v, int turn) { return corner[(3 * v + axis_of(turn)) * W] - o[turn]; });
        const Areas<Floats<W>> w = areas_of(s);
        const Ints<W> outside = ((w.a < 0.0f) | (w.b < 0.0f) | (w.c < 0.0f)) & ((w.a > 0.0f) | (w.b > 0.0f) | (w.c > 0.0f));
        return ~outside & (load<Ints<W>>(rays.main_axis + f) == z);
    }

    /// The rays from f on, where `paired` is not 0, and the lanes `which` of a block. Row c of its vertices is corners[c], less
    /// the origin if it is SHARED. inside: the lanes whose line meets the triangle. Returns whether there are any.
    CUDA_CALLABLE bool test(
        const float (*corners)[W], Ints<W> which, Ints<W> paired, int f, Ints<W>& inside, TriangleHit<Floats<W>>& hit) const
    {
        Floats<W> o[3];
        if (!SHARED) o[0] = origin(x, f), o[1] = origin(y, f), o[2] = origin(z, f);
        const Sheared<Floats<W>> s
            = sheared<Floats<W>>(load<Floats<W>>(rays.slope_x + f), load<Floats<W>>(rays.slope_y + f), [&](int v, int turn) {
                  const Floats<W> at = chosen<W>(corners + 3 * v + axis_of(turn), which);
                  return SHARED ? at : at - o[turn];
              });
        Areas<Floats<W>> w = areas_of(s);
        inside = on_one_side(w) & paired & (load<Ints<W>>(rays.main_axis + f) == z);
        for (unsigned left = bits_of(inside & some_zero(w)); left; left &= left - 1u) {
            const int i = lowest_bit(left);
            Areas<float> own;
            inside[i] = Inclusive::decide(lane_of(s, i), own) ? -1 : 0;
            w.a[i] = own.a, w.b[i] = own.b, w.c[i] = own.c;
        }
        if (!bits_of(inside)) return false;
        for (unsigned left = bits_of(inside & is_thin(w, size_of(s))); left; left &= left - 1u) {
            const int i = lowest_bit(left);
            const Areas<float> own = precise_areas(lane_of(s, i), {w.a[i], w.b[i], w.c[i]});
            w.a[i] = own.a, w.b[i] = own.b, w.c[i] = own.c;
        }
        hit = weighed<Floats<W>>(w, s.depth[0], s.depth[1], s.depth[2], load<Floats<W>>(rays.along + f));
        return true;
    }

    static CUDA_CALLABLE Sheared<float> lane_of(const Sheared<Floats<W>>& s, int i)
    {
        return {{s.x[0][i], s.x[1][i], s.x[2][i]}, {s.y[0][i], s.y[1][i], s.y[2][i]}, {}};
    }
};
#endif

}  // namespace
}  // namespace wrt
