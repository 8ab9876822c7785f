"""Shadow caching for packets: the leaf that occluded one packet is tested first for the next (Haines and Greenberg 1986).

**Problem.** An any-hit query visits leaves from near to far, and a shadow ray starts on a surface. It visits the leaves around
its origin, which occlude nothing, before it reaches the occluder.

**Idea.** Neighbouring rays have the same occluder. The leaf in which the last active ray of a packet found its hit is kept, and
the next packet of the run tests it first. If it occludes all rays of that packet, no node and no other leaf is visited.

**Data.** Two ints behind the components of a packet. One is the number of the leaf's lane (node * width + lane) + 1, or 0 for
none. It is 0 if some rays of the last packet were unoccluded or its traversal was abandoned, at the start of each run of
packets, and at the start of each instance, whose tree is another one (`wrt.kernels.traversal.two_level.instance_packets`). The
other counts packets in succession that this leaf has occluded before anything else was visited: then a triangle of it may
cover the next ones as a whole (`wrt.kernels.traversal.packet.leaves.covering_triangle`). The parts of a split packet
(`packet_splitting`) count as packets. The results do not depend on this, because an any-hit query only asks whether there is a
hit.

The effect depends on the size of the occluders: large in scenes of large triangles, none on fine meshes
(notebooks/records/2026-11-22-leaf-rays.md).

References: haines-greenberg-1986.
"""

from functools import cache

import warp as wp

from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout


@cache
def cached_leaf(layout: PacketLayout) -> wp.Function:
    """`wp.func(packet) -> int`: the stored leaf."""

    @wp.func_native(f"return ((const int*)packet.data)[{layout.occluder}];")
    def cached_leaf_native(packet: wp.array(dtype=float)) -> int: ...

    return cached_leaf_native


@cache
def cache_leaf(layout: PacketLayout) -> wp.Function:
    """`wp.func(packet, leaf, at_once)`: stores a leaf for the next packet, 0 for none, and counts the packets that it alone has
    occluded."""
    code = f"""
    ((int*)packet.data)[{layout.occluder}] = leaf;
    int& count = ((int*)packet.data)[{layout.at_once}];
    count = at_once ? count + 1 : 0;
"""

    @wp.func_native(code)
    def cache_leaf_native(packet: wp.array(dtype=float), leaf: int, at_once: bool): ...

    return cache_leaf_native


@cache
def covering_leaf(layout: PacketLayout) -> wp.Function:
    """`wp.func(packet) -> int`: the stored leaf if it has occluded enough packets alone to ask for the next ones together; else
    0."""
    code = f"return ((const int*)packet.data)[{layout.at_once}] > 0 ? ((const int*)packet.data)[{layout.occluder}] : 0;"

    @wp.func_native(code)
    def covering_leaf_native(packet: wp.array(dtype=float)) -> int: ...

    return covering_leaf_native


@cache
def wait_for_packets(layout: PacketLayout, count: int) -> wp.Function:
    """`wp.func(packet)`: as many more packets are to be occluded at once before `covering_leaf` is not 0 again."""

    @wp.func_native(f"((int*)packet.data)[{layout.at_once}] = {1 - count};")
    def wait_native(packet: wp.array(dtype=float)): ...

    return wait_native
