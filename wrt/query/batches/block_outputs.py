"""Arrays that the answers of blocks are written to, and what a worker does with an answer."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from wrt.query.batches.array_files import opened, opened_by_workers

ATTRIBUTES = ("t", "primitive_id", "geometry_id", "uv", "is_hit", "position", "normal")
"""Attributes of hits that can be written to arrays."""


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
        if not np.can_cast(values.dtype, array.dtype, casting):  # type: ignore[arg-type]
            raise ValueError(f"{name} holds {array.dtype}, which does not hold the answer; make it {values.dtype}")
        if values is getattr(answer, "position", None) and array.dtype.itemsize < 8 and answer.is_far:
            raise ValueError(f"{name} holds {array.dtype}, which would move positions so far from 0; make it float64")


def _outputs(out: Any, answer: Any) -> list[tuple[str, Any, Any]]:
    """(name, output array, values) for each array to write."""
    if isinstance(answer, (np.ndarray, wp.array)):
        return [("out", out, answer)]
    if not isinstance(out, Mapping):
        kind = type(out).__name__
        raise ValueError(f"out must be a dict from attributes of wrt.Hits to arrays, such as {{'t': array}}, not {kind}")
    known = answer if isinstance(answer, Mapping) else ATTRIBUTES
    for name in out:
        if name not in known:
            raise ValueError(f"out has the key {name!r}; choose from {', '.join(known)}")
    return [(f"out[{name!r}]", array, value_of(answer, name)) for name, array in out.items()]


def value_of(answer: Any, name: str) -> Any:
    """An attribute of hits, or an entry of a dict of them."""
    return answer[name] if isinstance(answer, Mapping) else getattr(answer, name)


@dataclass(frozen=True)
class TakeAttributes:
    """Takes some attributes of hits, so that a worker sends no others.

    Attributes:
        names: of the attributes; None for answers that are arrays.
    """

    names: tuple[str, ...] | None

    @staticmethod
    def of(out: Any) -> TakeAttributes:
        """Takes what is written to `out`."""
        return TakeAttributes(tuple(out) if isinstance(out, Mapping) else None)

    def __call__(self, rows: slice, answer: Any) -> Any:
        if self.names is None:
            return answer
        return {name: value_of(answer, name) for name in self.names}


@dataclass(frozen=True)
class StoreRows:
    """Writes an answer to arrays that workers open themselves, and returns nothing to the client.

    Attributes:
        out: as `Blocks.write`, with what workers open in place of arrays.
    """

    out: Any

    def __call__(self, rows: slice, answer: Any) -> None:
        arrays = {name: opened(one) for name, one in self.out.items()} if isinstance(self.out, Mapping) else opened(self.out)
        store(arrays, rows, answer)


def for_workers(out: Any) -> StoreRows | TakeAttributes:
    """What workers do with answers that are to be written to `out`: write them if they can open all arrays, else send them."""
    if not isinstance(out, Mapping):
        shared = opened_by_workers(out, is_written=True)
        return TakeAttributes.of(out) if shared is None else StoreRows(shared)
    arrays = {name: opened_by_workers(one, is_written=True) for name, one in out.items()}
    return TakeAttributes.of(out) if any(one is None for one in arrays.values()) else StoreRows(arrays)


def rows_together(out: Any) -> int:
    """Least number of rows of which blocks must be multiples, so that no two write the same chunk of a zarr array."""
    arrays = [*out.values()] if isinstance(out, Mapping) else [out]
    return math.lcm(*(chunk_rows(one) for one in arrays))


def chunk_rows(array: Any) -> int:
    """Rows that are stored together: of zarr arrays those of a shard or a chunk."""
    if not type(array).__module__.startswith("zarr."):
        return 1
    return int((getattr(array, "shards", None) or array.chunks)[0])
