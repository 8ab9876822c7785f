"""Assignment of rays to packets: consecutive rays, or the pixels of a tile of a picture.

Packets of 8 columns and P / 8 rows visit far fewer nodes than runs of P pixels, because the pixels of a tile see the same part
of the scene (notebooks/records/2026-11-21-packets.md). Tiles are ordered from left to right, then down. Tiles at the border of
the picture are smaller, and a packet may then contain rays of two tiles; this also happens if P is above 8 and not a multiple
of 8. The rays of a packet are those at the places first .. first + P - 1 of this order.
"""

import warp as wp

from wrt.kernels.layout.ray_batch import RayBatch
from wrt.kernels.runtime.options import exact_module

exact_module(__name__)

TILE_COLUMNS = wp.constant(8)
"""Columns of a tile, in pixels; a compact tile of 32 rays has 8 x 4 (notebooks/records/2026-11-21-packets.md)."""

NUMBERS = """
    const int rest = rays.count - first, here = rest < P ? rest : P;  // how many of them exist
    const bool picture = rays.columns > 0;
    // `whole` packets are runs of ACROSS consecutive rays, from `begin` on, so many rays `apart`
    constexpr int ACROSS = P < 8 ? P : 8, DOWN = P / ACROSS;
    int begin = first, apart = ACROSS, number[P];
    bool whole = here == P;
    if (picture) {
        const int columns = rays.columns, rows = DOWN * columns, band = first / rows, within = first - band * rows;
        const int left = within / P * ACROSS;  // if the band has all its rows
        begin = band * rows + left;
        apart = columns;
        whole = whole && P % ACROSS == 0 && within % P == 0 && band * rows <= rays.count - rows && left + ACROSS <= columns;
        if (!whole) for (int k = 0; k < P; ++k) {
            const int place = first + (k < here ? k : 0), b = place / rows, below = rays.count / columns - b * DOWN;
            const int h = below < DOWN ? below : DOWN;
            int offset = place - b * rows;
            const int l = offset / (ACROSS * h) * ACROSS, w = columns - l < ACROSS ? columns - l : ACROSS;
            offset -= l * h;
            number[k] = (b * DOWN + offset / w) * columns + l + offset % w;
        }
    } else if (!whole) for (int k = 0; k < P; ++k) number[k] = first + (k < here ? k : 0);
    // visit(k, n) for each ray k of the packet, n being its number in the batch
    auto for_rays = [&](auto visit) {
        if (whole && !picture) { WRT_FOR(P, k) visit(k, first + k); }
        else if (whole) for (int y = 0; y < DOWN; ++y) { WRT_FOR(ACROSS, x) visit(y * ACROSS + x, begin + y * apart + x); }
        else { WRT_SCALAR for (int k = 0; k < here; ++k) visit(k, number[k]); }
    };
"""
"""C++ for the head of a native function with parameters `rays` and `first`, and the constant P."""

ROWS = """
    constexpr int ACROSS = P < 8 ? P : 8, DOWN = P / ACROSS, STEP = W > ACROSS ? W / ACROSS : 1;
    const int left_over = rays.count - first;
    int packets = left_over / P < limit ? left_over / P : limit;
    int rows = 1, begin = first, apart = 0, length;
    if (rays.columns > 0) {
        const int columns = rays.columns, band_rays = DOWN * columns;
        const int band = first / band_rays, within = first - band * band_rays;
        const int left = within / P * ACROSS, fit = (columns - left) / ACROSS;
        begin = band * band_rays + left;
        apart = columns;
        rows = DOWN;
        const bool tiles = P % ACROSS == 0 && within % P == 0 && band * band_rays <= rays.count - band_rays;
        packets = tiles ? (packets < fit ? packets : fit) : 0;
        packets -= packets % STEP;
        length = packets * ACROSS;
    } else length = packets * P;
"""
"""C++ for the head of a native function with parameters `rays`, `first` and `limit`, and the constants P and W: `packets`, the
number of whole packets from ray `first` on that lie side by side, at most `limit`. They are `rows` of `length` rays, a multiple
of W, from ray `begin` on and `apart` rays from each other."""

FETCH = """
    // in memory of their own, so that no component of a packet may lie in their way
    float to_x[P], to_y[P], to_z[P];
    auto fetch = [&](int stride, auto take) {  // take(k, n): ray k has what is at place n
        if (stride) for_rays(take);
        else { WRT_FOR(P, k) take(k, 0); }
    };
    auto fetch_next = [&](const wp::vec3* data) {  // into the caches, what the next packet takes from there
        if (!whole || picture) return;
        WRT_UNROLLED for (int b = 0; b < 12 * P; b += 64) WRT_FETCH((const char*)(data + first + P) + b);
    };
    fetch(rays.direction_stride, [&](int k, int n) {
        const float* d = (const float*)rays.directions.data + 3 * (size_t)n;
        to_x[k] = d[0]; to_y[k] = d[1]; to_z[k] = d[2];
    });
    if (rays.direction_stride) fetch_next(rays.directions.data);
    for (int k = here; k < P; ++k) to_x[k] = to_y[k] = to_z[k] = 0.0f;  // beyond the end of the batch: no direction misses
"""
"""C++ after `NUMBERS`: the directions of the P rays, and `fetch` for what else they have, each its own or all one."""


@wp.func
def ray_at(rays: RayBatch, place: int, packet: int):
    """Number of the ray at a place in the order for packets of `packet` rays."""
    if rays.columns == 0:
        return place
    across = wp.min(packet, TILE_COLUMNS)
    down = packet / across
    rows = rays.count / rays.columns
    band = place / (down * rays.columns)
    height = wp.min(down, rows - band * down)
    offset = place - band * down * rays.columns
    left = offset / (across * height) * across
    width = wp.min(across, rays.columns - left)
    offset -= left * height
    return (band * down + offset / width) * rays.columns + left + offset % width
