"""A step of path tracing for W plain rays at once, on the CPU.

Most rays of most pictures hit a matte surface in air. Shading one takes a thousand instructions, nearly without branches, so W
of them are shaded in lanes. So are those that hit a mirror or smooth glass, and paths that end: in the last generation, and
where nothing is hit under a sky of one colour. A ray is plain if its surface has no image, no colours of corners and emits
nothing, if nothing is absorbed on its way, if it enters glass from air, and if the lamp that it chooses is one of those below.
Each plain ray gets the bits that `path_step` gives it. The others, and whole groups of W without a plain ray, are left to it.

Lamps: points, directions, flat and round lamps, emissive triangles, and a sky of one colour.
"""

from functools import cache
from typing import Any

import warp as wp

from wrt.kernels.compilation.target import lane_width
from wrt.kernels.layout.ray_batch import HitBatch
from wrt.kernels.query.spawn import INSET
from wrt.kernels.runtime import native
from wrt.kernels.shading.bsdf.ggx import SMALLEST_ALPHA
from wrt.kernels.shading.bsdf.material_table import DIELECTRIC, DIFFUSE, MIRROR
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
from wrt.kernels.shading.wavefront.plain_lamps import GATHER, LAMPS
from wrt.kernels.shading.wavefront.ray_queue import Gathered, RayQueue, Wave
from wrt.kernels.shading.wavefront.scene_light import LitScene

MOST_LAMPS = 8
"""Scenes with more lamps have no plain rays: each lamp costs all lanes."""

CONSTANTS = f"""
    constexpr float OFFSET = {float(OFFSET)!r}f, INSET = {float(INSET)!r}f;
    constexpr float PI = 3.141592653589793f, TWO_PI = 6.283185307179586f;
    constexpr int DIFFUSE = {DIFFUSE}, MIRROR = {MIRROR}, DIELECTRIC = {DIELECTRIC};
    constexpr float SMALLEST_ALPHA = {float(SMALLEST_ALPHA)!r}f;
    constexpr int POINT = {POINT}, DIRECTIONAL = {DIRECTIONAL}, PARALLELOGRAM = {PARALLELOGRAM};
    constexpr int TRIANGLE = {TRIANGLE}, SPHERE = {SPHERE}, TRIANGLES = {TRIANGLES}, SKY = {SKY}, MOST_LAMPS = {MOST_LAMPS};
    constexpr int SOBOL = {SOBOL}, RANDOM = {RANDOM}, FIRST_BOUNCE = {FIRST_BOUNCE}, PER_BOUNCE = {PER_BOUNCE};
"""

BEGIN = """
    const auto& materials = scene.materials;
    const auto& lights = scene.lights;
    if (scene.shaded.records.shape[0] == 0 || materials.has_color || lights.count > MOST_LAMPS) return 0;
    if (source.sampler != SOBOL && source.sampler != RANDOM) return 0;
    const bool is_sobol = source.sampler == SOBOL;
"""

