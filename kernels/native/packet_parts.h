// Rays of a packet apart from the others: parts of a split packet (wrt.kernels.traversal.packet.core.packet_splitting), smaller
// packets (ray_repacking), single rays (few_active_rays).
#pragma once
#include "packet_bounds.h"
#include "packet_culling.h"

namespace wrt {
namespace {

/// `part` of rays that are done, or that are to be traced one by one; the greatest number of parts.
constexpr int DONE = -1, SINGLE_RAY = -2, MAX_PARTS = 7;

/// How many times as far apart as usual the origins of a packet must be that is split before its traversal; the share of the
/// scene's size that they must span; the weight of a packet in what is usual.
constexpr float WIDE = 3.0f, MIN_WIDE = 0x1p-7f, ADAPTION = 0.25f;

/// Whether the origins of a packet are far apart. usual: what is usual so far, to which whole packets, `first`, add.
template <class Bounds, class Vec3>
inline CUDA_CALLABLE bool is_wide(float& usual, const Bounds& bounds, const Vec3& low, const Vec3& high, bool first)
{
    float extent = 0.0f, scene = 0.0f;
    for (int a = 0; a < 3; ++a) {
        extent += bounds.origin_high.c[a] - bounds.origin_low.c[a];
        scene += high.c[a] - low.c[a];
    }
    const bool wide = usual > 0.0f && extent > WIDE * usual && extent > MIN_WIDE * scene;
    if (first && !wide) usual = usual > 0.0f ? usual + ADAPTION * (extent - usual) : extent;
    return wide;
}

/// Makes the rays of a part the active ones, and computes their bounds.
template <class What, int P, int W, bool SHARED, class Bounds>
inline CUDA_CALLABLE void activate_part(const Packet<P, W, SHARED>& packet, Bounds& bounds, int number)
{
    float *const t = packet.t, *const kept = packet.kept;
    const int* const of = packet.part;
    WRT_FOR (P, k) {
        kept[k] = t[k];
        t[k] = of[k] == number ? t[k] : -WRT_INFINITY;
    }
    float lows[3], highs[3];
    bound_packet<What>(packet, bounds, lows, highs, true, SlackOfRays());
}

/// Ends a part after its traversal; returns the number of new parts. completed: whether its rays are done; otherwise it is
/// halved into `parts` and `parts` + 1, or its rays are marked SINGLE_RAY.
template <int P, int W, bool SHARED, class Bounds>
inline CUDA_CALLABLE int finish_part(
    const Packet<P, W, SHARED>& packet, const Bounds& bounds, int number, int parts, bool completed)
{
    if (completed && number == 0) return 0;
    int* const of = packet.part;
    float *const t = packet.t, *const kept = packet.kept;
    WRT_FOR (P, k) {
        const float own = t[k], before = kept[k];
        const int part = of[k];
        const bool in = (number == 0) | (part == number), over = (own == -WRT_INFINITY) | completed;
        of[k] = in ? (over ? DONE : number) : part;
        t[k] = in ? own : before;
    }
    if (completed) return 0;
    const float* const low = bounds.origin_low.c;
    const float* const high = bounds.origin_high.c;
    const float x = high[0] - low[0], y = high[1] - low[1], z = high[2] - low[2];
    const int axis = ((x >= y) & (x >= z)) ? 0 : y >= z ? 1 : 2;
    const float middle = low[axis] + 0.5f * (high[axis] - low[axis]);
    if (parts + 2 > MAX_PARTS || !((low[axis] < middle) & (middle < high[axis]))) {  // or no two rays of it start apart
        WRT_FOR (P, k) {
            of[k] = of[k] == number ? SINGLE_RAY : of[k];
        }
        return 0;
    }
    const float* origin = packet.origin(axis);
    WRT_FOR (P, k) {
        of[k] = of[k] == number ? parts + (origin[k] < middle ? 0 : 1) : of[k];
    }
    return 2;
}

/// Rays of a split packet that are to be traced one by one.
template <int P, int W, bool SHARED> inline CUDA_CALLABLE int count_single_rays(const Packet<P, W, SHARED>& packet)
{
    int rays = 0;
    WRT_FOR (P, k) {
        rays += packet.part[k] == SINGLE_RAY ? 1 : 0;
    }
    return rays;
}

/// The best hit so far of ray k.
template <int P, int W, bool SHARED, class Hit>
inline CUDA_CALLABLE void load_hit(const Packet<P, W, SHARED>& packet, int k, Hit& best)
{
    best.t = packet.t[k];
    best.primitive = packet.primitive[k];
    best.u = packet.u[k];
    best.v = packet.v[k];
}

/// Stores a hit of ray k, after which it is done in any-hit queries.
template <bool ANY_HIT, int P, int W, bool SHARED, class Hit>
inline CUDA_CALLABLE void store_hit(const Packet<P, W, SHARED>& packet, int k, const Hit& best)
{
    packet.t[k] = ANY_HIT && best.primitive >= 0 ? -WRT_INFINITY : best.t;
    packet.primitive[k] = best.primitive;
    packet.u[k] = best.u;
    packet.v[k] = best.v;
}

/// Ray k as a single ray: what boxes and the hit need; returns its t_min.
template <int P, int W, bool SHARED, class Slabs, class Hit>
inline CUDA_CALLABLE float extract_ray(
    const Packet<P, W, SHARED>& packet, const SharedOrigin& shared, int k, Slabs& slabs, Hit& best)
{
    const BoxRay ray = box_ray(packet, shared, k);
    for (int a = 0; a < 3; ++a) {
        slabs.inverse.c[a] = ray.inverse[a];
        slabs.origin_in.c[a] = ray.in[a];
        slabs.origin_out.c[a] = ray.out[a];
    }
    load_hit(packet, k, best);
    return packet.t_min[k];
}

/// Widening of the intervals of entry points, in slacks; factor on the rest of a ray beyond its entry, against rounding; 1 /
/// direction below which a component of the direction is not recovered from it.
constexpr float ENTRY_MARGIN = 4.0f, LONGER = 1.0f + 0x1p-20f, SMALLEST_INVERSE = 0x1p-120f;

/// Copies the rays that meet a box in a lane of a node to the packet `inner`, clipped to the box; `from` gets their numbers.
/// MOVED: whether they count t from their entries, which `inner.kept` gets. COMPONENTS: those of a packet.
template <bool MOVED, int COMPONENTS, int P, int Q, int W, bool SHARED, class Bounds>
inline CUDA_CALLABLE void gather_rays(
    const float* box, const Packet<P, W, SHARED>& packet, const Bounds& bounds, const Packet<Q, W, SHARED>& inner, int* from)
{
    float begin[P], end[P];
    MeetingRays<P, W> rays;
    rays.find(packet, shared_origin(bounds), box, [&](int k, const Interval& own) {
        begin[k] = own.enter;
        end[k] = own.leave;
    });
    const int n = rays.list(from);
    for (int k = n; k < Q; ++k) from[k] = from[0];  // places without a ray hold another's numbers
    for (int c = 0; c < COMPONENTS; ++c) {
        const float* row = packet.inverse_x + c * P;
        float* to = inner.inverse_x + c * Q;
        WRT_FOR (Q, k) {
            to[k] = row[from[k]];
        }
    }
    WRT_FOR (Q, k) {
        const int own = from[k];
        const bool farther = packet.t[own] > end[own];
        inner.t_min[k] = begin[own];
        inner.t[k] = k < n ? (farther ? end[own] : packet.t[own]) : -WRT_INFINITY;
        inner.primitive[k] = farther ? -1 : packet.primitive[own];
        if (MOVED) inner.kept[k] = begin[own];
    }
}

/// Copies the hits that the `count` rays of `inner` have found back.
template <int P, int Q, int W, bool SHARED>
inline CUDA_CALLABLE void scatter_rays(
    const Packet<P, W, SHARED>& packet, const Packet<Q, W, SHARED>& inner, const int* numbers, int count)
{
    for (int k = 0; k < count; ++k) {
        const int own = numbers[k], found = inner.primitive[k];
        if (found < 0 || found == packet.primitive[own]) continue;
        packet.t[own] = inner.t[k];
        packet.primitive[own] = found;
        packet.u[own] = inner.u[k];
        packet.v[own] = inner.v[k];
    }
}

/// Sets `bounds.t_max` after rays that count t from their entries have found hits.
template <int P, int W, bool SHARED, class Bounds>
inline CUDA_CALLABLE void shorten_moved(const Packet<P, W, SHARED>& packet, Bounds& bounds)
{
    int max_bits = (int)0x80000000;
    WRT_FOR (P, k) {
        const float rest = (packet.t[k] - packet.kept[k]) * LONGER + 0.0f;
        const int bits = packet.t[k] >= -0.0f ? __builtin_bit_cast(int, rest) : (int)0x80000000;
        max_bits = bits > max_bits ? bits : max_bits;
    }
    bounds.t_max = max_bits < 0 ? -WRT_INFINITY : __builtin_bit_cast(float, max_bits);
}

/// Bounds of a packet that `gather_rays` filled. MOVED: its origins are moved to the box in a lane of a node; outer: the bounds
/// of the packet that it was taken from.
template <class What, bool MOVED, int P, int W, bool SHARED, class Bounds>
inline CUDA_CALLABLE void bound_entries(
    const float* box, const Packet<P, W, SHARED>& packet, const Bounds& outer, Bounds& bounds)
{
    float lows[3], highs[3];
    for (int a = 0; a < 3; ++a) lows[a] = outer.origin_low.c[a], highs[a] = outer.origin_high.c[a];
    if constexpr (SHARED) bound_packet<What>(packet, bounds, lows, highs, true, GivenSlack {outer.slack});
    else bound_packet<What>(packet, bounds, lows, highs, true, SlackOfRays());
    if (!MOVED || !bounds.active) return;
    const float wide = ENTRY_MARGIN * bounds.slack;
    for (int a = 0; a < 3; ++a) {
        const float* inverse = packet.inverse(a);
        const float* origin = packet.origin(a);
        OrderedInterval entry;
        int lost = 0;
        WRT_FOR (P, k) {
            const bool counts = packet.t[k] >= -0.0f;
            lost |= (counts & (WRT_ABS(inverse[k]) < SMALLEST_INVERSE)) ? 1 : 0;
            entry.widen(origin[k] + packet.kept[k] * (1.0f / inverse[k]), counts);
        }
        const float from = lost ? box[a * W] : entry.lower(), to = lost ? box[(3 + a) * W] : entry.upper();
        const bool back = bounds.backward.c[a] != 0;
        bounds.origin_low.c[a] = from - wide;
        bounds.origin_high.c[a] = to + wide;
        bounds.origin_in.c[a] = back ? from - wide : to + wide;
        bounds.origin_out.c[a] = back ? to + wide : from - wide;
    }
    bounds.t_min = 0.0f;
    shorten_moved(packet, bounds);
}

}  // namespace
}  // namespace wrt
