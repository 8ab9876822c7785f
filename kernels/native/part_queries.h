// What queries of parts of a scene fetch ahead into the caches of a core: wrt.kernels.query.part_queries.
#pragma once
#include "loops.h"

namespace wrt {
namespace {

#if defined(__CUDA_ARCH__)
#define WRT_FETCH_WRITTEN(pointer)
#else
#define WRT_FETCH_WRITTEN(pointer) __builtin_prefetch(pointer, 1)
#endif

/// A ray and its best hit. An address without an array does no harm.
template <class Rays, class Hits> inline CUDA_CALLABLE void fetch_ray(const Rays& rays, const Hits& hits, int i)
{
    WRT_FETCH(rays.origins.data + (size_t)i * rays.origin_stride);
    WRT_FETCH(rays.directions.data + (size_t)i * rays.direction_stride);
    WRT_FETCH(rays.t_max.data + (size_t)i * rays.t_max_stride);
    WRT_FETCH(hits.t.data + i);
}

/// What merging the closest hit at a place reads and writes; the corners for a place AHEAD / 2 earlier, whose face has come.
template <int AHEAD, class Order, class Mesh, class Ids, class Hits, class Corners>
inline CUDA_CALLABLE void fetch_merged(const Order& order, const Mesh& mesh, const Ids& ids, const Hits& found,
    const Hits& hits, const Corners& corners, int place)
{
#if !defined(__CUDA_ARCH__)
    if (place >= order.shape[0]) return;
    const int local = found.primitive.data[place];
    if (local >= 0) {
        const int i = order.data[place];
        const char* const corner = (const char*)(corners.data + 3 * (size_t)i);
        WRT_FETCH_WRITTEN(hits.t.data + i);
        WRT_FETCH_WRITTEN(hits.primitive.data + i);
        WRT_FETCH_WRITTEN(hits.uv.data + i);
        WRT_FETCH_WRITTEN(corner);
        WRT_FETCH_WRITTEN(corner + 35);
        WRT_FETCH(mesh.faces.data + local);
        WRT_FETCH(ids.data + local);
    }
    const int nearer = found.primitive.data[place - AHEAD / 2];
    if (place < AHEAD || nearer < 0) return;
    const auto face = mesh.faces.data[nearer];
    for (int c = 0; c < 3; ++c) WRT_FETCH(mesh.vertices.data + face.c[c]);
#endif
}

}  // namespace
}  // namespace wrt
