// Triangles of 48 bytes, and one ray: the watertight test and the consistency rule, a triangle at a time
// (wrt.kernels.layout.binary_nodes). The bits of hits are those of blocks.
#pragma once
#include "binary_nodes.h"
#include "leaf.h"
#include "triangle.h"

namespace wrt {
namespace {

/// A ray of a batch as it was given: read again at each hit, so that it need not stay in registers.
struct GivenRay {
    float origin[3], direction[3], reach;

    CUDA_CALLABLE BoxRay boxes() const
    {
        return box_ray(direction[0], direction[1], direction[2], origin[0], origin[1], origin[2], reach);
    }
};

/// The ray from an origin in the space of a tree, whose bounds are those of `tree`.
template <class Tree>
inline CUDA_CALLABLE GivenRay given_in(const Tree& tree, float px, float py, float pz, float x, float y, float z)
{
    drop_negligible(x, y, z);
    return {{px, py, pz}, {x, y, z}, reach(tree.low, tree.high, px, py, pz)};
}

/// Where a ray of a batch is given.
struct RayPlace {
    const float *from, *along;
};

template <class Batch> inline CUDA_CALLABLE RayPlace place_of(const Batch& rays, int i)
{
    return {(const float*)(rays.origins.data + (size_t)i * rays.origin_stride),
        (const float*)(rays.directions.data + (size_t)i * rays.direction_stride)};
}

/// Ray i of a batch, relative to the centre of the scene whose bounds are those of `tree`.
template <class Tree, class Batch> inline CUDA_CALLABLE GivenRay given_ray(const Tree& tree, const Batch& rays, int i)
{
    const RayPlace at = place_of(rays, i);
    const auto& c = rays.center.c;
    return given_in(tree, relative(at.from[0], c[0]), relative(at.from[1], c[1]), relative(at.from[2], c[2]), at.along[0],
        at.along[1], at.along[2]);
}

/// A ray in the space of an instance at `place`, whose tree has the bounds of `tree` (`object_ray` of
/// wrt.kernels.layout.instance_maps). px, py, pz: its origin relative to the scene's centre.
template <class Tree, class Place>
inline CUDA_CALLABLE GivenRay mapped(
    const Tree& tree, const Place& place, double px, double py, double pz, float x, float y, float z)
{
    drop_negligible(x, y, z);
    const double qx = px - place.origin.c[0], qy = py - place.origin.c[1], qz = pz - place.origin.c[2];
    float to[6];
    WRT_UNROLLED
    for (int a = 0; a < 3; ++a) {
        const auto& m = place.to_object.data[a];
        to[a] = (float)((m[0] * qx + m[1] * qy) + m[2] * qz);
        to[3 + a] = (float)((m[0] * (double)x + m[1] * (double)y) + m[2] * (double)z);
    }
    return given_in(tree, to[0], to[1], to[2], to[3], to[4], to[5]);
}

/// Ray i of a batch there.
template <class Tree, class Place, class Batch>
inline CUDA_CALLABLE GivenRay given_within(const Tree& tree, const Place& place, const Batch& rays, int i)
{
    const RayPlace at = place_of(rays, i);
    const auto& c = rays.center.c;
    return mapped(tree, place, (double)at.from[0] - c[0], (double)at.from[1] - c[1], (double)at.from[2] - c[2], at.along[0],
        at.along[1], at.along[2]);
}

/// The range of ray i of a batch, what it sees of instances, and its environment (`ray_mask`, `ray_environment`).
template <class Batch> inline CUDA_CALLABLE float first_t(const Batch& rays, int i)
{
    return rays.t_min.data[(size_t)i * rays.t_min_stride];
}

template <class Batch> inline CUDA_CALLABLE float last_t(const Batch& rays, int i)
{
    const float last = rays.t_max.data[(size_t)i * rays.t_max_stride];
    return last > FARTHEST ? FARTHEST : last;
}

template <class Batch> inline CUDA_CALLABLE unsigned mask_of(const Batch& rays, int i)
{
    return rays.mask.shape[0] > 0 ? rays.mask.data[(size_t)i * rays.mask_stride] : ~0u;
}

template <class Batch> inline CUDA_CALLABLE int environment_of(const Batch& rays, int i)
{
    return rays.environment.shape[0] > 0 ? rays.environment.data[(size_t)i * rays.environment_stride] : -1;
}

/// In place of a batch, the ray of a thread: a checked `Ray`, its origin in float64, and what it sees.
template <class Ray, class Origin> struct OneRay {
    const Ray& ray;
    const Origin& origin;
    unsigned mask;
    int environment;
};

template <class Tree, class Ray, class Origin>
inline CUDA_CALLABLE GivenRay given_ray(const Tree& tree, const OneRay<Ray, Origin>& own, int)
{
    const auto &from = own.ray.origin.c, &along = own.ray.direction.c;
    return given_in(tree, from[0], from[1], from[2], along[0], along[1], along[2]);
}

template <class Tree, class Place, class Ray, class Origin>
inline CUDA_CALLABLE GivenRay given_within(const Tree& tree, const Place& place, const OneRay<Ray, Origin>& own, int)
{
    const auto& from = own.origin.c;
    const auto& along = own.ray.direction.c;
    return mapped(tree, place, from[0], from[1], from[2], along[0], along[1], along[2]);
}

template <class Ray, class Origin> inline CUDA_CALLABLE float first_t(const OneRay<Ray, Origin>& own, int)
{
    return own.ray.t_min;
}

template <class Ray, class Origin> inline CUDA_CALLABLE float last_t(const OneRay<Ray, Origin>& own, int)
{
    return own.ray.t_max;
}

template <class Ray, class Origin> inline CUDA_CALLABLE unsigned mask_of(const OneRay<Ray, Origin>& own, int)
{
    return own.mask;
}

template <class Ray, class Origin> inline CUDA_CALLABLE int environment_of(const OneRay<Ray, Origin>& own, int)
{
    return own.environment;
}

/// A vector in the order of axes in which the main axis is last.
inline CUDA_CALLABLE void turn(int main, float x, float y, float z, float* to)
{
    to[0] = main == 2 ? x : main == 0 ? y : z;
    to[1] = main == 2 ? y : main == 0 ? z : x;
    to[2] = main == 2 ? z : main == 0 ? x : y;
}

/// What the watertight test needs of a ray (`ShearedRay`).
struct TurnedRay {
    float origin[3], shear[3];
    int main;
};

inline CUDA_CALLABLE TurnedRay turned(const GivenRay& given)
{
    const float x = given.direction[0], y = given.direction[1], z = given.direction[2];
    const float size_x = WRT_ABS(x), size_y = WRT_ABS(y), size_z = WRT_ABS(z);
    TurnedRay ray;
    ray.main = size_x >= size_y ? (size_x >= size_z ? 0 : 2) : (size_y >= size_z ? 1 : 2);
    turn(ray.main, given.origin[0], given.origin[1], given.origin[2], ray.origin);
    float along[3];
    turn(ray.main, x, y, z, along);
    ray.shear[0] = along[0] / along[2], ray.shear[1] = along[1] / along[2], ray.shear[2] = 1.0f / along[2];
    return ray;
}

/// The best hit so far; id < 0 before the first one, and t is then the ray's end. Of queries about crossings, id is their
/// number so far minus one.
struct PackedHit {
    float t, u, v;
    int id;
};

/// Whether a line surely misses a triangle of these areas, as most do: areas that are so large have the sign of the exact ones.
inline CUDA_CALLABLE bool surely_misses(const Areas<float>& w)
{
    return min_of(w.a, min_of(w.b, w.c)) < -SMALL_AREA && max_of(w.a, max_of(w.b, w.c)) > SMALL_AREA;
}

/// The areas of a triangle that the ray's line meets, precise where needed (`woop_block`); false if it misses.
template <class Rule> inline CUDA_CALLABLE bool meet_line(const Sheared<float>& s, Areas<float>& w)
{
    w = areas_of(s);
    if (surely_misses(w)) return false;
    if (Rule::unsure(w)) return Rule::decide(s, w);
    if (!on_one_side(w)) return false;
    if (is_thin(w, size_of(s))) w = precise_areas(s, w);
    return true;
}

/// The words of a triangle, and its vertices in the frame of a ray.
struct LoadedTriangle {
    Quad a, b, c;
    Sheared<float> s;
};

inline CUDA_CALLABLE LoadedTriangle load_triangle(const float* triangles, int slot, const TurnedRay& ray)
{
    const float* const at = triangles + TRIANGLE_WORDS * (size_t)slot;
    const Quad a = load_quad(at), b = load_quad(at + 4), c = load_quad(at + 8);
    float vertex[3][3];
    turn(ray.main, a.x, a.y, a.z, vertex[0]);
    turn(ray.main, b.x, b.y, b.z, vertex[1]);
    turn(ray.main, c.x, c.y, c.z, vertex[2]);
    return {a, b, c, sheared<float>(ray.shear[0], ray.shear[1], [&](int corner, int along) {
                return vertex[corner][along] - ray.origin[along];
            })};
}

/// Tests a triangle; returns whether its hit, from t_min to t_max, is taken: take(hit, given) -> bool. CULLING: only from its
/// front. given() -> `GivenRay`.
template <class Rule, bool CULLING, class Given, class Take>
inline CUDA_CALLABLE bool meet_triangle(
    const LoadedTriangle& triangle, const TurnedRay& ray, float t_min, float t_max, const Given& given, const Take& take)
{
    const auto& [a, b, c, s] = triangle;
    Areas<float> w;
    if (!meet_line<Rule>(s, w)) return false;
    const TriangleHit<float> hit = weighed(w, s.depth[0], s.depth[1], s.depth[2], ray.shear[2]);
    const float corners[9] = {a.x, a.y, a.z, b.x, b.y, b.z, c.x, c.y, c.z};
    const GivenRay whole = given();
    const BoxRay boxes = whole.boxes();
    float low[3], high[3];
    vertex_box<1>(corners, low, high);
    const Interval own = meet_box(low, high, boxes, -WRT_INFINITY, WRT_INFINITY);
    const float t = clamped(hit.t, own);
    if (!((own.enter <= own.leave) & (t >= t_min) & (t <= t_max))) return false;
    if (CULLING && !comes_from_front<1>(corners, boxes)) return false;
    return take(PackedHit {t, Rule::ORIENTED ? sign_of(w, ray.shear[2]) : hit.u, hit.v, int_of(a.w)}, whole);
}

}  // namespace
}  // namespace wrt
