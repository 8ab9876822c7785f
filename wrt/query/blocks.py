"""Batches of any size: rays from large arrays, memory-mapped files or iterators, answered block by block.

A block is a range of rows, along the first axis of the rays' leading shape. Only its rows are read, and the memory for a
block's rays, work space and answer is bounded. A ray's answer depends on no other ray, so block boundaries do not affect
results. Ctrl-C takes effect after the current block, so that a whole number of blocks is written; a second Ctrl-C takes
effect at once.
"""

from __future__ import annotations

import math
import re
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
import warp as wp

from wrt.rays.rays import Rays, leading_shape

BYTES_PER_RAY = 320
"""Largest memory per ray: 32 bytes on the device, 46 while rays are sorted, 16 for a hit and 93 for all attributes computed
from it, and these 109 once more, because the caller may still hold the previous block. The rays passed in do not count.
"""

MASK_BYTES = 8
"""Memory per ray for masks, if each ray has one: on the device, and as an array of its own."""

MAX_RAYS = 1 << 30
"""Largest number of rays of a block: kernels count them with 32 bits."""

UNITS = {"": 1, "B": 1, "KB": 10**3, "MB": 10**6, "GB": 10**9, "KIB": 1 << 10, "MIB": 1 << 20, "GIB": 1 << 30}
"""Units of memory, in bytes."""

MEMORY = "256 MB"

ATTRIBUTES = ("t", "primitive_id", "geometry_id", "uv", "is_hit", "position", "normal")
"""Attributes of hits that can be written to arrays."""


class Block(NamedTuple):
    """Some rows of a large batch, and the answer for them.

    Attributes:
        rows: the rows within the whole batch; always with a start and a stop.
        answer: the query's result for these rays: a `wrt.Hits`, or an array.
    """

    rows: slice
    answer: Any


