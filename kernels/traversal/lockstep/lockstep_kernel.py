"""Lockstep traversal of a kd-tree: each lane of a vector walks its own ray; for incoherent rays.

**Problem.** A single ray waits for the node that it loads and for mispredicted branches. Neighbouring rays share their paths,
so packets amortise the waiting; random rays and ambient occlusion rays do not.

**Idea.** Incoherent rays share only the program. GPUs run one ray per lane: Foley and Sugerman traversed kd-trees without a
stack, Horn et al. with a short one. Aila and Laine found that the work of the lanes (a step, or the test of a leaf) must be
scheduled so that the lanes stay together. Here the lanes are those of the CPU's vectors. Rays need not be coherent or agree in
the signs of their directions, unlike in the packets of Wald et al.; nodes, axes and stacks differ from lane to lane.

**Phases**, repeated until the item's run of rays is used up:
1. refill: idle lanes take the next rays of the run;
2. step: all lanes at inner nodes take steps. Lanes at leaves wait until at most half of the lanes with a ray are still
   stepping: Aila and Laine's "while-while" loop with a threshold;
3. test: the blocks of the leaves reached, one ray against W triangles, as for single rays. The first blocks of all lanes are
   tested first, then the second ones, so that neighbouring iterations do not depend on each other's best hit;
4. pop: the next cell on the lane's stack, by the rule of `wrt.kernels.traversal.single.single_kdtree`; if there is none, the
hit is written.

A step computes what the step of a single ray computes, from the same numbers: nodes, leaves and triangles visited are the same,
and so are the hits, to the bit.

**Use.** For lazy trees, and for batches too small to pay for the wide form of a kd-tree, in which streams are faster
(`wrt.builders.convert.wide_kdtree`). Steps are cheap, so finer trees pay (`wrt.KdTree(block_cost=1.5, empty_factor=1.0)`).
Figures: notebooks/records/2026-11-21-single-rays.md.

**Limits.** Camera rays gain nothing, and shadow rays to a point light lose, because their branches are predicted well in
`single_kdtree`. On CUDA one thread processes all lanes in a loop, which is correct but slow; there each hardware lane should
have a ray, as in `single_kdtree`. A run is 64 rays per lane, so small batches occupy few threads.

**Lanes.** Each of L lanes walks its own ray (`kernels/native/lockstep.h`). Node, interval and ray are vectors over the lanes,
so a step through inner nodes is a few vector instructions, whatever nodes, axes and directions the lanes have. The formulas are
those of `step_selecting` of `wrt.kernels.traversal.single.single_kdtree`.

**The log.** A stack per lane, indexed by the lane's own size, would need a scatter for every vector that is written. Here all
lanes write to the same row, whether they have an entry to push or not, and the next step writes to the next row: plain stores.
The valid rows of a lane form a linked list, from the lane's `top` through the field `below`. When all rows are used, the linked
ones are moved to the front. No lane links more rows than the tree's depth, so at least half of the rows become free.

    log[((row * 4 + field) * L) + lane]    fields: far node, its entry, its leave (bits of float32), row below or -1

References: foley-sugerman-2005; horn-2007; aila-laine-2009; wald-2001.
"""

from functools import cache

import warp as wp

from wrt.kernels.answers.answer_kind import BestHit, start
from wrt.kernels.layout.kdtree_nodes import LEAF, MAX_TREE_DEPTH, KdNodes
from wrt.kernels.layout.ray_batch import HitBatch, Ray, RayBatch, load_ray
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import specialised_kernel
from wrt.kernels.simd.boxes import RaySlabs, ray_slabs, reach
from wrt.kernels.simd.lanes import count_bits, lanes, lowest_bit
from wrt.kernels.traversal.leaf import CounterRows, Counters, block_step, enter
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks

ROWS = 2 * MAX_TREE_DEPTH
"""Number of rows of the log."""

FIELDS = 4
"""Fields per lane in a row."""


@cache
def walks(count: int) -> type:
    """The struct of `count` walks; a vector over the lanes for each number."""
    Floats = lanes(count)
    Ints = wp.types.vector(length=count, dtype=wp.int32)

    class Walks:
        inverse_x: Floats
        inverse_y: Floats
        inverse_z: Floats
        in_x: Floats
        in_y: Floats
        in_z: Floats
        out_x: Floats
        out_y: Floats
        out_z: Floats
        node: Ints
        entry: Floats
        leave: Floats
        best: Floats
        top: Ints
        word0: Ints
        word1: Ints
        nodes: Ints

    Walks.__doc__ = """The `RaySlabs` of the rays by component, and the state of the walks:

    node, entry, leave: current node, and the interval of t in which the ray may be inside it.
    best: t of the best hit so far; before the first hit t_max.
    top: row of the log with the next cell, -1 if there is none.
    word0, word1: words of the node; see `wrt.kernels.layout.kdtree_nodes`.
    nodes: number of inner nodes visited, if work is counted.
    """
    return wp.struct(Walks)


