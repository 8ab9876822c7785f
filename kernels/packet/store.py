"""From a packet to hits in memory."""

from functools import cache

import warp as wp

from wrt.kernels.packet.layout import PacketLayout
from wrt.kernels.packet.numbers import NUMBERS
from wrt.kernels.rays import HitBatch, RayBatch

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

_STORE = """
    const int* found = (const int*)primitive;
    if (ANY_HIT) {
        for (int k = 0; k < here; ++k) hits.occluded.data[number[k]] = found[k] >= 0;
        return;
    }
    if (picture) {
        for (int k = 0; k < here; ++k) {
            hits.t.data[number[k]] = found[k] < 0 ? INF : t[k];
            hits.primitive.data[number[k]] = found[k];
            hits.uv.data[number[k]] = wp::vec2(u[k], v[k]);
        }
        return;
    }
    float* t_out = hits.t.data + first;
    int* primitive_out = hits.primitive.data + first;
    float* uv_out = (float*)(hits.uv.data + first);
    WRT_FOR(here, k) { t_out[k] = found[k] < 0 ? INF : t[k]; primitive_out[k] = found[k]; }
    WRT_FOR(here, k) { uv_out[2 * k] = u[k]; uv_out[2 * k + 1] = v[k]; }
"""


@cache
def store_packet(layout: PacketLayout, any_hit: bool) -> wp.Function:
    """`wp.func(packet, rays, first, hits)`: writes the hits of the P rays that `load_packet` loads."""
    constant = f"    constexpr bool ANY_HIT = {str(any_hit).lower()};\n"

    @wp.func_native(layout.head + constant + NUMBERS + _STORE)
    def store_packet_native(packet: wp.array(dtype=float), rays: RayBatch, first: int, hits: HitBatch): ...

    return store_packet_native
