"""A model of a cache: which bytes a traversal reads from memory, computed from the nodes and leaves that it visits.

Hardware counters are not available on every machine, and where they are they count everything that a process does. Here each
visit to a node, and to a block of triangles, reads its bytes through a set-associative cache with least recently used
replacement, as in one core. The visits are those of the kernels of `single` and `queued`, in the order in which one thread
makes them; what is counted is misses.

**Packets** are modelled as the union of the visits of their rays, each node and block read once per packet, in the order in
which its rays first reach them. That is the least that a packet traversal reads: its packets also visit what its culling
cannot exclude.
"""

import warp as wp

from wrt.kernels.runtime.options import exact_kernel

LINE = wp.constant(64)
"""Bytes of a cache line."""


@exact_kernel
def count_misses(
    first: int,
    addresses: wp.array(dtype=wp.int64),
    sizes: wp.array(dtype=int),
    sets: int,
    ways: int,
    tags: wp.array(dtype=wp.int64),
    misses: wp.array(dtype=wp.int64),
):
    """Reads ranges of bytes one after the other through a cache. Item: all of them.

    Args:
        addresses, sizes: (reads,) first byte and number of bytes of each range.
        sets, ways: of the cache.
        tags: (sets * ways,) lines in the cache, each set in the order of use, the last first; -1 before the first use.
        misses: (1,) receives the number of lines that were read from memory.
    """
    missed = wp.int64(0)
    for k in range(addresses.shape[0]):
        line = addresses[k] / wp.int64(LINE)
        last = (addresses[k] + wp.int64(sizes[k] - 1)) / wp.int64(LINE)
        while line <= last:
            begin = int(line % wp.int64(sets)) * ways
            place = int(0)
            while place < ways - 1 and tags[begin + place] != line:
                place += 1
            if tags[begin + place] != line:
                missed += wp.int64(1)
            while place > 0:
                tags[begin + place] = tags[begin + place - 1]
                place -= 1
            tags[begin] = line
            line += wp.int64(1)
    misses[0] = missed