@cache
def lane_start(count: int) -> wp.Function:
    """`func(walks, lane, slabs, interval, t_max)`: places a ray at the root; `interval` is its interval in the scene's box."""
    Walks = walks(count)

    @native.func_native("lockstep.h", "wrt::start_walk(walks, lane, slabs, interval.c, t_max);")
    def start_lane(walks: wp.ref[Walks], lane: int, slabs: RaySlabs, interval: wp.vec2, t_max: float): ...

    return start_lane


@cache
def advance(count: int, counting: bool) -> wp.Function:
    """`func(nodes, walks, log, row, min_walking) -> uint32`: steps until fewer than `min_walking` lanes are at inner
    nodes, or the log is full.

    Returns the mask of the lanes at leaves; `row` is the next free row of the log.
    """
    Walks = walks(count)

    form = f"{count}, {ROWS}, {int(counting)}"

    @native.func_native("lockstep.h", f"return wrt::advance_walks<{form}>(nodes.data, walks, log.data, row, min_walking);")
    def advance_lanes(
        nodes: wp.array(dtype=wp.vec2i), walks: wp.ref[Walks], log: wp.array(dtype=int), row: wp.ref[int], min_walking: int
    ) -> wp.uint32: ...

    return advance_lanes


@cache
def skip_blocks(count: int, width: int) -> wp.Function:
    """`func(walks, blocks) -> uint32`: removes `blocks` blocks from the front of every leaf; returns the mask of leaves with
    triangles left.

    Results for lanes at inner nodes are undefined.
    """
    Walks = walks(count)

    @native.func_native("lockstep.h", f"return wrt::skip_leaf_blocks<{count}, {width}>(walks, blocks);")
    def skip_leaf_blocks(walks: wp.ref[Walks], blocks: int) -> wp.uint32: ...

    return skip_leaf_blocks


@cache
def pop(count: int) -> wp.Function:
    """`func(walks, log, at_leaf) -> uint32`: moves the lanes of the mask to the next cell in their log.

    Returns the mask of the lanes that have none. A cell whose entry lies beyond the best hit is dropped, and the interval of a
    visited cell is clipped to the best hit. Most lanes find their cell at the first attempt, in vectors; lanes that drop a cell
    continue one by one.
    """
    Walks = walks(count)

    @native.func_native("lockstep.h", f"return wrt::pop_walks<{count}>(walks, log.data, at_leaf);")
    def pop_lanes(walks: wp.ref[Walks], log: wp.array(dtype=int), at_leaf: wp.uint32) -> wp.uint32: ...

    return pop_lanes


@cache
def compact(count: int) -> wp.Function:
    """`func(walks, log) -> int`: moves the linked rows to the start of the log; returns the first free row.

    Rows are moved oldest first: the k-th oldest is in row k or later, so no row is overwritten before it is moved.
    """
    Walks = walks(count)

    @native.func_native("lockstep.h", f"return wrt::compact_log<{count}, {MAX_TREE_DEPTH}>(walks, log.data);")
    def compact_log(walks: wp.ref[Walks], log: wp.array(dtype=int)) -> int: ...

    return compact_log


RAYS_PER_LANE = 64
"""Rays of an item per lane: enough that idle lanes at the end of a run do not matter."""


def lane_count(config: TraversalConfig) -> int:
    """Lanes of a group: two vectors, if the block width is the native width."""
    return 2 * config.width


def rays_per_item(config: TraversalConfig) -> int:
    """Length of a run."""
    return RAYS_PER_LANE * lane_count(config)


@cache
def leaf_phase(config: TraversalConfig) -> wp.Function:
    """`wp.func(triangles, group, states, slabs, t_min, best, at_leaf)`: tests the leaves of the lanes in the mask `at_leaf`."""
    RayState = TRIANGLE_TESTS[config.triangle_test].ray_state
    Walks = walks(lane_count(config))
    test_block = block_step(config)
    skip_leaf_blocks = skip_blocks(lane_count(config), config.width)
    any_hit = config.answer.rules.ends_at_first

    @wp.func
    def test_leaves(
        triangles: TriangleBlocks,
        group: wp.ref[Walks],
        states: wp.array(dtype=RayState),
        slabs: wp.array(dtype=RaySlabs),
        t_min: wp.array(dtype=float),
        best: wp.array(dtype=BestHit),
        at_leaf: wp.uint32,
    ):
        untested = skip_leaf_blocks(group, 0) & at_leaf
        while untested != wp.uint32(0):
            remaining = wp.uint32(untested)
            while remaining != wp.uint32(0):
                lane = lowest_bit(remaining)
                remaining &= remaining - wp.uint32(1)
                found = test_block(triangles, group.word0[lane], states[lane], slabs[lane], t_min[lane], best[lane])
                best[lane] = found
                group.best[lane] = found.t
                if wp.static(any_hit) and found.primitive >= 0:
                    group.word1[lane] = LEAF  # no more triangles to test in this leaf
                    group.top[lane] = -1
            untested = skip_leaf_blocks(group, 1) & untested

    return test_leaves


