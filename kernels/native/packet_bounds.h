// Bounds of the active rays of a packet (wrt.kernels.traversal.packet.rays.packet_bounds).
#pragma once
#include "packet.h"

namespace wrt {
namespace {

/// N intervals over the active rays of a packet, per lane, then over all lanes. W is a power of two.
template <int N, int W> struct LaneIntervals {
    alignas(4 * W) float rows[2 * N][W];  // lower ends are negated
    float ends[2 * N];

    inline CUDA_CALLABLE void join() { row_maxima<2 * N>(rows, ends); }
    inline CUDA_CALLABLE float lower(int j) const { return -ends[2 * j]; }
    inline CUDA_CALLABLE float upper(int j) const { return ends[2 * j + 1]; }

    /// Sets interval j of lane i to the values of rays i, i + W, ..; inactive rays are replaced by ray `one`, an active one, so
    /// that loops over lanes need no masks.
    template <int P, class Value> inline CUDA_CALLABLE void bound(int j, int i, const float* t, int one, Value value)
    {
        const float stand_in = value(one);
        float low = stand_in, high = stand_in;
        WRT_UNROLLED
        for (int f = 0; f < P; f += W) {
            const float there = value(f + i), own = t[f + i] >= -0.0f ? there : stand_in;
            low = own < low ? own : low;
            high = own > high ? own : high;
        }
        rows[2 * j][i] = -low;
        rows[2 * j + 1][i] = high;
    }
};

// The slack of the bounds: of rays that start between `lows` and `highs`; of the rays themselves; or a given one.

template <class Vec3> struct SlackOfEnds {
    static constexpr bool OF_RAYS = false;
    const Vec3 &low, &high;  // of the scene

    inline CUDA_CALLABLE float slack(const float* lows, const float* highs) const
    {
        const float of_lows = reach(low, high, lows[0], lows[1], lows[2]);
        const float of_highs = reach(low, high, highs[0], highs[1], highs[2]);
        return SLACK * (of_lows > of_highs ? of_lows : of_highs);
    }
};

struct SlackOfRays {
    static constexpr bool OF_RAYS = true;
    inline CUDA_CALLABLE float slack(const float*, const float*) const { return 0.0f; }
};

struct GivenSlack {
    static constexpr bool OF_RAYS = false;
    float given;
    inline CUDA_CALLABLE float slack(const float*, const float*) const { return given; }
};

/// Sets the fields of an axis that depend on the signs of the directions along it.
template <class Bounds>
inline CUDA_CALLABLE void set_sides(
    Bounds& bounds, int a, bool backward, bool mixed, const float* lows, const float* highs, float slack)
{
    bounds.mixed_axes += mixed ? 1 : 0;
    bounds.backward.c[a] = backward ? 1 : 0;
    bounds.origin_in.c[a] = backward ? lows[a] - slack : highs[a] + slack;
    bounds.origin_out.c[a] = backward ? highs[a] + slack : lows[a] - slack;
    bounds.origin_low.c[a] = lows[a];
    bounds.origin_high.c[a] = highs[a];
}

/// The interval of 1 / direction along an axis, from that of the direction.
template <class Bounds>
inline CUDA_CALLABLE void set_inverses(Bounds& bounds, int a, float lower, float upper, bool backward, bool mixed)
{
    const float p = 1.0f / lower, q = 1.0f / upper, none = WRT_NAN;
    bounds.inverse_large.c[a] = mixed ? none : backward ? q : p;
    bounds.inverse_small.c[a] = mixed ? none : backward ? p : q;
    bounds.forward_small.c[a] = mixed ? q : 0.0f;
    bounds.backward_small.c[a] = mixed ? p : 0.0f;
}

/// The sides of all axes, and the intervals of 1 / direction, from those of the directions: division is monotone on either side
/// of 0. A direction of -0 counts as +0, whose reciprocal bounds the same boxes.
template <class Bounds>
inline CUDA_CALLABLE void set_direction_axes(
    Bounds& bounds, const float* lower_of, const float* upper_of, const float* lows, const float* highs, float slack)
{
    bounds.finished = 0;
    bounds.mixed_axes = 0;
    WRT_UNROLLED
    for (int a = 0; a < 3; ++a) {
        const float lower = lower_of[a] + 0.0f, upper = upper_of[a] + 0.0f;
        const bool backward = upper < 0.0f, mixed = (lower < 0.0f) & !backward;
        set_inverses(bounds, a, lower, upper, backward, mixed);
        set_sides(bounds, a, backward, mixed, lows, highs, slack);
    }
}

/// The same from the intervals of 1 / direction.
template <int P, int W, bool SHARED, class Bounds>
inline CUDA_CALLABLE void set_inverse_axes(const Packet<P, W, SHARED>& packet, Bounds& bounds, const float* inverse_low,
    const float* inverse_high, const float* lows, const float* highs, float slack)
{
    bounds.finished = 1;
    bounds.mixed_axes = 0;
    WRT_UNROLLED
    for (int a = 0; a < 3; ++a) {
        const float lower = inverse_low[a], upper = inverse_high[a], none = WRT_NAN;
        const bool backward = upper < 0.0f, mixed = (lower < 0.0f) & !backward;
        bounds.inverse_large.c[a] = mixed ? none : backward ? lower : upper;
        bounds.inverse_small.c[a] = mixed ? none : backward ? upper : lower;
        bounds.forward_small.c[a] = bounds.backward_small.c[a] = 0.0f;
        set_sides(bounds, a, backward, mixed, lows, highs, slack);
    }
    if (!bounds.mixed_axes) return;
    for (int a = 0; a < 3; ++a) {
        if (!((inverse_low[a] < 0.0f) & !(inverse_high[a] < 0.0f))) continue;
        const float *inverse = packet.inverse(a), *t = packet.t;
        // two loops: Clang does not vectorise a reduction of values that a condition selects
        int ahead[P], behind[P];
        OrderedInterval ends;
        WRT_FOR (P, k) {
            const bool valid = t[k] >= -0.0f, forward = valid & !(inverse[k] < 0.0f), back = valid & !forward;
            ahead[k] = forward ? OrderedInterval::key(inverse[k]) : ends.low;
            behind[k] = back ? OrderedInterval::key(inverse[k]) : ends.high;
        }
        int lower = ends.low, upper = ends.high;
        WRT_FOR (P, k) {
            lower = ahead[k] < lower ? ahead[k] : lower;
            upper = behind[k] > upper ? behind[k] : upper;
        }
        bounds.forward_small.c[a] = OrderedInterval::value(lower);
        bounds.backward_small.c[a] = OrderedInterval::value(upper);
    }
}

/// Bounds the points in which the rays cross a plane near their origins, normal to the axis that all of them have as the main
/// one. one: an active ray.
template <int P, int W, bool SHARED, class Bounds>
inline CUDA_CALLABLE void bound_crossings(const Packet<P, W, SHARED>& packet, Bounds& bounds, int one, int main_axes,
    const float* lows, const float* highs, float slack)
{
    const int main = axis_of(main_axes), next = main == 2 ? 0 : main + 1, other = next == 2 ? 0 : next + 1;
    const float plane = SHARED ? lows[main] : 0.5f * (lows[main] + highs[main]);
    bounds.plane = plane;
    if constexpr (SHARED) {
        bounds.through_low.c[0] = bounds.through_high.c[0] = lows[next];
        bounds.through_low.c[1] = bounds.through_high.c[1] = lows[other];
    } else {
        const float* along = packet.origin(main);
        const float* across_x = packet.origin(next);
        const float* across_y = packet.origin(other);
        LaneIntervals<2, W> crossings;
        WRT_FOR_LANES (i) {
            crossings.template bound<P>(
                0, i, packet.t, one, [&](int k) { return across_x[k] - packet.slope_x[k] * (along[k] - plane); });
            crossings.template bound<P>(
                1, i, packet.t, one, [&](int k) { return across_y[k] - packet.slope_y[k] * (along[k] - plane); });
        }
        crossings.join();
        for (int a = 0; a < 2; ++a) {
            bounds.through_low.c[a] = crossings.lower(a) - slack;
            bounds.through_high.c[a] = crossings.upper(a) + slack;
        }
    }
}

/// The main axes of the active rays, one bit each.
template <int P, int W, bool SHARED> inline CUDA_CALLABLE int main_axes_of(const Packet<P, W, SHARED>& packet)
{
    const int* axis = packet.main_axis;
    int main_axes = 0;
    WRT_FOR (P, k) {
        main_axes |= packet.t[k] >= -0.0f ? 1 << axis[k] : 0;
    }
    return main_axes;
}

/// What is bounded. SLOPES: slopes, too; LATER: components of 1 / direction still hold directions, and values that only the
/// triangle test reads are still to be computed; ENDS: the ends of rays with origins of their own, too; PASSES: those of the
/// triangle test.
template <int PASSES_, bool SLOPES_, bool LATER_ = false, bool ENDS_ = false> struct Bounding {
    static constexpr int PASSES = PASSES_;
    static constexpr bool SLOPES = SLOPES_, LATER = LATER_, ENDS = ENDS_;
};

/// Bounds the range of the active rays. ranged: whether it may differ between them; one: an active ray.
template <int P, int W, bool SHARED, class Bounds>
inline CUDA_CALLABLE void bound_range(const Packet<P, W, SHARED>& packet, Bounds& bounds, bool ranged, int one)
{
    bounds.t_min = packet.t_min[one];
    bounds.t_max = packet.t[one];
    if (!ranged) return;
    LaneIntervals<2, W> range;
    WRT_FOR_LANES (i) {
        range.template bound<P>(0, i, packet.t, one, [&](int k) { return packet.t_min[k]; });
        range.template bound<P>(1, i, packet.t, one, [&](int k) { return packet.t[k]; });
    }
    range.join();
    bounds.t_min = range.lower(0);
    bounds.t_max = range.upper(1);
}

/// Sets `bounds`; if no ray is active (t >= 0), only `active`. lows, highs: the shared origin, else any numbers; ranged:
/// whether rays may have a t_min or t of their own.
template <class What, int P, int W, bool SHARED, class Bounds, class Slack>
inline CUDA_CALLABLE void bound_packet(
    const Packet<P, W, SHARED>& packet, Bounds& bounds, float* lows, float* highs, bool ranged, const Slack& given)
{
    constexpr bool OWN_SLACK = Slack::OF_RAYS && !SHARED;
    constexpr int SX = 3, OX = SX + (What::SLOPES ? 2 : 0), WIDE = OX + (SHARED ? 0 : 3), EX = WIDE + (OWN_SLACK ? 1 : 0);
    const float* const t = packet.t;
    int one = 0, active = 0;
    while (one < P && !(t[one] >= -0.0f)) ++one;
    bounds.active = 0;
    if (one == P) return;
    LaneIntervals<EX + (What::ENDS ? 3 : 0), W> of;
    WRT_FOR_LANES (i) {
        of.template bound<P>(0, i, t, one, [&](int k) { return packet.inverse_x[k]; });
        of.template bound<P>(1, i, t, one, [&](int k) { return packet.inverse_y[k]; });
        of.template bound<P>(2, i, t, one, [&](int k) { return packet.inverse_z[k]; });
        if constexpr (What::SLOPES) {
            of.template bound<P>(SX, i, t, one, [&](int k) { return packet.slope_x[k]; });
            of.template bound<P>(SX + 1, i, t, one, [&](int k) { return packet.slope_y[k]; });
        }
        if constexpr (!SHARED) {
            of.template bound<P>(OX, i, t, one, [&](int k) { return packet.origin_x[k]; });
            of.template bound<P>(OX + 1, i, t, one, [&](int k) { return packet.origin_y[k]; });
            of.template bound<P>(OX + 2, i, t, one, [&](int k) { return packet.origin_z[k]; });
        }
        if constexpr (OWN_SLACK) of.template bound<P>(WIDE, i, t, one, [&](int k) { return packet.slack[k]; });
        if constexpr (What::ENDS) {
            const auto direction = [](float of_ray) { return What::LATER ? of_ray : 1.0f / of_ray; };
            of.template bound<P>(
                EX, i, t, one, [&](int k) { return packet.origin_x[k] + t[k] * direction(packet.inverse_x[k]); });
            of.template bound<P>(
                EX + 1, i, t, one, [&](int k) { return packet.origin_y[k] + t[k] * direction(packet.inverse_y[k]); });
            of.template bound<P>(
                EX + 2, i, t, one, [&](int k) { return packet.origin_z[k] + t[k] * direction(packet.inverse_z[k]); });
        }
        WRT_UNROLLED
        for (int f = 0; f < P; f += W) active += t[f + i] >= -0.0f ? 1 : 0;
    }
    of.join();
    bounds.active = active;
    bound_range(packet, bounds, ranged, one);
    for (int a = 0; a < 3; ++a) {
        if constexpr (!SHARED) lows[a] = of.lower(OX + a), highs[a] = of.upper(OX + a);
        if constexpr (What::ENDS) bounds.end_low.c[a] = of.lower(EX + a), bounds.end_high.c[a] = of.upper(EX + a);
    }
    int main_axes = 0;
    if constexpr (!What::LATER) {
        bounds.main_axes = main_axes = main_axes_of(packet);
        bounds.passes = What::PASSES == 1 ? 1 : main_axes;
    }
    const float slack = OWN_SLACK ? of.upper(WIDE) : given.slack(lows, highs);
    bounds.slack = slack;
    if constexpr (What::SLOPES) {
        for (int a = 0; a < 2; ++a) bounds.slope_low.c[a] = of.lower(SX + a), bounds.slope_high.c[a] = of.upper(SX + a);
        bound_crossings(packet, bounds, one, main_axes, lows, highs, slack);
    }
    const float lower[3] = {of.lower(0), of.lower(1), of.lower(2)}, upper[3] = {of.upper(0), of.upper(1), of.upper(2)};
    if constexpr (What::LATER) set_direction_axes(bounds, lower, upper, lows, highs, slack);
    else set_inverse_axes(packet, bounds, lower, upper, lows, highs, slack);
}

/// Fraction of the largest coordinate by which the end of a ray may err, and how many times as far apart as the ends, with
/// their slack, the origins must be for bounds to be reversed (wrt.kernels.traversal.packet.rays.reversed_bounds).
constexpr float ENDS_ERROR = 0x1p-20f, CLOSER = 4.0f;

/// Reverses the bounds of a packet if that makes them tighter; low, high: bounds of the scene.
template <class Vec3, class Bounds> inline CUDA_CALLABLE void reverse_bounds(const Vec3& low, const Vec3& high, Bounds& bounds)
{
    if (bounds.mixed_axes) return;
    float ends = 0.0f, origins = 0.0f, far = 0.0f, size = 0.0f;
    const auto widen = [](float value, float& largest) { largest = WRT_ABS(value) > largest ? WRT_ABS(value) : largest; };
    WRT_UNROLLED
    for (int a = 0; a < 3; ++a) {
        const float lower = bounds.end_low.c[a], upper = bounds.end_high.c[a];
        ends += upper - lower;
        origins += bounds.origin_high.c[a] - bounds.origin_low.c[a];
        widen(low.c[a] - upper, far), widen(high.c[a] - lower, far);
        widen(lower, size), widen(upper, size);
        widen(bounds.origin_low.c[a], size), widen(bounds.origin_high.c[a], size);
    }
    const float wide = 2.0f * bounds.slack + SLACK * far + ENDS_ERROR * size;
    if (!(CLOSER * (ends + wide) < origins)) return;  // NaN, of ends at infinity, too
    WRT_UNROLLED
    for (int a = 0; a < 3; ++a) {
        const bool backward = !bounds.backward.c[a];
        bounds.backward.c[a] = backward ? 1 : 0;
        bounds.inverse_large.c[a] = -bounds.inverse_large.c[a];
        bounds.inverse_small.c[a] = -bounds.inverse_small.c[a];
        bounds.origin_in.c[a] = backward ? bounds.end_low.c[a] - wide : bounds.end_high.c[a] + wide;
        bounds.origin_out.c[a] = backward ? bounds.end_high.c[a] + wide : bounds.end_low.c[a] - wide;
    }
    bounds.slack = wide;
    bounds.t_max = (bounds.t_max - bounds.t_min) * (1.0f + ENDS_ERROR);
    bounds.t_min = 0.0f;
}

}  // namespace
}  // namespace wrt
