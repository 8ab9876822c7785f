"""Several kernels for one tile of items after the other: what one of them writes is in the cache when the next reads it.

**Problem.** Launches over arrays that are larger than the caches read all they need from memory and write it back, each anew.
Between two launches every thread waits for the last one, and for Python.

**Idea.** Where the items of a tile depend on no other tile, one thread does everything for a tile: the first kernel, the second
one, and so on. Then it takes the next tile. A chain is a list of kernels with packed arguments (`PackedKernel`), and the kernel
that carries it out has a tile as its item: `launch` divides tiles among threads like any other items.

**Numbers of items.** A tile's items may become fewer. The number that are left is in memory, and a kernel of the chain may
lower it. A stage learns it from one of its arguments, an int that holds the end of the tile's items (`Stage.end`).

**Alternatives.** Two kernels may give the same answers, and which is faster may depend on the items: on how many are left, and
on what they are. A stage may have both. The first tiles are shared among them; then a tile takes the alternative that has
needed less time for an item so far, and now and then the other one, since items change from tile to tile.

CPU only, on systems with native helpers (`wrt.kernels.runtime.pool.is_available`).
"""

import ctypes
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.argument_packing import PackedKernel
from wrt.kernels.runtime.job_queue import BOUNDS, MAX_ARGUMENT_BYTES, on_cpu
from wrt.kernels.runtime.launch import Chunks, PreparedLaunch, load
from wrt.kernels.runtime.options import exact_kernel

ALTERNATIVE_NUMBERS = 9
"""Numbers of 64 bits of an alternative: entry point (0: there is none), launch bounds, arguments, their bytes, where the end is
in them, grain, the nanoseconds that all threads together have spent on it, the items of the tiles that it has done, and the
address of the stage's own numbers of items, or 0."""

MAX_ALTERNATIVES = 2
"""Alternatives of a stage; native code has room for two."""

MAX_STAGES = 64
"""Stages for whose numbers there is room at first."""

TRIED_ITEMS, TRIED_TILE = 8192, 32
"""Items that each alternative has to do before one is preferred; and later on, of this many tiles one takes the other one."""

CLOCK = getattr(time, "CLOCK_THREAD_CPUTIME_ID", 3)
"""The clock that times stages: a thread's own, which stands still while other programs have the CPU."""

MAX_TILES = 8
"""Greatest number of tiles of a chunk: some hundredths of a second, after which a Ctrl-C takes effect."""

SPENT, ITEMS = 6, 7
"""Which numbers count nanoseconds and items."""


@dataclass(frozen=True)
class Stage:
    """A kernel of a chain.

    Attributes:
        kernel: its first parameter is `first: int`, as in `wrt.kernels.runtime.launch`.
        inputs: the other arguments.
        grain: items of a tile that an item of the kernel does; divides the items of a tile, or is all of them.
        end: which argument is the number of the item at which the tile ends, the first item counted; with the name of a field
            if the argument is a struct. None for kernels that do all items of a tile, or do not depend on their number.
        counts: (tiles,) int32, items of each tile for this stage alone, which is left out where there are none; None for those
            that are left.
    """

    kernel: wp.Kernel
    inputs: Sequence[Any]
    grain: int
    end: tuple[int, str] | None = None
    counts: wp.array | None = None


LAYOUT = f"""
    static_assert(sizeof(wrt::Alternative) == 8 * {ALTERNATIVE_NUMBERS});
    static_assert(wrt::MAX_ARGUMENT_BYTES == {MAX_ARGUMENT_BYTES});
    static_assert(__builtin_offsetof(wrt::Alternative, spent) == 8 * {SPENT});
    static_assert(__builtin_offsetof(wrt::Alternative, items) == 8 * {ITEMS});
"""

TEMPLATE = f"{BOUNDS}, {CLOCK}, {TRIED_ITEMS}, {TRIED_TILE}"


@native.func_native(
    "calls.h",
    on_cpu(f"{LAYOUT}wrt::run_stages<{TEMPLATE}>((wrt::Alternative*)stages.data, begin, end, counts.data, size, tile);"),
)
def run_stages(
    stages: wp.array(dtype=wp.int64), begin: int, end: int, counts: wp.array(dtype=int), size: int, tile: int
) -> int:
    """Runs the stages begin .. end - 1 for a tile, as long as items are left."""


