"""Assignment of rays to packets: consecutive rays, or the pixels of a tile of a picture.

Packets of 8 columns and P / 8 rows visit far fewer nodes than runs of P pixels, because the pixels of a tile see the same part
of the scene (notebooks/records/2026-11-21-packets.md). Tiles are ordered from left to right, then down. The rays of a packet
are those at the places first .. first + P - 1 of this order.

**Any width.** Whole tiles are packets in every band of P / 8 rows, whether or not the number of columns is a multiple of 8: a
band whose first place is within a packet begins with rays of the columns to the right of its whole tiles, from the top down,
and ends with the rest of them. Such packets have rays of the right border of two bands. Of a last band with fewer rows, tiles
are smaller and packets have rays of several; so if P is above 8 and not a multiple of 8.
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
    begin = place / (down * rays.columns) * (down * rays.columns)
    height = wp.min(down, rays.count / rays.columns - begin / rays.columns)
    before = int(0)
    if packet % across == 0 and height == down:
        before = (packet - begin % packet) % packet
    area = across * height
    tiles = wp.max(height * rays.columns - before, 0) / area
    offset = place - begin
    own = offset - before
    if own >= 0 and own < tiles * area:
        within = own % area
        return begin + within / across * rays.columns + own / area * across + within % across
    if own >= 0:
        offset -= tiles * area
    return begin + offset % height * rays.columns + tiles * across + offset / height
