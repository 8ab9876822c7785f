"""Writes the results of a packet to a batch of hits.

A store fetches the cache line that it writes to. Packets of consecutive rays write whole lines, so these are fetched ahead; or,
if the hits would not stay in the caches anyway (`PacketConfig.non_temporal`), written by non-temporal stores, which fetch
nothing. Figures: notebooks/records/2026-11-23-packet-ends.md, notebooks/records/2026-11-24-streams.md.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.ray_batch import HitBatch, RayBatch
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout
from wrt.kernels.traversal.packet.rays.ray_numbers import NUMBERS

exact_module(__name__)

_STORE = """
    const int* found = (const int*)primitive;
    if (ANY_HIT) {
        bool* __restrict__ occluded = hits.occluded.data;
        if (untested) for_rays([&](int k, int n) { occluded[n] = false; });
        else for_rays([&](int k, int n) { occluded[n] = found[k] >= 0; });
        return;
    }
    float* __restrict__ t_out = hits.t.data;
    int* __restrict__ primitive_out = hits.primitive.data;
    float* __restrict__ uv_out = (float*)hits.uv.data;
    if (untested) {
        for_rays([&](int k, int n) { t_out[n] = INF; });
        for_rays([&](int k, int n) { primitive_out[n] = -1; });
        for_rays([&](int k, int n) { uv_out[2 * (size_t)n] = 0.0f; uv_out[2 * (size_t)n + 1] = 0.0f; });
        return;
    }
    for_rays([&](int k, int n) { t_out[n] = found[k] < 0 ? INF : t[k]; });
    for_rays([&](int k, int n) { primitive_out[n] = found[k]; });
    for_rays([&](int k, int n) { uv_out[2 * (size_t)n] = u[k]; uv_out[2 * (size_t)n + 1] = v[k]; });
"""


LINE = 16
"""Words of a cache line."""

_STORE_LINES = """
#if defined(__x86_64__) && defined(__clang__) && !defined(__CUDA_ARCH__)
    float *t_to = hits.t.data + first, *uv_to = (float*)(hits.uv.data + first);
    int* primitive_to = hits.primitive.data + first;
    if (P % LINE == 0 && whole && !picture && (((size_t)t_to | (size_t)primitive_to | (size_t)uv_to) & 63) == 0) {
        typedef float wrt_line __attribute__((ext_vector_type(LINE)));
        typedef int wrt_line_of_ints __attribute__((ext_vector_type(LINE)));
        for (int j = 0; j < P; j += LINE) {
            wrt_line distances, second, third;
            wrt_line_of_ints ids;
            __builtin_memcpy(&distances, t + j, sizeof(distances)); __builtin_memcpy(&ids, primitive + j, sizeof(ids));
            __builtin_memcpy(&second, u + j, sizeof(second)); __builtin_memcpy(&third, v + j, sizeof(third));
            ids |= untested ? -1 : 0;
            distances = ids < 0 ? (wrt_line)(INF) : distances;
            second = untested ? (wrt_line)(0.0f) : second; third = untested ? (wrt_line)(0.0f) : third;
            __builtin_nontemporal_store(distances, (wrt_line*)(t_to + j));
            __builtin_nontemporal_store(ids, (wrt_line_of_ints*)(primitive_to + j));
            __builtin_nontemporal_store(__builtin_shufflevector(second, third, LOW), (wrt_line*)(uv_to + 2 * j));
            __builtin_nontemporal_store(__builtin_shufflevector(second, third, HIGH), (wrt_line*)(uv_to + 2 * j + LINE));
        }
        return;
    }
#endif
"""
"""C++ that writes closest hits by non-temporal stores and returns, if they are whole cache lines."""


@cache
def store_packet(layout: PacketLayout, any_hit: bool, non_temporal: bool = False) -> wp.Function:
    """`wp.func(packet, rays, first, hits, untested)`: writes the hits of the P rays that `load_packet` loaded.

    untested: whether the packet has met no leaf, so that it has no hits and was not finished (`finish_packet`).
    non_temporal: whether closest hits are written by non-temporal stores, where they are whole cache lines; the kernel has to
    call `finish_stores` after the last of them.
    """
    constant = f"    constexpr bool ANY_HIT = {str(any_hit).lower()};\n"
    if non_temporal and not any_hit:
        pairs = [f"{k}, {LINE + k}" for k in range(LINE)]  # of u and v, alternately
        lines = _STORE_LINES.replace("LOW", ", ".join(pairs[: LINE // 2])).replace("HIGH", ", ".join(pairs[LINE // 2 :]))
    else:
        lines = ""

    @native.func_native("lanes.h", f"{layout.head}    constexpr int LINE = {LINE};\n{constant}{NUMBERS}{lines}{_STORE}")
    def store_packet_native(packet: wp.array(dtype=float), rays: RayBatch, first: int, hits: HitBatch, untested: bool): ...

    return store_packet_native


_FETCH_HITS = """
#if !defined(__CUDA_ARCH__)
    if (!whole || picture) return;
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

    @native.func_native("lanes.h", layout.constants + NUMBERS + _FETCH_HITS)
    def fetch_hits_native(rays: RayBatch, first: int, hits: HitBatch): ...

    return fetch_hits_native


@wp.func_native("""
#if defined(__x86_64__) && defined(__clang__) && !defined(__CUDA_ARCH__)
    __builtin_ia32_sfence();
#endif
""")
def finish_stores():
    """Orders non-temporal stores before all later stores: whoever learns that the item is done then finds its hits."""
    ...


@cache
def clear_packet(layout: PacketLayout) -> wp.Function:
    """`wp.func(packet)`: no ray has a hit."""

    @native.func_native(
        "lanes.h", layout.head + "    WRT_FOR(P, k) { ((int*)primitive)[k] = -1; t[k] = INF; u[k] = v[k] = 0.0f; }\n"
    )
    def clear_packet_native(packet: wp.array(dtype=float)): ...

    return clear_packet_native
