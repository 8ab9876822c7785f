"""Multi-frusta tracing of rays from one point, such as eye rays (Benthin and Wald 2009), on a wide BVH.

**Problem.** One frustum around many rays is loose; one around few has few rays to share its steps.

**Idea.** A block of the picture is divided into 16 small frusta, each of one vector of rays with the common origin. They walk
the tree together: a child that the block meets as a whole is tested against all frusta in one lane loop, since intervals of
directions are all that distinguishes them (`frustum_lanes`). A child waits with the t at which each frustum enters it. Each
frustum ends by itself, once its rays have nearer hits than all that waits.

**Rays on demand.** The bounds of a frustum come from the ends of its directions. Its rays, with their inverses, slopes and what
the triangle test prepares, are made when it first meets a triangle: frusta that see nothing never have any.

**At leaves** each frustum that meets the leaf is a packet of its own. All cullings of packets apply (`wrt.kernels.traversal.
packet`), corner rays among them, on the bounds of the directions before the rays are made and on those of the rays after it.
Where back faces are to be culled, triangles that turn their back to all directions of the frustum are, before any ray is
tested (`wrt.kernels.traversal.packet.culling.back_faces`).

**Differences from the paper.** The tree is wide, so the block as a whole is tested first, with the children in lanes; the paper
tests boxes one by one. The paper's frusta are shadow rays to an area light (`wrt.kernels.traversal.shadows.multi_frusta`); here
any hits are a switch. No ray needs another traversal: both signs along all three axes are allowed.

**Limits.** All rays of the batch must start at one point. On CUDA a thread traces a block, which is correct but slow. Figures:
notebooks/records/2026-11-23-multi-frusta.md.

References: benthin-wald-2009; rahikainen-2013 (section 2.3).
"""

from dataclasses import replace
from functools import cache

import warp as wp

from wrt.kernels.classics.traversal.frustum_lanes import (
    FRUSTA,
    bound_block,
    frusta_waiting,
    frustum_bounds,
    gather_directions,
    lane_memory,
    push_children,
    shorten_frustum,
)
from wrt.kernels.classics.traversal.frustum_order import frustum_at
from wrt.kernels.layout import bvh_nodes as bvh
from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.ray_batch import HitBatch, RayBatch
from wrt.kernels.layout.unchecked import load_int
from wrt.kernels.runtime.options import exact_module, specialised_kernel
from wrt.kernels.simd.lanes import lowest_bit
from wrt.kernels.traversal.leaf import CounterRows, Counters
from wrt.kernels.traversal.packet import CULLINGS, CullingTraits
from wrt.kernels.traversal.packet.core.packet_bvh import visit_leaf
from wrt.kernels.traversal.packet.core.packet_kernel import packet_layout
from wrt.kernels.traversal.packet.culling.interval_culling import cull_triangles
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_load import load_packet
from wrt.kernels.traversal.packet.rays.packet_store import clear_packet, store_packet
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks

exact_module(__name__)

RUN = 4
"""Blocks per item. They share its local memory, which Warp clears once per item."""


def rays_per_item(config: TraversalConfig) -> int:
    """Rays of a run of blocks; an item of the kernel is one run."""
    return RUN * FRUSTA * config.packet.rays


def most_waiting(config: TraversalConfig) -> int:
    """Children that may wait at a time."""
    return config.stack.levels * (config.width - 1) + config.width


@cache
def meets_triangles(config: TraversalConfig) -> wp.Function:
    """`wp.func(triangles, first, count, bounds) -> bool`: whether a frustum meets some of the `count` triangles from a block
    on."""
    cull, width = cull_triangles(packet_layout(config)), config.width

    @wp.func
    def meets(triangles: TriangleBlocks, first: int, count: int, bounds: wp.ref[PacketBounds]):
        block = int(first)
        rest = int(count)
        while rest > 0:
            if cull(triangles.records, block, bounds) != wp.uint32(0):
                return True
            block += 1
            rest -= wp.static(width)
        return False

    return meets


