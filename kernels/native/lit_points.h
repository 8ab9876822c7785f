// Rays from a tile of points to a group of directions: counted, written, and summed (wrt.kernels.fields.exposures).
//
// Rays go point by point. Vectors are three numbers each.
#pragma once
#include "loops.h"

namespace wrt {
namespace {

/// Points of a tile, and the largest number of directions of a group.
constexpr int LIT_TILE = 256, LIT_GROUP = 8;

/// Whether a direction is in front of a point.
inline CUDA_CALLABLE bool is_in_front(const double* normal, const float* way)
{
    return normal[0] * (double)way[0] + normal[1] * (double)way[1] + normal[2] * (double)way[2] > 0.0;
}

/// The number of points, of `count`, that a direction is in front of.
inline CUDA_CALLABLE int count_in_front(const double* normals, int count, const float* way)
{
    int found = 0;
    for (int i = 0; i < count; ++i) found += is_in_front(normals + 3 * i, way) ? 1 : 0;
    return found;
}

/// Whether some of the lanes of a mask have a t of 0 or more.
template <int W> inline CUDA_CALLABLE bool some_ahead(unsigned mask, const float* t)
{
    unsigned met = 0;
    for (int k = 0; k < W; ++k) met |= mask >> k & (t[k] >= 0.0f ? 1u : 0u);
    return met != 0;
}

/// `write_rays`, of a number of directions that may be known when this is compiled.
template <class Group>
inline CUDA_CALLABLE void write_group(
    const double* points, int count, const float* ways, Group group, const double* center, float* origins, float* directions)
{
    for (int i = 0; i < count; ++i, points += 3, origins += 3 * group, directions += 3 * group) {
        const float from[3] = {(float)(points[0] - center[0]), (float)(points[1] - center[1]), (float)(points[2] - center[2])};
        WRT_UNROLLED
        for (int k = 0; k < 3 * group; ++k) origins[k] = from[k % 3];
        WRT_UNROLLED
        for (int k = 0; k < 3 * group; ++k) directions[k] = ways[k];
    }
}

/// A number that is known when this is compiled.
template <int N> struct Number {
    CUDA_CALLABLE operator int() const { return N; }
};

/// Writes all rays from some points to `group` directions; origins become relative to `center`.
inline CUDA_CALLABLE void write_rays(const double* points, int count, const float* __restrict ways, int group,
    const double* center, float* __restrict origins, float* __restrict directions)
{
    if (group != LIT_GROUP) return write_group(points, count, ways, group, center, origins, directions);
    float own[3 * LIT_GROUP];
    for (int k = 0; k < 3 * LIT_GROUP; ++k) own[k] = ways[k];
    write_group(points, count, own, Number<LIT_GROUP>(), center, origins, directions);
}

/// Whether each point of a tile sees each direction: seen[d * LIT_TILE + i]. full: whether each has a ray to each;
/// dark: whether the rays met something.
inline CUDA_CALLABLE void sort_seen(
    const double* normals, int count, const float* ways, int group, bool full, const bool* dark, unsigned char* seen)
{
    if (full && group == LIT_GROUP) {
        for (int d = 0; d < LIT_GROUP; ++d)
            WRT_FOR (count, i) seen[d * LIT_TILE + i] = !dark[LIT_GROUP * i + d];
        return;
    }
    for (int i = 0; i < count; ++i)
        for (int d = 0; d < group; ++d) {
            const bool has_ray = full || is_in_front(normals + 3 * i, ways + 3 * d);
            seen[d * LIT_TILE + i] = has_ray ? !*dark : 0;
            dark += has_ray ? 1 : 0;
        }
}

/// Adds the weights of what a tile sees of a group of directions to sums[g * all_points + i]. cosine: whether they are
/// multiplied with the cosine to the normal, in float32; weights: `groups` of each direction, weighted: the first and the end
/// of those that are not 0.
inline CUDA_CALLABLE void add_seen(const double* normals, int count, const float* ways, int group, const unsigned char* seen,
    bool cosine, const double* weights, int groups, const int* weighted, double* sums, long long all_points)
{
    double share[LIT_TILE];
    for (int d = 0; d < group; ++d, seen += LIT_TILE, weights += groups, ways += 3) {
        for (int i = 0; i < count; ++i) share[i] = seen[i] ? 1.0 : 0.0;
        if (cosine)
            for (int i = 0; i < count; ++i) {
                const double *n = normals + 3 * i, x = (float)n[0], y = (float)n[1], z = (float)n[2];
                const double angle = (double)ways[0] * x + (double)ways[1] * y + (double)ways[2] * z;
                share[i] = share[i] * (angle > 0.0 ? angle : 0.0);
            }
        for (int g = weighted[2 * d]; g < weighted[2 * d + 1]; ++g) {
            double* sum = sums + g * all_points;
            for (int i = 0; i < count; ++i) sum[i] += weights[g] * share[i];
        }
    }
}

}  // namespace
}  // namespace wrt
