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
    const auto cells = cell.data + begin;
    const auto pairs = moved.data + begin;
    const auto digit = [&](int i) {{ return (is_second ? pairs[i].c[0] / {DIGITS} : cells[i]) & {DIGITS - 1}; }};
"""


@native.func_native(
    "sorting.h", DIGIT + f"wrt::count_digits<{DIGITS}>(digit, end - begin, places.data + chunk, places.shape[1]);"
)
def count_range(
    cell: wp.array(dtype=int),
    moved: wp.array(dtype=wp.vec2i),
    is_second: wp.bool,
    chunk: int,
    begin: int,
    end: int,
    places: wp.array2d(dtype=int),
):
    """Counts the digits of a chunk."""


@native.func_native(
    "sorting.h",
    f"""{DIGIT}
    const int* const next = places.data + chunk;
    const auto move = [&](int i, size_t to) {{ moved.data[to].c[0] = cells[i], moved.data[to].c[1] = begin + i; }};
    const auto move_number = [&](int i, size_t to) {{ cell.data[to] = pairs[i].c[1]; }};
    if (is_second) wrt::move_digits<{DIGITS}>(digit, move_number, end - begin, next, places.shape[1]);
    else wrt::move_digits<{DIGITS}>(digit, move, end - begin, next, places.shape[1]);
    """,
)
def move_range(
    cell: wp.array(dtype=int),
    moved: wp.array(dtype=wp.vec2i),
    is_second: wp.bool,
    chunk: int,
    begin: int,
    end: int,
    places: wp.array2d(dtype=int),
):
    """Moves a chunk to the places of its digits."""


@exact_kernel
def count_chunks(
    first: int,
    cell: wp.array(dtype=int),
    moved: wp.array(dtype=wp.vec2i),
    is_second: wp.bool,
    size: int,
    places: wp.array2d(dtype=int),
):
    """Item: a chunk of `size` points. Writes the counts of its digits to places, (DIGITS, chunks)."""
    chunk = first + wp.tid()
    begin = chunk * size
    count_range(cell, moved, is_second, chunk, begin, wp.min(begin + size, cell.shape[0]), places)


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
def move_chunks(
    first: int,
    cell: wp.array(dtype=int),
    moved: wp.array(dtype=wp.vec2i),
    is_second: wp.bool,
    size: int,
    places: wp.array2d(dtype=int),
):
    """Item: a chunk. Moves its points."""
    chunk = first + wp.tid()
    begin = chunk * size
    move_range(cell, moved, is_second, chunk, begin, wp.min(begin + size, cell.shape[0]), places)


def sort_by_cells(cell: wp.array) -> None:
    """Replaces the cells of points by the numbers of the points, sorted by their cells; stable.

    Args:
        cell: (N,) int32 on the CPU, from 0 to DIGITS^2 - 1.
    """
    count, device = len(cell), cell.device
    size = -(-count // (CHUNKS_PER_THREAD * get_num_threads()))
    chunks = -(-count // size)
    places, moved = wp.empty((DIGITS, chunks), dtype=int, device=device), wp.empty(count, dtype=wp.vec2i, device=device)
    for is_second in (False, True):
        inputs = [cell, moved, is_second, size, places]
        launch(count_chunks, chunks, inputs, device=device, chunk=1, chunks_per_thread=1)
        launch(find_places, 1, [places], device=device)
        launch(move_chunks, chunks, inputs, device=device, chunk=1, chunks_per_thread=1)