KINDS = """
    const auto& sky = lights.sky;
    const bool has_sky = lights.sky_entry >= 0;
    const bool is_even = sky.width == 1 && sky.height == 1 && sky.rows <= 1 && sky.columns <= 1;
    typedef unsigned long long vl __attribute__((ext_vector_type(W)));
    vl media_of;
    __builtin_memcpy(&media_of, queue.media.data + first, sizeof(media_of));
    const vi hit = load_ints(hits.primitive.data + first), is_hit = hit >= 0;
    const vi media = __builtin_convertvector(media_of <= 0xFFFF ? media_of : (vl)~0ull, vi);  // -1: several
    const vi in_air = media == 0;
    int number_of[W], face_of[W];
    save(face_of, is_hit & hit);
    WRT_SCALAR for (int i = 0; i < W; ++i) number_of[i] = materials.of_face.data[face_of[i] * materials.of_face_stride];
    const vi number = load_ints(number_of);
    vi kind = 0, is_dark = -1, has_image = 0, is_clear = in_air;
    vf rough = all(0.0f), index = rough, through = rough;
    V3 color = {rough, rough, rough};
    for_each_value(number, is_hit, [&](int n, vi own) {  // neighbours have few materials
        const wp::vec3& e = materials.emission.data[n];
        const auto& shape = materials.shape.data[n];
        kind = pick_ints(own, (vi)materials.kind.data[n], kind);
        if (!(e.c[0] + e.c[1] + e.c[2] == 0.0f)) is_dark = is_dark & ~own;
        if (materials.has_uv && (materials.color_texture.data[n] >= 0 || materials.surface_texture.data[n] >= 0))
            has_image = has_image | own;
        rough = pick(own, all(shape.c[0]), rough);
        index = pick(own, all(shape.c[2]), index);
        through = pick(own, all(shape.c[3]), through);
        color = pick3(own, all3(materials.color.data[n]), color);
    });
    for_each_value(media, media > 0, [&](int medium, vi own) {
        const wp::vec3& a = materials.absorption.data[medium - 1];
        if (a.c[0] == 0.0f && a.c[1] == 0.0f && a.c[2] == 0.0f) is_clear = is_clear | own;  // nothing is absorbed
    });
    const vi goes = is_last ? (vi)0 : is_hit & is_dark & ~has_image & is_clear;
    vi matte = goes & in_air & (kind == DIFFUSE) & (through == 0.0f), mirror = goes & (kind == MIRROR);
    vi glass = goes & (kind == DIELECTRIC) & (in_air | (media == number + 1));
    glass = glass & (rough * rough < SMALLEST_ALPHA);
    if (scene.schlick) glass = 0;
    const vi sheds = lights.triangle_entry < 0 ? (vi)0 : ~is_dark, escapes = !has_sky || is_even ? ~is_hit : (vi)0;
    const vi ended = escapes | (is_last ? is_hit & is_clear & ~sheds : (vi)0);
    if (!is_any(matte | mirror | glass | ended)) return 0;
"""
"""C++: which rays are plain, by what happens to them: paths end where nothing is hit, and in the last generation."""

RECORDS = """
    struct Record { V3 corner, edge1, edge2, normal, inverse_heights; vf curved; };
    const auto* table = scene.shaded.records.data;
    auto records_of = [&](const int* faces) {
        vf words[16];
        load_records([&](int i) { return table + faces[i]; }, words);
        auto three = [&](int k) { return V3{words[k], words[k + 1], words[k + 2]}; };
        return Record{three(0), three(3), three(6), three(9), three(12), words[15]};
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
    const V3 direction = load3(queue.direction.data + first), weight = load3(queue.weight.data + first);
    const vi slot = load_ints(queue.slot.data + first);
"""
"""C++: what is read of triangles and rays."""

CROSSED = """
    auto crossed = [&](int e, const V3& start, const V3& direction, vf end, vf& density) {
        const auto& shape = lights.shape.data[e];
        const V3 middle = all3(lights.position.data[e]) - start;
        if (lights.kind.data[e] == SPHERE) {
            const vf along = dot(middle, direction), square = dot(middle, middle), round = all(shape.c[2] * shape.c[2]);
            const V3 miss = middle - direction * along;
            const vf inside = round - dot(miss, miss), t = along - root(inside), sine = round / square;
            density = (1.0f + root(1.0f - sine)) / (TWO_PI * sine);
            return (inside > 0.0f) & (square > round) & (t > 0.0f) & (t < end);
        }
        const V3 axis = all3(lights.axis.data[e]), e1 = all3(lights.edge1.data[e]), e2 = all3(lights.edge2.data[e]);
        const vf slope = dot(axis, direction), t = dot(middle, axis) / slope;
        const V3 at = direction * t - middle, area = cross(e1, e2);
        const vf scale = 1.0f / dot(area, area);
        const vf s = dot(cross(at, e2), area) * scale, r = dot(cross(e1, at), area) * scale;
        const vf limit = lights.kind.data[e] == TRIANGLE ? s + r : larger(s, r);
        const vi faces = shape.c[3] != 0.0f ? (vi)-1 : (slope < 0.0f), inside = (s >= 0.0f) & (r >= 0.0f) & (limit <= 1.0f);
        density = t * t / (size_of(slope) * shape.c[2]);
        return faces & (size_of(slope) > 1e-6f) & (t > 0.0f) & (t < end) & inside;
    };
"""
"""C++: `crossed(e, ...)`, which rays cross a flat or round lamp before they end, and its density: `crossed_light`."""

