// Winding numbers of points by a walk of a wide BVH: clusters that are far away by their moments, triangles by solid angles.
//
// wrt.kernels.fields has the expansion and its bound; wrt.kernels.fields.cluster_moments stores the moments.
#pragma once
#include "lanes.h"
#include "square_root.h"

namespace wrt {
namespace {
namespace winding {

/// A vector from the point.
struct Apart {
    float x, y, z;
};

inline CUDA_CALLABLE float dot(const Apart& p, const Apart& q) { return (p.x * q.x + p.y * q.y) + p.z * q.z; }

/// p . ((q - p) x (r - p)): six times the volume between the point and a triangle.
inline CUDA_CALLABLE float volume_of(const Apart& p, const Apart& q, const Apart& r)
{
    const Apart b = {q.x - p.x, q.y - p.y, q.z - p.z}, c = {r.x - p.x, r.y - p.y, r.z - p.z};
    return dot(p, {b.y * c.z - b.z * c.y, b.z * c.x - b.x * c.z, b.x * c.y - b.y * c.x});
}

/// Floats of a lane.
constexpr int MOMENTS = 19;

/// Greatest number of inner nodes on a path from the root.
constexpr int DEPTH = 64;

/// Squared distance, over the square of what the scene reaches, from which numbers are 0: the powers in `far_children` are in
/// range.
constexpr float FARTHEST_SQUARE = 1e16f;

constexpr float PI = 3.14159274101257324f, HALF_PI = 1.57079637050628662f, OVER_FOUR_PI = 0.0795774683356285095f;

/// The angle of (x, y) in [-pi, pi], to 2e-7: a polynomial for the smaller one of both over the greater one. 0 for a zero
/// vector.
inline CUDA_CALLABLE float angle_of(float y, float x)
{
    const float up = WRT_ABS(y), along = WRT_ABS(x), low = up < along ? up : along, high = up < along ? along : up;
    const float t = high > 0.0f ? low / high : 0.0f, z = t * t;
    float p = 0.0024567246437072754f;
    p = p * z - 0.014401358552277088f;
    p = p * z + 0.039781223982572556f;
    p = p * z - 0.07234857231378555f;
    p = p * z + 0.10498946160078049f;
    p = p * z - 0.14161229133605957f;
    p = p * z + 0.19985906779766083f;
    p = p * z - 0.33332598209381104f;
    p = p * z + 0.9999998807907104f;
    const float octant = p * t, quadrant = up > along ? HALF_PI - octant : octant;
    const float half = x < 0.0f ? PI - quadrant : quadrant;
    return y < 0.0f ? -half : half;
}

/// Half the solid angle of a triangle, seen from the origin (van Oosterom and Strackee); 0 if a vertex is there.
inline CUDA_CALLABLE float half_solid_angle(const Apart& a, const Apart& b, const Apart& c)
{
    const float la = square_root(dot(a, a)), lb = square_root(dot(b, b)), lc = square_root(dot(c, c));
    const float rest = ((la * lb) * lc + dot(a, b) * lc) + (dot(b, c) * la + dot(c, a) * lb);
    return angle_of(volume_of(a, b, c), rest);
}

/// The vertex of a record times the scale, less the point.
template <int W> inline CUDA_CALLABLE Apart vertex_at(const float* record, int vertex, float scale, const Apart& point)
{
    const float* const from = record + 3 * W * vertex;
    return {from[0] * scale - point.x, from[W] * scale - point.y, from[2 * W] * scale - point.z};
}

/// Half the solid angles of a leaf's triangles. point: times the scale, a power of two that keeps products of three
/// lengths normal numbers; angles have the same bits with another one.
template <int W> inline CUDA_CALLABLE float angles_of_leaf(const float* records, int word, float scale, const Apart& point)
{
    float sum = 0.0f;
    int block = ~word >> 6;
    for (int left = ~word & 63; left > 0; left -= W, ++block) {
        const float* const record = records + (size_t)block * (9 * W);
        float angle[W];
        WRT_FOR_LANES (i) {
            const Apart a = vertex_at<W>(record + i, 0, scale, point), b = vertex_at<W>(record + i, 1, scale, point);
            const float one = half_solid_angle(a, b, vertex_at<W>(record + i, 2, scale, point));
            angle[i] = one == one ? one : 0.0f;
        }
        for (int i = 0; i < W && i < left; ++i) sum += angle[i];
    }
    return sum;
}

/// What the children of a node that are far away add, times 4 pi; the others are in `near`. far: of a lane, -1 if it is unused.
template <int W>
inline CUDA_CALLABLE float far_children(const float* moments, const float* far, const Apart& point, unsigned* near)
{
    float part[W];
    int left[W];
    WRT_FOR_LANES (i) {
        const float x = moments[i] - point.x, y = moments[W + i] - point.y, z = moments[2 * W + i] - point.z;
        const float square = (x * x + y * y) + z * z, over = 1.0f / square;
        const float dipole = (moments[3 * W + i] * x + moments[4 * W + i] * y) + moments[5 * W + i] * z;
        const float* const two = moments + 6 * W + i;
        const float* const three = moments + 11 * W + i;
        const float x2 = x * x, y2 = y * y, z2 = z * z, xy = x * y;
        const float second
            = (two[0] * (x2 - z2) + two[W] * (y2 - z2)) + (two[2 * W] * xy + (two[3 * W] * x + two[4 * W] * y) * z);
        const float third = ((three[0] * (x2 - 3.0f * z2) + three[W] * (y2 - z2)) * x
                                + (three[2 * W] * (y2 - 3.0f * z2) + three[3 * W] * (x2 - z2)) * y)
            + ((three[4 * W] * (3.0f * x2 - z2) + three[5 * W] * (3.0f * y2 - z2)) + three[6 * W] * xy) * z;
        const bool is_far = square >= far[i];
        const float value = (dipole + over * (second + over * third)) * (over * square_root(over));
        part[i] = (is_far & (far[i] > 0.0f)) ? value : 0.0f;
        left[i] = is_far ? 0 : -1;
    }
    *near = bits<W>(left);
    float sum = 0.0f;
    for (int i = 0; i < W; ++i) sum += part[i];
    return sum;
}

/// The winding number of a point.
template <int W, class Tree, class Triangles, class Clusters>
inline CUDA_CALLABLE float number_at(const Tree& tree, const Triangles& triangles, const Clusters& clusters, const Apart& point)
{
    const Apart scaled = {point.x * clusters.scale, point.y * clusters.scale, point.z * clusters.scale};
    if (!(dot(scaled, scaled) < FARTHEST_SQUARE)) return 0.0f;
    int nodes[DEPTH * (W - 1) + 1 + W], size = 0;
    float sum = 0.0f, angles = 0.0f;
    nodes[size++] = 0;
    while (size > 0) {
        const int node = nodes[--size];
        unsigned near;
        sum += far_children<W>(
            clusters.moments.data + (size_t)node * (MOMENTS * W), clusters.far.data + (size_t)node * W, scaled, &near);
        for (; near; near &= near - 1u) {
            const int word = tree.child.data[node * W + lowest_bit(near)];
            if (word >= 0) nodes[size++] = word;
            else angles += angles_of_leaf<W>(triangles.records.data, word, clusters.scale, scaled);
        }
    }
    return (sum + 2.0f * angles) * OVER_FOUR_PI;
}

}  // namespace winding
}  // namespace
}  // namespace wrt
