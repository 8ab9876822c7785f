// The closest hit in float64 by walks that test triangles of 48 bytes one by one (wrt.kernels.answers.exact_hit): boxes are
// those of the rounded ray, and a triangle whose box it meets is tested with ray and vertices as the caller gave them.
#pragma once
#include "packed_answers.h"

namespace wrt {
namespace {

/// A ray in float64, in the space of the vertices that it is tested with.
struct WideRay {
    double origin[3], direction[3];
};

/// The best hit so far; before the first one, t is the ray's end.
struct WideHit {
    double t, u, v;
};

/// In place of a batch of rays, those in float64. rays: `ExactRays`; seen: the batch that says what they see of instances;
/// center: of the scene.
template <class Exact, class Batch, class Vec> struct WideRays {
    const Exact& rays;
    const Batch& seen;
    const Vec& center;
    int count;
};

template <class Exact, class Batch, class Vec>
inline CUDA_CALLABLE WideRay wide_ray(const WideRays<Exact, Batch, Vec>& own, int i)
{
    const auto &from = own.rays.origins.data[(size_t)i * own.rays.origin_stride].c,
               &along = own.rays.directions.data[(size_t)i * own.rays.direction_stride].c;
    return {{from[0], from[1], from[2]}, {along[0], along[1], along[2]}};
}

template <class Tree, class Exact, class Batch, class Vec>
inline CUDA_CALLABLE GivenRay given_ray(const Tree& tree, const WideRays<Exact, Batch, Vec>& own, int i)
{
    const WideRay ray = wide_ray(own, i);
    const double *const from = ray.origin, *const along = ray.direction;
    const auto& c = own.center.c;
    return given_in(tree, (float)(from[0] - c[0]), (float)(from[1] - c[1]), (float)(from[2] - c[2]), (float)along[0],
        (float)along[1], (float)along[2]);
}

/// A vector by the inverse map of an instance.
template <class Place> inline CUDA_CALLABLE void map_vector(const Place& place, double x, double y, double z, double* to)
{
    WRT_UNROLLED
    for (int a = 0; a < 3; ++a) {
        const auto& m = place.to_object.data[a];
        to[a] = (m[0] * x + m[1] * y) + m[2] * z;
    }
}

/// A ray in the space of an instance's vertices; shift: what the tree there is relative to.
template <class Place, class Exact, class Batch, class Vec>
inline CUDA_CALLABLE WideRay wide_within(const Place& place, const Vec& shift, const WideRays<Exact, Batch, Vec>& own, int i)
{
    const WideRay ray = wide_ray(own, i);
    const auto &c = own.center.c, &o = place.origin.c;
    const double *const from = ray.origin, *const along = ray.direction;
    WideRay to;
    map_vector(place, (from[0] - c[0]) - o[0], (from[1] - c[1]) - o[1], (from[2] - c[2]) - o[2], to.origin);
    map_vector(place, along[0], along[1], along[2], to.direction);
    WRT_UNROLLED
    for (int a = 0; a < 3; ++a) to.origin[a] += shift.c[a];
    return to;
}

template <class Tree, class Place, class Exact, class Batch, class Vec>
inline CUDA_CALLABLE GivenRay given_within(const Tree& tree, const Place& place, const WideRays<Exact, Batch, Vec>& own, int i)
{
    const WideRay ray = wide_ray(own, i);
    const auto &c = own.center.c, &o = place.origin.c;
    const double *const from = ray.origin, *const along = ray.direction;
    double to[3], towards[3];
    map_vector(place, (from[0] - c[0]) - o[0], (from[1] - c[1]) - o[1], (from[2] - c[2]) - o[2], to);
    map_vector(place, along[0], along[1], along[2], towards);
    return given_in(tree, (float)to[0], (float)to[1], (float)to[2], (float)towards[0], (float)towards[1], (float)towards[2]);
}

template <class Exact, class Batch, class Vec> inline CUDA_CALLABLE float first_t(const WideRays<Exact, Batch, Vec>& own, int i)
{
    const double first = own.rays.t_min.data[(size_t)i * own.rays.t_min_stride];
    return first < 0.0 ? -1.0f : (float)first;  // also where it is rounded to -0
}

template <class Exact, class Batch, class Vec> inline CUDA_CALLABLE double end_of(const WideRays<Exact, Batch, Vec>& own, int i)
{
    const double last = own.rays.t_max.data[(size_t)i * own.rays.t_max_stride];
    return last < (double)FARTHEST ? last : (double)FARTHEST;
}

template <class Exact, class Batch, class Vec> inline CUDA_CALLABLE float last_t(const WideRays<Exact, Batch, Vec>& own, int i)
{
    return (float)end_of(own, i);
}

template <class Exact, class Batch, class Vec>
inline CUDA_CALLABLE unsigned mask_of(const WideRays<Exact, Batch, Vec>& own, int i)
{
    return mask_of(own.seen, i);
}

template <class Exact, class Batch, class Vec>
inline CUDA_CALLABLE int environment_of(const WideRays<Exact, Batch, Vec>& own, int i)
{
    return environment_of(own.seen, i);
}

/// A vertex in the frame of a ray: across it, and its t (`shear` of wrt.kernels.answers.exact_hit).
struct WideVertex {
    double x, y, t;
};

template <class Vec> inline CUDA_CALLABLE WideVertex sheared_vertex(const Vec& point, const WideRay& ray, int main)
{
    const int x = main == 2 ? 0 : main + 1, y = main == 0 ? 2 : main - 1;
    const double t = (point.c[main] - ray.origin[main]) / ray.direction[main];
    return {(point.c[x] - ray.origin[x]) - ray.direction[x] * t, (point.c[y] - ray.origin[y]) - ray.direction[y] * t, t};
}

/// The answer of a walk that keeps a `WideHit` besides its best hit, which bounds the walk.
struct WideAnswer : ClosestAnswer {
    static constexpr bool WIDE = true;
    using State = WideHit;