class Blocks:
    """The answer to a large batch, computed block by block during iteration, or written to arrays.

        for rows, hits in scene.intersect_blocks(origins, directions):
            nearest[rows] = hits.t

    Attributes:
        shape: leading shape of the batch; None if the rays come from an iterator.
        done: rows answered by the latest iteration or `write`; after a Ctrl-C, the row to resume at.
    """

    def __init__(
        self,
        query: Callable[..., Any],
        source: Rays | Iterable[Any],
        memory: int | str,
        progress: bool,
        **each: Any,
    ) -> None:
        self.done = 0
        self._query, self._source, self._progress = query, source, progress
        given = {name: values for name, values in each.items() if values is not None}
        self._each = {name: values if np.isscalar(values) else _sliceable(values) for name, values in given.items()}
        self._cut = [name for name, values in given.items() if np.ndim(values) > 0]
        if self._cut and not isinstance(source, Rays):
            raise ValueError(
                f"{self._cut[0]} must be one number if the rays come from an iterator; pass rays and masks as arrays instead"
            )
        self._bytes = parse_memory(memory)
        self.shape: tuple[int, ...] | None = None
        if isinstance(source, Rays):
            self.shape = _rows_shape(source, "the rays")

    def __repr__(self) -> str:
        return f"Blocks(shape={self.shape}, memory={self._bytes} bytes)"

    def __len__(self) -> int:
        """Number of blocks.

        Raises:
            TypeError: the rays come from an iterator.
        """
        if self.shape is None:
            raise TypeError("rays from an iterator have no known number of blocks before the iterator ends")
        return len(self._ranges(self.shape))

    def __iter__(self) -> Iterator[Block]:
        return self._blocks(None)

    def write(self, out: Any) -> int:
        """Computes all blocks and writes each to its rows of `out`.

            t = np.lib.format.open_memmap("t.npy", "w+", np.float32, shape=(len(origins),))
            scene.intersect_blocks(origins, directions).write({"t": t})
            scene.occluded_blocks(origins, directions).write(dark)

        Args:
            out: for closest hits a dict from attributes of `wrt.Hits` ("t", "primitive_id", "geometry_id", "uv", "is_hit",
                "position", "normal") to arrays, else one array. An array is an np.ndarray, an np.memmap, or any object with
                a shape, a dtype and assignment to slices. It has the shape of the whole answer, or, for rays from an
                iterator, at least as many rows.

        Returns:
            The number of rows written.

        Raises:
            ValueError: an unknown attribute, or an array whose shape or type does not hold the answer.
        """
        if isinstance(self._source, Rays):
            none = rows_of(self._source, len(self.shape), 0, 0)
            check_out(out, self._answer(none, 0, 0), self.shape[0], exact=True)
        for _ in self._blocks(out):
            pass
        return self.done

    def _blocks(self, out: Any) -> Iterator[Block]:
        self.done = 0
        with progress_bar(self._progress, None if self.shape is None else math.prod(self.shape)) as advance:
            for rows, rays in self._pieces():
                with finished_before_interrupt():
                    answer = self._answer(rays, rows.start, rows.stop)
                    if out is not None:
                        if self.shape is None:
                            check_out(out, answer, rows.stop, exact=False)
                        store(out, rows, answer)
                    self.done = rows.stop
                advance(len(rays))
                yield Block(rows, answer)
                del answer  # freed before the next block is computed

    def _answer(self, rays: Rays, begin: int, end: int) -> Any:
        """The answer for some rows, with their masks and environments."""
        each = dict(self._each)
        for name in self._cut:
            each[name] = cut_rows(each[name], np.shape(each[name]), len(self.shape), begin, end)
        return self._query(rays, **each)

    def _pieces(self) -> Iterator[tuple[slice, Rays]]:
        """The rays of each block, and their rows in the batch."""
        first = 0
        for rays in [self._source] if isinstance(self._source, Rays) else self._source:
            shape = _rows_shape(rays, "an item of the iterator")
            ranges = self._ranges(shape)
            for begin in ranges:
                end = min(begin + ranges.step, shape[0])
                yield slice(first + begin, first + end), rows_of(rays, len(shape), begin, end)
            first += shape[0]

    def _ranges(self, shape: tuple[int, ...]) -> range:
        """First row of each block of a batch; the step is the number of rows of a block."""
        a_row = max(math.prod(shape[1:]), 1)
        each = BYTES_PER_RAY + (MASK_BYTES * len(self._cut))
        rows = min(self._bytes // each, MAX_RAYS) // a_row
        return range(0, shape[0], max(rows, 1))


def blocks_of(
    query: Callable[..., Any],
    source: Rays | Iterator[Rays],
    memory: int | str = MEMORY,
    progress: bool = False,
    mask: Any = None,
    environment: Any = None,
    **options: Any,
) -> Blocks:
    """The blocks of a batch, each answered by a method of a scene with these options and with its rows of masks."""
    return Blocks(partial(query, **options), source, memory, progress, mask=mask, environment=environment)


def as_source(origins: Any, directions: Any, t_min: Any, t_max: Any) -> Rays | Iterator[Rays]:
    """Rays whose arrays can be sliced, or an iterator over such rays."""
    if isinstance(origins, Rays):
        if directions is not None:
            raise TypeError("pass either a wrt.Rays, or origins and directions, not both")
        return Rays(*(_sliceable(a) for a in (origins.origins, origins.directions, origins.t_min, origins.t_max)))
    if directions is not None:
        return Rays(*(_sliceable(a) for a in (origins, directions, t_min, t_max)))
    if hasattr(origins, "shape") or not isinstance(origins, Iterable):
        raise TypeError("directions is missing; pass origins and directions, a wrt.Rays, or an iterator of pairs of them")
    if np.ndim(t_min) or np.ndim(t_max):
        raise ValueError("t_min and t_max must be numbers if the rays come from an iterator; let it give wrt.Rays instead")
    return _items(origins, t_min, t_max)


def _items(source: Iterable[Any], t_min: float, t_max: float) -> Iterator[Rays]:
    for number, item in enumerate(source):
        if isinstance(item, Rays):
            yield as_source(item, None, 0.0, 0.0)
        elif isinstance(item, (tuple, list)) and len(item) == 2:
            yield as_source(*item, t_min, t_max)
        else:
            raise TypeError(f"item {number} of the iterator must be (origins, directions) or a wrt.Rays, not {item!r:.60}")


def rows_of(rays: Rays, axes: int, begin: int, end: int) -> Rays:
    """Rows begin .. end - 1 of rays with `axes` leading axes; arrays shared by all rows stay whole."""
    vectors = (cut_rows(a, leading_shape(a), axes, begin, end) for a in (rays.origins, rays.directions))
    return Rays(*vectors, *(cut_rows(a, np.shape(a), axes, begin, end) for a in (rays.t_min, rays.t_max)))


def cut_rows(values: Any, shape: tuple[int, ...], axes: int, begin: int, end: int) -> Any:
    """Rows begin .. end - 1 of an array with this leading shape; the whole array if all rows share it."""
    return values[begin:end] if len(shape) == axes and shape[0] != 1 else values


def store(out: Any, rows: slice, answer: Any) -> None:
    """Writes the answer of a block to its rows of the output arrays."""
    for _, array, values in _outputs(out, answer):
        array[rows] = values.numpy() if isinstance(values, wp.array) else values


def check_out(out: Any, answer: Any, length: int, exact: bool) -> None:
    """Refuses arrays that cannot hold `length` rows of answers such as `answer`.

    Raises:
        ValueError: as `Blocks.write`.
    """
    for name, array, values in _outputs(out, answer):
        values = values.numpy() if isinstance(values, wp.array) else values
        wanted, shape = (length, *values.shape[1:]), tuple(np.shape(array))
        if shape[1:] != wanted[1:] or shape[:1] < wanted[:1] or (exact and shape != wanted):
            raise ValueError(f"{name} has shape {shape}; it must {'be' if exact else 'hold at least'} {wanted}")
        casting = "same_kind" if values.dtype.kind == "f" else "safe"
        if not np.can_cast(values.dtype, array.dtype, casting):
            raise ValueError(f"{name} holds {array.dtype}, which does not hold the answer; make it {values.dtype}")


def _outputs(out: Any, answer: Any) -> list[tuple[str, Any, Any]]:
    """(name, output array, values) for each array to write."""
    if isinstance(answer, (np.ndarray, wp.array)):
        return [("out", out, answer)]
    if not isinstance(out, Mapping):
        kind = type(out).__name__
        raise ValueError(f"out must be a dict from attributes of wrt.Hits to arrays, such as {{'t': array}}, not {kind}")
    for name in out:
        if name not in ATTRIBUTES:
            raise ValueError(f"out has the key {name!r}; choose from {', '.join(ATTRIBUTES)}")
    return [(f"out[{name!r}]", array, getattr(answer, name)) for name, array in out.items()]


def parse_memory(memory: int | str) -> int:
    """An amount of memory in bytes, from a number or a text such as "256 MB" or "1.5 GiB".

    Raises:
        TypeError: neither an int nor a str.
        ValueError: not positive, or not an amount of memory.
    """
    if isinstance(memory, bool) or not isinstance(memory, (int, str)):
        raise TypeError(f"memory must be an int, in bytes, or a text such as '256 MB', not {type(memory).__name__}")
    match = re.fullmatch(r"\s*(\d+(?:\.\d*)?)\s*([KMG]?I?B|)\s*", str(memory).upper())
    if match is None or match[2] not in UNITS or not float(match[1]) > 0:
        raise ValueError(f"memory is {memory!r}; give a number of bytes from 1 up, or a text such as '256 MB' or '1.5 GiB'")
    return max(1, int(float(match[1]) * UNITS[match[2]]))


@contextmanager
def finished_before_interrupt() -> Iterator[None]:
    """Delays a Ctrl-C to the end of the `with` block; a second one is not delayed. Has an effect only in the main thread."""
    python_s = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if not python_s or threading.current_thread() is not threading.main_thread():
        yield
        return
    interrupted = False

    def note(number: int, frame: Any) -> None:
        nonlocal interrupted
        if interrupted:
            raise KeyboardInterrupt
        interrupted = True

    signal.signal(signal.SIGINT, note)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if interrupted:
        raise KeyboardInterrupt


@contextmanager
def progress_bar(shown: bool, total: int | None) -> Iterator[Callable[[int], None]]:
    """A progress bar on stderr, if `shown`. The yielded function takes the number of rays that a block adds."""
    if not shown:
        yield lambda rays: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (BarColumn(), TextColumn("{task.completed:,} rays"), TimeRemainingColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task, start, done = bar.add_task("", total=total), perf_counter(), 0

        def advance(rays: int) -> None:
            nonlocal done
            done += rays
            bar.update(task, completed=done, description=f"{done / (perf_counter() - start) / 1e6:.1f} Mrays/s")

        yield advance


def _sliceable(values: Any) -> Any:
    return values if hasattr(values, "shape") or np.isscalar(values) else np.asarray(values)


def _rows_shape(rays: Rays, what: str) -> tuple[int, ...]:
    shape = rays.shape
    if not shape:
        raise ValueError(f"{what} must have a leading axis to cut into blocks: pass origins or directions of shape (N, 3)")
    return shape
