"""Assignment of rays to packets: consecutive rays, or the pixels of a tile of a picture.

Packets of 8 columns and P / 8 rows visit far fewer nodes than runs of P pixels, because the pixels of a tile see the same part
of the scene (notebooks/records/2026-11-21-packets.md). Tiles are ordered from left to right, then down. Tiles at the border of
the picture are smaller, and a packet may then contain rays of two tiles; this also happens if P is above 8 and not a multiple
of 8. The rays of a packet are those at the places first .. first + P - 1 of this order.
"""

import warp as wp

from wrt.kernels.layout.ray_batch import RayBatch

TILE_COLUMNS = wp.constant(8)
"""Columns of a tile, in pixels; a compact tile of 32 rays has 8 x 4 (notebooks/records/2026-11-21-packets.md)."""


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
