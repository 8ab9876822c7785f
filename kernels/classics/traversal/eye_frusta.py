"""Multi-frusta tracing of rays from one point, such as eye rays (Benthin and Wald 2009), on a wide BVH.

**Problem.** One frustum around many rays is loose; one around few has few rays to share its steps.

**Idea.** A block of the picture is divided into 16 small frusta, each of one vector of rays with the common origin. They walk
the tree together: a child that the block meets as a whole is tested against all frusta in one lane loop, since intervals of
directions are all that distinguishes them. Each frustum ends by itself, once its rays have nearer hits than all that waits.

**Steps.**

1. `frustum_at`: the frusta of a block of a picture lie side by side, 16 x 16 pixels for tiles of 8 x 2.
2. `gather_directions`, `bound_block`: the bounds of each frustum come from the ends of its directions; no ray is made.
3. `push_children`: children of a node that the block meets as a whole are tested against each frustum. A child waits with the t
   at which each frustum enters it.
4. At leaves each frustum that meets the leaf is a packet of its own. Its rays, with their inverses, slopes and what the
   triangle test prepares, are made when it first meets a triangle (`make_rays`): frusta that see nothing never have any. All
   cullings of packets apply (`wrt.kernels.traversal.packet`), corner rays among them, on the bounds of the directions before
   the rays are made and on those of the rays after it. Where back faces are to be culled, triangles that turn their back to all
   directions of the frustum are, before any ray is tested (`wrt.kernels.traversal.packet.culling.back_faces`).

**A child against 16 frusta.** With one origin o, a ray enters the widened slab of a box at (low - (o + slack)) / d if it goes
forward, and at (high - (o - slack)) / d if it goes backward. Let `ahead` be the first distance and `behind` the second one with
its sign changed: at most one of them is positive. They are numbers of the box, the same for all frusta; what differs are the
ends of the interval of 1 / d. A frustum has, for each axis:

    near_forward   least 1 / d of the rays that go forward; the largest float if there are none
    near_backward  least -1 / d of the rays that go backward; likewise
    far_forward    greatest 1 / d if all rays go forward; inf if they go both ways, 0 if all go backward
    far_backward   greatest -1 / d if all rays go backward; inf if they go both ways, 0 if all go forward

No ray enters before ahead * near_forward, nor before behind * near_backward, and all of them have left after the greater one of
-behind * far_forward and -ahead * far_backward. These are the products that each ray computes (`wrt.kernels.simd.boxes`), with
factors that are not less, or not greater; rounding is monotone. A product 0 * inf is NaN, which bounds nothing.

**Both signs.** Where an interval of directions contains 0, nothing is known of the far planes, and a box is beyond the frustum
if it lies farther along the axis than the farthest-going ray gets while it is within the other slabs: the box around the rays
against the node's box, as Benthin and Wald have it, within these limits.

**Memory**, rows of 16 floats from the first cache line on: 12 rows of factors in the order above, x, y, z each; `t_min` and
`t_max`, the ranges; `block`, the same 14 numbers for all frusta as one; `origin`, o + slack and o - slack; then the stack, for
each waiting child the t at which each frustum enters its box, inf for those that miss it. Which child it is, is in another
array.

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

from wrt.kernels.layout import bvh_nodes as bvh
from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.ray_batch import HitBatch, RayBatch
from wrt.kernels.layout.unchecked import CACHE_LINE, load_int
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import specialised_kernel
from wrt.kernels.simd.lanes import lowest_bit
from wrt.kernels.traversal.leaf import CounterRows, Counters
from wrt.kernels.traversal.packet import CULLINGS, CullingTraits
from wrt.kernels.traversal.packet.core.packet_bvh import visit_leaf
from wrt.kernels.traversal.packet.core.packet_kernel import packet_layout
from wrt.kernels.traversal.packet.culling.interval_culling import cull_triangles
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout
from wrt.kernels.traversal.packet.rays.packet_load import load_packet
from wrt.kernels.traversal.packet.rays.packet_store import clear_packet, store_packet
from wrt.kernels.traversal.packet.rays.ray_numbers import TILE_COLUMNS
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks

FRUSTA = 16
"""Frusta of a block."""

RUN = 4
"""Blocks per item. They share its local memory, which Warp clears once per item."""

_STACK = 16

_ROWS = f"wrt::FrustumRows<{FRUSTA}>(lanes.data)"


def rays_per_item(config: TraversalConfig) -> int:
    """Rays of a run of blocks; an item of the kernel is one run."""
    return RUN * FRUSTA * config.packet.rays


def max_waiting(config: TraversalConfig) -> int:
    """Children that may wait at a time."""
    return config.stack.levels * (config.width - 1) + config.width


def lane_memory(waiting: int) -> int:
    """Floats of the memory of a block, for a stack of this many children."""
    return (_STACK + waiting) * FRUSTA + CACHE_LINE


@cache
def frustum_at(packet: int) -> wp.Function:
    """`wp.func(rays, place) -> int`: number of the frustum at a place in the order of blocks; packet: rays of a frustum.

    The frusta of a picture are numbered row by row of tiles. Blocks take several rows of them, column by column. Pictures whose
    columns are no multiple of a tile's, and the tiles of a last row that is not complete, are taken as they are numbered.
    """
    across = min(packet, int(TILE_COLUMNS))
    down = packet // across
    rows = 4 if down >= 4 else 8

    @wp.func
    def find(rays: RayBatch, place: int):
        columns = rays.columns / wp.static(across)
        if columns * wp.static(across) != rays.columns or wp.static(packet % across != 0):
            return place
        if rays.columns == 0:
            return place
        bands = rays.count / rays.columns / wp.static(down)
        if place >= bands * columns:
            return place
        above = place / (wp.static(rows) * columns) * wp.static(rows)
        height = wp.min(wp.static(rows), bands - above)
        within = place - above * columns
        return (above + within % height) * columns + within / height

    return find


@cache
def gather_directions(layout: PacketLayout) -> wp.Function:
    """`wp.func(rays, first, lanes, f)`: the ends of the directions and of the ranges of the P rays at `first`, in lane f.

    No ray is made. An interval of no active ray is inf .. -inf.
    """
    code = f"wrt::gather_directions<{layout.rays}, {layout.width}>(rays, first, {_ROWS}, f);"

    @native.func_native("frustum.h", code)
    def gather_directions_native(rays: RayBatch, first: int, lanes: wp.array(dtype=float), f: int): ...

    return gather_directions_native


@native.func_native("frustum.h", f"wrt::bound_block(rays, low, high, {_ROWS}, count);")
def bound_block(rays: RayBatch, low: wp.vec3, high: wp.vec3, lanes: wp.array(dtype=float), count: int):
    """Derives the factors of a block from the ends of the directions of its first `count` frusta; low, high: bounds of the
    scene."""


@native.func_native("frustum.h", f"wrt::frustum_bounds({_ROWS}, f, bounds);")
def frustum_bounds(lanes: wp.array(dtype=float), f: int, bounds: wp.ref[PacketBounds]):
    """Sets what `wrt.kernels.traversal.packet.culling.interval_culling` reads to the bounds of lane f."""


@cache
def push_children(width: int) -> wp.Function:
    """`wp.func(boxes, node, lanes, slots, top) -> top`: pushes the children of a node that frusta meet, nearest last.

    Only those that the block meets as a whole are tested against each frustum. top: children that wait so far. A child is given
    by its slot, node * W + lane.
    """
    box = f"boxes.data + (size_t)node * {6 * width}"

    @native.func_native(
        "frustum.h",
        f"""static_assert(wrt::FrustumRows<{FRUSTA}>::STACK == {_STACK});
        return wrt::push_children<{width}>({box}, node, {_ROWS}, slots.data, top);""",
    )
    def push_children_native(
        boxes: wp.array(dtype=float), node: int, lanes: wp.array(dtype=float), slots: wp.array(dtype=int), top: int
    ) -> int: ...

    return push_children_native


@native.func_native("frustum.h", f"return wrt::frusta_waiting({_ROWS}, place);")
def frusta_waiting(lanes: wp.array(dtype=float), place: int) -> wp.uint32:
    """The frusta that enter a waiting child before their best hits, one bit each."""


@native.func_native("frustum.h", f"{_ROWS}.t_max[f] = end;")
def shorten_frustum(lanes: wp.array(dtype=float), f: int, end: float):
    """Sets the end of a frustum's range; -inf if all of its rays are done."""


