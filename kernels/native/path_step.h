// A step of path tracing for W simple rays at once: wrt.kernels.shading.wavefront.path_step, in lanes.
#pragma once
#include "light_sampling.h"

#if WRT_VECTORS
namespace wrt {
namespace {

/// Light that may arrive at W points. segment: the way to the light from `origin`, 0 where there is none.
template <int W> struct Arrivals {
    V3<W> lit, segment, origin;
};

/// Where W paths go on.
template <int W> struct Sent {
    V3<W> toward, share, origin;
    Ints<W> transmitted, alive, media;
    Floats<W> density;
};

/// Adds `crossed_lights` and `sky_light` to the samples of these rays.
template <int W, class A>
inline void collect(const A& a, bool samples_lights, const Surfaces<W>& s, const Rays<W>& ray, Ints<W> simple)
{
    using F = Floats<W>;
    const auto& lights = a.scene.lights;
    const Ints<W> missed = s.ended & ~s.is_hit;
    const bool sees_sky = lights.sky_entry >= 0 && is_any(missed);
    if (lights.areas == 0 && !sees_sky) return;
    const V3<W> start = load3<W>(a.queue.origin.data + ray.first);
    const F end = load<F>(a.hits.t.data + ray.first);
    const F own = samples_lights ? load<F>(a.queue.density.data + ray.first) : all<W>(0.0f);
    V3<W> found = zero3<W>();
    for (int e = 0; e < lights.areas; ++e) {
        F density;
        const Ints<W> crosses = crossed<W>(lights, e, start, ray.direction, end, density) & simple;
        if (!is_any(crosses)) continue;
        const F other = density * (lights.sums.data[e + 1] - lights.sums.data[e]);
        const F part = pick(own > 0.0f, power_weight<W>(own, other), all<W>(1.0f));
        const V3<W> seen = ray.weight * all3<W>(lights.radiance.data[e]) * part;
        found = found + pick3<W>(crosses, seen, zero3<W>());
    }
    if (sees_sky) {
        const float probability = lights.sums.data[lights.sky_entry + 1] - lights.sums.data[lights.sky_entry];
        const F part = pick(own > 0.0f, power_weight<W>(own, all<W>(1.0f / (4.0f * PI) * probability)), all<W>(1.0f));
        found = pick3<W>(missed, found + ray.weight * all3<W>(lights.sky.texels.data[0]) * part, found);
    }
    float red[W], green[W], blue[W];
    save(red, found.x), save(green, found.y), save(blue, found.z);
    WRT_SCALAR
    for (int i = 0; i < W; ++i) {
        if (!simple[i] || red[i] + green[i] + blue[i] == 0.0f) continue;
        auto& sum = a.rays.radiance.data[a.queue.slot.data[ray.first + i]];
        sum.c[0] += red[i], sum.c[1] += green[i], sum.c[2] += blue[i];
    }
}

/// `sampled_light` for matte points. Those whose light is not sampled in lanes are no longer simple.
template <int W, class A, class Step>
inline Arrivals<W> gather(
    const A& a, const Step& step, const SampleKeys<W>& keys, const Points<W>& p, const Rays<W>& ray, Surfaces<W>& s)
{
    using F = Floats<W>;
    using I = Ints<W>;
    const auto& lights = a.scene.lights;
    Arrivals<W> found = {zero3<W>(), zero3<W>(), p.lit_from + p.face_normal * p.offset};
    if (!step.samples_lights || lights.count == 0 || !is_any(s.matte)) return found;
    I entry = (I)0;
    if (lights.count > 1) {
        const F chance = keys.number(3 * step.generation);
        for (int e = 1; e < lights.count; ++e) entry -= lights.sums.data[e] <= chance;
    }
    F x, y;
    keys.point(FIRST_BOUNCE + PER_BOUNCE * step.generation, x, y);
    for (int e = 0; e < lights.count; ++e) {
        const I takes = s.matte & (entry == e);
        if (!is_any(takes)) continue;
        Found<W> light;
        const Sampling sampling = sample_light<W>(a.scene, e, p.lit_from, x, y, light);
        if (sampling == Sampling::SCALAR) {
            s.matte = s.matte & (entry != e);
            continue;
        }
        const float probability = lights.count > 1 ? lights.sums.data[e + 1] - lights.sums.data[e] : 1.0f;
        const F cosine = dot(p.normal, light.direction), scatters = absolute(cosine) / PI;
        const F density = light.density * probability;
        F share = 1.0f / density;
        if (sampling == Sampling::BOTH) share = share * power_weight<W>(density, scatters);
        const I faces = (cosine > 0.0f) & (dot(light.direction, p.face_normal) > 0.0f);
        const I arrives = takes & (light.density > 0.0f) & faces & (scatters > 0.0f);
        const V3<W> value = s.color * scatters;
        found.lit = pick3<W>(arrives, ray.weight * (value * light.radiance * share), found.lit);
        found.segment = pick3<W>(arrives, light.segment - (found.origin - p.lit_from), found.segment);
    }
    return found;
}

/// `scatter`.
template <int W, class Step>
inline Sent<W> scatter(
    const Step& step, const SampleKeys<W>& keys, const Points<W>& p, const Surfaces<W>& s, const Rays<W>& ray)
{
    using F = Floats<W>;
    Sent<W> sent;
    sent.toward = ray.direction, sent.share = ray.weight * s.color;
    sent.transmitted = (Ints<W>)0;
    if (is_any(s.matte)) {
        F x, y;
        keys.point(FIRST_BOUNCE + PER_BOUNCE * step.generation + 1, x, y);
        sent.toward = cosine_direction<W>(p.normal, x, y);
    }
    if (is_any(s.single())) {
        const Boundaries<W> b = meet_boundaries<W>(ray.direction, p.normal, p.is_front, s.index);
        sent.transmitted = s.glass & ~(keys.number(3 * step.generation + 1) < b.reflected);
        const V3<W> single = pick3<W>(sent.transmitted, b.bent, b.back);
        sent.toward = pick3<W>(s.single(), kept_above<W>(single, p.face_normal, sent.transmitted), sent.toward);
        sent.share = pick3<W>(sent.transmitted, ray.weight * (s.color * (b.ratio * b.ratio)), sent.share);
    }
    const F max_share = largest<W>(sent.share);
    sent.alive = is_weight<W>(sent.share);
    sent.alive = sent.alive & ~((dot(sent.toward, p.face_normal) < 0.0f) ^ sent.transmitted) & s.going_on();
    if (step.generation >= step.roulette) {
        const F survival = smaller(max_share, all<W>(0.95f));
        sent.alive = sent.alive & (keys.number(3 * step.generation + 2) < survival);
        sent.share = sent.share / survival;
    }
    sent.density = pick(s.matte, absolute(dot(sent.toward, p.normal)) / PI, all<W>(0.0f));
    sent.origin = p.position + p.face_normal * pick(sent.transmitted, -p.offset, p.offset);
    sent.media = pick(sent.transmitted, p.is_front & (s.number + 1), s.media);
    return sent;
}

/// The step of the simple ones among W rays from number `first` on, which all exist; one bit for each. Writer: what becomes of
/// paths that go on and of shadow rays.
template <int W, class A, class Step, class Writer>
inline unsigned shade_paths(const A& a, const Step& step, int first, Writer&& writer)
{
    const auto& scene = a.scene;
    if (scene.shaded.records.shape[0] == 0 || scene.materials.has_color || scene.lights.count > MAX_LIGHTS) return 0;
    if (a.source.sampler != SOBOL && a.source.sampler != RANDOM) return 0;
    Surfaces<W> s;
    read_surfaces<W>(a, first, s);
    if (!find_simple<W>(scene, step.is_last, s)) return 0;
    const Rays<W> ray = read_rays<W>(a, first);
    if (!is_any(s.going_on())) {
        collect<W>(a, step.samples_lights, s, ray, s.ended);
        if (!step.is_last) writer.end(ray);
        return bits_of(s.ended);
    }
    const Points<W> p = find_points<W>(a, ray, s);
    Ints<W> pixel;
    const SampleKeys<W> keys = sample_keys<W>(a.source, a.wave, ray.slot, pixel);
    const Arrivals<W> arrivals = gather<W>(a, step, keys, p, ray, s);
    const Sent<W> sent = scatter<W>(step, keys, p, s, ray);
    const Ints<W> simple = s.going_on() | s.ended;
    if (!is_any(simple)) return 0;
    collect<W>(a, step.samples_lights, s, ray, simple);
    writer.write(ray, sent, arrivals, simple);
    return bits_of(simple);
}

/// Writes paths and shadow rays to the places of the rays that they follow.
template <class Queue, class Flags, class Gathered> struct InPlace {
    const Queue& following;
    const Flags& is_alive;
    const Gathered& rays;

    /// No path goes on.
    template <int W> void end(const Rays<W>& ray)
    {
        save(following.slot.data + ray.first, ray.slot);
        save(is_alive.data + ray.first, (Ints<W>)0);
        save3<W>(rays.lit.data + ray.first, zero3<W>());
        save3<W>(rays.shadow_direction.data + ray.first, zero3<W>());
        save3<W>(rays.shadow_origin.data + ray.first, zero3<W>());
    }

    template <int W> void write(const Rays<W>& ray, const Sent<W>& sent, const Arrivals<W>& found, Ints<W>)
    {
        const int first = ray.first;
        const Ints<W> is_lit = (found.segment.x != 0.0f) | (found.segment.y != 0.0f) | (found.segment.z != 0.0f);
        save3<W>(following.direction.data + first, sent.toward);
        save3<W>(following.weight.data + first, sent.share);
        save3<W>(following.origin.data + first, sent.origin);
        save(following.density.data + first, sent.density);
        save(following.slot.data + first, ray.slot);
        save_media<W>(following.media.data + first, sent.media);
        save(is_alive.data + first, -sent.alive);
        save3<W>(rays.lit.data + first, found.lit);
        save3<W>(rays.shadow_direction.data + first, found.segment);
        save3<W>(rays.shadow_origin.data + first, pick3<W>(is_lit, found.origin, zero3<W>()));
    }
};
template <class Queue, class Flags, class Gathered>
InPlace(const Queue&, const Flags&, const Gathered&) -> InPlace<Queue, Flags, Gathered>;

/// Appends paths that go on to a queue at place `to`, and shadow rays that may bring light to a list at place `entry`.
template <class Queue, class Slots, class Gathered> struct Appended {
    const Queue& following;
    const Slots& lit_slot;
    const Gathered& rays;
    int &to, &entry;

    template <int W> void end(const Rays<W>&) { }

    template <int W> void write(const Rays<W>& ray, const Sent<W>& sent, const Arrivals<W>& found, Ints<W> simple)
    {
        const unsigned on = bits_of(sent.alive);
        if (on) {
            const Ints<W> lanes = lanes_of<W>(on);
            save3<W>(following.origin.data + to, packed3<W>(sent.origin, lanes));
            save3<W>(following.direction.data + to, packed3<W>(sent.toward, lanes));
            save3<W>(following.weight.data + to, packed3<W>(sent.share, lanes));
            save(following.density.data + to, chosen_lanes(sent.density, lanes));
            save(following.slot.data + to, chosen_lanes(ray.slot, lanes));
            save_media<W>(following.media.data + to, chosen_lanes(sent.media, lanes));
            to += count_bits(on);
        }
        const unsigned listed = bits_of(simple & ((found.lit.x != 0.0f) | (found.lit.y != 0.0f) | (found.lit.z != 0.0f)));
        if (listed) {
            const Ints<W> lanes = lanes_of<W>(listed);
            save3<W>(rays.lit.data + entry, packed3<W>(found.lit, lanes));
            save3<W>(rays.shadow_origin.data + entry, packed3<W>(found.origin, lanes));
            save3<W>(rays.shadow_direction.data + entry, packed3<W>(found.segment, lanes));
            save(lit_slot.data + entry, chosen_lanes(ray.slot, lanes));
            entry += count_bits(listed);
        }
    }
};
template <class Queue, class Slots, class Gathered>
Appended(const Queue&, const Slots&, const Gathered&, int&, int&) -> Appended<Queue, Slots, Gathered>;

}  // namespace
}  // namespace wrt
#endif
