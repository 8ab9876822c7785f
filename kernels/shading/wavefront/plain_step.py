"""A step of path tracing for W plain rays at once, on the CPU.

Most rays of most pictures hit a matte surface in air. Shading one takes a thousand instructions, nearly without branches, so W
of them are shaded in lanes. A ray is plain if it hit a flat, matte, opaque triangle that emits nothing and has one colour, in
air, and if the lamp that it chooses is one of those below. Each plain ray gets the bits that `path_step` gives it. The others,
and whole groups of W without a plain ray, are left to `path_step`.

Lamps: points, directions, flat and round lamps, emissive triangles, and a sky of one colour. The loop over them is not in
lanes: lamps are few, and each is taken by the rays that chose it.
"""

from functools import cache
from typing import Any

import warp as wp

from wrt.kernels.compilation.target import lane_width
from wrt.kernels.layout.ray_batch import HitBatch
from wrt.kernels.query.spawn import INSET
from wrt.kernels.shading.bsdf.material_table import DIFFUSE
from wrt.kernels.shading.emitters.light_table import (
    DIRECTIONAL,
    PARALLELOGRAM,
    POINT,
    SKY,
    SPHERE,
    TRIANGLE,
    TRIANGLES,
)
from wrt.kernels.shading.surface import OFFSET
from wrt.kernels.shading.wavefront.lane_words import lane_words
from wrt.kernels.shading.wavefront.pixel_samples import FIRST_BOUNCE, PER_BOUNCE, RANDOM, SOBOL, PixelSamples
from wrt.kernels.shading.wavefront.ray_queue import Gathered, RayQueue, Wave
from wrt.kernels.shading.wavefront.scene_light import LitScene
from wrt.kernels.simd.lanes import FOR_LANES

MOST_LAMPS = 8
"""Scenes with more lamps have no plain rays: each lamp costs all lanes."""

_CONSTANTS = f"""
    constexpr float OFFSET = {float(OFFSET)!r}f, INSET = {float(INSET)!r}f;
    constexpr float PI = 3.141592653589793f, TWO_PI = 6.283185307179586f;
    constexpr int DIFFUSE = {DIFFUSE}, POINT = {POINT}, DIRECTIONAL = {DIRECTIONAL}, PARALLELOGRAM = {PARALLELOGRAM};
    constexpr int TRIANGLE = {TRIANGLE}, SPHERE = {SPHERE}, TRIANGLES = {TRIANGLES}, SKY = {SKY}, MOST_LAMPS = {MOST_LAMPS};
    constexpr int SOBOL = {SOBOL}, RANDOM = {RANDOM}, FIRST_BOUNCE = {FIRST_BOUNCE}, PER_BOUNCE = {PER_BOUNCE};
"""

_BEGIN = """
    const auto& materials = scene.materials;
    const auto& lights = scene.lights;
    if (scene.shaded.records.shape[0] == 0 || materials.has_color || lights.count > MOST_LAMPS) return 0;
    if (source.sampler != SOBOL && source.sampler != RANDOM) return 0;
    const bool is_sobol = source.sampler == SOBOL;
"""

_PLAIN = """
    int number_of[W], face_of[W], plain_of[W];
    for (int i = 0; i < W; ++i) {
        const int face = hits.primitive.data[first + i], known = face < 0 ? 0 : face;
        const int number = materials.of_face.data[known * materials.of_face_stride];
        const wp::vec3& e = materials.emission.data[number];
        const bool has_image = materials.has_uv
            && (materials.color_texture.data[number] >= 0 || materials.surface_texture.data[number] >= 0);
        face_of[i] = known; number_of[i] = number;
        const bool is_matte = (materials.kind.data[number] == DIFFUSE) & (materials.shape.data[number].c[3] == 0.0f);
        const bool is_dark = e.c[0] + e.c[1] + e.c[2] == 0.0f, in_air = queue.media.data[first + i] == 0;
        plain_of[i] = ((face >= 0) & is_matte & is_dark & in_air & !has_image) ? -1 : 0;
    }
    vi plain = load_ints(plain_of);
    if (!is_any(plain)) return 0;
"""