    template <class Hits> static CUDA_CALLABLE void store(const Hits& hits, int i, const PackedHit& best, const WideHit& wide)
    {
        const bool missed = best.id < 0;
        hits.t.data[i] = missed ? (double)WRT_INFINITY : wide.t;
        double* const uv = (double*)(hits.uv.data + i);
        uv[0] = wide.u, uv[1] = wide.v;
        ClosestAnswer::store(hits.rounded, i, {(float)wide.t, (float)wide.u, (float)wide.v, best.id});
    }
};

/// Tests a triangle (`test_exactly`); returns whether it is hit from t_min on, and how.
template <class Mesh>
inline CUDA_CALLABLE bool meet_exactly(const Mesh& mesh, int triangle, const WideRay& ray, double t_min, WideHit& hit)
{
    const double size_x = ray.direction[0] < 0.0 ? -ray.direction[0] : ray.direction[0];
    const double size_y = ray.direction[1] < 0.0 ? -ray.direction[1] : ray.direction[1];
    const double size_z = ray.direction[2] < 0.0 ? -ray.direction[2] : ray.direction[2];
    int main = size_y > size_x ? 1 : 0;
    main = size_z > (size_x > size_y ? size_x : size_y) ? 2 : main;
    const auto& face = mesh.faces.data[triangle].c;
    const WideVertex a = sheared_vertex(mesh.vertices.data[face[0]], ray, main);
    const WideVertex b = sheared_vertex(mesh.vertices.data[face[1]], ray, main);
    const WideVertex c = sheared_vertex(mesh.vertices.data[face[2]], ray, main);
    const double area_a = b.x * c.y - b.y * c.x, area_b = c.x * a.y - c.y * a.x, area_c = a.x * b.y - a.y * b.x;
    const double total = (area_a + area_b) + area_c;
    const bool front = (area_a >= 0.0) & (area_b >= 0.0) & (area_c >= 0.0);
    const bool back = (area_a <= 0.0) & (area_b <= 0.0) & (area_c <= 0.0);
    if (!((front | back) & (total != 0.0))) return false;
    hit = {((area_a * a.t + area_b * b.t) + area_c * c.t) / total + 0.0, area_b / total, area_c / total};
    return hit.t >= t_min;
}

}  // namespace
}  // namespace wrt
