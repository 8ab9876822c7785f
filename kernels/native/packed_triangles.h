// Triangles of 48 bytes, and one ray: the watertight test and the consistency rule, a triangle at a time
// (wrt.kernels.layout.binary_nodes). The bits of hits are those of blocks.
#pragma once
#include "binary_nodes.h"
#include "leaf.h"
#include "triangle.h"

namespace wrt {
namespace {

/// Words of a triangle: three vertices, each followed by a word; that of the first is the triangle's id.
constexpr int TRIANGLE_WORDS = 12;

/// A ray of a batch as it was given: read again at each hit, so that it need not stay in registers.
struct GivenRay {
    float origin[3], direction[3], reach;

    CUDA_CALLABLE BoxRay boxes() const
    {
        return box_ray(direction[0], direction[1], direction[2], origin[0], origin[1], origin[2], reach);
    }
};

/// Ray i of a batch, relative to the centre of the scene whose bounds are those of `tree`.
template <class Tree, class Batch> inline CUDA_CALLABLE GivenRay given_ray(const Tree& tree, const Batch& rays, int i)
{
    const float* const from = (const float*)(rays.origins.data + (size_t)i * rays.origin_stride);
    const float* const along = (const float*)(rays.directions.data + (size_t)i * rays.direction_stride);
    GivenRay ray;
    WRT_UNROLLED
    for (int a = 0; a < 3; ++a) {
        ray.origin[a] = relative(from[a], rays.center.c[a]);
        ray.direction[a] = along[a];
    }
    drop_negligible(ray.direction[0], ray.direction[1], ray.direction[2]);
    ray.reach = reach(tree.low, tree.high, ray.origin[0], ray.origin[1], ray.origin[2]);
    return ray;
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

/// The best hit so far; id < 0 before the first one, and t is then the ray's end.
struct PackedHit {
    float t, u, v;
    int id;
};

/// The areas of a triangle that the ray's line meets, precise where needed (`woop_block`); false if it misses.
inline CUDA_CALLABLE bool meet_line(const Sheared<float>& s, Areas<float>& w)
{
    w = areas_of(s);
    // most misses; areas that are so large have the sign of the exact ones
    if (least(w.a, least(w.b, w.c)) < -SMALL_AREA && most(w.a, most(w.b, w.c)) > SMALL_AREA) return false;
    if (Inclusive::unsure(w)) return Inclusive::decide(s, w);
    if (!on_one_side(w)) return false;
    if (is_thin(w, size_of(s))) w = precise_areas(s, w);
    return true;
}

/// Tests a triangle; returns the scale of the ray (`scale_of`) if it is the best hit now, else 0. CULLING: only from its front.
/// given() -> `GivenRay`.
template <bool CULLING, class Given>
inline CUDA_CALLABLE float meet_triangle(
    const float* triangles, int slot, const TurnedRay& ray, float t_min, const Given& given, PackedHit& best)
{
    const float* const at = triangles + TRIANGLE_WORDS * (size_t)slot;
    const Quad a = load_quad(at), b = load_quad(at + 4), c = load_quad(at + 8);
    float vertex[3][3];
    turn(ray.main, a.x, a.y, a.z, vertex[0]);
    turn(ray.main, b.x, b.y, b.z, vertex[1]);
    turn(ray.main, c.x, c.y, c.z, vertex[2]);
    const Sheared<float> s = sheared<float>(
        ray.shear[0], ray.shear[1], [&](int corner, int along) { return vertex[corner][along] - ray.origin[along]; });
    Areas<float> w;
    if (!meet_line(s, w)) return 0.0f;
    const TriangleHit<float> hit = weighed(w, s.depth[0], s.depth[1], s.depth[2], ray.shear[2]);
    const float corners[9] = {a.x, a.y, a.z, b.x, b.y, b.z, c.x, c.y, c.z};
    const GivenRay whole = given();
    const BoxRay boxes = whole.boxes();
    float low[3], high[3];
    vertex_box<1>(corners, low, high);
    const Interval own = meet_box(low, high, boxes, -WRT_INFINITY, WRT_INFINITY);
    const float t = clamped(hit.t, own);
    if (!((own.enter <= own.leave) & (t >= t_min) & (t <= best.t))) return 0.0f;
    const int id = int_of(a.w);
    if (t == best.t && best.id >= 0 && id >= best.id) return 0.0f;
    if (CULLING && !comes_from_front<1>(corners, boxes)) return 0.0f;
    best = {t, hit.u, hit.v, id};
    return scale_of(whole.direction[0], whole.direction[1], whole.direction[2]);
}

}  // namespace
}  // namespace wrt
