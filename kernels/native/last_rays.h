// Which rays of the last generation of paths need the closest hit: wrt.kernels.shading.paths.last_rays.
#pragma once
#include "light_sampling.h"
#include "ray_queues.h"

#if WRT_VECTORS
namespace wrt {
namespace {

/// Rays that meet the box of the emissive triangles.
template <int W, class Lights> inline Ints<W> meets_triangles(const Lights& lights, const V3<W>& start, const V3<W>& direction)
{
    using F = Floats<W>;
    const V3<W> away = {1.0f / direction.x, 1.0f / direction.y, 1.0f / direction.z};
    const V3<W> a = (all3<W>(lights.triangle_low) - start) * away, b = (all3<W>(lights.triangle_high) - start) * away;
    const F near = larger(larger(smaller(a.x, b.x), smaller(a.y, b.y)), smaller(a.z, b.z));
    const F far = smaller(smaller(larger(a.x, b.x), larger(a.y, b.y)), larger(a.z, b.z));
    return (near <= far) & (far >= 0.0f);
}

/// Moves those of the rays begin .. stop - 1 that may meet a light before the sky to the front of their places, and returns
/// their number. Copies the others to another queue if there is a sky. Writes is_met, and up to W - 1 places beyond.
template <int W, class Lights, class Queue>
inline int part_last_rays(
    int begin, int stop, bool has_sky, const Lights& lights, const Queue& source, int* is_met, const Queue& target)
{
    for (int i = begin; i < stop; i += W) {  // what lies beyond the last ray is written over
        const V3<W> start = load3<W>(source.origin.data + i), direction = load3<W>(source.direction.data + i);
        Ints<W> meets = (Ints<W>)0;
        for (int e = 0; e < lights.areas; ++e) {
            Floats<W> density;
            meets = meets | crossed<W>(lights, e, start, direction, all<W>(WRT_INFINITY), density);
        }
        if (lights.triangle_entry >= 0) meets = meets | meets_triangles<W>(lights, start, direction);
        save(is_met + i, meets);
    }
    return part_rays(begin, stop, is_met, has_sky, source, target);
}

}  // namespace
}  // namespace wrt
#endif
