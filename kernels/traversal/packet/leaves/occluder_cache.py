"""Shadow caching for packets: the leaf that occluded one packet is tested first for the next (Haines and Greenberg 1986).

**Problem.** An any-hit query visits leaves from near to far, and a shadow ray starts on a surface. It visits the leaves around
its origin, which occlude nothing, before it reaches the occluder.

**Idea.** Neighbouring rays have the same occluder. The leaf in which the last active ray of a packet found its hit is kept, and
the next packet of the run tests it first. If it occludes all rays of that packet, no node and no other leaf is visited.

**Data.** One int behind the components of a packet: the number of the leaf's lane (node * width + lane) + 1, or 0 for none. It
is 0 if some rays of the last packet were unoccluded or its traversal was abandoned, at the start of each run of packets, and at
the start of each instance, whose tree is another one (`wrt.kernels.traversal.two_level.instance_packets`). The parts of a split
packet (`packet_splitting`) count as packets. The results do not depend on it, because an any-hit query only asks whether there
is a hit.

The effect depends on the size of the occluders: large in scenes of large triangles, none on fine meshes
(notebooks/records/2026-11-22-leaf-rays.md).

References:
    E. A. Haines, D. P. Greenberg: The light buffer: a shadow-testing accelerator. IEEE Computer Graphics and Applications 6(9),
        1986.
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime.options import exact_module
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout

exact_module(__name__)


@cache
def cached_leaf(layout: PacketLayout) -> wp.Function:
    """`wp.func(packet) -> int`: the stored leaf."""

    @wp.func_native(f"return ((const int*)packet.data)[{layout.occluder}];")
    def cached_leaf_native(packet: wp.array(dtype=float)) -> int: ...

    return cached_leaf_native


@cache
def cache_leaf(layout: PacketLayout) -> wp.Function:
    """`wp.func(packet, leaf)`: stores a leaf for the next packet; 0 for none."""

    @wp.func_native(f"((int*)packet.data)[{layout.occluder}] = leaf;")
    def cache_leaf_native(packet: wp.array(dtype=float), leaf: int): ...

    return cache_leaf_native
