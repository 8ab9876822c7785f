"""Rays in parquet files, and answers in folders of them, by pyarrow.

A block reads the groups of rows that it overlaps, and of them only the columns that it needs. Files whose groups have as many
rows as a block, or a few times fewer, are read once. Answers are a file a block, which readers of parquet take together as one
table.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from wrt.query.batches.block_outputs import value_of
from wrt.query.batches.reductions import as_array
from wrt.query.blocks import Blocks

if TYPE_CHECKING:
    from pyarrow.parquet import ParquetFile


class ParquetColumns:
    """Columns of a parquet file, or of a folder of them in the order of their names, as an array that is read by rows.

        origins = wrt.cluster.ParquetColumns("rays.parquet", ["x", "y", "z"])
        directions = wrt.cluster.ParquetColumns("rays.parquet", ["dx", "dy", "dz"])
        scene.intersect_blocks(origins, directions)

    Workers of an executor open the file themselves, at the same path.

    Args:
        path: path of the file or folder.
        columns: names of the columns; a single name gives an array of one axis, for `t_min`, `t_max`, `mask` or `skip`.

    Attributes:
        shape: (N, number of columns), or (N,).
        dtype: common NumPy type of the columns.

    Raises:
        FileNotFoundError: there is no file.
        ImportError: pyarrow is not installed.
        ValueError: no such column, a column that does not hold numbers, or one that has gaps (nulls).
    """

    is_shared = True
    """Whether workers can open it (`wrt.query.batches.array_files`)."""

    def __init__(self, path: str | Path, columns: str | Sequence[str]) -> None:
        self.path = Path(path).absolute()
        self.paths = sorted(self.path.glob("*.parquet")) if self.path.is_dir() else [self.path]
        if not self.paths or not all(one.is_file() for one in self.paths):  # a pipe would be waited for
            raise FileNotFoundError(f"there is no parquet file at '{path}'")
        self.columns = [columns] if isinstance(columns, str) else list(columns)
        self._sizes = [(os.stat(one).st_size, os.stat(one).st_mtime_ns) for one in self.paths]
        schema = self._files[0].schema_arrow
        for name in self.columns:
            if name not in schema.names:
                raise ValueError(f"'{path}' has no column {name!r}; choose from {', '.join(schema.names)}")
        types = [np.dtype(schema.field(name).type.to_pandas_dtype()) for name in self.columns]
        if any(one.kind not in "fiub" for one in types):
            raise ValueError(f"columns {self.columns} of '{path}' do not hold numbers, but {', '.join(map(str, types))}")
        self.dtype = np.result_type(*types)
        counts = [file.metadata.row_group(i).num_rows for file in self._files for i in range(file.num_row_groups)]
        self._first = np.cumsum([0, *counts])
        self.shape = (int(self._first[-1]),) if isinstance(columns, str) else (int(self._first[-1]), len(self.columns))

    @cached_property
    def _files(self) -> list[ParquetFile]:
        try:
            from pyarrow.parquet import ParquetFile
        except ImportError as error:
            raise ImportError("parquet files need pyarrow: pip install 'wrt[cluster-dask]'") from error
        if [(os.stat(one).st_size, os.stat(one).st_mtime_ns) for one in self.paths] != self._sizes:
            raise ValueError(f"'{self.path}' has changed since the batch began; start again")
        return [ParquetFile(one) for one in self.paths]

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_files"}

    def __getitem__(self, rows: slice) -> np.ndarray:
        """Some rows.

        Raises:
            ValueError: a value is missing (null).
        """
        begin, end, step = rows.indices(self.shape[0])
        groups = [(file, i) for file in self._files for i in range(file.num_row_groups)]
        first = int(np.searchsorted(self._first, begin, side="right")) - 1
        out = np.empty((max(end - begin, 0), len(self.columns)), self.dtype)
        for number in range(max(first, 0), len(groups)):
            start, stop = int(self._first[number]), int(self._first[number + 1])
            if start >= end:
                break
            file, group = groups[number]
            table = file.read_row_group(group, columns=self.columns)
            low, high = max(begin, start), min(end, stop)
            for column, name in enumerate(self.columns):
                part = table.column(name).slice(low - start, high - low)
                if part.null_count:
                    raise ValueError(f"column {name!r} of '{self.path}' has no value in some of the rows {low} to {high - 1}")
                out[low - begin : high - begin, column] = part.to_numpy()
        return (out if len(self.shape) == 2 else out[:, 0])[::step]


def write_parquet(blocks: Blocks, folder: str | Path, attributes: Sequence[str] = ("t", "primitive_id", "geometry_id")) -> int:
    """Computes all blocks and writes each to a parquet file of its own, part-(first row).parquet. Workers write them.

    Columns have the names of attributes, those of vectors with .0, .1, .2; of occlusion and counts the one column is "value".

    Args:
        blocks: what `intersect_blocks`, `occluded_blocks` or `count_blocks` returned; each row has one ray.
        folder: path of a folder that workers see at the same path.
        attributes: of closest hits, the attributes to write.

    Returns:
        The number of rows.

    Raises:
        ImportError: pyarrow is not installed.
        OSError: a file cannot be written.
        ValueError: rows have several rays that are not reduced, or the rays come from an iterator.
    """
    if blocks.shape is None:
        raise ValueError("rays from an iterator cannot be written by workers; pass arrays or wrt.batches.GeneratedRays")
    place = Path(folder).absolute()
    place.mkdir(parents=True, exist_ok=True)
    deliver = WriteTable(str(place), tuple(attributes))
    deliver.columns(blocks.answer_rows(slice(0, 0)))
    return sum(piece.rows.stop - piece.rows.start for piece, _ in blocks.run_pieces(blocks.pieces(), deliver, ordered=False))


class WriteTable:
    """Writes answers of blocks to parquet files; arguments as in `write_parquet`."""

    def __init__(self, folder: str, attributes: tuple[str, ...]) -> None:
        self.folder, self.attributes = folder, attributes

    def columns(self, answer: Any) -> dict[str, np.ndarray]:
        """The columns of an answer.

        Raises:
            ValueError: rows have several rays.
        """
        if isinstance(answer, np.ndarray):
            arrays = {"value": answer}
        else:
            names = answer if isinstance(answer, dict) else self.attributes
            arrays = {name: as_array(value_of(answer, name)) for name in names}
        found = {}
        for name, array in arrays.items():
            if array.ndim == 2 and array.shape[1] in (2, 3) and name in ("uv", "position", "normal"):
                found |= {f"{name}.{i}": array[:, i] for i in range(array.shape[1])}
            elif array.ndim == 1:
                found[name] = array
            else:
                raise ValueError(f"{name} has shape {array.shape} for a block; a row of a table holds one ray: use reduce")
        return found

    def __call__(self, rows: slice, answer: Any) -> None:
        import pyarrow as pa
        from pyarrow.parquet import write_table

        from wrt.atomic_files import replaced

        table = pa.table({name: np.ascontiguousarray(array) for name, array in self.columns(answer).items()})
        with replaced(Path(self.folder) / f"part-{rows.start:015d}.parquet") as file:
            write_table(table, file)