_POINTS = """
    struct Record { V3 corner, edge1, edge2, normal, inverse_heights; vf sliver; };
    const auto* table = scene.shaded.records.data;
    auto records_of = [&](const int* faces) {
        float words[16][W];
        WRT_SCALAR for (int i = 0; i < W; ++i) {
            const float* from = (const float*)(table + faces[i]);
            WRT_UNROLLED for (int k = 0; k < 16; ++k) words[k][i] = from[k];
        }
        auto three = [&](int k) { return V3{load(words[k]), load(words[k + 1]), load(words[k + 2])}; };
        return Record{three(0), three(3), three(6), three(9), three(12), load(words[15])};
    };
    auto colors_of = [&](const wp::vec3* colors, const int* numbers) {
        float words[3][W];
        WRT_SCALAR for (int i = 0; i < W; ++i)
            WRT_UNROLLED for (int k = 0; k < 3; ++k) words[k][i] = colors[numbers[i]].c[k];
        return V3{load(words[0]), load(words[1]), load(words[2])};
    };
    const V3 low = all3(scene.shaded.mesh.low), high = all3(scene.shaded.mesh.high);
    auto reach = [&](const V3& o) {
        const V3 down = low - o, up = high - o;
        const vf x = larger(size_of(down.x), size_of(up.x)), y = larger(size_of(down.y), size_of(up.y));
        return larger(x, larger(y, larger(size_of(down.z), size_of(up.z))));
    };
    const Record face = records_of(face_of);
    const V3 direction = load3(queue.direction.data + first), weight = load3(queue.weight.data + first);
    if (scene.shaded.is_smooth) plain = plain & (face.sliver < 0.0f);
    plain = plain & (dot(face.normal, face.normal) != 0.0f);
    if (!is_any(plain)) return 0;
    const V3 normal = face.normal * pick(dot(face.normal, direction) <= 0.0f, all(1.0f), all(-1.0f));
    vf u, v;
    load2(hits.uv.data + first, u, v);
    const V3 near = face.corner + face.edge1 * u + face.edge2 * v;
    const vf offset = larger(OFFSET * reach(near), size_of(face.sliver));
    auto inset = [&](vf share, vf inverse_height) {
        const vf least = INSET * offset * inverse_height;
        return larger(share, pick(3.0f * least < 1.0f, least, all(1.0f / 3.0f)));
    };
    const vf a0 = inset(1.0f - u - v, face.inverse_heights.x), a1 = inset(u, face.inverse_heights.y);
    const vf a2 = inset(v, face.inverse_heights.z), sum = a0 + a1 + a2;
    const V3 position = face.corner + face.edge1 * (a1 / sum) + face.edge2 * (a2 / sum);
    const V3 origin = position + normal * offset, color = colors_of(materials.color.data, number_of);
    const vi slot = load_ints(queue.slot.data + first);
    const vu pixel = mix((vu)(wave.first_pixel + slot % wave.pixels), (vu)source.seed);
    const vu sample = (vu)(wave.first_sample + slot / wave.pixels);
"""
"""C++: records of triangles, and the points where rays end: `shading_point` for flat triangles."""