COLLECT = """
    auto power_weight = [&](vf own, vf other) {
        const vf square = own * own;
        return square / larger(square + other * other, all(1e-30f));
    };
    const vi missed = ended & ~is_hit;
    const bool sees_sky = has_sky && is_any(missed);
    auto collect = [&](vi plain) {
        if (lights.areas == 0 && !sees_sky) return;
        const V3 start = load3(queue.origin.data + first);
        const vf end = load(hits.t.data + first), own = samples_lights ? load(queue.density.data + first) : all(0.0f);
        V3 found = {all(0.0f), all(0.0f), all(0.0f)};
        for (int e = 0; e < lights.areas; ++e) {
            vf density;
            const vi crosses = crossed(e, start, direction, end, density) & plain;
            if (!is_any(crosses)) continue;
            const vf other = density * (lights.sums.data[e + 1] - lights.sums.data[e]);
            const vf part = pick(own > 0.0f, power_weight(own, other), all(1.0f));
            const V3 seen = weight * all3(lights.radiance.data[e]) * part;
            found = found + pick3(crosses, seen, V3{all(0.0f), all(0.0f), all(0.0f)});
        }
        if (sees_sky) {
            const float probability = lights.sums.data[lights.sky_entry + 1] - lights.sums.data[lights.sky_entry];
            const vf part = pick(own > 0.0f, power_weight(own, all(1.0f / (4.0f * PI) * probability)), all(1.0f));
            found = pick3(missed, found + weight * all3(sky.texels.data[0]) * part, found);
        }
        float r[W], g[W], b[W];
        save(r, found.x); save(g, found.y); save(b, found.z);
        WRT_SCALAR for (int i = 0; i < W; ++i) {
            if (!plain[i] || r[i] + g[i] + b[i] == 0.0f) continue;
            wp::vec3& sum = rays.radiance.data[queue.slot.data[first + i]];
            sum.c[0] += r[i]; sum.c[1] += g[i]; sum.c[2] += b[i];
        }
    };
"""
"""C++, after `CROSSED`: `collect(plain)` adds `crossed_lights` and `sky_light` to the samples of these rays."""

_END = """
    if (!is_any(matte | mirror | glass)) {
        collect(ended);
        if (is_last) return bits_of(ended);
        const V3 nothing = {all(0.0f), all(0.0f), all(0.0f)};
        save(following.slot.data + first, slot);
        save(goes_on.data + first, (vi)0);
        save3(rays.lit.data + first, nothing);
        save3(rays.shadow_direction.data + first, nothing);
        save3(rays.shadow_origin.data + first, nothing);
        return bits_of(ended);
    }
"""
"""C++: the way out where no path goes on."""

