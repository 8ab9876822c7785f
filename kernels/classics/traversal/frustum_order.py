"""Assignment of frusta to blocks: the frusta of a block of a picture lie side by side, those of other rays follow one another.

A frustum is a packet of P rays (`wrt.kernels.traversal.packet.rays.ray_numbers`): in a picture, a tile of ACROSS x DOWN pixels.
16 of them make a block that is as square as they allow: 16 x 16 pixels for tiles of 8 x 2.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.ray_batch import RayBatch
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.traversal.packet.rays.ray_numbers import TILE_COLUMNS

exact_module(__name__)


@cache
def frustum_at(packet: int) -> wp.Function:
    """`wp.func(rays, place) -> int`: number of the frustum at a place in the order of blocks; packet: rays of a frustum.

    The frusta of a picture are numbered row by row of tiles. Blocks take several rows of them, column by column. Pictures whose
    columns are no multiple of a tile's, and the tiles of a last row that is not complete, are taken as they are numbered.
    """
    across = min(packet, int(TILE_COLUMNS))
    down = packet // across
    rows = 4 if down >= 4 else 8

    @wp.func
    def find(rays: RayBatch, place: int):
        columns = rays.columns / wp.static(across)
        if columns * wp.static(across) != rays.columns or wp.static(packet % across != 0):
            return place
        if rays.columns == 0:
            return place
        bands = rays.count / rays.columns / wp.static(down)
        if place >= bands * columns:
            return place
        above = place / (wp.static(rows) * columns) * wp.static(rows)
        height = wp.min(wp.static(rows), bands - above)
        within = place - above * columns
        return (above + within % height) * columns + within / height

    return find
