"""A parallel sort of points on the CPU by the numbers of their cells.

**Algorithm.** Two passes over digits of 11 bits. The points of a pass are divided into chunks. Every chunk counts its digits, a
scan over digits and chunks turns the counts into places, and every chunk moves its points in order, as in
`wrt.builders.radix_sort`. So the sort is stable, and the order does not depend on threads. The first pass moves cells with the
numbers of their points, the second one numbers alone, to where the cells were.

References: zagha-blelloch-1991.
"""

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.launch import get_num_threads, launch
from wrt.kernels.runtime.options import exact_kernel

DIGITS = 1 << 11
"""Values of a digit."""

CHUNKS_PER_THREAD = 2

DIGIT = f"""
    const int begin = chunk * sort.size, left = sort.cell.shape[0] - begin, count = left < sort.size ? left : sort.size;
    const auto cells = sort.cell.data + begin;
    const auto pairs = sort.moved.data + begin;
    int* const places = sort.places.data + chunk;
    const auto digit = [&](int i) {{ return (sort.is_second ? pairs[i].c[0] / {DIGITS} : cells[i]) & {DIGITS - 1}; }};
"""


@wp.struct
class CellSort:
    """A pass of a sort."""

    cell: wp.array(dtype=int)
    """(N,) cells of points; after the second pass, numbers of points."""
    moved: wp.array(dtype=wp.vec2i)
    """(N,) cells and numbers of points, in the order of the first pass."""
    is_second: wp.bool
    size: int
    """Points of a chunk; the last may have fewer."""
    places: wp.array2d(dtype=int)
    """(DIGITS, chunks) points with a digit in a chunk, and then where the first of them goes."""


@native.func_native("sorting.h", DIGIT + f"wrt::count_digits<{DIGITS}>(digit, count, places, sort.places.shape[1]);")
def count_chunk(sort: CellSort, chunk: int):
    """Counts the digits of a chunk."""


@native.func_native(
    "sorting.h",
    f"""{DIGIT}
    const auto move = [&](int i, size_t to) {{ sort.moved.data[to].c[0] = cells[i], sort.moved.data[to].c[1] = begin + i; }};
    const auto move_number = [&](int i, size_t to) {{ sort.cell.data[to] = pairs[i].c[1]; }};
    if (sort.is_second) wrt::move_digits<{DIGITS}>(digit, move_number, count, places, sort.places.shape[1]);
    else wrt::move_digits<{DIGITS}>(digit, move, count, places, sort.places.shape[1]);
    """,
)
def move_chunk(sort: CellSort, chunk: int):
    """Moves the points of a chunk to the places of their digits."""


@exact_kernel
def count_chunks(first: int, sort: CellSort):
    """Item: a chunk."""
    count_chunk(sort, first + wp.tid())


@exact_kernel
def find_places(first: int, places: wp.array2d(dtype=int)):
    """Turns counts into places. There is one item."""
    place = int(0)
    for digit in range(places.shape[0]):
        for chunk in range(places.shape[1]):
            here = places[digit, chunk]
            places[digit, chunk] = place
            place += here


@exact_kernel
def move_chunks(first: int, sort: CellSort):
    """Item: a chunk."""
    move_chunk(sort, first + wp.tid())


def sort_by_cells(cell: wp.array) -> None:
    """Replaces the cells of points by the numbers of the points, sorted by their cells; stable.

    Args:
        cell: (N,) int32 on the CPU, from 0 to DIGITS^2 - 1.
    """
    count, device, sort = len(cell), cell.device, CellSort()
    sort.size = -(-count // (CHUNKS_PER_THREAD * get_num_threads()))
    chunks = -(-count // sort.size)
    sort.cell, sort.moved = cell, wp.empty(count, dtype=wp.vec2i, device=device)
    sort.places = wp.empty((DIGITS, chunks), dtype=int, device=device)
    for is_second in (False, True):
        sort.is_second = is_second
        launch(count_chunks, chunks, [sort], device=device, chunk=1, chunks_per_thread=1)
        launch(find_places, 1, [sort.places], device=device)
        launch(move_chunks, chunks, [sort], device=device, chunk=1, chunks_per_thread=1)
