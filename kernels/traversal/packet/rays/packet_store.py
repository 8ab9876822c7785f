"""Writes the results of a packet to a batch of hits.

Figures of fetching ahead: notebooks/records/2026-11-23-packet-ends.md.
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
    def store_packet_native(packet: wp.array(dtype=float), rays: RayBatch, first: int, hits: HitBatch): ...

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

    @wp.func_native(layout.constants + NUMBERS + _FETCH_HITS)
    def fetch_hits_native(rays: RayBatch, first: int, hits: HitBatch): ...

    return fetch_hits_native


@cache
def clear_packet(layout: PacketLayout) -> wp.Function:
    """`wp.func(packet)`: no ray has a hit."""

    @wp.func_native(layout.head + "    WRT_FOR(P, k) { ((int*)primitive)[k] = -1; t[k] = INF; u[k] = v[k] = 0.0f; }\n")
    def clear_packet_native(packet: wp.array(dtype=float)): ...

    return clear_packet_native
