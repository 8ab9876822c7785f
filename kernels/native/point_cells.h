// Numbers of the cells of points along a Morton curve: `wrt.kernels.points.point_order`.
#pragma once
#include "loops.h"

namespace wrt {
namespace {

/// Number of a cell along an axis, its 7 bits apart by two zeros. Coordinates outside of the grid, and NaN, are clamped.
inline CUDA_CALLABLE int cell_along_axis(float offset, float scale)
{
    const float place = offset * scale;
    const int cell = (int)(place >= 0.0f ? place < 127.0f ? place : 127.0f : 0.0f);
    int apart = (cell | cell << 8) & 0x700f;
    apart = (apart | apart << 4) & 0x430c3;
    return (apart | apart << 2) & 0x49249;
}

/// The cells of some points.
template <class Vec3>
inline CUDA_CALLABLE void find_cells(const Vec3* points, int count, const Vec3& low, const Vec3& scale, int* cells)
{
    const float low_x = low.c[0], low_y = low.c[1], low_z = low.c[2];
    const float scale_x = scale.c[0], scale_y = scale.c[1], scale_z = scale.c[2];
    WRT_FOR (count, i) {
        const float x = points[i].c[0] - low_x, y = points[i].c[1] - low_y, z = points[i].c[2] - low_z;
        cells[i] = 4 * cell_along_axis(x, scale_x) + 2 * cell_along_axis(y, scale_y) + cell_along_axis(z, scale_z);
    }
}

}  // namespace
}  // namespace wrt