_LAMPS = """
    struct Found { V3 segment, direction, radiance; vf density; };
    auto power_weight = [&](vf own, vf other) {
        const vf square = own * own;
        return square / larger(square + other * other, all(1e-30f));
    };
    auto find_interval = [](const float* sums, int count, float value) {
        int lowest = 0, highest = count;
        while (highest - lowest > 1) {
            const int middle = (lowest + highest) / 2;
            if (sums[middle] <= value) lowest = middle; else highest = middle;
        }
        return lowest;
    };
    auto within = [&](vf below, vf above, vf value) {
        return smaller(larger((value - below) / larger(above - below, all(1e-20f)), all(0.0f)), all(0.999999f));
    };
    auto on_flat = [&](const V3& target, const V3& axis, vf area, const V3& radiance, vi two_sided, vf lift, Found& found) {
        const V3 toward = target - position;
        const vf distance = root(dot(toward, toward));
        found.direction = toward / distance;
        const vf slope = dot(found.direction, axis), cosine = pick(two_sided, size_of(-slope), -slope);
        found.segment = toward + axis * pick(slope < 0.0f, lift, -lift);
        found.radiance = radiance;
        found.density = pick((distance > 0.0f) & (cosine > 1e-6f), distance * distance / (cosine * area), all(0.0f));
    };
    auto sample_triangles = [&](vf x, vf y, Found& found) {
        int faces[W], numbers[W], sided[W];
        float values[W], below[W], above[W];
        save(values, x);
        const float* sums = lights.triangle_sums.data;
        WRT_SCALAR for (int i = 0; i < W; ++i) {
            const int number = find_interval(sums, (int)lights.triangle.shape[0], values[i]);
            below[i] = sums[number]; above[i] = sums[number + 1];
            faces[i] = lights.triangle.data[number];
            numbers[i] = materials.of_face.data[faces[i] * materials.of_face_stride];
            sided[i] = materials.two_sided.data[numbers[i]] != 0 ? -1 : 0;
        }
        const vf inner = within(load(below), load(above), x), side = root(inner);
        const Record lamp = records_of(faces);
        const V3 target = lamp.corner + lamp.edge1 * (side * (1.0f - y)) + lamp.edge2 * (side * y);
        const V3 radiance = colors_of(materials.emission.data, numbers);
        const vf bright = 0.2126f * radiance.x + 0.7152f * radiance.y + 0.0722f * radiance.z;
        const vf lift = larger(OFFSET * reach(target), size_of(lamp.sliver));
        const vf area = lights.triangle_power / larger(bright, all(1e-30f));
        on_flat(target, lamp.normal, area, radiance, load_ints(sided), lift, found);
    };
    auto sample_sphere = [&](int entry, vf x, vf y, Found& found) {
        const V3 axis = all3(lights.position.data[entry]) - position;
        const vf distance = root(dot(axis, axis)), radius = all(lights.shape.data[entry].c[2]);
        const vf sine = radius / distance, cosine = root(larger(all(0.0f), 1.0f - sine * sine));
        const vf cap = sine * sine / (1.0f + cosine), rest = x * cap, height = 1.0f - rest;
        const vf across = root(larger(all(0.0f), rest * (1.0f + height)));
        const V3 forward = axis / distance, tangent = tangent_of(forward);
        vf c, s;
        turned(y, c, s);
        const V3 aimed = forward * height + (tangent * c + cross(forward, tangent) * s) * across;
        found.direction = aimed / root(dot(aimed, aimed));
        const vf half = root(larger(all(0.0f), radius * radius - distance * distance * across * across));
        found.segment = found.direction * (height * distance - half);
        found.radiance = all3(lights.radiance.data[entry]);
        found.density = pick(distance > radius * 1.000001f, 1.0f / (TWO_PI * cap), all(0.0f));
    };
    auto sample_sky = [&](vf x, vf y, Found& found) {
        const auto& sky = lights.sky;
        const float *rows = sky.row_sums.data, *cells = sky.cell_sums.data;
        const vf height = 1.0f - 2.0f * within(all(rows[0]), all(rows[1]), y);
        vf c, s;
        turned(within(all(cells[0]), all(cells[1]), x) - 0.5f, c, s);
        const vf radius = root(larger(all(0.0f), 1.0f - height * height));
        found.direction = (all3(sky.east) * c + all3(sky.north) * s) * radius + all3(sky.up) * height;
        found.segment = found.direction * lights.far;
        found.radiance = all3(sky.texels.data[0]);
        found.density = all(1.0f / (4.0f * PI));
    };
    auto sample_lamp = [&](int entry, vf x, vf y, Found& found) {  // whether only this way finds the light; -1: not in lanes
        const int kind = lights.kind.data[entry];
        const auto& shape = lights.shape.data[entry];
        found.radiance = all3(lights.radiance.data[entry]);
        found.density = all(1.0f);
        if (kind == POINT) {
            found.segment = all3(lights.position.data[entry]) - position;
            const vf square = dot(found.segment, found.segment), distance = root(square);
            found.direction = found.segment / distance;
            found.radiance = found.radiance / larger(square, all(1e-30f));
            found.density = pick(distance > 0.0f, all(1.0f), all(0.0f));
            return 1;
        }
        if (kind == DIRECTIONAL) {
            found.direction = all3(lights.axis.data[entry]) * -1.0f;
            found.segment = found.direction * lights.far;
            return 1;
        }
        if (kind == PARALLELOGRAM || kind == TRIANGLE) {
            const vf side = root(x), s = kind == TRIANGLE ? side * (1.0f - y) : x, t = kind == TRIANGLE ? side * y : y;
            const V3 target = all3(lights.position.data[entry]) + all3(lights.edge1.data[entry]) * s
                + all3(lights.edge2.data[entry]) * t;
            const vi two_sided = (vi)(shape.c[3] != 0.0f ? -1 : 0);
            on_flat(target, all3(lights.axis.data[entry]), all(shape.c[2]), found.radiance, two_sided, all(0.0f), found);
            return 0;
        }
        if (kind == SPHERE) { sample_sphere(entry, x, y, found); return 0; }
        if (kind == TRIANGLES) { sample_triangles(x, y, found); return 0; }
        if (kind != SKY || lights.sky.width * lights.sky.height != 1 || lights.sky.rows * lights.sky.columns != 1) return -1;
        sample_sky(x, y, found);
        return 0;
    };
"""
"""C++: `sample_light` from `position`, for W places on one lamp."""

