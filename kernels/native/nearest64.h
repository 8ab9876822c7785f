// Nearest hits by brute force in float64 (wrt.kernels.query.nearest64).
#pragma once
#include "triangle.h"

namespace wrt {
namespace {

/// Whether all of three numbers are above 0, or all below.
inline CUDA_CALLABLE int one_sign(const double (&x)[3])
{
    return ((x[0] > 0) & (x[1] > 0) & (x[2] > 0)) | ((x[0] < 0) & (x[1] < 0) & (x[2] < 0));
}

/// Tests the triangles begin .. end - 1, W at a time; of equally near ones the first counts. corners: nine rows of `row`
/// numbers. z: the axis along which the ray is longest.
template <int W, class Nearest>
inline CUDA_CALLABLE void nearest_of(
    const double* corners, size_t row, int begin, int end, const double* origin, const double* direction, int z, Nearest& found)
{
    const double far = __builtin_bit_cast(double, 0x7ff0000000000000ull);
    const int axes[3] = {(z + 1) % 3, (z + 2) % 3, z};
    const double ox = origin[axes[0]], oy = origin[axes[1]], oz = origin[z];
    const double dx = direction[axes[0]], dy = direction[axes[1]], dz = direction[z];
    double best_t[W];
    int which[W];
    WRT_FOR_LANES (j) {
        best_t[j] = far;
        which[j] = -1;
    }
    for (int first = begin; first < end; first += W) {
        const double *const from_x = corners + axes[0] * row + first, *const from_y = corners + axes[1] * row + first;
        const double* const from_z = corners + z * row + first;
        WRT_FOR_LANES (j) {
            // the second and the third vertex are exchanged, which gives the areas their signs
            const Sheared<double> s = sheared<double>(dx, dy, [&](int vertex, int turn) {
                const size_t at = (vertex == 0 ? 0 : vertex == 1 ? 6 : 3) * row + j;
                return turn == 0 ? from_x[at] - ox : turn == 1 ? from_y[at] - oy : (from_z[at] - oz) / dz;
            });
            // all corners on one side of an axis through the ray: it does not meet the triangle, whatever rounding says below
            const int beside = one_sign(s.x) | one_sign(s.y);
            const Areas<double> exchanged = areas_of(s), w = {exchanged.a, exchanged.c, exchanged.b};
            const double total = sum(w), t = (w.a * s.depth[0] + w.b * s.depth[2] + w.c * s.depth[1]) / total;
            const int same = on_one_side(w);
            const bool better = (beside == 0) & (same != 0) & (total != 0) & !(t < 0) & (t < best_t[j]);
            best_t[j] = better ? t : best_t[j];
            which[j] = better ? first + j : which[j];
        }
    }
    for (int j = 0; j < W; ++j) {
        if (best_t[j] < found.t || (best_t[j] == found.t && which[j] >= 0 && which[j] < found.triangle)) {
            found.t = best_t[j];
            found.triangle = which[j];
        }
    }
}

}  // namespace
}  // namespace wrt