@cache
def make_walk(config: TraversalConfig) -> wp.Function:
    """`wp.func(tree, triangles, rays, block, packets, bounds, lanes, slots, work) -> mask`: traces a block of frusta.

    Returns those whose rays were made. block: place of the first of them in the order of blocks.
    """
    layout, culling = packet_layout(config), CULLINGS[config.packet.culling]
    load, start, visit = (
        load_packet(layout, CullingTraits.SLOPES in culling.traits),
        culling.start(layout),
        visit_leaf(config, False),
    )
    push, meets, order = push_children(config.width), meets_triangles(config), frustum_at(layout.rays)
    width, counting, packet_rays = config.width, config.counters, layout.rays

    @wp.func
    def walk(
        tree: wp.ref[WideNodes],
        triangles: wp.ref[TriangleBlocks],
        rays: wp.ref[RayBatch],
        block: int,
        packets: wp.array2d(dtype=float),
        bounds: wp.array(dtype=PacketBounds),
        lanes: wp.array(dtype=float),
        slots: wp.array(dtype=int),
        work: wp.ref[Counters],
    ):
        made = wp.uint32(0)
        top = push(tree.bounds, 0, lanes, slots, 0)
        if wp.static(counting):
            work.nodes += 1
            work.boxes += wp.static(width)
        while top > 0:
            top -= 1
            waiting = frusta_waiting(lanes, top)
            if waiting == wp.uint32(0):
                continue
            slot = load_int(slots, top)
            child = load_int(tree.child, slot)
            if child >= 0:
                top = push(tree.bounds, child, lanes, slots, top)
                if wp.static(counting):
                    work.nodes += 1
                    work.boxes += wp.static(width)
            else:
                while waiting != wp.uint32(0):
                    f = lowest_bit(waiting)
                    waiting &= waiting - wp.uint32(1)
                    bit = wp.uint32(1) << wp.uint32(f)
                    if made & bit == wp.uint32(0):
                        frustum_bounds(lanes, f, bounds[f])
                        if meets(triangles, bvh.first_block(child), bvh.leaf_triangles(child), bounds[f]):
                            begin = order(rays, block + f) * wp.static(packet_rays)
                            load(rays, begin, tree.low, tree.high, packets[f], bounds[f])
                            start(tree.low, tree.high, packets[f], bounds[f])
                            made |= bit
                    if made & bit != wp.uint32(0):
                        visit(
                            tree,
                            triangles,
                            slot / wp.static(width),
                            slot % wp.static(width),
                            packets[f],
                            bounds[f],
                            slots,
                            work,
                        )
                        shorten_frustum(lanes, f, bounds[f].t_max)
        return made

    return walk


@cache
def make_eye_frusta_kernel(config: TraversalConfig) -> wp.Kernel:
    """The kernel for one specialisation; its packets are frusta."""
    config = replace(config, packet=replace(config.packet, shared_origin=True))
    layout, waiting = packet_layout(config), most_waiting(config)
    gather, order, walk = gather_directions(layout), frustum_at(layout.rays), make_walk(config)
    clear, store = clear_packet(layout), store_packet(layout, config.answer.ends_at_first)
    packet_rays, size, memory, counting = layout.rays, layout.size, lane_memory(waiting), config.counters

    def multi_frusta(
        first: int,
        tree: WideNodes,
        triangles: TriangleBlocks,
        rays: RayBatch,
        hits: HitBatch,
        counters: CounterRows,
    ):
        """Traces a run of blocks. Item: a run."""
        packets = wp.zeros(shape=(FRUSTA, size), dtype=float)
        bounds = wp.zeros(shape=(FRUSTA,), dtype=PacketBounds)
        lanes = wp.zeros(shape=(memory,), dtype=float)
        slots = wp.zeros(shape=(waiting,), dtype=int)
        total = (rays.count - 1) / wp.static(packet_rays) + 1
        block = (first + wp.tid()) * wp.static(RUN * FRUSTA)
        end = wp.min(block + wp.static(RUN * FRUSTA), total)
        while block < end:
            frusta = wp.min(wp.static(FRUSTA), total - block)
            work = Counters()
            for f in range(frusta):
                gather(rays, order(rays, block + f) * wp.static(packet_rays), lanes, f)
            bound_block(rays, tree.low, tree.high, lanes, frusta)
            made = walk(tree, triangles, rays, block, packets, bounds, lanes, slots, work)
            for f in range(frusta):
                if made & (wp.uint32(1) << wp.uint32(f)) == wp.uint32(0):
                    clear(packets[f])
                store(packets[f], rays, order(rays, block + f) * wp.static(packet_rays), hits, False)
            if wp.static(counting):
                counters.rows[block * wp.static(packet_rays)] = work
            block += wp.static(FRUSTA)

    return specialised_kernel(multi_frusta)
