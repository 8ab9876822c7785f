// Packets of rays that Embree traces, called by address (wrt.bench.peers.embree_packets). A packet is an RTCRay4, 8 or 16, or
// its form with a hit: arrays of 32-bit words, one for each field, one element a ray.
#pragma once

namespace wrt {
namespace embree {

/// Which field is which, in both forms up to `FLAGS`.
enum Field { ORIGIN, T_NEAR = 3, DIRECTION, TIME = 7, T_FAR, MASK, ID, FLAGS, U = 15, V, PRIMITIVE, GEOMETRY };

/// Fields of the largest form: with a hit, of version 4.
constexpr int FIELDS = 21;

/// RTC_INVALID_GEOMETRY_ID.
constexpr unsigned NO_GEOMETRY = 0xFFFFFFFFu;

/// Has Embree trace the lanes of a packet whose `valid` is -1.
template <class Call> inline void trace_lanes(const Call& call, const int* valid, void* packet)
{
    if (call.version == 3) {
        // an RTCIntersectContext without a filter
        using Trace = void (*)(const int* valid, void* scene, void* context, void* packet);
        struct Context {
            int flags;
            void* filter;
            unsigned instance;
        } context = {call.flags, nullptr, NO_GEOMETRY};
        ((Trace)call.function)(valid, (void*)call.scene, &context, packet);
    } else {
        // RTCIntersectArguments, which have the layout of RTCOccludedArguments: all features, no context, no callbacks
        using Trace = void (*)(const int* valid, void* scene, void* packet, void* arguments);
        struct Arguments {
            int flags;
            unsigned features;
            void *context, *filter, *intersect;
        } arguments = {call.flags, 0xFFFFFFFFu, nullptr, nullptr, nullptr};
        ((Trace)call.function)(valid, (void*)call.scene, packet, &arguments);
    }
}

/// Traces packet `number` of those that were filled before, after its results are set back.
template <class Call, class Packets> inline void trace_filled(const Call& call, const Packets& packets, int number)
{
    alignas(64) int valid[16];
    for (int i = 0; i < 16; ++i) valid[i] = -1;
    float* const packet = (float*)packets.address + (size_t)number * packets.fields * call.width;
    for (int i = 0; i < call.width; ++i) packet[T_FAR * call.width + i] = call.t_max;
    if (call.closest)
        for (int i = 0; i < call.width; ++i) ((unsigned*)packet)[GEOMETRY * call.width + i] = NO_GEOMETRY;
    trace_lanes(call, valid, packet);
}

/// Fills a packet with rays `first` to `first + last`, and lanes beyond them with the last one.
template <int W, class Rays> inline void fill_rays(const Rays& rays, int first, int last, float* packet)
{
    const float* const o = (const float*)rays.origins + (size_t)first * rays.origin_step;
    const float* const d = (const float*)rays.directions + (size_t)first * 3;
    if (last == W - 1 && rays.origin_step == 0) {
        for (int i = 0; i < W; ++i)
            for (int k = 0; k < 3; ++k) packet[(ORIGIN + k) * W + i] = o[k];
        for (int i = 0; i < W; ++i)
            for (int k = 0; k < 3; ++k) packet[(DIRECTION + k) * W + i] = d[3 * i + k];
    } else if (last == W - 1) {
        for (int i = 0; i < W; ++i)
            for (int k = 0; k < 3; ++k) packet[(ORIGIN + k) * W + i] = o[3 * i + k];
        for (int i = 0; i < W; ++i)
            for (int k = 0; k < 3; ++k) packet[(DIRECTION + k) * W + i] = d[3 * i + k];
    } else {
        for (int i = 0; i < W; ++i)
            for (int k = 0; k < 3; ++k) {
                const int ray = i < last ? i : last;
                packet[(ORIGIN + k) * W + i] = o[ray * rays.origin_step + k];
                packet[(DIRECTION + k) * W + i] = d[ray * 3 + k];
            }
    }
}

/// Sets the other fields of a packet.
template <int W, class Call> inline void fill_other_fields(const Call& call, float* packet)
{
    int* const words = (int*)packet;
    for (int i = 0; i < W; ++i) {
        packet[T_NEAR * W + i] = packet[TIME * W + i] = 0.0f;
        packet[T_FAR * W + i] = call.t_max;
        words[MASK * W + i] = -1;
        words[ID * W + i] = words[FLAGS * W + i] = 0;
    }
    if (call.closest)
        for (int i = 0; i < W; ++i) {
            packet[U * W + i] = packet[V * W + i] = 0.0f;
            words[PRIMITIVE * W + i] = words[GEOMETRY * W + i] = -1;
        }
}

/// Copies the answers of the first `count` lanes to flat arrays, from number `first` on.
template <int W, class Call, class Answers>
inline void copy_answers(const Call& call, const float* packet, const Answers& answers, int first, int count)
{
    const int* const words = (const int*)packet;
    const float* const reach = packet + T_FAR * W;
    if (!call.closest) {
        for (int i = 0; i < count; ++i) ((bool*)answers.occluded)[first + i] = reach[i] < 0.0f;
        return;
    }
    const auto is_miss = [&](int i) { return words[PRIMITIVE * W + i] < 0; };
    for (int i = 0; i < count; ++i) ((float*)answers.t)[first + i] = is_miss(i) ? __builtin_inff() : reach[i];
    for (int i = 0; i < count; ++i) ((int*)answers.primitive)[first + i] = words[PRIMITIVE * W + i];
    for (int i = 0; i < count; ++i) ((float*)answers.u)[first + i] = packet[U * W + i];
    for (int i = 0; i < count; ++i) ((float*)answers.v)[first + i] = packet[V * W + i];
}

/// Traces packet `number` of flat arrays of rays: it is filled on the stack, and its answers are copied to flat arrays.
template <int W, class Call, class Rays, class Answers>
inline void trace_flat_of(const Call& call, const Rays& rays, const Answers& answers, int number)
{
    alignas(64) int valid[W];
    alignas(64) float packet[FIELDS * W];
    const int first = number * W, left = rays.count - first, count = left < W ? left : W;
    fill_rays<W>(rays, first, count - 1, packet);
    fill_other_fields<W>(call, packet);
    for (int i = 0; i < W; ++i) valid[i] = i < count ? -1 : 0;
    trace_lanes(call, valid, packet);
    if (count == W) copy_answers<W>(call, packet, answers, first, W);
    else copy_answers<W>(call, packet, answers, first, count);
}

/// The same with the call's width as a constant, so that loops are vector instructions.
template <class Call, class Rays, class Answers>
inline void trace_flat(const Call& call, const Rays& rays, const Answers& answers, int number)
{
    if (call.width == 16) trace_flat_of<16>(call, rays, answers, number);
    else if (call.width == 8) trace_flat_of<8>(call, rays, answers, number);
    else trace_flat_of<4>(call, rays, answers, number);
}

}  // namespace embree
}  // namespace wrt
