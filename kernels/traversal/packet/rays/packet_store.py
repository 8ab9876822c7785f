"""Writes the results of a packet to a batch of hits.

A store first fetches the line that it writes to, which takes time before and room in the caches after. Packets of consecutive
rays write whole lines. So the lines are fetched ahead, or, if the hits would not fit into the caches anyway
(`HitBatch.beside_caches`), written past them. Figures: notebooks/records/2026-11-23-packet-ends.md,
notebooks/records/2026-11-24-streams.md.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.ray_batch import HitBatch, RayBatch
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout
from wrt.kernels.traversal.packet.rays.ray_numbers import NUMBERS

exact_module(__name__)

_STORE = """
    const int* found = (const int*)primitive;
    if (ANY_HIT) {
        bool* __restrict__ occluded = hits.occluded.data;
        for_rays([&](int k, int n) { occluded[n] = found[k] >= 0; });
        return;
    }
    float* __restrict__ t_out = hits.t.data;
    int* __restrict__ primitive_out = hits.primitive.data;
    float* __restrict__ uv_out = (float*)hits.uv.data;
    for_rays([&](int k, int n) { t_out[n] = found[k] < 0 ? INF : t[k]; });
    for_rays([&](int k, int n) { primitive_out[n] = found[k]; });
    for_rays([&](int k, int n) { uv_out[2 * (size_t)n] = u[k]; uv_out[2 * (size_t)n + 1] = v[k]; });
"""


@cache
def store_packet(layout: PacketLayout, any_hit: bool) -> wp.Function:
    """`wp.func(packet, rays, first, hits)`: writes the hits of the P rays that `load_packet` loaded."""
    constant = f"    constexpr bool ANY_HIT = {str(any_hit).lower()};\n"

    @wp.func_native(layout.head + constant + NUMBERS + _STORE)
    def store_packet_native(packet: wp.array(dtype=float), rays: wp.ref[RayBatch], first: int, hits: wp.ref[HitBatch]): ...

    return store_packet_native


LINE = 16
"""Words of a cache line."""

_STORE_LINES = """
#if defined(__x86_64__) && defined(__clang__) && !defined(__CUDA_ARCH__)
    const int* found = (const int*)primitive;
    float *t_out = hits.t.data + first, *uv_out = (float*)(hits.uv.data + first);
    int* primitive_out = hits.primitive.data + first;
    const bool lines = (((size_t)t_out | (size_t)primitive_out | (size_t)uv_out) & 63) == 0;
    if (P % LINE != 0 || rays.columns > 0 || rays.count - first < P || !lines) return false;
    typedef float wrt_line __attribute__((ext_vector_type(LINE)));
    typedef int wrt_line_of_ints __attribute__((ext_vector_type(LINE)));
    // not inlined, so that it is out of the way of smaller batches
    auto store_all = [](const float* t, const float* u, const float* v, const int* found, float* t_out, int* primitive_out,
                        float* uv_out) __attribute__((noinline)) {
        for (int j = 0; j < P; j += LINE) {
            wrt_line distances, first, second;
            wrt_line_of_ints ids;
            __builtin_memcpy(&distances, t + j, sizeof(distances)); __builtin_memcpy(&ids, found + j, sizeof(ids));
            __builtin_memcpy(&first, u + j, sizeof(first)); __builtin_memcpy(&second, v + j, sizeof(second));
            distances = ids < 0 ? (wrt_line)(__builtin_bit_cast(float, 0x7f800000)) : distances;
            __builtin_nontemporal_store(distances, (wrt_line*)(t_out + j));
            __builtin_nontemporal_store(ids, (wrt_line_of_ints*)(primitive_out + j));
            __builtin_nontemporal_store(__builtin_shufflevector(first, second, LOW), (wrt_line*)(uv_out + 2 * j));
            __builtin_nontemporal_store(__builtin_shufflevector(first, second, HIGH), (wrt_line*)(uv_out + 2 * j + LINE));
        }
    };
    store_all(t, u, v, found, t_out, primitive_out, uv_out);
    return true;
#else
    return false;
#endif
"""


@cache
def store_lines(layout: PacketLayout) -> wp.Function:
    """`wp.func(packet, rays, first, hits) -> bool`: writes closest hits as `store_packet` does, but past the caches; False, and
    nothing written, if they are not whole cache lines. `finish_stores` has to follow."""

    pairs = [f"{k}, {LINE + k}" for k in range(LINE)]
    code = _STORE_LINES.replace("LOW", ", ".join(pairs[: LINE // 2])).replace("HIGH", ", ".join(pairs[LINE // 2 :]))

    @wp.func_native(f"{layout.head}    constexpr int LINE = {LINE};\n{code}")
    def store_lines_native(
        packet: wp.array(dtype=float), rays: wp.ref[RayBatch], first: int, hits: wp.ref[HitBatch]
    ) -> wp.bool: ...

    return store_lines_native


_FETCH_HITS = """
#if !defined(__CUDA_ARCH__)
    if (!whole || picture || hits.beside_caches) return;
    auto fetch_to_write = [](void* data, int bytes) {
        WRT_UNROLLED for (int b = 0; b < bytes; b += 64) __builtin_prefetch((char*)data + b, 1);
    };
    fetch_to_write(hits.t.data + first, 4 * P);
    fetch_to_write(hits.primitive.data + first, 4 * P);
    fetch_to_write(hits.uv.data + first, 8 * P);
#endif
"""


@cache
def fetch_hits(layout: PacketLayout) -> wp.Function:
    """`wp.func(rays, first, hits)`: fetches into the caches where `store_packet` will write closest hits, so that it does not
    wait for memory."""

    @wp.func_native(layout.constants + NUMBERS + _FETCH_HITS)
    def fetch_hits_native(rays: wp.ref[RayBatch], first: int, hits: wp.ref[HitBatch]): ...

    return fetch_hits_native


@wp.func_native("""
#if defined(__x86_64__) && defined(__clang__) && !defined(__CUDA_ARCH__)
    if (hits.beside_caches) __builtin_ia32_sfence();
#endif
""")
def finish_stores(hits: HitBatch):
    """Hits that an item has stored past the caches are there for whoever learns that the item is done."""
    ...


@cache
def clear_packet(layout: PacketLayout) -> wp.Function:
    """`wp.func(packet)`: no ray has a hit."""

    @wp.func_native(layout.head + "    WRT_FOR(P, k) { ((int*)primitive)[k] = -1; t[k] = INF; u[k] = v[k] = 0.0f; }\n")
    def clear_packet_native(packet: wp.array(dtype=float)): ...

    return clear_packet_native