@cache
def make_rays(config: TraversalConfig) -> wp.Function:
    """`wp.func(tree, triangles, rays, begin, child, packet, bounds) -> bool`: makes the rays of a frustum that meets a triangle
    of a leaf, and says whether it does.

    begin: its first ray. bounds: those of its directions, which become those of the rays.
    """
    layout, culling, width = packet_layout(config), CULLINGS[config.packet.culling], config.width
    load = load_packet(layout, CullingTraits.SLOPES in culling.traits)
    start, cull = culling.start(layout), cull_triangles(layout)

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

    @wp.func
    def make(
        tree: wp.ref[WideNodes],
        triangles: wp.ref[TriangleBlocks],
        rays: wp.ref[RayBatch],
        begin: int,
        child: int,
        packet: wp.array(dtype=float),
        bounds: wp.ref[PacketBounds],
    ):
        if not meets(triangles, bvh.first_block(child), bvh.leaf_triangles(child), bounds):
            return False
        load(rays, begin, tree.low, tree.high, packet, bounds)
        start(tree.low, tree.high, packet, bounds)
        return True

    return make


@wp.struct
class FrustaMemory:
    """The packets of a block of frusta."""

    packets: wp.array2d(dtype=float)
    bounds: wp.array(dtype=PacketBounds)


