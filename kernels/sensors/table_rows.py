"""Tables of sensors: rows of a structured array in host memory, written from columns by all cores.

An item is a return or a pixel, and has a row if its id is not negative. Threads count the rows of blocks of `ROWS` items, and
write them, block by block, from the row on at which each block begins.
"""

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_kernel

ROWS = 1024
"""Items of a block, as in table_rows.h."""

COPIES = (1, 2, 4, 8, 24)
"""Kinds of columns that are copied, by their bytes; 24 are three numbers."""

CONVERSIONS = {("<f8", "<f4", 1): 30, ("<f8", "<f4", 3): 31, ("<i4", "<u2", 1): 32}
"""Kinds of columns that are converted, by the types before and after, and how many numbers a row has."""


@wp.struct
class Column:
    """A column. Item i has the value number (i / divisor) % modulus."""

    data: wp.uint64
    """Address of the first value."""
    stride: wp.int64
    """Bytes from a value to the next."""
    offset: int
    """Of the field in its row, in bytes."""
    kind: int
    """How values are converted: one of `COPIES` or `CONVERSIONS`."""
    divisor: int
    modulus: int
    """0 for none."""


@wp.struct
class RowSource:
    """Items and the rows that they have."""

    count: int
    """Of items."""
    order: wp.array(dtype=int)
    """(own,) in which the items of a sensor are taken; (0,) by number."""
    own: int
    """Items of a sensor."""
    id: wp.array(dtype=int)
    """(count,) negative for items without a row; (0,) if all have one."""
    begins: wp.array(dtype=int)
    """(blocks,) number of rows before each block; what `count_rows` writes are the rows of each."""


ITEMS = f"""static_assert(wrt::ROWS == {ROWS});
    const int begin = block * wrt::ROWS, left = source.count - begin, end = begin + (left < wrt::ROWS ? left : wrt::ROWS);
    const int* order = source.order.shape[0] ? source.order.data : nullptr;
    const int* id = source.id.shape[0] ? source.id.data : nullptr;"""


@native.func_native("table_rows.h", f"{ITEMS}\nreturn wrt::count_rows(order, source.own, id, begin, end);")
def rows_of(source: RowSource, block: int) -> int:
    """Number of rows of a block."""


@native.func_native(
    "table_rows.h",
    f"""{ITEMS}
    wrt::RowItems rows;
    wrt::rows_of_block(order, source.own, id, begin, end, rows);
    wrt::write_columns(columns.data, columns.shape[0], rows, table.data, source.begins.data[block], row_bytes);""",
)
def write_block(
    source: RowSource, columns: wp.array(dtype=Column), row_bytes: int, block: int, table: wp.array(dtype=wp.uint8)
):
    """Writes the rows of a block."""


@exact_kernel
def count_rows(first: int, source: RowSource):
    """Counts the rows of a block. Item: a block. On the CPU."""
    block = first + wp.tid()
    source.begins[block] = rows_of(source, block)


@exact_kernel
def write_rows(first: int, source: RowSource, columns: wp.array(dtype=Column), row_bytes: int, table: wp.array(dtype=wp.uint8)):
    """Writes the rows of a block. Item: a block. On the CPU."""
    write_block(source, columns, row_bytes, first + wp.tid(), table)
