"""Images of textures by tiles: those that rays need are in device memory, under a budget.

Before a generation is shaded, its hits say which tiles they need. If these fit, the missing ones are loaded in place of those
that were used least recently. If not, the generation is halved until its parts do, and they are shaded one after the other.
Tiles come from `Texture.pixels`, which may be a file that is mapped into memory.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import warp as wp

from wrt.kernels.layout.ray_batch import HitBatch
from wrt.kernels.runtime.launch import launch
from wrt.kernels.shading.bsdf.material_table import TILE, Materials
from wrt.kernels.shading.wavefront.scene_light import LitScene
from wrt.kernels.shading.wavefront.texture_demand import mark_tiles
from wrt.materials.material import Texture

__all__ = ["MIN_BUDGET", "TextureTiles", "packed_texels"]

TEXELS = TILE * TILE
"""Texels of a tile."""

MIN_BUDGET = 8 * 4 * TEXELS
"""Bytes of the most tiles that one hit can need: four of each of two images."""

MAX_PLACES = (1 << 31) // TEXELS - 1
"""Texels are numbered by 32 bits."""


def packed_texels(pixels: np.ndarray) -> np.ndarray:
    """(..., 3) uint8 as (...) uint32, red in the lowest byte."""
    words = pixels.astype(np.uint32)
    return words[..., 0] | words[..., 1] << np.uint32(8) | words[..., 2] << np.uint32(16)


class TextureTiles:
    """The tiles of a table's images, of which some are in memory.

    Args:
        table: gets the arrays of tiles; its `texture_size` is set.
        textures: the images, in the order of their numbers.
        budget: bytes for texels, at least `MIN_BUDGET`.
        device: of the table.

    Attributes:
        loads: number of tiles loaded so far.
    """

    def __init__(self, table: Materials, textures: list[Texture], budget: int, device: wp.Device) -> None:
        self._textures, self._device, self.loads = textures, device, 0
        self._across = np.array([-(-one.pixels.shape[1] // TILE) for one in textures])
        down = np.array([-(-one.pixels.shape[0] // TILE) for one in textures])
        self._begins = np.cumsum([0, *(self._across * down)])
        count = int(self._begins[-1])
        places = min(budget // (4 * TEXELS), count, MAX_PLACES)
        self._place, self._used = np.full(count, -1, dtype=np.int32), np.zeros(count, dtype=np.int64)
        self._free, self._clock = list(range(places)), 0
        self._places = places
        self._needed = wp.zeros(count, dtype=int, device=device)
        table.tiled = True
        table.texture_first = wp.array(self._begins[:-1].astype(np.int32), dtype=int, device=device)
        table.tile_place = wp.array(self._place, dtype=int, device=device)
        table.texels = wp.zeros(places * TEXELS, dtype=wp.uint32, device=device)
        self._table_place, self._texels = table.tile_place, table.texels

    def ranges(self, scene: LitScene, hits: HitBatch, count: int) -> Iterator[tuple[int, int]]:
        """Cuts rays 0 .. count - 1 into ranges (start, stop), in order. When one is given, its tiles are in memory.

        Args:
            scene: with the table.
            hits: of the rays.
            count: number of rays.
        """
        waiting = [(0, count)]
        while waiting:
            start, stop = waiting.pop()
            needed = self._tiles_of(scene, hits, start, stop)
            if len(needed) > self._places:
                middle = (start + stop) // 2
                waiting += [(middle, stop), (start, middle)]
                continue
            self._load(needed)
            yield start, stop

    def _tiles_of(self, scene: LitScene, hits: HitBatch, start: int, stop: int) -> np.ndarray:
        """The tiles that rays need, in order."""
        self._needed.zero_()
        launch(mark_tiles, stop - start, [start, scene, hits, self._needed], device=self._device, chunk=4096)
        return np.flatnonzero(self._needed.numpy())

    def _load(self, needed: np.ndarray) -> None:
        """Brings tiles into memory."""
        self._clock += 1
        self._used[needed] = self._clock
        missing = needed[self._place[needed] < 0]
        if len(missing) == 0:
            return
        spare = len(missing) - len(self._free)
        if spare > 0:
            loaded = np.flatnonzero(self._place >= 0)
            ended = loaded[np.argsort(self._used[loaded], kind="stable")[:spare]]
            self._free += self._place[ended].tolist()
            self._place[ended] = -1
        for tile in missing:
            place = self._free.pop()
            self._place[tile] = place
            words = wp.array(self._tile(int(tile)).reshape(-1), dtype=wp.uint32, device=self._device)
            wp.copy(self._texels, words, dest_offset=place * TEXELS, count=TEXELS)
        self._table_place.assign(self._place)
        self.loads += len(missing)

    def _tile(self, tile: int) -> np.ndarray:
        """(TILE, TILE) uint32: a tile; texels beyond the image are 0."""
        number = int(np.searchsorted(self._begins, tile, side="right")) - 1
        row, column = divmod(tile - int(self._begins[number]), int(self._across[number]))
        top, left = row * TILE, column * TILE
        found = packed_texels(self._textures[number].pixels[top : top + TILE, left : left + TILE])
        return np.pad(found, ((0, TILE - found.shape[0]), (0, TILE - found.shape[1])))
