// Frusta of rays against all triangles, without a tree, boxes or a rule for ties
// (wrt.kernels.classics.studies.bare_triangle_tests).
#pragma once
#include "packet_load.h"
#include "triangle.h"

namespace wrt {
namespace {

/// P rays with a common origin.
template <int P> struct BareFrustum {
    float slope_x[P], slope_y[P], t[P];
    int found[P], main_axis[P], main_axes;

    /// d: their directions; prepare(k, ray) computes what the test keeps of ray k.
    template <class Prepare> CUDA_CALLABLE void start(const float* origin, const float* d, const Prepare& prepare)
    {
        const float ox = origin[0], oy = origin[1], oz = origin[2];
        main_axes = 0;
        WRT_FOR (P, k) {
            const float x = d[3 * k], y = d[3 * k + 1], z = d[3 * k + 2], ix = 1.0f / x, iy = 1.0f / y, iz = 1.0f / z;
            const float size_x = WRT_ABS(x), size_y = WRT_ABS(y), size_z = WRT_ABS(z);
            const bool main_x = (size_x >= size_y) & (size_x >= size_z), main_y = !(size_x >= size_y) & (size_y >= size_z);
            const float major = main_x ? x : main_y ? y : z;
            const float sx = (main_x ? y : main_y ? z : x) / major, sy = (main_x ? z : main_y ? x : y) / major;
            slope_x[k] = sx, slope_y[k] = sy, t[k] = WRT_INFINITY, found[k] = -1;
            prepare(k, LoadedRay {x, y, z, ox, oy, oz, ix, iy, iz, sx, sy, main_x, main_y});
            main_axis[k] = main_x ? 0 : main_y ? 1 : 2;
            main_axes |= 1 << main_axis[k];
        }
    }

    /// Tests all triangles, and keeps the closest hits with t > 0. triangle: a test as in packet_leaves.h.
    template <int W, int PASSES, int COMPONENTS, class Triangle>
    CUDA_CALLABLE void trace(const float* records, int triangles, const Triangle& triangle)
    {
        for (int id = 0; id < triangles; ++id) {
            const float* const corner = records + (size_t)(id / W) * (COMPONENTS * W) + id % W;
            WRT_UNROLLED
            for (int pass = 0; pass < PASSES; ++pass) {
                if (PASSES > 1 && !(main_axes >> pass & 1)) continue;
                triangle(corner, pass, [&](const auto& lines) {
                    for (int f = 0; f < P; f += W)
                        lines(f, [&](const int* inside, const auto& hit_of) {
                            WRT_FOR_LANES (i) {
                                const int k = f + i;
                                const TriangleHit<float> own = hit_of(i, k);
                                const bool hit = (inside[i] != 0) & (own.t > 0.0f) & (own.t < t[k]);
                                t[k] = hit ? own.t : t[k];
                                found[k] = hit ? id : found[k];
                            }
                        });
                });
            }
        }
    }
};

}  // namespace
}  // namespace wrt
