"""Writes the results of a packet to a batch of hits.

A store fetches the cache line that it writes to. Packets of consecutive rays write whole lines, so these are fetched ahead; or,
if the hits would not stay in the caches anyway (`PacketConfig.non_temporal`), written by non-temporal stores, which fetch
nothing. Figures: notebooks/records/2026-11-23-packet-ends.md, notebooks/records/2026-11-24-streams.md.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.ray_batch import HitBatch, RayBatch
from wrt.kernels.runtime import native
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout, cpp


@cache
def store_packet(layout: PacketLayout, any_hit: bool, non_temporal: bool = False) -> wp.Function:
    """`wp.func(packet, rays, first, hits, untested)`: writes the hits of the P rays that `load_packet` loaded.

    untested: whether the packet has met no leaf, so that it has no hits and was not finished (`finish_packet`).
    non_temporal: whether closest hits are written by non-temporal stores, where they are whole cache lines; the kernel has to
    call `finish_stores` after the last of them.
    """
    what = f"{cpp(any_hit)}, {cpp(non_temporal)}"

    @native.func_native("packet_store.h", f"wrt::store_packet<{what}>({layout.packet}, rays, first, hits, untested);")
    def store_packet_native(packet: wp.array(dtype=float), rays: RayBatch, first: int, hits: HitBatch, untested: bool): ...

    return store_packet_native


@cache
def fetch_hits(layout: PacketLayout) -> wp.Function:
    """`wp.func(rays, first, hits)`: fetches into the caches where `store_packet` will write closest hits, so that it does not
    wait for memory."""

    @native.func_native("packet_store.h", f"wrt::fetch_hits<{layout.rays}>(rays, first, hits);")
    def fetch_hits_native(rays: RayBatch, first: int, hits: HitBatch): ...

    return fetch_hits_native


@native.func_native("packet_store.h", "wrt::finish_stores();")
def finish_stores():
    """Orders non-temporal stores before all later stores: whoever learns that the item is done then finds its hits."""


@cache
def clear_packet(layout: PacketLayout) -> wp.Function:
    """`wp.func(packet)`: no ray has a hit."""

    @native.func_native("packet_store.h", f"wrt::clear_packet({layout.packet});")
    def clear_packet_native(packet: wp.array(dtype=float)): ...

    return clear_packet_native
