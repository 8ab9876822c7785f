"""Sums of weights, in groups, of the rows in which the booleans of a column are true: on all cores, in tiles of columns.

Weights are whole numbers whose sums have fewer than 53 bits, so that the sums are exact in any order. A row is in few groups as
a rule, such as a sun in its month: only weights other than 0 are stored, row by row.
"""

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_kernel

TILE = 256
"""Columns of a tile, as in column_sums.h."""


@wp.struct
class WeightedRows:
    """The weights of D rows in G groups."""

    count: int
    """G."""
    begins: wp.array(dtype=int)
    """(D + 1,) number of the first weight of each row."""
    groups: wp.array(dtype=int)
    """Group of each weight."""
    weights: wp.array(dtype=wp.float64)


@wp.struct
class BooleanColumns:
    """P columns of booleans in D rows."""

    values: wp.array(dtype=wp.uint8)
    row_stride: wp.int64
    """Bytes from a row to the next; one of the strides is 1."""
    column_stride: wp.int64


@native.func_native(
    "column_sums.h",
    f"""static_assert(wrt::SUM_TILE == {TILE});
    const int begin = tile * {TILE}, left = sums.shape[1] - begin, count = left < {TILE} ? left : {TILE};
    wrt::sum_tile(
        columns.values.data + begin * columns.column_stride, columns.row_stride, columns.column_stride, count, rows,
        sums.data + begin, sums.shape[1]);""",
)
def sum_columns_of_tile(columns: BooleanColumns, rows: WeightedRows, tile: int, sums: wp.array2d(dtype=wp.float64)):
    """Writes the sums of the columns of a tile."""


@exact_kernel
def sum_columns(first: int, columns: BooleanColumns, rows: WeightedRows, sums: wp.array2d(dtype=wp.float64)):
    """Writes sums (G, P). Item: a tile. On the CPU."""
    sum_columns_of_tile(columns, rows, first + wp.tid(), sums)