POINTS = """
    const Record face = records_of(face_of);
    const vi has_area = dot(face.normal, face.normal) != 0.0f, is_front = dot(face.normal, direction) <= 0.0f;
    matte = matte & has_area; mirror = mirror & has_area;
    glass = glass & has_area & (~is_front | in_air);  // not a body within one of its kind
    const vf side = pick(is_front, all(1.0f), all(-1.0f));
    const V3 face_normal = face.normal * side;
    vf u, v;
    load2(hits.uv.data + first, u, v);
    const V3 near = face.corner + face.edge1 * u + face.edge2 * v;
    const vf offset = OFFSET * reach(near);
    const V3 inverse = face.inverse_heights;
    vf w0 = 1.0f - u - v, w1 = u, w2 = v;
    {
        const vf room = smaller(INSET * offset, 0.5f / (inverse.x + inverse.y + inverse.z)), sum = w0 + w1 + w2;
        const vf least0 = room * inverse.x, least1 = room * inverse.y, least2 = room * inverse.z;
        const vi is_near = (w0 < least0) | (w1 < least1) | (w2 < least2);
        w0 = w0 / sum; w1 = w1 / sum; w2 = w2 / sum;
        if (is_any(is_near & (matte | mirror | glass))) {
            const V3 edge0 = face.edge2 - face.edge1, edge1 = face.edge2 * -1.0f, edge2 = face.edge1;
            const V3 across = cross(face.edge1, face.edge2);
            const vf area = root(dot(across, across));
            const vi moves = is_near & (area > 0.0f);
            auto part = [&](vf least, vf share, vf over) { return larger(all(0.0f), least - share) / over / (over * area); };
            for (int pass = 0; pass < 2; ++pass) {
                const V3 step = edge0 * part(least0, w0, inverse.x) + edge1 * part(least1, w1, inverse.y)
                    + edge2 * part(least2, w2, inverse.z);
                w0 = pick(moves, w0 + dot(edge0, step) / area, w0);
                w1 = pick(moves, w1 + dot(edge1, step) / area, w1);
                w2 = pick(moves, w2 + dot(edge2, step) / area, w2);
            }
        }
    }
    const V3 position = face.corner + face.edge1 * w1 + face.edge2 * w2;
    V3 normal = face_normal, lit_from = position;
    if (scene.shaded.is_smooth && is_any((matte | mirror | glass) & (face.curved != 0.0f))) {
        auto corner_normals = [&](int corner) {
            float words[3][W];
            WRT_SCALAR for (int i = 0; i < W; ++i) {
                const wp::vec3& n = scene.shaded.corner_normals.data[3 * face_of[i] + corner];
                WRT_UNROLLED for (int k = 0; k < 3; ++k) words[k][i] = n.c[k];
            }
            return V3{load(words[0]), load(words[1]), load(words[2])} * side;
        };
        auto lift = [&](const V3& corner, const V3& n) { return n * -smaller(all(0.0f), dot(position - corner, n)); };
        const V3 na = corner_normals(0), nb = corner_normals(1), nc = corner_normals(2);
        const V3 blend = na * w0 + nb * w1 + nc * w2;
        const vi is_round = (face.curved != 0.0f) & (dot(blend, face_normal) > 0.0f) & (dot(blend, direction) < 0.0f);
        const V3 rise = lift(face.corner, na) * w0 + lift(face.corner + face.edge1, nb) * w1
            + lift(face.corner + face.edge2, nc) * w2;
        normal = pick3(is_round, blend / root(dot(blend, blend)), face_normal);
        lit_from = pick3(is_round, position + rise, position);
    }
    const vi place = quotient(slot, wave.samples);
    int pixel_of[W];
    save(pixel_of, place);
    WRT_SCALAR for (int i = 0; i < W; ++i) pixel_of[i] = wave.order.data[wave.first_pixel + pixel_of[i]];
    const vu pixel = mix((vu)load_ints(pixel_of), (vu)source.seed);
    const vu sample = (vu)(wave.first_sample + slot - place * wave.samples);
"""
"""C++: the points where rays end: `shading_point`."""


