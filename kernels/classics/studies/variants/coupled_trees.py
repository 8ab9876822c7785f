"""A BVH for wide packets and a kd-tree for small ones, in one traversal: for measurements.

**Problem.** Packets walk a BVH better than a kd-tree, and the wider they are, the more so. Single rays and small packets walked
a kd-tree better, say Cadet and Lecussan.

**Idea.** Both trees hold the same triangles. Each packet takes the BVH if more than `small` of its rays are active, else the
kd-tree. A packet whose rays diverge is split (`wrt.kernels.traversal.packet.core.packet_splitting`); each part chooses anew by
the number of its rays. Rays that still do not stay together are traced one by one, through either tree.

**Differences from the paper.** The paper was not at hand; this follows its abstract and the survey. It couples a BSP tree with
a binary BVH; ours are a kd-tree and a wide BVH. Whether the paper leaves one tree for the other on the way down is not known;
here a packet or a part of one walks one tree from the root.

**Limits.** Two trees take the memory and the building time of both, and both keep their own records of triangles. Figures:
notebooks/records/2026-11-23-coupled-trees.md.

References: cadet-lecussan-2007; rahikainen-2013 (section 3.2).
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.kdtree_nodes import KdNodes
from wrt.kernels.layout.ray_batch import HitBatch, Ray
from wrt.kernels.traversal.leaf import Counters
from wrt.kernels.traversal.packet import CULLINGS
from wrt.kernels.traversal.packet.core import packet_bvh, packet_kdtree
from wrt.kernels.traversal.packet.core.packet_kernel import PacketWalk, make_packet_kernel, packet_layout
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.single import single_bvh, single_kdtree
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks


@wp.struct
class CoupledTrees:
    """Both trees, and the triangles in the leaves of the kd-tree; those of the BVH are the kernel's."""

    bvh: WideNodes
    kdtree: KdNodes
    triangles: TriangleBlocks
    low: wp.vec3
    high: wp.vec3


@cache
def make_kernel(config: TraversalConfig, within: TraversalConfig, small: int, kdtree_singles: bool) -> wp.Kernel:
    """The kernel for one specialisation; its tree is a `CoupledTrees`.

    Args:
        config: of packets through the BVH.
        within: of packets through the kd-tree: the same, but for mailbox and culling. Its culling must bound slopes if that of
            `config` does, and must not need boxes (`wrt.kernels.traversal.packet.Culling`).
        small: greatest number of active rays of a packet that walks the kd-tree; 0 for none.
        kdtree_singles: whether rays that are traced one by one walk the kd-tree instead of the BVH.
    """
    walk_bvh, walk_kdtree = packet_bvh.make_packet_bvh_walk(config), packet_kdtree.make_packet_kdtree_walk(within)
    memory_size = max(packet_bvh.walk_memory(config), packet_kdtree.walk_memory(within))
    start_bvh = CULLINGS[config.packet.culling].start(packet_layout(config))  # the kernel itself calls that of `within`

    @wp.func
    def walk_packet(
        trees: wp.ref[CoupledTrees],
        triangles: wp.ref[TriangleBlocks],
        packet: wp.array(dtype=float),
        memory: wp.array(dtype=int),
        bounds: wp.ref[PacketBounds],
        work: wp.ref[Counters],
    ):
        completed = bool(False)
        if bounds.active <= wp.static(small):
            kdtree = trees.kdtree
            leaves = trees.triangles
            completed = walk_kdtree(kdtree, leaves, packet, memory, bounds, work)
        else:
            bvh = trees.bvh
            start_bvh(trees.low, trees.high, packet, bounds)
            completed = walk_bvh(bvh, triangles, packet, memory, bounds, work)
        return completed

    walk = PacketWalk(walk_packet, single_walk(config, kdtree_singles), packet_bvh.MIXED_AXES, memory_size)
    return make_packet_kernel(within, CoupledTrees, walk)


@cache
def single_walk(config: TraversalConfig, kdtree: bool) -> wp.Function:
    """`wp.func(trees, triangles, ray, hits, i, work) -> best`: traces one ray through the kd-tree or the BVH."""
    walk = single_kdtree.make_kdtree_walk(config) if kdtree else single_bvh.make_bvh_walk(config)

    @wp.func
    def walk_ray(
        trees: wp.ref[CoupledTrees],
        triangles: wp.ref[TriangleBlocks],
        ray: Ray,
        hits: wp.ref[HitBatch],
        i: int,
        work: wp.ref[Counters],
    ):
        if wp.static(kdtree):
            return walk(trees.kdtree, trees.triangles, ray, hits, i, work)
        else:  # decided when the kernel is made
            return walk(trees.bvh, triangles, ray, hits, i, work)

    return walk_ray
