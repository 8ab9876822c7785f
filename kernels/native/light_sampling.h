// Lights for W rays at once: points on them, rays that cross them, and what arrives.
//
// The loop over lights is not in lanes: lights are few, and each is taken by the rays that chose it. The scalar functions are
// wrt.kernels.shading.emitters.light_sampling, .environment, and .wavefront.path_step.sampled_light.
#pragma once
#include "scattering.h"

#if WRT_VECTORS
namespace wrt {
namespace {

constexpr float PI = 3.141592653589793f, TWO_PI = 6.283185307179586f;
constexpr int POINT = 0, DIRECTIONAL = 2, PARALLELOGRAM = 3, TRIANGLE = 4, SPHERE = 5, TRIANGLES = 6, SKY = 7;

/// Points on lights, seen from where light is sampled. segment: the way to them.
template <int W> struct Found {
    V3<W> segment, direction, radiance;
    Floats<W> density;
};

/// The number of the interval that holds a value, among `count` ascending sums.
inline int find_interval(const float* sums, int count, float value)
{
    int lowest = 0, highest = count;
    while (highest - lowest > 1) {
        const int middle = (lowest + highest) / 2;
        if (sums[middle] <= value) lowest = middle;
        else highest = middle;
    }
    return lowest;
}

/// The place of values between two others, in [0, 1).
template <int W> inline Floats<W> within(Floats<W> below, Floats<W> above, Floats<W> value)
{
    const Floats<W> share = (value - below) / larger(above - below, all<W>(1e-20f));
    return smaller(larger(share, all<W>(0.0f)), all<W>(0.999999f));
}

template <int W> inline Floats<W> power_weight(Floats<W> own, Floats<W> other)
{
    const Floats<W> square = own * own;
    return square / larger(square + other * other, all<W>(1e-30f));
}

/// Points on flat lights. offset: the distance from a light at which rays to it end.
template <int W>
inline void find_on_flat(
    const V3<W>& toward, const V3<W>& axis, Floats<W> area, Ints<W> two_sided, Floats<W> offset, Found<W>& found)
{
    using F = Floats<W>;
    const F distance = root(dot(toward, toward));
    found.direction = toward / distance;
    const F slope = dot(found.direction, axis), cosine = pick(two_sided, absolute(-slope), -slope);
    found.segment = toward + axis * pick(slope < 0.0f, offset, -offset);
    found.density = pick((distance > 0.0f) & (cosine > 1e-6f), distance * distance / (cosine * area), all<W>(0.0f));
}

/// Points on the emissive triangles of the scene.
template <int W, class Scene>
inline void sample_triangles(const Scene& scene, const V3<W>& lit_from, Floats<W> x, Floats<W> y, Found<W>& found)
{
    using F = Floats<W>;
    const auto& lights = scene.lights;
    const auto& materials = scene.materials;
    int faces[W], numbers[W], sided[W];
    float values[W], below[W], above[W];
    save(values, x);
    const float* sums = lights.triangle_sums.data;
    WRT_SCALAR
    for (int i = 0; i < W; ++i) {
        const int number = find_interval(sums, (int)lights.triangle.shape[0], values[i]);
        below[i] = sums[number];
        above[i] = sums[number + 1];
        faces[i] = lights.triangle.data[number];
        numbers[i] = materials.of_face.data[faces[i] * materials.of_face_stride];
        sided[i] = materials.two_sided.data[numbers[i]] != 0 ? -1 : 0;
    }
    const F inner = within<W>(load<F>(below), load<F>(above), x), side = root(inner);
    const Faces<W> light = read_faces<W>(scene, faces);
    const V3<W> target = light.corner + light.edge1 * (side * (1.0f - y)) + light.edge2 * (side * y);
    const V3<W> radiance = gather3<W>(materials.emission.data, numbers);
    const F bright = 0.2126f * radiance.x + 0.7152f * radiance.y + 0.0722f * radiance.z;
    const F offset = OFFSET * reach<W>(scene, target);
    const F area = lights.triangle_power / larger(bright, all<W>(1e-30f));
    found.radiance = radiance;
    find_on_flat<W>(target - lit_from, light.normal, area, load<Ints<W>>(sided), offset, found);
}

/// Points on the part of a sphere that is seen.
template <int W, class Lights>
inline void sample_sphere(const Lights& lights, int entry, const V3<W>& lit_from, Floats<W> x, Floats<W> y, Found<W>& found)
{
    using F = Floats<W>;
    const V3<W> axis = all3<W>(lights.position.data[entry]) - lit_from;
    const F distance = root(dot(axis, axis)), radius = all<W>(lights.shape.data[entry].c[2]);
    const F sine = radius / distance, cosine = root(larger(all<W>(0.0f), 1.0f - sine * sine));
    const F cap = sine * sine / (1.0f + cosine), rest = x * cap, height = 1.0f - rest;
    const F across = root(larger(all<W>(0.0f), rest * (1.0f + height)));
    const V3<W> forward = axis / distance, tangent = tangent_of<W>(forward);
    F c, s;
    direction_of<W>(y, c, s);
    const V3<W> aimed = forward * height + (tangent * c + cross(forward, tangent) * s) * across;
    found.direction = aimed / root(dot(aimed, aimed));
    const F half = root(larger(all<W>(0.0f), radius * radius - distance * distance * across * across));
    found.segment = found.direction * (height * distance - half);
    found.density = pick(distance > radius * 1.000001f, 1.0f / (TWO_PI * cap), all<W>(0.0f));
}

/// Directions to a sky of one colour.
template <int W, class Lights> inline void sample_sky(const Lights& lights, Floats<W> x, Floats<W> y, Found<W>& found)
{
    using F = Floats<W>;
    const auto& sky = lights.sky;
    const float *rows = sky.row_sums.data, *cells = sky.cell_sums.data;
    const F height = 1.0f - 2.0f * within<W>(all<W>(rows[0]), all<W>(rows[1]), y);
    F c, s;
    direction_of<W>(within<W>(all<W>(cells[0]), all<W>(cells[1]), x) - 0.5f, c, s);
    const F radius = root(larger(all<W>(0.0f), 1.0f - height * height));
    found.direction = (all3<W>(sky.east) * c + all3<W>(sky.north) * s) * radius + all3<W>(sky.up) * height;
    found.segment = found.direction * lights.far;
    found.radiance = all3<W>(sky.texels.data[0]);
    found.density = all<W>(1.0f / (4.0f * PI));
}

/// How light is found.
enum class Sampling { SAMPLED, BOTH, SCALAR };

/// `sample_light` from `lit_from`, for W places on one light. Whether light is found by sampling alone, by scattering too, or
/// not in lanes.
template <int W, class Scene>
inline Sampling sample_light(const Scene& scene, int entry, const V3<W>& lit_from, Floats<W> x, Floats<W> y, Found<W>& found)
{
    using F = Floats<W>;
    const auto& lights = scene.lights;
    const int kind = lights.kind.data[entry];
    const auto& shape = lights.shape.data[entry];
    found.radiance = all3<W>(lights.radiance.data[entry]);
    found.density = all<W>(1.0f);
    if (kind == POINT) {
        found.segment = all3<W>(lights.position.data[entry]) - lit_from;
        const F square = dot(found.segment, found.segment), distance = root(square);
        found.direction = found.segment / distance;
        found.radiance = found.radiance / larger(square, all<W>(1e-30f));
        found.density = pick(distance > 0.0f, all<W>(1.0f), all<W>(0.0f));
        return Sampling::SAMPLED;
    }
    if (kind == DIRECTIONAL) {
        found.direction = all3<W>(lights.axis.data[entry]) * -1.0f;
        found.segment = found.direction * lights.far;
        return Sampling::SAMPLED;
    }
    if (kind == PARALLELOGRAM || kind == TRIANGLE) {
        const F side = root(x), s = kind == TRIANGLE ? side * (1.0f - y) : x, t = kind == TRIANGLE ? side * y : y;
        const V3<W> target = all3<W>(lights.position.data[entry]) + all3<W>(lights.edge1.data[entry]) * s
            + all3<W>(lights.edge2.data[entry]) * t;
        const auto two_sided = (Ints<W>)(shape.c[3] != 0.0f ? -1 : 0);
        const V3<W> axis = all3<W>(lights.axis.data[entry]);
        find_on_flat<W>(target - lit_from, axis, all<W>(shape.c[2]), two_sided, all<W>(0.0f), found);
        return Sampling::BOTH;
    }
    if (kind == SPHERE) {
        sample_sphere<W>(lights, entry, lit_from, x, y, found);
        return Sampling::BOTH;
    }
    if (kind == TRIANGLES) {
        sample_triangles<W>(scene, lit_from, x, y, found);
        return Sampling::BOTH;
    }
    const auto& sky = lights.sky;
    if (kind != SKY || sky.width * sky.height != 1 || sky.rows * sky.columns != 1) return Sampling::SCALAR;
    sample_sky<W>(lights, x, y, found);
    return Sampling::BOTH;
}

/// Which rays cross flat or round light `e` before they end, and the density with which it would be sampled: `crossed_light`.
template <int W, class Lights>
inline Ints<W> crossed(
    const Lights& lights, int e, const V3<W>& start, const V3<W>& direction, Floats<W> end, Floats<W>& density)
{
    using F = Floats<W>;
    using I = Ints<W>;
    const auto& shape = lights.shape.data[e];
    const V3<W> middle = all3<W>(lights.position.data[e]) - start;
    if (lights.kind.data[e] == SPHERE) {
        const F along = dot(middle, direction), square = dot(middle, middle), round = all<W>(shape.c[2] * shape.c[2]);
        const V3<W> miss = middle - direction * along;
        const F inside = round - dot(miss, miss), t = along - root(inside), sine = round / square;
        density = (1.0f + root(1.0f - sine)) / (TWO_PI * sine);
        return (inside > 0.0f) & (square > round) & (t > 0.0f) & (t < end);
    }
    const V3<W> axis = all3<W>(lights.axis.data[e]);
    const V3<W> e1 = all3<W>(lights.edge1.data[e]), e2 = all3<W>(lights.edge2.data[e]);
    const F slope = dot(axis, direction), t = dot(middle, axis) / slope;
    const V3<W> at = direction * t - middle, area = cross(e1, e2);
    const F scale = 1.0f / dot(area, area);
    const F s = dot(cross(at, e2), area) * scale, r = dot(cross(e1, at), area) * scale;
    const F limit = lights.kind.data[e] == TRIANGLE ? s + r : larger(s, r);
    const I faces = shape.c[3] != 0.0f ? (I)-1 : (I)(slope < 0.0f);
    const I inside = (s >= 0.0f) & (r >= 0.0f) & (limit <= 1.0f);
    density = t * t / (absolute(slope) * shape.c[2]);
    return faces & (absolute(slope) > 1e-6f) & (t > 0.0f) & (t < end) & inside;
}

}  // namespace
}  // namespace wrt
#endif
