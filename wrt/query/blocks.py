"""Batches of any size: rays from large arrays, memory-mapped files, iterators or functions, answered block by block.

A block is a range of rows, along the first axis of the rays' leading shape. Only its rows are read, and the memory for a
block's rays, work space and answer is bounded. A ray's answer depends on no other ray, so block boundaries do not affect
results. Blocks are answered here one after the other, or by the workers of an executor, several at a time; the answers are the
same, to the bit. Ctrl-C takes effect after the current block, so that a whole number of blocks is written; a second Ctrl-C
takes effect at once.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from copy import copy
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from wrt.engine.rays.rays import Rays
from wrt.kernels.validation import as_bool
from wrt.query.batches.block_limits import finished_before_interrupt, parse_memory, progress_bar
from wrt.query.batches.block_outputs import TakeAttributes, check_out, for_workers, rows_together, store
from wrt.query.batches.block_rows import GeneratedRays, Source, as_column, rows_of, rows_shape
from wrt.query.batches.block_work import HIT_QUERIES, BlockQuery, BlockWork, Deliver, Examine, Submitter
from wrt.query.batches.outer_batches import kept_axes_first
from wrt.query.batches.reductions import as_array, as_block_reduction
from wrt.query.batches.task_window import run_tasks
from wrt.query.batches.workers import Workers, as_workers

BYTES_PER_RAY = 320
"""Largest memory per ray: 32 bytes on the device, 46 while rays are sorted, 16 for a hit and 93 for all attributes computed
from it, and these 109 once more, because the caller may still hold the previous block. The rays passed in do not count.
"""

MASK_BYTES = 8
"""Memory per ray for masks, if each ray has one: on the device, and as an array of its own. As much for environments, and for
triangles to skip."""

MAX_RAYS = 1 << 30
"""Largest number of rays of a block: kernels count them with 32 bits."""

MEMORY = "256 MB"


class Block(NamedTuple):
    """Some rows of a large batch, and the answer for them.

    Attributes:
        rows: the rows within the whole batch; always with a start and a stop.
        answer: the query's result for these rays: a `wrt.Hits`, or an array; with `reduce`, what is left of it.
    """

    rows: slice
    answer: Any


class Blocks:
    """The answer to a large batch, computed block by block during iteration, written to arrays, or reduced.

    All blocks of an iteration are answered by the scene as it was when the iteration began: an update meanwhile changes none.

        for rows, hits in scene.intersect_blocks(origins, directions):
            nearest[rows] = hits.t
        shaded = scene.occluded_blocks(points[:, None], suns, reduce="sum", axis=1).result()

    Attributes:
        shape: leading shape of the batch, reduced axes last where they were put there (`wrt.query.batches.outer_batches`);
            None if the rays come from an iterator.
        done: rows answered by the latest iteration or `write`; after a Ctrl-C, the row to resume at.
    """

    def __init__(
        self,
        work: BlockWork,
        source: Source,
        memory: int | str,
        progress: bool,
        workers: Workers | None,
    ) -> None:
        self.done = 0
        self.work, self.workers, self.progress = work, workers, progress
        self._source, self._bytes = source, parse_memory(memory)
        self.shape: tuple[int, ...] | None = None
        if isinstance(source, (Rays, GeneratedRays)):
            self.shape = rows_shape(source, "the rays")
            self.work = replace(work, rays=source, axes=len(self.shape))
            if work.query.reduction is not None:
                work.query.reduction.check(self.shape)

    def __repr__(self) -> str:
        return f"Blocks(shape={self.shape}, memory={self._bytes} bytes)"

    def __len__(self) -> int:
        """Number of blocks.

        Raises:
            TypeError: the rays come from an iterator.
        """
        if self.shape is None:
            raise TypeError("rays from an iterator have no known number of blocks before the iterator ends")
        return len(self.ranges(self.shape))

    def __iter__(self) -> Iterator[Block]:
        self._refuse_merged("iterate over axes without the first one, or call result()")
        return self._blocks(None)

    def write(self, out: Any) -> int:
        """Computes all blocks and writes each to its rows of `out`.

            t = np.lib.format.open_memmap("t.npy", "w+", np.float32, shape=(len(origins),))
            scene.intersect_blocks(origins, directions).write({"t": t})
            scene.occluded_blocks(origins, directions).write(dark)

        With an executor, workers write memory-mapped files and zarr arrays themselves, which they must see at the same path.
        The number of rows of a block is then a multiple of those of a zarr chunk.

        Args:
            out: for closest hits a dict from attributes of `wrt.Hits` ("t", "primitive_id", "geometry_id", "uv", "is_hit",
                "position", "normal") to arrays, else one array. An array is an np.ndarray, an np.memmap, or any object with
                a shape, a dtype and assignment to slices. It has the shape of the whole answer, or, for rays from an
                iterator, at least as many rows.

        Returns:
            The number of rows written.

        Raises:
            ValueError: an unknown attribute, an array whose shape or type does not hold the answer, a zarr array with chunks
                larger than a block, or a reduction along the first axis.
        """
        self._refuse_merged("call result()")
        if self.shape is not None:
            check_out(out, self.answer_rows(slice(0, 0)), self.shape[0], exact=True)
        for _ in self._blocks(out):
            pass
        return self.done

    def result(self) -> Any:
        """Computes all blocks; returns what `reduce` makes of them, or, of occlusion and counts, the whole array.

        Returns:
            An array, or, of closest hits, a dict of arrays as given to `reduce`.

        Raises:
            ValueError: closest hits without `reduce` (write their attributes to arrays); an iterator without rays.
        """
        query = self.work.query
        if query.reduction is None and query.gives_hits:
            raise ValueError("result() of closest hits needs reduce={'t': ...}; or write attributes to arrays with write()")
        parts: list[Any] = []
        for _, answer in self._blocks(None):
            parts = [query.reduction.merge(parts[0], answer)] if parts and self._merges() else [*parts, answer]
        if not parts:
            if self.shape is None:
                raise ValueError("the iterator gave no rays")
            parts = [self.answer_rows(slice(0, 0))]
        return query.reduction.finish(parts[0]) if self._merges() else joined(parts)

    def answer_rows(self, rows: slice) -> Any:
        """The answer for some rows, computed here: hits, an array, reduced rows, or states of reductions. Not for iterators."""
        return self.work.run(rows, {})

    def ranges(self, shape: tuple[int, ...], together: int = 1) -> range:
        """First row of each block of a batch; the step is the number of rows of a block, a multiple of `together`.

        Args:
            shape: leading shape of the batch.
            together: rows that no two blocks may share.

        Raises:
            ValueError: `together` rows are more than a block may have.
        """
        a_row = max(math.prod(shape[1:]), 1)
        each = BYTES_PER_RAY + MASK_BYTES * sum(np.ndim(values) > 0 for values in self.work.columns.values())
        rows = max(min(self._bytes // each, MAX_RAYS) // a_row, 1)
        if together > rows:
            raise ValueError(
                f"zarr chunks of {together:,} rows are larger than a block of {rows:,} rows; make chunks smaller, or raise "
                f"memory to {together * a_row * each:,} bytes"
            )
        return range(0, shape[0], rows - rows % together)

    def _blocks(self, out: Any) -> Iterator[Block]:
        self.done = 0
        with progress_bar(self.progress, None if self.shape is None else math.prod(self.shape)) as advance:
            for piece, answer in self._answered(out):
                with finished_before_interrupt():
                    if out is not None and answer is not None:
                        if self.shape is None:
                            check_out(out, answer, piece.rows.stop, exact=False)
                        store(out, piece.rows, answer)
                    self.done = piece.rows.stop
                advance(piece.count)
                yield Block(piece.rows, answer)
                del answer  # freed before the next block is computed

    def _answered(self, out: Any) -> Iterator[tuple[Piece, Any]]:
        """The pieces in order, with their answers; None if a worker has written them to `out`."""
        if out is None or self.workers is None:
            return self.run_pieces(self._pieces(1), None)
        if self.shape is None:
            return self.run_pieces(self._pieces(1), TakeAttributes.of(out))
        return self.run_pieces(self._pieces(rows_together(out)), for_workers(out))

    def run_pieces(
        self, pieces: Iterator[Piece], deliver: Deliver | None, ordered: bool = True, examine: Examine | None = None
    ) -> Iterator[tuple[Piece, Any]]:
        """Some blocks with their answers, or with what `deliver` returned of them. The scene is as it was at the first block.

        Args:
            pieces: the blocks.
            deliver: called with the rows and the answer of each block, by the worker that has computed it.
            ordered: whether answers come in the order of the pieces.
            examine: as in `BlockWork`.

        Raises:
            RuntimeError: the workers that took a block died each time.
        """
        work = replace(self.work, scene=copy(self.work.scene), deliver=deliver, examine=examine)
        if self.workers is not None:
            yield from run_tasks(pieces, Submitter(work, self.workers).submit, self.workers, ordered)
            return
        for piece in pieces:
            with finished_before_interrupt():
                answer = work.run(piece.rows, piece.sent)
            yield piece, answer
            del answer

    def _pieces(self, together: int) -> Iterator[Piece]:
        """The rows of each block, and their rays if these come from an iterator."""
        if self.shape is not None:
            ranges, each = self.ranges(self.shape, together), math.prod(self.shape[1:])
            for begin in ranges:
                rows = slice(begin, min(begin + ranges.step, self.shape[0]))
                yield Piece(rows, (rows.stop - begin) * each, {})
            return
        first = 0
        for rays in self._source:
            shape = rows_shape(rays, "an item of the iterator")
            self.work = replace(self.work, axes=len(shape))
            ranges = self.ranges(shape)
            for begin in ranges:
                end = min(begin + ranges.step, shape[0])
                part = rows_of(rays, len(shape), begin, end)
                yield Piece(slice(first + begin, first + end), len(part), {"rays": part})
            first += shape[0]

    def pieces(self) -> Iterator[Piece]:
        """The blocks that are to be answered, in order."""
        return self._pieces(1)

    def _merges(self) -> bool:
        """Whether blocks are merged along the first axis."""
        return self.work.query.merges_rows(self.work.axes)

    def _refuse_merged(self, remedy: str) -> None:
        if self.shape is not None and self._merges():
            raise ValueError(f"reduce along the first axis leaves no rows; {remedy}")


class Piece(NamedTuple):
    """A block that is to be answered.

    Attributes:
        rows: within the whole batch.
        count: number of rays.
        sent: {"rays": rays} if they come from an iterator.
    """

    rows: slice
    count: int  # type: ignore[assignment]
    sent: Mapping[str, Any]


def joined(parts: list[Any]) -> Any:
    """Answers of blocks, one after the other."""
    if isinstance(parts[0], Mapping):
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return np.concatenate([as_array(part) for part in parts])


class How(NamedTuple):
    """How a batch is answered; arguments of `wrt.Scene.intersect_blocks`."""

    memory: int | str
    progress: bool
    executor: Any
    reduce: Any
    axis: Any


def blocks_of(scene: Any, method: str, source: Source, how: How, columns: Mapping[str, Any], options: dict[str, Any]) -> Blocks:
    """The blocks of a batch, each answered by a method of a scene.

    Args:
        scene: a `wrt.Scene`.
        method: its name.
        source: the rays or points.
        how: they are answered.
        columns: options of which each ray may have its own value; None for none.
        options: others.

    Raises:
        TypeError, ValueError: as `wrt.Scene.intersect_blocks`.
    """
    own = {name: as_column(values, name, scene, source) for name, values in columns.items() if values is not None}
    progress = as_bool("progress", how.progress)
    if "precise" in options:
        options["precise"] = as_bool("precise", options["precise"])
    reduction = as_block_reduction(how.reduce, how.axis, method in HIT_QUERIES)
    source, columns, reduction = kept_axes_first(source, own, reduction)
    query = BlockQuery(method, options, reduction)
    return Blocks(BlockWork(scene, query, None, columns, 0), source, how.memory, progress, as_workers(how.executor))