@wp.func
def frusta_memory(packets: wp.array2d(dtype=float), bounds: wp.array(dtype=PacketBounds)):
    """A struct of arrays that a kernel has made: Warp lets only a function's arguments become fields."""
    memory = FrustaMemory()
    memory.packets = packets
    memory.bounds = bounds
    return memory


@cache
def make_walk(config: TraversalConfig) -> wp.Function:
    """`wp.func(tree, triangles, rays, block, frusta, lanes, slots, work) -> mask`: traces a block of frusta.

    Returns those whose rays were made. block: place of the first of them in the order of blocks.
    """
    packet_rays, width, counting = config.packet.rays, config.width, config.counters
    make, visit = make_rays(config), visit_leaf(config, False)
    push, order = push_children(width), frustum_at(packet_rays)

    @wp.func
    def walk(
        tree: wp.ref[WideNodes],
        triangles: wp.ref[TriangleBlocks],
        rays: wp.ref[RayBatch],
        block: int,
        frusta: wp.ref[FrustaMemory],
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
                        frustum_bounds(lanes, f, frusta.bounds[f])
                        begin = order(rays, block + f) * wp.static(packet_rays)
                        if make(tree, triangles, rays, begin, child, frusta.packets[f], frusta.bounds[f]):
                            made |= bit
                    if made & bit != wp.uint32(0):
                        node, lane = slot / wp.static(width), slot % wp.static(width)
                        visit(tree, triangles, node, lane, frusta.packets[f], frusta.bounds[f], slots, work)
                        shorten_frustum(lanes, f, frusta.bounds[f].t_max)
        return made

    return walk


@cache
def make_eye_frusta_kernel(config: TraversalConfig) -> wp.Kernel:
    """The kernel for one specialisation; its packets are frusta."""
    config = replace(config, packet=replace(config.packet, shared_origin=True))
    layout, waiting = packet_layout(config), max_waiting(config)
    gather, order, walk = gather_directions(layout), frustum_at(layout.rays), make_walk(config)
    clear, store = clear_packet(layout), store_packet(layout, config.answer.rules.ends_at_first)
    packet_rays, size, lanes_size, counting = layout.rays, layout.size, lane_memory(waiting), config.counters

    def multi_frusta(
        first: int, tree: WideNodes, triangles: TriangleBlocks, rays: RayBatch, hits: HitBatch, counters: CounterRows
    ):
        """Traces a run of blocks. Item: a run."""
        packets = wp.zeros(shape=(FRUSTA, size), dtype=float)
        bounds = wp.zeros(shape=(FRUSTA,), dtype=PacketBounds)
        memory = frusta_memory(packets, bounds)
        lanes = wp.zeros(shape=(lanes_size,), dtype=float)
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
            made = walk(tree, triangles, rays, block, memory, lanes, slots, work)
            for f in range(frusta):
                if made & (wp.uint32(1) << wp.uint32(f)) == wp.uint32(0):
                    clear(packets[f])
                store(packets[f], rays, order(rays, block + f) * wp.static(packet_rays), hits, False)
            if wp.static(counting):
                counters.rows[block * wp.static(packet_rays)] = work
            block += wp.static(FRUSTA)

    return specialised_kernel(multi_frusta)