_GATHER = """
    V3 lit = {all(0.0f), all(0.0f), all(0.0f)}, segment = lit;
    if (samples_lights && lights.count > 0) {
        vi entry = 0;
        if (lights.count > 1) {
            const vf chance = single_number(pixel, sample, 3 * generation);
            for (int e = 1; e < lights.count; ++e) entry -= lights.sums.data[e] <= chance;
        }
        vf x, y;
        pixel_point(pixel, sample, FIRST_BOUNCE + PER_BOUNCE * generation, x, y);
        for (int e = 0; e < lights.count; ++e) {
            const vi takes = plain & (entry == e);
            if (!is_any(takes)) continue;
            Found light;
            const int is_single = sample_lamp(e, x, y, light);
            if (is_single < 0) { plain = plain & (entry != e); continue; }
            const float probability = lights.count > 1 ? lights.sums.data[e + 1] - lights.sums.data[e] : 1.0f;
            const vf cosine = dot(normal, light.direction), scatters = size_of(cosine) / PI;
            const vf density = light.density * probability;
            vf share = 1.0f / density;
            if (!is_single) share = share * power_weight(density, scatters);
            const vi arrives = takes & (light.density > 0.0f) & (cosine > 0.0f) & (scatters > 0.0f);
            const V3 value = color * scatters;
            lit = pick3(arrives, weight * (value * light.radiance * share), lit);
            segment = pick3(arrives, light.segment - (origin - position), segment);
        }
        if (!is_any(plain)) return 0;
    }
"""
"""C++: `lamp_light`, for a matte surface."""

_SCATTER = """
    vf x, y;
    pixel_point(pixel, sample, FIRST_BOUNCE + PER_BOUNCE * generation + 1, x, y);
    const V3 toward = cosine_direction(normal, x, y);
    V3 share = weight * color;
    const vf rise = dot(toward, normal), most = larger(share.x, larger(share.y, share.z));
    const V3 rest = share - share;
    vi alive = (most > 0.0f) & (rise >= 0.0f) & (rest.x == 0.0f) & (rest.y == 0.0f) & (rest.z == 0.0f);
    if (generation >= roulette) {
        const vf survival = smaller(most, all(0.95f));
        alive = alive & (single_number(pixel, sample, 3 * generation + 2) < survival);
        share = share / survival;
    }
"""
"""C++: `scatter`, for a matte surface."""

