// Nearest hits by brute force in double precision: wrt.kernels.query.nearest64.
#pragma once
#include "loops.h"

namespace wrt {
namespace {

/// The corners of W triangles, relative to a ray that is sheared to the third axis.
template <int W> struct ShearedTriangles {
    double x[3][W], y[3][W], depth[3][W];
};

/// A ray along axis z.
struct ShearedRay {
    int x, y, z;
    double origin[3], direction[3];
};

/// rows: 9 rows of `row` numbers, from the first triangle on.
template <int W> inline CUDA_CALLABLE void shear(const double* rows, size_t row, const ShearedRay& ray, ShearedTriangles<W>& at)
{
    const int x = ray.x, y = ray.y, z = ray.z;
    const double ox = ray.origin[0], oy = ray.origin[1], oz = ray.origin[2];
    const double dx = ray.direction[0], dy = ray.direction[1], dz = ray.direction[2];
    for (int corner = 0; corner < 3; ++corner) {
        const double* const from = rows + (size_t)corner * 3 * row;
        WRT_FOR_LANES (j) {
            at.depth[corner][j] = (from[z * row + j] - oz) / dz;
            at.x[corner][j] = (from[x * row + j] - ox) - dx * at.depth[corner][j];
            at.y[corner][j] = (from[y * row + j] - oy) - dy * at.depth[corner][j];
        }
    }
}

/// Keeps the nearest of W triangles from number `first` on in each lane.
template <int W>
inline CUDA_CALLABLE void keep_nearest(const ShearedTriangles<W>& at, int first, double (&least)[W], int (&which)[W])
{
    WRT_FOR_LANES (j) {
        const double x0 = at.x[0][j], x1 = at.x[1][j], x2 = at.x[2][j];
        const double y0 = at.y[0][j], y1 = at.y[1][j], y2 = at.y[2][j];
        // all corners on one side of an axis through the ray: it does not meet the triangle, whatever rounding says below
        const bool beside = ((x0 > 0) & (x1 > 0) & (x2 > 0)) | ((x0 < 0) & (x1 < 0) & (x2 < 0))
            | ((y0 > 0) & (y1 > 0) & (y2 > 0)) | ((y0 < 0) & (y1 < 0) & (y2 < 0));
        const double a = x1 * y2 - y1 * x2, b = x2 * y0 - y2 * x0, c = x0 * y1 - y0 * x1;
        const double total = a + b + c;
        const bool same = ((a >= 0) & (b >= 0) & (c >= 0)) | ((a <= 0) & (b <= 0) & (c <= 0));
        const double t = (a * at.depth[0][j] + b * at.depth[1][j] + c * at.depth[2][j]) / total;
        const bool better = !beside & same & (total != 0) & !(t < 0) & (t < least[j]);
        least[j] = better ? t : least[j];
        which[j] = better ? first + j : which[j];
    }
}

/// Tests the triangles begin .. end - 1; of equally near ones the first counts. z: the axis along which the ray is longest.
template <int W, class Corners, class Vec, class Nearest>
inline CUDA_CALLABLE void find_nearest(
    const Corners& corners, int begin, int end, const Vec& origin, const Vec& direction, int z, Nearest& found)
{
    const int x = (z + 1) % 3, y = (z + 2) % 3;
    const ShearedRay ray = {x, y, z, {origin.c[x], origin.c[y], origin.c[z]}, {direction.c[x], direction.c[y], direction.c[z]}};
    double least[W];
    int which[W];
    WRT_FOR_LANES (j) {
        least[j] = __builtin_bit_cast(double, 0x7ff0000000000000ull);
        which[j] = -1;
    }
    ShearedTriangles<W> at;
    for (int first = begin; first < end; first += W) {
        shear<W>(corners.data + first, corners.shape[1], ray, at);
        keep_nearest<W>(at, first, least, which);
    }
    for (int j = 0; j < W; ++j)
        if (least[j] < found.t || (least[j] == found.t && which[j] >= 0 && which[j] < found.triangle)) {
            found.t = least[j];
            found.triangle = which[j];
        }
}

}  // namespace
}  // namespace wrt