SCATTER = """
    V3 toward = direction, share = weight * color;
    vi transmitted = 0;
    if (is_any(matte)) {
        vf x, y;
        pixel_point(pixel, sample, FIRST_BOUNCE + PER_BOUNCE * generation + 1, x, y);
        toward = cosine_direction(normal, x, y);
    }
    const vi single = mirror | glass;
    if (is_any(single)) {
        const V3 out = direction * -1.0f;
        const vf cosine = dot(out, normal), size = size_of(cosine);
        const vf ratio = pick(is_front, 1.0f / index, index);
        const vf beyond = 1.0f - ratio * ratio * (1.0f - size * size), other = root(beyond);
        const vf parallel = (size - ratio * other) / (size + ratio * other);
        const vf perpendicular = (ratio * size - other) / (ratio * size + other);
        const vf reflected = pick(beyond > 0.0f, 0.5f * (parallel * parallel + perpendicular * perpendicular), all(1.0f));
        transmitted = glass & ~(single_number(pixel, sample, 3 * generation + 1) < reflected);
        const vf under = 1.0f - ratio * ratio * larger(all(0.0f), 1.0f - cosine * cosine);
        const V3 refracted = normal * (ratio * cosine - root(under)) - out * ratio;
        V3 sent = pick3(transmitted, refracted, normal * (2.0f * cosine) - out);
        sent = pick3(transmitted & ~(under > 0.0f), V3{all(0.0f), all(0.0f), all(0.0f)}, sent);
        const vf rise = dot(sent, face_normal);
        sent = pick3((rise < 0.0f) ^ transmitted, sent - face_normal * (2.0f * rise), sent);
        toward = pick3(single, sent, toward);
        share = pick3(transmitted, weight * (color * (ratio * ratio)), share);
    }
    const vf most = larger(share.x, larger(share.y, share.z));
    const V3 rest = share - share;
    vi alive = (most > 0.0f) & (rest.x == 0.0f) & (rest.y == 0.0f) & (rest.z == 0.0f);
    alive = alive & ~((dot(toward, face_normal) < 0.0f) ^ transmitted) & (matte | single);
    if (generation >= roulette) {
        const vf survival = smaller(most, all(0.95f));
        alive = alive & (single_number(pixel, sample, 3 * generation + 2) < survival);
        share = share / survival;
    }
"""
"""C++: `scatter`."""

ENDS = """
    const vi plain = matte | mirror | glass | ended;
    if (!is_any(plain)) return 0;
    collect(plain);
    const vf nothing = all(0.0f), density = pick(matte, size_of(dot(toward, normal)) / PI, nothing);
    const V3 origin = position + face_normal * pick(transmitted, -offset, offset), lit_origin = lit_from + face_normal * offset;
    const vi media_beyond = pick_ints(transmitted, is_front & (number + 1), media);
    const vi is_lit = (segment.x != 0.0f) | (segment.y != 0.0f) | (segment.z != 0.0f);
"""
"""C++: light, and the rays that follow."""

_WRITE = """
    save3(following.direction.data + first, toward);
    save3(following.weight.data + first, share);
    save3(following.origin.data + first, origin);
    save(following.density.data + first, density);
    save(following.slot.data + first, slot);
    save(following.media.data + first, __builtin_convertvector((vu)media_beyond, vl));
    save(goes_on.data + first, -alive);
    save3(rays.lit.data + first, lit);
    save3(rays.shadow_direction.data + first, segment);
    save3(rays.shadow_origin.data + first, pick3(is_lit, lit_origin, V3{nothing, nothing, nothing}));
    return bits_of(plain);
"""


@cache
def make_shade_plain(width: int) -> Any:
    """`shade_plain` for so many lanes."""
    head = f"#if defined(__CUDA_ARCH__)\nreturn 0;\n#else\nconstexpr int W = {width};\n"
    parts = (CONSTANTS, BEGIN, lane_words(width), KINDS, RECORDS, CROSSED, COLLECT, _END, POINTS, LAMPS, GATHER, SCATTER)

    @native.func_native("lanes.h", f"{head}{''.join(parts)}{ENDS}{_WRITE}\n#endif\n")
    def shade_plain(
        first: int,
        generation: int,
        is_last: bool,
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
        each. What it writes for the others is to be overwritten.
        """
        ...

    return shade_plain


WIDTH = wp.constant(lane_width())
shade_plain = make_shade_plain(lane_width())
