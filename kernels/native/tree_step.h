// A step of trees of rays for W simple rays at once: wrt.kernels.shading.wavefront.tree_step, in lanes.
#pragma once
#include "scattering.h"

#if WRT_VECTORS
namespace wrt {
namespace {

/// Two vectors whose elements take turns, W of them from `First` on.
template <int W, int First, class V, int... I> inline V interleaved(V a, V b, Numbers<int, I...>)
{
    return __builtin_shufflevector(a, b, (First + I / 2 + I % 2 * W)...);
}

template <int W, class V> inline void save_pairs(void* to, V a, V b)
{
    save(to, interleaved<W, 0>(a, b, Lanes<W>()));
    save((float*)to + W, interleaved<W, W / 2>(a, b, Lanes<W>()));
}

template <int W, int First> inline V3<W> interleaved3(const V3<W>& a, const V3<W>& b)
{
    return {interleaved<W, First>(a.x, b.x, Lanes<W>()), interleaved<W, First>(a.y, b.y, Lanes<W>()),
        interleaved<W, First>(a.z, b.z, Lanes<W>())};
}

template <int W, class Vec> inline void save_pairs3(Vec* to, const V3<W>& a, const V3<W>& b)
{
    save3<W>(to, interleaved3<W, 0>(a, b));
    save3<W>(to + W, interleaved3<W, W / 2>(a, b));
}

/// The numbers of W rays among those of their samples, in a queue that begins at `begin`.
template <int W> inline Ints<W> branches_of(const int* slot, int begin, int first)
{
    int before = 0, numbers[W];
    for (int i = first; i > begin && slot[i - 1] == slot[first]; --i) ++before;
    for (int i = 0; i < W; ++i) {
        if (i > 0) before = slot[first + i] == slot[first + i - 1] ? before + 1 : 0;
        numbers[i] = before;
    }
    return load<Ints<W>>(numbers);
}

/// `send_child`: the weights of rays that are sent, and which of them go on.
template <int W> struct Sender {
    const int* slots;
    int begin;
    SampleKeys<W> keys;
    const Rays<W>& ray;
    Ints<W> branch;
    bool knows_branch;

    template <class Step>
    Ints<W> send(const Step& step, Ints<W> sends, const V3<W>& toward, const V3<W>& part, bool is_transmitted, V3<W>& share)
    {
        share = ray.weight * part;
        const Floats<W> max_share = largest<W>(share);
        Ints<W> alive = sends & is_weight<W>(share);
        alive = alive & (dot(toward, toward) > 0.5f);
        const Ints<W> dim = alive & (max_share < step.threshold);
        if (!is_any(dim)) return alive;
        if (!step.roulette) return alive & ~dim;
        if (!knows_branch) branch = branches_of<W>(slots, begin, ray.first);
        knows_branch = true;
        const SampleKeys<W> own = {false, keys.pixel + (Words<W>)branch * MIX_1, keys.sample};
        const Floats<W> chance = own.number(3 * step.generation + (is_transmitted ? 1 : 0));
        share = pick3<W>(dim, share * (step.threshold / max_share), share);
        return alive & ~(dim & ~(chance * step.threshold < max_share));
    }
};

/// `send_children`: the reflected and the refracted rays, side by side, to the places from `at` on.
template <int W, class Step, class Scratch, class Flags>
inline void send_children(const Step& step, const Surfaces<W>& s, const Points<W>& p, Sender<W>& sender, int at,
    const Scratch& scratch, const Flags& is_alive)
{
    using I = Ints<W>;
    const Boundaries<W> b = meet_boundaries<W>(sender.ray.direction, p.normal, p.is_front, s.index);
    const V3<W> part_back = pick3<W>(s.glass, s.color * b.reflected, s.color);
    const V3<W> part_on = s.color * ((1.0f - b.reflected) * b.ratio * b.ratio);
    V3<W> share_back, share_on;
    const I reflects = sender.send(step, s.single(), b.back, part_back, false, share_back);
    const I passes = sender.send(step, s.glass, b.bent, part_on, true, share_on);
    const V3<W> shift = p.face_normal * p.offset;
    const I slot = sender.ray.slot, beyond = p.is_front & (s.number + 1);
    save_pairs<W>(is_alive.data + at, -reflects, -passes);
    save_pairs<W>(scratch.slot.data + at, slot, slot);
    save_pairs3<W>(scratch.origin.data + at, p.position + shift, p.position - shift);
    save_pairs3<W>(
        scratch.direction.data + at, kept_above<W>(b.back, p.face_normal, (I)0), kept_above<W>(b.bent, p.face_normal, (I)-1));
    save_pairs3<W>(scratch.weight.data + at, share_back, share_on);
    save_media<W>(scratch.media.data + at, interleaved<W, 0>(s.media, beyond, Lanes<W>()));
    save_media<W>(scratch.media.data + at + W, interleaved<W, W / 2>(s.media, beyond, Lanes<W>()));
}

/// The step of the simple ones among W rays from number `first` on of a queue that begins at `begin`; one bit for each. The
/// rays that follow go to the places from 2 `child` on.
template <int W, class A, class Step, class Scratch, class Flags>
inline unsigned shade_trees(
    const A& a, const Step& step, int first, int begin, int child, const Scratch& scratch, const Flags& is_alive)
{
    using I = Ints<W>;
    const auto& scene = a.scene;
    if (scene.shaded.records.shape[0] == 0 || scene.materials.has_color || scene.lights.areas > 0) return 0;
    Surfaces<W> s;
    read_surfaces<W>(a, first, s);
    if (!find_simple<W>(scene, step.is_last, s)) return 0;
    const I closed = s.ended & (~s.is_hit | (s.is_dark & ((s.kind == MIRROR) | (s.kind == DIELECTRIC))));
    if (!step.is_last) __builtin_memset(is_alive.data + 2 * child, 0, 8 * W);
    if (!is_any(s.single() | closed)) return 0;
    const Rays<W> ray = read_rays<W>(a, first);
    I simple = closed;
    if (is_any(s.single())) {
        const Points<W> p = find_points<W>(a, ray, s);
        I pixel;
        const SampleKeys<W> keys = sample_keys<W>(a.source, a.wave, ray.slot, pixel);
        Sender<W> sender = {a.queue.slot.data, begin, keys, ray, (I)0, false};
        send_children<W>(step, s, p, sender, 2 * child, scratch, is_alive);
        simple = closed | s.single();
    }
    V3<W> found = zero3<W>();  // the light of rays that end
    if (scene.lights.sky_entry >= 0 && is_any(closed & ~s.is_hit))
        found = pick3<W>(~s.is_hit, ray.weight * all3<W>(scene.lights.sky.texels.data[0]), found);
    save3<W>(a.rays.emitted.data + first, found);
    return bits_of(simple);
}

}  // namespace
}  // namespace wrt
#endif