@exact_kernel
def run_chain(
    first: int, start: int, stages: wp.array(dtype=wp.int64), begin: int, end: int, counts: wp.array(dtype=int), size: int
):
    """Runs stages of a chain for the items of a tile. Item: a tile from `start` on."""
    run_stages(stages, begin, end, counts, size, start + first + wp.tid())


class LaunchChain:
    """Kernels that are run one after the other for each tile of items.

    Args:
        size: items of a tile.
        counts: (tiles,) int32, items that are left of each tile.
        device: the CPU.
    """

    def __init__(self, size: int, counts: wp.array, device: wp.Device) -> None:
        self.size, self.counts, self.device = size, counts, device
        self._packed: list[list[PackedKernel]] = []
        self._launch: PreparedLaunch | None = None
        self._stages = wp.zeros(MAX_STAGES * MAX_ALTERNATIVES * ALTERNATIVE_NUMBERS, dtype=wp.int64, device=device)

    def __len__(self) -> int:
        return len(self._packed)

    def add(self, *alternatives: Stage) -> list[PackedKernel]:
        """Adds a stage to the end; the arguments of the results, one for each alternative, may be changed between two runs.

        Args:
            alternatives: one stage, or two that give the same answers, the likely faster one first.

        Raises:
            ValueError: a grain does not divide the tile, or the arguments are too large.
        """
        if not 0 < len(alternatives) <= MAX_ALTERNATIVES:
            raise ValueError(f"a stage has 1 to {MAX_ALTERNATIVES} alternatives, not {len(alternatives)}")
        packed, rows = zip(*map(self._pack, alternatives), strict=True)
        number, numbers = len(self), self._numbers
        if number == len(numbers):
            more = np.concatenate([numbers, np.zeros_like(numbers)])
            self._stages = wp.array(more.ravel(), dtype=wp.int64, device=self.device)
            numbers = self._numbers
        numbers[number, : len(rows)] = rows
        self._packed.append([*packed])
        return [*packed]

    def _pack(self, stage: Stage) -> tuple[PackedKernel, tuple[int, ...]]:
        """An alternative, ready to be run, and its numbers."""
        if self.size % stage.grain:
            raise ValueError(f"a grain of {stage.grain} items does not divide tiles of {self.size}")
        load([stage.kernel], self.device)
        packed = PackedKernel(stage.kernel, [0, *stage.inputs], self.device)
        bytes_of, at = ctypes.sizeof(packed.arguments), 0
        if bytes_of > MAX_ARGUMENT_BYTES:
            raise ValueError(f"the arguments of a stage take {bytes_of} bytes, more than {MAX_ARGUMENT_BYTES}")
        if stage.end is not None:
            index, name = stage.end
            at = getattr(type(packed.arguments), f"p{index}").offset
            at += getattr(type(packed.argument(index)), name).offset if name else 0
        bounds, arguments = (ctypes.addressof(part) for part in (packed.bounds, packed.arguments))
        own = 0 if stage.counts is None else stage.counts.ptr
        return packed, (packed.entry, bounds, arguments, bytes_of, at, stage.grain, 0, 0, own)

    @property
    def _numbers(self) -> np.ndarray:
        """(stages for which there is room, alternatives, numbers of each) int64."""
        return self._stages.numpy().reshape(-1, MAX_ALTERNATIVES, ALTERNATIVE_NUMBERS)

    @property
    def stages(self) -> wp.array:
        """The stages for `run_stages`; valid as long as the chain is alive and none is added."""
        return self._stages

    @property
    def seconds(self) -> np.ndarray:
        """(stages,) float64, seconds of CPU time that all threads together have spent in each stage."""
        return self._numbers[: len(self), :, SPENT].sum(axis=1) * 1e-9

    @property
    def items(self) -> np.ndarray:
        """(stages, alternatives) int64, the items of the tiles that each alternative of each stage has done."""
        return self._numbers[: len(self), :, ITEMS].copy()

    def run(self, start: int, stop: int, begin: int = 0) -> None:
        """Runs the stages from number `begin` on for the tiles start .. stop - 1."""
        inputs = [start, self._stages, begin, len(self), self.counts, self.size]
        if self._launch is None:
            self._launch = PreparedLaunch(run_chain, inputs, self.device)
        self._launch.update(inputs)
        self._launch.run(stop - start, Chunks(chunk=1, longest=MAX_TILES), self)
