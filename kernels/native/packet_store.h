// The hits of packets, written to a batch (wrt.kernels.traversal.packet.rays.packet_store).
#pragma once
#include "packet.h"

#if defined(__x86_64__) && WRT_VECTORS
#define WRT_NON_TEMPORAL 1
#else
#define WRT_NON_TEMPORAL 0
#endif

namespace wrt {
namespace {

/// Fetches the cache lines of an array that will be written to.
inline CUDA_CALLABLE void fetch_to_write(const void* data, size_t bytes)
{
#if !defined(__CUDA_ARCH__)
    for (size_t b = 0; b < bytes; b += 64) __builtin_prefetch((const char*)data + b, 1);
#endif
}

/// Fetches where `store_packet` will write closest hits into the caches, so that it does not wait for memory.
template <int P, class Batch, class Hits> inline CUDA_CALLABLE void fetch_hits(const Batch& batch, int first, const Hits& hits)
{
    const PacketRays<P> rays(batch, first);
    if (!rays.whole || rays.picture) return;
    fetch_to_write(hits.t.data + first, 4 * P);
    fetch_to_write(hits.primitive.data + first, 4 * P);
    fetch_to_write(hits.uv.data + first, 8 * P);
}

/// No ray has a hit.
template <int P, int W, bool SHARED> inline CUDA_CALLABLE void clear_packet(const Packet<P, W, SHARED>& packet)
{
    WRT_FOR (P, k) {
        packet.primitive[k] = -1;
        packet.t[k] = WRT_INFINITY;
        packet.u[k] = packet.v[k] = 0.0f;
    }
}

#if WRT_NON_TEMPORAL
template <class V> inline void save_past_caches(void* to, V v) { __builtin_nontemporal_store(v, (V*)to); }

/// Lanes of two vectors alternately, from lane FIRST on.
template <int FIRST, class V, int... I> inline V alternate(V v, V w, Numbers<int, I...>)
{
    constexpr int N = sizeof...(I);
    return __builtin_shufflevector(v, w, ((I & 1) * N + FIRST + I / 2)...);
}

/// Writes closest hits past the caches, if they are whole cache lines; returns whether they are.
template <int P, int W, bool SHARED, class Hits>
inline bool store_lines(const Packet<P, W, SHARED>& packet, const PacketRays<P>& rays, const Hits& hits, bool untested)
{
    constexpr int LINE = 16;
    float *t_to = hits.t.data + rays.first, *uv_to = (float*)(hits.uv.data + rays.first);
    int* primitive_to = hits.primitive.data + rays.first;
    if (P % LINE || !rays.whole || rays.picture || (((size_t)t_to | (size_t)primitive_to | (size_t)uv_to) & 63)) return false;
    using Line = Vector<float, LINE>;
    const Line none = (Line)0.0f;
    for (int j = 0; j < P; j += LINE) {
        Vector<int, LINE> ids = load<Vector<int, LINE>>(packet.primitive + j);
        Line t = load<Line>(packet.t + j), u = load<Line>(packet.u + j), v = load<Line>(packet.v + j);
        ids |= untested ? -1 : 0;
        t = ids < 0 ? (Line)WRT_INFINITY : t;
        u = untested ? none : u;
        v = untested ? none : v;
        save_past_caches(t_to + j, t);
        save_past_caches(primitive_to + j, ids);
        save_past_caches(uv_to + 2 * j, alternate<0>(u, v, Lanes<LINE>()));
        save_past_caches(uv_to + 2 * j + LINE, alternate<LINE / 2>(u, v, Lanes<LINE>()));
    }
    return true;
}
#endif

/// Writes the hits of the rays that `load_packet` loaded. untested: whether the packet has met no leaf, and has no hits.
/// NON_TEMPORAL: closest hits past the caches, where they are whole cache lines.
template <bool ANY_HIT, bool NON_TEMPORAL, int P, int W, bool SHARED, class Batch, class Hits>
inline CUDA_CALLABLE void store_packet(
    const Packet<P, W, SHARED>& packet, const Batch& batch, int first, const Hits& hits, bool untested)
{
    const PacketRays<P> rays(batch, first);
    const int* found = packet.primitive;
    if (ANY_HIT) {
        bool* __restrict__ occluded = hits.occluded.data;
        if (untested) rays.each([&](int, int n) { occluded[n] = false; });
        else rays.each([&](int k, int n) { occluded[n] = found[k] >= 0; });
        return;
    }
#if WRT_NON_TEMPORAL
    if (NON_TEMPORAL && store_lines(packet, rays, hits, untested)) return;
#endif
    float* __restrict__ t = hits.t.data;
    int* __restrict__ primitive = hits.primitive.data;
    float* __restrict__ uv = (float*)hits.uv.data;
    if (untested) {
        rays.each([&](int, int n) { t[n] = WRT_INFINITY; });
        rays.each([&](int, int n) { primitive[n] = -1; });
        rays.each([&](int, int n) { uv[2 * (size_t)n] = 0.0f, uv[2 * (size_t)n + 1] = 0.0f; });
        return;
    }
    rays.each([&](int k, int n) { t[n] = found[k] < 0 ? WRT_INFINITY : packet.t[k]; });
    rays.each([&](int k, int n) { primitive[n] = found[k]; });
    rays.each([&](int k, int n) { uv[2 * (size_t)n] = packet.u[k], uv[2 * (size_t)n + 1] = packet.v[k]; });
}

/// Orders non-temporal stores before all later ones.
inline CUDA_CALLABLE void finish_stores()
{
#if defined(__x86_64__) && WRT_VECTORS
    __builtin_ia32_sfence();
#endif
}

/// Fetches where the closest hits of the packets after those of `PacketRow` will be written into the caches.
template <int P, int W, class Batch, class Hits>
inline CUDA_CALLABLE void fetch_row(const Batch& batch, int first, int limit, const Hits& hits)
{
    const PacketRow<P, W> row(batch, first, limit);
    for (int y = 0; y < row.rows; ++y) {
        const size_t at = row.begin + (size_t)y * row.apart + row.length;
        fetch_to_write(hits.t.data + at, 4 * (size_t)row.length);
        fetch_to_write(hits.primitive.data + at, 4 * (size_t)row.length);
        fetch_to_write(hits.uv.data + at, 8 * (size_t)row.length);
    }
}

#if WRT_NON_TEMPORAL
/// Writes `length` misses past the caches, if vectors of them are aligned; returns whether they are.
template <int W> inline bool store_misses(float* t, int* primitive, float* uv, int length)
{
    using Misses = Vector<float, W>;
    if ((((size_t)t | (size_t)primitive | (size_t)uv) & (4 * W - 1)) != 0) return false;
    for (int x = 0; x < length; x += W) save_past_caches(t + x, (Misses)WRT_INFINITY);
    for (int x = 0; x < length; x += W) save_past_caches(primitive + x, (Vector<int, W>)(-1));
    for (int x = 0; x < 2 * length; x += W) save_past_caches(uv + x, (Misses)0.0f);
    return true;
}
#endif

/// No ray of the packets of `PacketRow` has a hit; or, of an any-hit query, all of them, if OCCLUDED.
template <int P, int W, bool ANY_HIT, bool NON_TEMPORAL, bool OCCLUDED, class Batch, class Hits>
inline CUDA_CALLABLE void store_row(const Batch& batch, int first, int limit, const Hits& hits)
{
    const PacketRow<P, W> row(batch, first, limit);
    for (int y = 0; y < row.rows; ++y) {
        const size_t at = row.begin + (size_t)y * row.apart;
        if (ANY_HIT) {
            WRT_FOR (row.length, x) {
                hits.occluded.data[at + x] = OCCLUDED;
            }
            continue;
        }
        float *t = hits.t.data + at, *uv = (float*)(hits.uv.data + at);
        int* primitive = hits.primitive.data + at;
#if WRT_NON_TEMPORAL
        if (NON_TEMPORAL && store_misses<W>(t, primitive, uv, row.length)) continue;
#endif
        WRT_FOR (row.length, x) {
            t[x] = WRT_INFINITY;
        }
        WRT_FOR (row.length, x) {
            primitive[x] = -1;
        }
        WRT_FOR (2 * row.length, x) {
            uv[x] = 0.0f;
        }
    }
}

}  // namespace
}  // namespace wrt
