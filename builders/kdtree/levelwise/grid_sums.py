"""What all threads of a launch find together: sums in the order of the threads, in one pass, and least values.

A block of threads sums up what its threads have, and tells it to the blocks behind it. Each looks back over what the blocks
before it have told, until it comes to one that knows the sum up to its own end (decoupled look-back). So a scan is not a launch
of its own: a kernel counts, learns what is before it, and writes, in one pass over its data.

On the CPU, where such a launch is one chunk, one thread comes after the other, and a running sum does.

References: merrill-garland-2016.
"""

from collections.abc import Sequence
from itertools import count
from typing import Any

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import CUDA_BLOCK

SUMS = wp.constant(4)
"""Sums side by side."""

TILE_WORDS = 16
"""Of a block of threads (grid_sums.h)."""


@wp.struct
class Tiles:
    """What blocks of threads tell each other of their sums."""

    word: wp.array(dtype=int)
    """`TILE_WORDS` for each block, 0 at first."""
    turn: int
    """Above 0, and rises from launch to launch."""


@native.func_native("grid_sums.h", "wrt::keep_least((long long*)keys.data, node, key);")
def keep_least(keys: wp.array(dtype=wp.int64), node: int, key: wp.int64):
    """keys[node] becomes the least of it and the key; -1 for none. On CUDA all threads of a warp come here."""


@native.func_native("grid_sums.h", "wrt::keep_less((long long*)keys.data + node, key);")
def keep_less(keys: wp.array(dtype=wp.int64), node: int, key: wp.int64):
    """keys[node] becomes the least of it and the key, by this thread alone."""


@native.func_native(
    "grid_sums.h",
    "const wrt::Sums own_sums = {{own.c[0], own.c[1], own.c[2], own.c[3]}};\n"
    "const wrt::Sums before = wrt::sums_before((wrt::Tile*)tiles.word.data, tiles.turn, own_sums);\n"
    "return {before.of[0], before.of[1], before.of[2], before.of[3]};",
)
def sums_before(tiles: Tiles, own: wp.vec4i) -> wp.vec4i:
    """The sums of what all threads before this one own. On CUDA all threads of all blocks come here."""


@native.func_native("grid_sums.h", "return wrt::add_to((long long*)words.data + i, value);")
def add_to(words: wp.array(dtype=wp.int64), i: int, value: wp.int64) -> wp.int64:
    """words[i] += value; what it was."""


class Grid:
    """Launches of whole blocks of threads that work together.

    Args:
        device: where.
    """

    def __init__(self, device: wp.Device) -> None:
        self.device = device
        self._tiles = Tiles()
        self._turns = count(1)
        self._blocks = 0

    def tiles(self, threads: int) -> Tiles:
        """For the next launch, of so many threads."""
        blocks = blocks_of(threads)
        if blocks > self._blocks:
            self._tiles.word = wp.zeros(TILE_WORDS * 2 * blocks, dtype=int, device=self.device)
            self._blocks = 2 * blocks
        self._tiles.turn = next(self._turns)
        return self._tiles

    def run(self, kernel: wp.Kernel, threads: int, inputs: Sequence[Any]) -> None:
        """Launches at least so many threads: on CUDA all of the last block; on the CPU one chunk."""
        threads = CUDA_BLOCK * blocks_of(threads) if self.device.is_cuda else threads
        launch(kernel, threads, inputs, device=self.device, chunk=threads, longest=threads)


def blocks_of(threads: int) -> int:
    """Blocks of so many threads."""
    return -(-threads // CUDA_BLOCK)
