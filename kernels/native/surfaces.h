// What W rays hit: materials, which rays are simple, and the points where they end.
//
// The scalar functions are wrt.kernels.shading.bsdf.material_table, .shading_point and .wavefront.scene_light.
#pragma once
#include "random_numbers.h"

#if WRT_VECTORS
namespace wrt {
namespace {

constexpr float OFFSET = 3.814697265625e-06f, INSET = 7.0f;
constexpr int DIFFUSE = 0, MIRROR = 1, DIELECTRIC = 2;
constexpr float MIN_ALPHA = 0.001f;

/// Scenes with more lights have no simple rays: each light costs all lanes.
constexpr int MAX_LIGHTS = 8;

template <int W> inline void save_media(void* to, Ints<W> media)
{
    save(to, __builtin_convertvector((Words<W>)media, Vector<unsigned long long, W>));
}

/// What a step reads and writes.
template <class Scene, class Source, class Wave, class Queue, class Hits, class Gathered> struct StepArrays {
    const Scene& scene;
    const Source& source;
    const Wave& wave;
    const Queue& queue;
    const Hits& hits;
    const Gathered& rays;
};
template <class Scene, class Source, class Wave, class Queue, class Hits, class Gathered>
StepArrays(const Scene&, const Source&, const Wave&, const Queue&, const Hits&, const Gathered&)
    -> StepArrays<Scene, Source, Wave, Queue, Hits, Gathered>;

/// W rays of a queue, from number `first` on.
template <int W> struct Rays {
    int first;
    V3<W> direction, weight;
    Ints<W> slot;
};

template <int W, class A> inline Rays<W> read_rays(const A& a, int first)
{
    const V3<W> direction = load3<W>(a.queue.direction.data + first), weight = load3<W>(a.queue.weight.data + first);
    return {first, direction, weight, load<Ints<W>>(a.queue.slot.data + first)};
}

/// The surfaces that W rays hit, and which rays are simple, by what happens to them. Paths end (`ended`) where nothing is hit,
/// and in the last generation.
template <int W> struct Surfaces {
    Ints<W> is_hit, media, in_air, is_clear;
    Ints<W> number, kind, is_dark, has_image;
    Floats<W> rough, index, through;
    V3<W> color;
    int face_of[W];
    Ints<W> matte, mirror, glass, ended;

    Ints<W> single() const { return mirror | glass; }
    Ints<W> going_on() const { return matte | mirror | glass; }
};

/// Materials of the triangles that the rays from number `first` on hit.
template <int W, class A> inline void read_surfaces(const A& a, int first, Surfaces<W>& s)
{
    using I = Ints<W>;
    using L = Vector<unsigned long long, W>;
    const auto& materials = a.scene.materials;
    const L media_of = load<L>(a.queue.media.data + first);
    const I hit = load<I>(a.hits.primitive.data + first);
    s.is_hit = hit >= 0;
    s.media = __builtin_convertvector(media_of <= 0xFFFF ? media_of : (L)~0ull, I);  // -1: several
    s.in_air = s.media == 0;
    int number_of[W];
    save(s.face_of, s.is_hit & hit);
    WRT_SCALAR
    for (int i = 0; i < W; ++i) number_of[i] = materials.of_face.data[s.face_of[i] * materials.of_face_stride];
    s.number = load<I>(number_of);
    s.kind = (I)0, s.is_dark = (I)-1, s.has_image = (I)0, s.is_clear = s.in_air;
    s.rough = all<W>(0.0f), s.index = s.rough, s.through = s.rough;
    s.color = zero3<W>();
    for_each_value<W>(s.number, s.is_hit, [&](int n, I own) {  // neighbours have few materials
        const auto& e = materials.emission.data[n];
        const auto& shape = materials.shape.data[n];
        s.kind = pick(own, (I)materials.kind.data[n], s.kind);
        if (!(e.c[0] + e.c[1] + e.c[2] == 0.0f)) s.is_dark = s.is_dark & ~own;
        if (materials.has_uv && (materials.color_texture.data[n] >= 0 || materials.surface_texture.data[n] >= 0))
            s.has_image = s.has_image | own;
        s.rough = pick(own, all<W>(shape.c[0]), s.rough);
        s.index = pick(own, all<W>(shape.c[2]), s.index);
        s.through = pick(own, all<W>(shape.c[3]), s.through);
        s.color = pick3<W>(own, all3<W>(materials.color.data[n]), s.color);
    });
    for_each_value<W>(s.media, s.media > 0, [&](int medium, I own) {
        const auto& b = materials.absorption.data[medium - 1];
        if (b.c[0] == 0.0f && b.c[1] == 0.0f && b.c[2] == 0.0f) s.is_clear = s.is_clear | own;  // nothing is absorbed
    });
}

/// Which rays are simple; false if none is.
template <int W, class Scene> inline bool find_simple(const Scene& scene, bool is_last, Surfaces<W>& s)
{
    using I = Ints<W>;
    const auto& lights = scene.lights;
    const auto& sky = lights.sky;
    const bool is_even = sky.width == 1 && sky.height == 1 && sky.rows <= 1 && sky.columns <= 1;
    const I goes = is_last ? (I)0 : s.is_hit & s.is_dark & ~s.has_image & s.is_clear;
    s.matte = goes & s.in_air & (s.kind == DIFFUSE) & (s.through == 0.0f), s.mirror = goes & (s.kind == MIRROR);
    s.glass = goes & (s.kind == DIELECTRIC) & (s.in_air | (s.media == s.number + 1));
    s.glass = s.glass & (s.rough * s.rough < MIN_ALPHA);
    if (scene.schlick) s.glass = (I)0;
    const I emits = lights.triangle_entry < 0 ? (I)0 : ~s.is_dark;
    const I escapes = lights.sky_entry < 0 || is_even ? ~s.is_hit : (I)0;
    s.ended = escapes | (is_last ? s.is_hit & s.is_clear & ~emits : (I)0);
    return is_any(s.going_on() | s.ended);
}

/// W triangles: `FaceRecord`.
template <int W> struct Faces {
    V3<W> corner, edge1, edge2, normal, inverse_heights;
    Floats<W> curved;
};

template <int W, class Scene> inline Faces<W> read_faces(const Scene& scene, const int* numbers)
{
    Floats<W> w[16];
    gather_records<W>(scene.shaded.records.data, numbers, w);
    return {{w[0], w[1], w[2]}, {w[3], w[4], w[5]}, {w[6], w[7], w[8]}, {w[9], w[10], w[11]}, {w[12], w[13], w[14]}, w[15]};
}

/// The greatest distance along an axis from points to the ends of the scene.
template <int W, class Scene> inline Floats<W> reach(const Scene& scene, const V3<W>& o)
{
    using F = Floats<W>;
    const V3<W> down = all3<W>(scene.shaded.mesh.low) - o, up = all3<W>(scene.shaded.mesh.high) - o;
    const F x = larger(absolute(down.x), absolute(up.x)), y = larger(absolute(down.y), absolute(up.y));
    return larger(x, larger(y, larger(absolute(down.z), absolute(up.z))));
}

/// The points where W rays end: `shading_point`.
template <int W> struct Points {
    Ints<W> is_front;
    Floats<W> side, offset, w0, w1, w2;
    V3<W> face_normal, normal, position, lit_from;
};

/// Moves points of these lanes away from the edges of their triangles.
template <int W> inline void keep_from_edges(const Faces<W>& face, Ints<W> lanes, Points<W>& p)
{
    using F = Floats<W>;
    using I = Ints<W>;
    const V3<W> inverse = face.inverse_heights;
    const F room = smaller(INSET * p.offset, 0.5f / (inverse.x + inverse.y + inverse.z)), sum = p.w0 + p.w1 + p.w2;
    const F least0 = room * inverse.x, least1 = room * inverse.y, least2 = room * inverse.z;
    const I is_near = (p.w0 < least0) | (p.w1 < least1) | (p.w2 < least2);
    p.w0 = p.w0 / sum, p.w1 = p.w1 / sum, p.w2 = p.w2 / sum;
    if (!is_any(is_near & lanes)) return;
    const V3<W> edge0 = face.edge2 - face.edge1, edge1 = face.edge2 * -1.0f, edge2 = face.edge1;
    const V3<W> across = cross(face.edge1, face.edge2);
    const F area = root(dot(across, across));
    const I moves = is_near & (area > 0.0f);
    const auto part = [&](F lower, F share, F over) { return larger(all<W>(0.0f), lower - share) / over / (over * area); };
    for (int pass = 0; pass < 2; ++pass) {
        const V3<W> step = edge0 * part(least0, p.w0, inverse.x) + edge1 * part(least1, p.w1, inverse.y)
            + edge2 * part(least2, p.w2, inverse.z);
        p.w0 = pick(moves, p.w0 + dot(edge0, step) / area, p.w0);
        p.w1 = pick(moves, p.w1 + dot(edge1, step) / area, p.w1);
        p.w2 = pick(moves, p.w2 + dot(edge2, step) / area, p.w2);
    }
}

/// Smooth normals, and points on the curved surface from which light is sampled.
template <int W, class Scene>
inline void smooth(const Scene& scene, const int* face_of, const Faces<W>& face, const V3<W>& direction, Points<W>& p)
{
    const auto corner_normals = [&](int corner) {
        int numbers[W];
        WRT_SCALAR
        for (int i = 0; i < W; ++i) numbers[i] = 3 * face_of[i] + corner;
        return gather3<W>(scene.shaded.corner_normals.data, numbers) * p.side;
    };
    const auto raised
        = [&](const V3<W>& corner, const V3<W>& n) { return n * -smaller(all<W>(0.0f), dot(p.position - corner, n)); };
    const V3<W> na = corner_normals(0), nb = corner_normals(1), nc = corner_normals(2);
    const V3<W> blend = na * p.w0 + nb * p.w1 + nc * p.w2;
    const Ints<W> is_round = (face.curved != 0.0f) & (dot(blend, p.face_normal) > 0.0f) & (dot(blend, direction) < 0.0f);
    const V3<W> rise = raised(face.corner, na) * p.w0 + raised(face.corner + face.edge1, nb) * p.w1
        + raised(face.corner + face.edge2, nc) * p.w2;
    p.normal = pick3<W>(is_round, blend / root(dot(blend, blend)), p.face_normal);
    p.lit_from = pick3<W>(is_round, p.position + rise, p.position);
}

/// The points where rays end. Rays that hit a triangle without an area are no longer simple.
template <int W, class A> inline Points<W> find_points(const A& a, const Rays<W>& ray, Surfaces<W>& s)
{
    using F = Floats<W>;
    using I = Ints<W>;
    const Faces<W> face = read_faces<W>(a.scene, s.face_of);
    Points<W> p;
    const I has_area = dot(face.normal, face.normal) != 0.0f;
    p.is_front = dot(face.normal, ray.direction) <= 0.0f;
    s.matte = s.matte & has_area, s.mirror = s.mirror & has_area;
    s.glass = s.glass & has_area & (~p.is_front | s.in_air);  // not a body within one of its kind
    p.side = pick(p.is_front, all<W>(1.0f), all<W>(-1.0f));
    p.face_normal = face.normal * p.side;
    F u, v;
    load2<W>(a.hits.uv.data + ray.first, u, v, Lanes<W>());
    p.offset = OFFSET * reach<W>(a.scene, face.corner + face.edge1 * u + face.edge2 * v);
    p.w0 = 1.0f - u - v, p.w1 = u, p.w2 = v;
    keep_from_edges<W>(face, s.going_on(), p);
    p.position = face.corner + face.edge1 * p.w1 + face.edge2 * p.w2;
    p.normal = p.face_normal, p.lit_from = p.position;
    if (a.scene.shaded.is_smooth && is_any(s.going_on() & (face.curved != 0.0f)))
        smooth<W>(a.scene, s.face_of, face, ray.direction, p);
    return p;
}

}  // namespace
}  // namespace wrt
#endif
