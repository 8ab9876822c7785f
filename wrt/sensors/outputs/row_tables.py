"""Structured arrays of what sensors measured, written by all cores (`wrt.kernels.sensors.table_rows`)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import warp as wp

from wrt.engine.host_arrays import address_of, write_flat
from wrt.engine.memory import empty_host
from wrt.instances.instance_boxes import on_device
from wrt.kernels.runtime.argument_packing import blank
from wrt.kernels.runtime.launch import launch, use_threads


class Field(NamedTuple):
    """A field of a table, or three neighbours of one type.

    Attributes:
        names: of the field, or of three.
        kind: their type, as NumPy writes it.
        values: (N,) of all items, or (N, 3); or fewer: item i has the value number (i / divisor) % len(values).
        divisor: 1 for a value of each item.
    """

    names: tuple[str, ...]
    kind: str
    values: np.ndarray
    divisor: int = 1


def as_host(values: Any) -> np.ndarray:
    """An array in NumPy's memory."""
    return values if isinstance(values, np.ndarray) else values.numpy()


def coordinates(points: Any, kind: str) -> Field:
    """The fields x, y and z of (..., 3) points."""
    return Field(("x", "y", "z"), kind, np.ascontiguousarray(as_host(points).reshape(-1, 3)))


@lru_cache(maxsize=64)
def row_type(kinds: tuple[tuple[tuple[str, ...], str], ...]) -> np.dtype:
    """The type of a row, of the names and types of its fields."""
    return np.dtype([(name, kind) for names, kind in kinds for name in names])


def row_table(
    fields: Sequence[Field], ids: np.ndarray | None, count: int, order: tuple[np.ndarray, int] | None, threads: int | None
) -> np.ndarray:
    """A structured array of one dimension.

    Args:
        fields: what is in a row.
        ids: (N,) int32; items with a negative one have no row. None: all have one.
        count: N.
        order: (own,) int32 in which the items of each sensor are taken, and own. None: by number.
        threads: number of threads; None for the default.
    """
    from wrt.kernels.sensors.table_rows import ROWS, RowSource, count_rows, write_rows

    dtype = row_type(tuple((field.names, field.kind) for field in fields))
    host, source, size = wp.get_device("cpu"), blank(RowSource), dtype.itemsize
    blocks = -(-count // ROWS)
    begins = np.minimum(ROWS * np.arange(blocks + 1, dtype=np.int32), count)
    source.count, source.own = count, count if order is None else order[1]
    packed = source.__ctype__()
    write_flat(packed.begins, address_of(begins), len(begins), wp.int32)
    if order is not None:
        write_flat(packed.order, address_of(order[0]), len(order[0]), wp.int32)
    with use_threads(threads):
        if ids is not None:
            write_flat(packed.id, address_of(ids), len(ids), wp.int32)
            launch(count_rows, blocks, [source], device=host, chunk=4)
            begins[1:] = np.cumsum(begins[:-1])
            begins[0] = 0
        (rows,) = empty_host(int(begins[-1]) * size, wp.uint8)
        columns, kept = _columns(fields, dtype, count)
        if rows.size:
            launch(write_rows, blocks, [source, columns, size, rows.array], device=host, chunk=4)
    del kept
    return rows.numpy().view(dtype)


def _columns(fields: Sequence[Field], dtype: np.dtype, count: int) -> tuple[wp.array, list[np.ndarray]]:
    """Columns for kernels, and the arrays at whose addresses they are."""
    from wrt.kernels.sensors.table_rows import CONVERSIONS, COPIES, Column

    kept: list[np.ndarray] = []
    found: list[dict[str, int]] = []
    for field in fields:
        values, together = field.values, len(field.names)
        kind = CONVERSIONS.get((values.dtype.str, field.kind, together))
        if kind is None:
            target = np.dtype(field.kind)
            values = values.astype(target, copy=False)
            kind = COPIES[COPIES.index(target.itemsize * together)]
        kept.append(values)
        every = len(values) * field.divisor == count
        column = {"data": address_of(values), "stride": values.strides[0], "offset": dtype.fields[field.names[0]][1]}
        column |= {"kind": kind, "divisor": field.divisor, "modulus": 0 if every else len(values)}
        found.append(column if len(values) > 1 else column | {"stride": 0, "divisor": 1, "modulus": 0})
    kinds = Column.numpy_dtype()  # type: ignore[attr-defined]  # made by wp.struct
    table = np.array([tuple(column[name] for name in kinds["names"]) for column in found], dtype=np.dtype(kinds))
    return on_device(table, Column, wp.get_device("cpu")), kept
