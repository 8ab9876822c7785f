"""All hits of each ray: turns the unordered output of a traversal into sorted, compact lists (count, scan, fill).

A traversal writes the hits of a ray in the order in which it finds them. The kernels here sort the hits of each ray by t, then
by triangle. This order does not depend on the tree, the traversal or the number of threads. The sorted hits are then copied to
their final positions.
"""

import warp as wp

from wrt.kernels.layout.ray_batch import HitBatch
from wrt.kernels.runtime.options import exact_kernel

MAX_INSERTION_SORT = wp.constant(16)
"""A list of at most this many hits is sorted by insertion; a longer list by heapsort, in O(n log n)."""


@wp.func
def comes_before(hits: HitBatch, a: int, b: int):
    """Whether hit a precedes hit b: it has the smaller t or, at equal t, the smaller triangle id."""
    return hits.t[a] < hits.t[b] or (hits.t[a] == hits.t[b] and hits.primitive[a] < hits.primitive[b])


@wp.func
def swap_hits(hits: HitBatch, a: int, b: int):
    """Exchanges two hits."""
    t = hits.t[a]
    primitive = hits.primitive[a]
    uv = hits.uv[a]
    hits.t[a] = hits.t[b]
    hits.primitive[a] = hits.primitive[b]
    hits.uv[a] = hits.uv[b]
    hits.t[b] = t
    hits.primitive[b] = primitive
    hits.uv[b] = uv


@wp.func
def sift_down(hits: HitBatch, begin: int, start: int, count: int):
    """Restores the heap property below element `start`; the heap has `count` hits and its root is the last hit in the order."""
    parent = int(start)
    child = int(2 * start + 1)
    while child < count:
        if child + 1 < count and comes_before(hits, begin + child, begin + child + 1):
            child += 1
        if comes_before(hits, begin + parent, begin + child):
            swap_hits(hits, begin + parent, begin + child)
            parent = child
            child = 2 * parent + 1
        else:
            child = count


@wp.func
def sort_hits(hits: HitBatch, begin: int, count: int):
    """Sorts the hits begin .. begin + count - 1."""
    if count <= MAX_INSERTION_SORT:
        for i in range(1, count):
            j = int(begin + i)
            while j > begin and comes_before(hits, j, j - 1):
                swap_hits(hits, j, j - 1)
                j -= 1
    else:
        for i in range(count / 2):
            sift_down(hits, begin, count / 2 - 1 - i, count)
        for i in range(count - 1):
            swap_hits(hits, begin, begin + count - 1 - i)
            sift_down(hits, begin, 0, count - 1 - i)


@exact_kernel
def gather_hits(first: int, found: HitBatch, order: wp.array(dtype=int), offsets: wp.array(dtype=wp.int64), hits: HitBatch):
    """Sorts the hits of a traced ray and copies the nearest ones to the ray's elements of `hits`. Item: a traced ray.

    Args:
        first: number of the first item.
        found: output of the traversal, sorted in place. Rays whose hits did not fit are skipped.
        order: original number of each traced ray; empty if rays are traced in their original order.
        offsets: (rays + 1,) start of each ray's hits.
        hits: `t`, `primitive` and `uv` are written.
    """
    item = first + wp.tid()
    ray = int(item)
    if order.shape[0] > 0:
        ray = order[item]
    begin = int(item * found.room)
    if found.room == 0:
        begin = found.begins[item]
    count = found.counts[item]
    if found.room == 0 or count <= found.room:
        sort_hits(found, begin, count)
        place = int(offsets[ray])
        for k in range(int(offsets[ray + 1]) - place):
            hits.t[place + k] = found.t[begin + k]
            hits.primitive[place + k] = found.primitive[begin + k]
            hits.uv[place + k] = found.uv[begin + k]


@exact_kernel
def sort_lists(first: int, found: HitBatch):
    """Sorts the hits of a ray, from `begins` on. Item: a ray."""
    i = first + wp.tid()
    sort_hits(found, found.begins[i], found.counts[i])


@exact_kernel
def lengths_of_lists(first: int, counts: wp.array(dtype=int), max_length: int, lengths: wp.array(dtype=wp.int64)):
    """Writes the length of a ray's list, at most `max_length`, and 0 after the last one. Item: an element of `lengths`."""
    i = first + wp.tid()
    length = int(0)
    if i < counts.shape[0]:
        length = wp.min(counts[i], max_length)
    lengths[i] = wp.int64(length)


@exact_kernel
def narrow_offsets(first: int, offsets: wp.array(dtype=wp.int64), begins: wp.array(dtype=int)):
    """Copies the first index of a list; only sums below 2^31 are of use. Item: a list."""
    i = first + wp.tid()
    begins[i] = int(offsets[i])


@exact_kernel
def number_rays(first: int, offsets: wp.array(dtype=wp.int64), ray_id: wp.array(dtype=int)):
    """Writes the number of a ray to each of its hits. Item: a ray."""
    i = first + wp.tid()
    for k in range(int(offsets[i]), int(offsets[i + 1])):
        ray_id[k] = i


@exact_kernel
def count_listed(first: int, offsets: wp.array(dtype=wp.int64), counts: wp.array(dtype=int)):
    """Writes the number of hits in a ray's list. Item: a ray."""
    i = first + wp.tid()
    counts[i] = int(offsets[i + 1] - offsets[i])


ODD, NONZERO, POSITIVE = 0, 1, 2
"""What `decide_inside` asks of a number."""


@exact_kernel
def decide_inside(first: int, counts: wp.array(dtype=int), rule: int, inside: wp.array(dtype=wp.bool)):
    """Writes whether a number of crossings, or their sum by sign, is as the rule asks. Item: a ray."""
    i = first + wp.tid()
    is_so = (counts[i] & 1) != 0
    if rule == wp.static(NONZERO):
        is_so = counts[i] != 0
    elif rule == wp.static(POSITIVE):
        is_so = counts[i] > 0
    inside[i] = is_so


@exact_kernel
def find_unequal(first: int, one: wp.array(dtype=wp.bool), other: wp.array(dtype=wp.bool), unequal: wp.array(dtype=int)):
    """Writes whether two answers differ, as 0 or 1. Item: a ray."""
    i = first + wp.tid()
    unequal[i] = wp.where(one[i] == other[i], 0, 1)


@exact_kernel
def list_marked(first: int, marked: wp.array(dtype=int), places: wp.array(dtype=int), numbers: wp.array(dtype=int)):
    """Writes the number of an item that is marked by 1, at its place. Item: an element."""
    i = first + wp.tid()
    if marked[i] != 0:
        numbers[places[i] - 1] = i


@exact_kernel
def aim_outwards(
    first: int,
    origins: wp.array(dtype=wp.vec3),
    stride: int,
    center: wp.vec3d,
    direction: wp.vec3,
    directions: wp.array(dtype=wp.vec3),
):
    """Writes `direction` or its opposite, whichever points away from the scene's centre at the ray's origin. Item: a ray.

    origins: (N,), or (1,) with a stride of 0; center: subtracted from them.
    """
    i = first + wp.tid()
    offset = wp.vec3(wp.vec3d(origins[i * stride]) - center)
    directions[i] = wp.where(wp.dot(offset, direction) < 0.0, -direction, direction)
