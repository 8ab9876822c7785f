"""Packets, streams and frusta as a GPU means them: the 32 threads of a CUDA warp go through a BVH together.

On a CPU a packet saves loads and fills vector lanes. A GPU's threads are lanes by themselves: a warp whose threads walk alone
issues one instruction for all that are at the same place, and loads a node once for those that want the same. What is
left to win is that threads stay together, and what it costs is that each waits for all (Aila and Laine 2009).

    packet    A warp is a packet of 32 rays with one stack in shared memory. All threads test the node that is next, by votes
              it is decided whether one of them goes to a child and which child most of them meet first (Guenther et al. 2007).
              With a node waits who met it.
    stream    A warp has 128 rays. At each node those that meet a child are written, by ballot and compaction, to a list of
              their own, and go on together: so threads are at work in all but the last 32 of each list (Garanzha and Loop
              2010 and Wald et al. 2007 filter streams, the former in breadth first order). Lists and rays are in shared memory.
    frustum   The rays of a warp that start at one point, with the same main axis, have a frustum of four planes. Each
              thread tests it with the children of another node, 32 nodes at a time; all rays are tested with the
              triangles of the leaves that are found. Other rays are a packet.

Rays, the filter of boxes and the triangle test are those of persistent threads, so hits are the same to the bit. On the CPU an
item traces its rays one by one. What each takes on a card is in notebooks/records/2026-11-28-gpu-warps.md.

References: guenther-2007; garanzha-loop-2010; aila-laine-2009; wald-2007-streams.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.binary_nodes import BinaryNodes, PackedTriangles
from wrt.kernels.layout.ray_batch import HitBatch, RayBatch
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import specialised_kernel
from wrt.kernels.traversal.persistent.persistent_bvh import ANSWER_CLASSES

WAYS = {"packet": "PACKET", "stream": "STREAMED", "frustum": "FRUSTUM"}
"""Names in `warp_packets.h`."""

WARP, BLOCK = 32, 64
"""Threads of a warp, and of a block."""

RAYS = {"packet": WARP, "stream": 128, "frustum": WARP}
"""Rays of a warp."""

BLOCKS = {"packet": 16, "stream": 6, "frustum": 12}
"""Blocks of a multiprocessor, to which registers are bounded; of streams, shared memory allows no more."""


def threads_of(way: str, count: int) -> int:
    """Threads of a launch for this many rays: whole warps."""
    return -(-count // RAYS[way]) * WARP


@cache
def make_kernel(way: str, query: str, levels: int, from_zero: bool) -> wp.Kernel:
    """The kernel of a way for a query "closest" or "any".

    Args:
        way: one of `WAYS`.
        query: a kind of answer.
        levels: greatest number of inner nodes on a path of the tree.
        from_zero: whether t_min is 0 for all rays.
    """
    options = f"{levels + 1}, wrt::{ANSWER_CLASSES[query]}, 0, 0, 0"
    walks = f"wrt::walks_of<{options}>(wrt::one_tree(tree, triangles), rays, hits, hits, hits)"

    @native.func_native("warp_packets.h", f"wrt::walk_together<wrt::{WAYS[way]}, {int(from_zero)}>({walks}, i);")
    def walk(tree: BinaryNodes, triangles: PackedTriangles, rays: RayBatch, hits: HitBatch, i: int): ...

    def warp_rays(first: int, tree: BinaryNodes, triangles: PackedTriangles, rays: RayBatch, hits: HitBatch):
        walk(tree, triangles, rays, hits, first + wp.tid())

    return specialised_kernel(warp_rays, bounds=(BLOCK, BLOCKS[way]))
