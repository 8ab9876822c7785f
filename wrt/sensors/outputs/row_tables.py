"""Structured arrays of what sensors measured, written by all cores (`wrt.kernels.sensors.table_rows`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import warp as wp

from wrt.engine.memory import empty
from wrt.instances.instance_boxes import on_device
from wrt.kernels.runtime.launch import launch, use_threads


class Field(NamedTuple):
    """A field of a table.

    Attributes:
        name: of the field.
        kind: its type, as NumPy writes it.
        values: (N,) of all items, or fewer: item i has the value number (i / divisor) % len(values).
        divisor: 1 for a value of each item.
    """

    name: str
    kind: str
    values: np.ndarray
    divisor: int = 1


def as_host(values: Any) -> np.ndarray:
    """An array in NumPy's memory."""
    return values if isinstance(values, np.ndarray) else values.numpy()


def coordinates(points: Any, kind: str) -> list[Field]:
    """The fields x, y and z of (..., 3) points."""
    points = as_host(points).reshape(-1, 3)
    return [Field(name, kind, points[:, axis]) for axis, name in enumerate("xyz")]


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

    dtype, host, source = np.dtype([(field.name, field.kind) for field in fields]), wp.get_device("cpu"), RowSource()
    blocks = -(-count // ROWS)
    begins = np.minimum(ROWS * np.arange(blocks + 1, dtype=np.int32), count)
    source.count, source.own = count, count if order is None else order[1]
    if order is not None:
        source.order = on_device(order[0], wp.int32, host)
    source.begins = on_device(begins, wp.int32, host)
    with use_threads(threads):
        if ids is not None:
            source.id = on_device(ids, wp.int32, host)
            launch(count_rows, blocks, [source], device=host, chunk=4)
            begins[1:] = np.cumsum(begins[:-1])
            begins[0] = 0
        rows = empty(int(begins[-1]) * dtype.itemsize, wp.uint8, host)
        columns, kept = _columns(fields, dtype, count)
        if rows.size:
            launch(write_rows, blocks, [source, columns, dtype.itemsize, rows], device=host, chunk=4)
    del kept
    return rows.numpy().view(dtype)


def _columns(fields: Sequence[Field], dtype: np.dtype, count: int) -> tuple[wp.array, list[np.ndarray]]:
    """Columns for kernels, and the arrays at whose addresses they are."""
    from wrt.kernels.sensors.table_rows import COPIES, DOUBLE_TO_FLOAT, INT_TO_USHORT, Column

    table: np.ndarray = np.zeros(len(fields), dtype=Column.numpy_dtype())  # type: ignore[attr-defined]  # made by wp.struct
    kept: list[np.ndarray] = []
    conversions = {("<f8", "<f4"): DOUBLE_TO_FLOAT, ("<i4", "<u2"): INT_TO_USHORT}
    for row, field in zip(table, fields, strict=True):
        target, values = dtype[field.name], field.values
        kind = conversions.get((values.dtype.str, target.str))
        if kind is None:
            values = values.astype(target, copy=False)
            kind = COPIES[COPIES.index(target.itemsize)]
        kept.append(values)
        alone = len(values) == 1
        row["data"], row["stride"] = values.__array_interface__["data"][0], 0 if alone else values.strides[0]
        row["offset"], row["kind"], row["divisor"] = dtype.fields[field.name][1], kind, 1 if alone else field.divisor
        row["modulus"] = 0 if alone or len(values) * field.divisor == count else len(values)
    return on_device(table, Column, wp.get_device("cpu")), kept