@cache
def make_refill(config: TraversalConfig) -> wp.Function:
    """`wp.func(tree, ray, lane, group, states, slabs, t_min, best) -> bool`: puts a ray into a lane.

    Returns False if the ray misses the scene; `best` is then its result.
    """
    test = TRIANGLE_TESTS[config.triangle_test]
    prepare, RayState = test.prepare, test.ray_state
    Walks, start_lane = walks(lane_count(config)), lane_start(lane_count(config))

    @wp.func
    def refill_lane(
        tree: KdNodes,
        ray: Ray,
        lane: int,
        group: wp.ref[Walks],
        states: wp.array(dtype=RayState),
        slabs: wp.array(dtype=RaySlabs),
        t_min: wp.array(dtype=float),
        best: wp.array(dtype=BestHit),
    ):
        best[lane] = start(ray.t_max)
        interval = wp.vec2(1.0, 0.0)
        ray_slab = RaySlabs()
        if ray.valid:
            ray_slab = ray_slabs(ray.origin, ray.direction, reach(ray.origin, tree.low, tree.high))
            interval = enter(ray_slab, tree.low, tree.high, ray.t_min, ray.t_max)
        enters_scene = interval[0] <= interval[1]
        if enters_scene:
            start_lane(group, lane, ray_slab, interval, ray.t_max)
            slabs[lane] = ray_slab
            states[lane] = prepare(ray.origin, ray.direction)
            t_min[lane] = ray.t_min
        return enters_scene

    return refill_lane


@cache
def make_lockstep_kernel(config: TraversalConfig) -> wp.Kernel:
    """The kernel for one specialisation."""
    RayState, counting = TRIANGLE_TESTS[config.triangle_test].ray_state, config.counters
    count, run = lane_count(config), rays_per_item(config)
    Walks, refill_lane, advance_lanes = walks(count), make_refill(config), advance(count, counting)
    pop_lanes, compact_log = pop(count), compact(count)
    test_leaves, store = leaf_phase(config), config.answer.stored.store
    all_lanes = (1 << count) - 1

    def lockstep_kdtree(
        first: int,
        tree: KdNodes,
        triangles: TriangleBlocks,
        rays: RayBatch,
        hits: HitBatch,
        counters: CounterRows,
    ):
        """Traces a run of consecutive rays. Item: a run."""
        next_ray = (first + wp.tid()) * wp.static(run)
        end = wp.min(next_ray + wp.static(run), rays.count)
        group = Walks()
        log = wp.zeros(shape=(wp.static(ROWS * FIELDS * count),), dtype=int)
        number = wp.zeros(shape=(wp.static(count),), dtype=int)
        slabs = wp.zeros(shape=(wp.static(count),), dtype=RaySlabs)
        states = wp.zeros(shape=(wp.static(count),), dtype=RayState)
        t_min = wp.zeros(shape=(wp.static(count),), dtype=float)
        best = wp.zeros(shape=(wp.static(count),), dtype=BestHit)
        idle_node = tree.nodes.shape[0] - 1  # in depth-first order the last node is a leaf: idle lanes take no step
        for lane in range(wp.static(count)):
            group.node[lane] = idle_node
            group.top[lane] = -1
        busy = wp.uint32(0)
        rows = int(0)
        while next_ray < end or busy != wp.uint32(0):
            # refill
            idle = wp.static(wp.uint32(all_lanes)) & ~busy
            while idle != wp.uint32(0) and next_ray < end:
                lane = lowest_bit(idle)
                ray = load_ray(rays, next_ray)
                if refill_lane(tree, ray, lane, group, states, slabs, t_min, best):
                    number[lane] = next_ray
                    idle &= idle - wp.uint32(1)
                    busy |= wp.uint32(1) << wp.uint32(lane)
                else:
                    store(hits, next_ray, best[lane])
                if wp.static(counting):
                    counters.rows[next_ray] = Counters()
                next_ray += 1
            # step
            if rows == wp.static(ROWS):
                rows = compact_log(group, log)
            at_leaf = advance_lanes(tree.nodes, group, log, rows, count_bits(busy) / 2 + 1) & busy
            if wp.static(counting):
                remaining = wp.uint32(at_leaf)
                while remaining != wp.uint32(0):
                    lane = lowest_bit(remaining)
                    remaining &= remaining - wp.uint32(1)
                    counters.rows[number[lane]].leaves += 1
                    counters.rows[number[lane]].triangles += group.word1[lane] >> 2
            # test
            test_leaves(triangles, group, states, slabs, t_min, best, at_leaf)
            # pop
            done = pop_lanes(group, log, at_leaf)
            busy &= ~done
            while done != wp.uint32(0):
                lane = lowest_bit(done)
                done &= done - wp.uint32(1)
                store(hits, number[lane], best[lane])
                group.node[lane] = idle_node
                if wp.static(counting):
                    counters.rows[number[lane]].nodes = group.nodes[lane]

    return specialised_kernel(lockstep_kdtree)
