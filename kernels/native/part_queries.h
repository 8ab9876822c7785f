// What queries of parts of a scene read and write, fetched into the caches of a core: `wrt.kernels.query.part_queries`. They do
// nothing on CUDA.
#pragma once
#include "loops.h"

namespace wrt {
namespace {

/// A ray and its best hit. An address without an array does no harm.
template <class Rays, class Hits> inline CUDA_CALLABLE void fetch_ray(const Rays& rays, const Hits& hits, int i)
{
#if !defined(__CUDA_ARCH__)
    __builtin_prefetch(rays.origins.data + (size_t)i * rays.origin_stride);
    __builtin_prefetch(rays.directions.data + (size_t)i * rays.direction_stride);
    __builtin_prefetch(rays.t_max.data + (size_t)i * rays.t_max_stride);
    __builtin_prefetch(hits.t.data + i);
#endif
}

/// A closest hit, its triangle, and the corners of the triangle half as far ahead, whose face has been fetched before. corners:
/// three of each ray.
template <int AHEAD, class Mesh, class Hits, class Vec3>
inline CUDA_CALLABLE void fetch_merged(const int* order, int count, const Mesh& mesh, const int* ids, const int* found,
    const Hits& hits, const Vec3* corners, int place)
{
#if !defined(__CUDA_ARCH__)
    if (place >= count) return;
    const int local = found[place];
    if (local >= 0) {
        const int i = order[place];
        const char* const corner = (const char*)(corners + 3 * (size_t)i);
        __builtin_prefetch(hits.t.data + i, 1);
        __builtin_prefetch(hits.primitive.data + i, 1);
        __builtin_prefetch(hits.uv.data + i, 1);
        __builtin_prefetch(corner, 1);
        __builtin_prefetch(corner + 3 * sizeof(Vec3) - 1, 1);
        __builtin_prefetch(mesh.faces.data + local);
        __builtin_prefetch(ids + local);
    }
    if (place < AHEAD) return;
    const int nearer = found[place - AHEAD / 2];
    if (nearer < 0) return;
    const auto& face = mesh.faces.data[nearer];
    for (int c = 0; c < 3; ++c) __builtin_prefetch(mesh.vertices.data + face.c[c]);
#endif
}

}  // namespace
}  // namespace wrt
