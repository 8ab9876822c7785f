"""A parallel radix sort of float keys with values, for several rows at once. On CUDA it is Warp's sort.

**Algorithm.** Least significant digit first, four passes over digits of 8 bits. A pass divides each row into chunks. Every
chunk counts its digits, a scan over digits and chunks turns the counts into positions, and every chunk moves its keys and
values in order. So the sort is stable, and the result does not depend on threads or chunks. Keys are ordered by the total order
of IEEE 754: negative numbers by decreasing magnitude, -0.0 before 0.0.

**Memory.** A row has room for twice its keys. Passes move them to the other half and back.

References: benthin-2006 (parallel build); zagha-blelloch-1991.
"""

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.launch import Chunks, PreparedLaunch, get_num_threads
from wrt.kernels.runtime.options import exact_kernel

DIGITS = wp.constant(256)
PASSES = 4

MIN_CHUNK = 4096
"""Least number of keys in a chunk."""

CHUNKS_PER_THREAD = 2


@wp.struct
class KeyChunk:
    """A chunk of a row's keys."""

    row: int
    number: int
    chunks: int
    """Of each row."""
    begin: int
    end: int


@wp.func
def chunk_of(item: int, count: wp.vec3i, size: int, chunks: int):
    """The chunk of `size` keys of an item."""
    chunk = KeyChunk()
    chunk.row = item / chunks
    chunk.number = item % chunks
    chunk.chunks = chunks
    chunk.begin = wp.min(chunk.number * size, count[chunk.row])
    chunk.end = wp.min(chunk.begin + size, count[chunk.row])
    return chunk


@native.func_native(
    "sorting.h",
    "const float* from = keys.data + (size_t)chunk.row * keys.shape[1] + source + chunk.begin;\n"
    "int* to = places.data + (size_t)chunk.row * places.shape[1] + chunk.number;\n"
    "wrt::count_digits(from, chunk.end - chunk.begin, shift, to, chunk.chunks);",
)
def count_range(keys: wp.array2d(dtype=float), places: wp.array2d(dtype=int), chunk: KeyChunk, source: int, shift: int):
    """Counts the digits of a chunk's keys."""


@native.func_native(
    "sorting.h",
    "const size_t at = (size_t)chunk.row * keys.shape[1], from = at + source + chunk.begin, to = at + target;\n"
    "const int* next = places.data + (size_t)chunk.row * places.shape[1] + chunk.number;\n"
    "const int length = chunk.end - chunk.begin;\n"
    "float* keys_to = keys.data + to;\n"
    "wrt::move_digits(keys.data + from, values.data + from, length, shift, next, chunk.chunks, keys_to, values.data + to);",
)
def move_range(
    keys: wp.array2d(dtype=float),
    values: wp.array2d(dtype=int),
    places: wp.array2d(dtype=int),
    chunk: KeyChunk,
    source: int,
    target: int,
    shift: int,
):
    """Moves a chunk's keys and values to their positions in the other half of the row."""


@exact_kernel
def count_digits(
    first: int,
    keys: wp.array2d(dtype=float),
    count: wp.vec3i,
    size: int,
    source: int,
    shift: int,
    places: wp.array2d(dtype=int),
):
    """Item: row * chunks + chunk of `size` keys. Writes its counts to places, (rows, DIGITS * chunks), digit-major."""
    count_range(keys, places, chunk_of(first + wp.tid(), count, size, places.shape[1] / DIGITS), source, shift)


@exact_kernel
def scan_digits(first: int, places: wp.array2d(dtype=int)):
    """Item: a row. Turns counts into positions."""
    row = first + wp.tid()
    place = int(0)
    for i in range(places.shape[1]):
        here = places[row, i]
        places[row, i] = place
        place += here


@exact_kernel
def move_keys(
    first: int,
    keys: wp.array2d(dtype=float),
    values: wp.array2d(dtype=int),
    count: wp.vec3i,
    size: int,
    source: int,
    target: int,
    shift: int,
    places: wp.array2d(dtype=int),
):
    """Item: row * chunks + chunk. Moves its keys and values."""
    chunk = chunk_of(first + wp.tid(), count, size, places.shape[1] / DIGITS)
    move_range(keys, values, places, chunk, source, target, shift)


def sort_rows(keys: wp.array, values: wp.array, count: wp.vec3i) -> None:
    """Sorts the first `count[row]` keys of each of three rows in ascending order, together with the values.

    Args:
        keys: (3, capacity) float32, without NaN; a row has room for at least twice its keys.
        values: (3, capacity) int32.
        count: number of keys of each row.
    """
    device, half, max_count = keys.device, keys.shape[1] // 2, max(count)
    if device.is_cuda:
        for row in range(3):
            wp.utils.radix_sort_pairs(keys[row], values[row], int(count[row]))
        return
    size = max(MIN_CHUNK, -(-3 * max_count // (CHUNKS_PER_THREAD * get_num_threads())))
    chunks = max(1, -(-max_count // size))
    places = wp.empty((3, int(DIGITS) * chunks), dtype=int, device=device)
    scan = PreparedLaunch(scan_digits, [places], device)
    single_items = Chunks(1, 1)
    for number in range(PASSES):
        source, target = (0, half) if number % 2 == 0 else (half, 0)
        part = [count, size, source, 8 * number, places]
        PreparedLaunch(count_digits, [keys, *part], device).run(3 * chunks, single_items)
        scan.run(3, single_items)
        part = [count, size, source, target, 8 * number, places]
        PreparedLaunch(move_keys, [keys, values, *part], device).run(3 * chunks, single_items)