_CROSSED = """
    if (lights.areas > 0) {
        const V3 start = load3(queue.origin.data + first);
        const vf end = load(hits.t.data + first), own = samples_lights ? load(queue.density.data + first) : all(0.0f);
        V3 found = {all(0.0f), all(0.0f), all(0.0f)};
        for (int e = 0; e < lights.areas; ++e) {
            const auto& shape = lights.shape.data[e];
            const V3 middle = all3(lights.position.data[e]) - start;
            vi crosses; vf density;
            if (lights.kind.data[e] == SPHERE) {
                const vf along = dot(middle, direction), square = dot(middle, middle), round = all(shape.c[2] * shape.c[2]);
                const V3 miss = middle - direction * along;
                const vf inside = round - dot(miss, miss), t = along - root(inside), sine = round / square;
                crosses = (inside > 0.0f) & (square > round) & (t > 0.0f) & (t < end);
                density = (1.0f + root(1.0f - sine)) / (TWO_PI * sine);
            } else {
                const V3 axis = all3(lights.axis.data[e]), e1 = all3(lights.edge1.data[e]), e2 = all3(lights.edge2.data[e]);
                const vf slope = dot(axis, direction), t = dot(middle, axis) / slope;
                const V3 at = direction * t - middle, area = cross(e1, e2);
                const vf scale = 1.0f / dot(area, area);
                const vf s = dot(cross(at, e2), area) * scale, r = dot(cross(e1, at), area) * scale;
                const vf limit = lights.kind.data[e] == TRIANGLE ? s + r : larger(s, r);
                const vi faces = shape.c[3] != 0.0f ? (vi)-1 : (slope < 0.0f);
                const vi inside = (s >= 0.0f) & (r >= 0.0f) & (limit <= 1.0f);
                crosses = faces & (size_of(slope) > 1e-6f) & (t > 0.0f) & (t < end) & inside;
                density = t * t / (size_of(slope) * shape.c[2]);
            }
            crosses = crosses & plain;
            if (!is_any(crosses)) continue;
            const vf other = density * (lights.sums.data[e + 1] - lights.sums.data[e]);
            const vf part = pick(own > 0.0f, power_weight(own, other), all(1.0f));
            const V3 seen = weight * all3(lights.radiance.data[e]) * part;
            found = found + pick3(crosses, seen, V3{all(0.0f), all(0.0f), all(0.0f)});
        }
        float r[W], g[W], b[W];
        save(r, found.x); save(g, found.y); save(b, found.z);
        WRT_SCALAR for (int i = 0; i < W; ++i) {
            if (!plain[i] || r[i] + g[i] + b[i] == 0.0f) continue;
            wp::vec3& sum = rays.radiance.data[queue.slot.data[first + i]];
            sum.c[0] += r[i]; sum.c[1] += g[i]; sum.c[2] += b[i];
        }
    }
"""
"""C++: `crossed_lights`, added to the samples."""

_WRITE = """
    const vf nothing = all(0.0f);
    save3(following.direction.data + first, toward);
    save3(following.weight.data + first, share);
    save3(following.origin.data + first, origin);
    save(following.density.data + first, size_of(rise) / PI);
    save(following.slot.data + first, slot);
    __builtin_memset(following.media.data + first, 0, 8 * W);
    save(goes_on.data + first, -alive);
    const vi is_lit = (segment.x != 0.0f) | (segment.y != 0.0f) | (segment.z != 0.0f);
    save3(rays.lit.data + first, lit);
    save3(rays.shadow_direction.data + first, segment);
    save3(rays.shadow_origin.data + first, pick3(is_lit, origin, V3{nothing, nothing, nothing}));
    unsigned done = 0;
    for (int i = 0; i < W; ++i) done |= plain[i] ? 1u << i : 0u;
    return done;
"""


@cache
def make_shade_plain(width: int) -> Any:
    """`shade_plain` for so many lanes."""
    head = f"{FOR_LANES}\n#if defined(__CUDA_ARCH__)\nreturn 0;\n#else\nconstexpr int W = {width};\n"
    parts = (_CONSTANTS, _BEGIN, lane_words(width), _PLAIN, _POINTS, _LAMPS, _GATHER, _SCATTER, _CROSSED, _WRITE)

    @wp.func_native(f"{head}{''.join(parts)}\n#endif\n")
    def shade_plain(
        first: int,
        generation: int,
        roulette: int,
        samples_lights: bool,
        scene: LitScene,
        source: PixelSamples,
        wave: Wave,
        queue: RayQueue,
        hits: HitBatch,
        rays: Gathered,
        following: RayQueue,
        goes_on: wp.array(dtype=int),
    ) -> wp.uint32:
        """Does the step of the plain ones among the rays first .. first + width - 1, which all exist, and returns one bit for
        each. What it writes for the others is to be overwritten. Not for the last generation.
        """
        ...

    return shade_plain


WIDTH = wp.constant(lane_width())
shade_plain = make_shade_plain(lane_width())
