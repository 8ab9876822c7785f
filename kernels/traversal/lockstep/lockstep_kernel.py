"""Lockstep traversal of a kd-tree: each lane of a vector walks its own ray. For rays that have nothing in common.

**Problem.** A single ray waits: for the node that it loads, for the processor that guessed the wrong child or the wrong end
of a loop. Neighbouring rays share ways, so packets of them amortise that; random rays, or ambient occlusion, do not.

**Idea.** What incoherent rays have in common is the program. GPUs run one ray a lane: Foley and Sugerman walked kd-trees so,
without a stack, Horn et al. with a short one; Aila and Laine found that what a lane does (step, or test a leaf) has to be
arranged for the lanes to stay together. Here the lanes are those of the CPU's vectors. Rays need not be coherent, nor agree
in the signs of their directions, as they must in Wald's packets; nodes, axes and stacks differ from lane to lane.

**Phases**, repeated until the item's run of rays is used up:
1. refill: lanes without a ray take the next ones of the run;
2. step: all lanes at inner nodes take a step, again and again (`wrt.kernels.traversal.lockstep.lockstep_lanes`); lanes at
   leaves wait, until no more than half of those that have a ray still step: Aila and Laine's "while-while" with a threshold;
3. test: the blocks of the leaves reached, one ray against W triangles as single rays do; the first blocks of all lanes, then
   the second ones, so that neighbours in this loop do not wait for each other's best hit;
4. pop: the next waiting cell, by the rule of `wrt.kernels.traversal.single.single_kdtree`; where none is left, the hit is
written.

A step computes what a single ray's step computes, from the same numbers: nodes, leaves and triangles visited are the same,
and so are the hits, to the bit.

**Measured** (Zen 5; bunny, the same tree): random rays 1.7 times as fast as `single`, ambient occlusion 1.5 times; 75 and 68
of 100 lanes take a step in a step. It is now so cheap that finer trees pay: 1.85 and 1.7 times with
`wrt.KdTree(block_cost=1.5, empty_factor=1.0)`. Two vectors of lanes are a tenth faster than one: one waits for its nodes
while the other computes. Sorting a run by octant, or by the origin's cell, gained nothing even when the sorting was not
counted; nor did fetching the blocks of leaves ahead.

**Where it is used.** For trees that are lazy, and for batches too small to pay for the wide form of a kd-tree, through which
streams are 2 to 3 times as fast (`wrt.builders.convert.wide_kdtree`): what is left to gain here is bounded by a tree whose
every step waits for a load of its own, 18 of them and 4 leaves a random ray of the bunny, where a wide node decides as much in
four.

**Limits.** Camera rays gain nothing, shadow rays to a point light lose a tenth: one by one, they are guessed well. On CUDA a
thread has all lanes, in a loop: right, but slow; there each of the hardware's lanes should have a ray, which is what `single`
does. A run is 64 rays a lane, so small batches occupy few threads.

References:
    T. Foley, J. Sugerman: KD-tree acceleration structures for a GPU raytracer. Graphics Hardware 2005.
    D. R. Horn, J. Sugerman, M. Houston, P. Hanrahan: Interactive k-d tree GPU raytracing. Symposium on Interactive 3D
        Graphics and Games (I3D) 2007.
    T. Aila, S. Laine: Understanding the efficiency of ray traversal on GPUs. High Performance Graphics 2009.
    I. Wald, P. Slusallek, C. Benthin, M. Wagner: Interactive rendering with coherent ray tracing. Eurographics 2001.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.kdtree_nodes import LEAF, KdNodes
from wrt.kernels.layout.ray_batch import HitBatch, RayBatch, load_ray
from wrt.kernels.simd.boxes import RaySlabs, ray_slabs, reach
from wrt.kernels.simd.lanes import count_bits, lowest_bit
from wrt.kernels.traversal.leaf import Candidate, CounterRows, Counters, block_step, enter, start, store_best
from wrt.kernels.traversal.lockstep.lockstep_lanes import FIELDS, ROWS, advance, board, compact, filled, pop, walks
from wrt.kernels.traversal.traversal_config import ANY, TraversalConfig
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

RAYS_PER_LANE = 64
"""Rays of an item, a lane: enough that the end of a run, when lanes go empty, does not matter."""


def lane_count(config: TraversalConfig) -> int:
    """Rays under way at a time: two vectors, if blocks are as wide as suits the device."""
    return 2 * config.width


def rays_per_item(config: TraversalConfig) -> int:
    """Length of a run."""
    return RAYS_PER_LANE * lane_count(config)


@cache
def leaf_phase(config: TraversalConfig) -> wp.Function:
    """`wp.func(triangles, group, states, slabs, t_min, best, arrived)`: tests the leaves of the lanes in the mask `arrived`."""
    RayState = TRIANGLE_TESTS[config.triangle_test].ray_state
    Walks = walks(lane_count(config))
    test_block = block_step(config)
    filled_lanes = filled(lane_count(config), config.width)
    any_hit = config.query == ANY

    @wp.func
    def test_leaves(
        triangles: TriangleBlocks,
        group: wp.ref[Walks],
        states: wp.array(dtype=RayState),
        slabs: wp.array(dtype=RaySlabs),
        t_min: wp.array(dtype=float),
        best: wp.array(dtype=Candidate),
        arrived: wp.uint32,
    ):
        untested = filled_lanes(group, 0) & arrived
        while untested != wp.uint32(0):
            todo = wp.uint32(untested)
            while todo != wp.uint32(0):
                lane = lowest_bit(todo)
                todo &= todo - wp.uint32(1)
                found = test_block(triangles, group.word0[lane], states[lane], slabs[lane], t_min[lane], best[lane])
                best[lane] = found
                group.best[lane] = found.t
                if wp.static(any_hit) and found.primitive >= 0:
                    group.word1[lane] = LEAF  # as if the leaf had no more triangles
                    group.top[lane] = -1
            untested = filled_lanes(group, 1) & untested

    return test_leaves


@cache
def boarding(config: TraversalConfig) -> wp.Function:
    """`wp.func(tree, rays, i, lane, group, states, slabs, t_min, best) -> bool`: gives a lane ray number i; False if that does
    not meet the scene, and then `best` is its answer."""
    test = TRIANGLE_TESTS[config.triangle_test]
    prepare, RayState = test.prepare, test.ray_state
    Walks, board_lane = walks(lane_count(config)), board(lane_count(config))

    @wp.func
    def board_ray(
        tree: KdNodes,
        rays: RayBatch,
        i: int,
        lane: int,
        group: wp.ref[Walks],
        states: wp.array(dtype=RayState),
        slabs: wp.array(dtype=RaySlabs),
        t_min: wp.array(dtype=float),
        best: wp.array(dtype=Candidate),
    ):
        ray = load_ray(rays, i)
        best[lane] = start(ray.t_max)
        interval = wp.vec2(1.0, 0.0)
        ray_slab = RaySlabs()
        if ray.valid:
            ray_slab = ray_slabs(ray.origin, ray.direction, reach(ray.origin, tree.low, tree.high))
            interval = enter(ray_slab, tree.low, tree.high, ray.t_min, ray.t_max)
        meets = interval[0] <= interval[1]
        if meets:
            board_lane(group, lane, ray_slab, interval, ray.t_max)
            slabs[lane] = ray_slab
            states[lane] = prepare(ray.origin, ray.direction)
            t_min[lane] = ray.t_min
        return meets

    return board_ray


@cache
def make_kernel(config: TraversalConfig) -> wp.Kernel:
    """The kernel for one specialisation."""
    RayState, counting = TRIANGLE_TESTS[config.triangle_test].ray_state, config.counters
    count, run = lane_count(config), rays_per_item(config)
    Walks, board_ray, advance_lanes = walks(count), boarding(config), advance(count, counting)
    pop_lanes, compact_log = pop(count), compact(count)
    test_leaves, store = leaf_phase(config), store_best(config)
    all_lanes = (1 << count) - 1

    def lockstep_kdtree(
        first: int,
        tree: KdNodes,
        triangles: TriangleBlocks,
        rays: RayBatch,
        hits: HitBatch,
        counters: CounterRows,
    ):
        """Item: a run of consecutive rays."""
        upcoming = (first + wp.tid()) * wp.static(run)
        end = wp.min(upcoming + wp.static(run), rays.count)
        group = Walks()
        log = wp.zeros(shape=(wp.static(ROWS * FIELDS * count),), dtype=int)
        number = wp.zeros(shape=(wp.static(count),), dtype=int)
        slabs = wp.zeros(shape=(wp.static(count),), dtype=RaySlabs)
        states = wp.zeros(shape=(wp.static(count),), dtype=RayState)
        t_min = wp.zeros(shape=(wp.static(count),), dtype=float)
        best = wp.zeros(shape=(wp.static(count),), dtype=Candidate)
        resting_place = tree.nodes.shape[0] - 1  # depth first, the last node is a leaf: lanes without a ray take no step
        for lane in range(wp.static(count)):
            group.node[lane] = resting_place
            group.top[lane] = -1
        busy = wp.uint32(0)
        rows = int(0)
        while upcoming < end or busy != wp.uint32(0):
            # refill
            idle = wp.static(wp.uint32(all_lanes)) & ~busy
            while idle != wp.uint32(0) and upcoming < end:
                lane = lowest_bit(idle)
                if board_ray(tree, rays, upcoming, lane, group, states, slabs, t_min, best):
                    number[lane] = upcoming
                    idle &= idle - wp.uint32(1)
                    busy |= wp.uint32(1) << wp.uint32(lane)
                else:
                    store(hits, upcoming, best[lane])
                if wp.static(counting):
                    counters.rows[upcoming] = Counters()
                upcoming += 1
            # step
            if rows == wp.static(ROWS):
                rows = compact_log(group, log)
            arrived = advance_lanes(tree.nodes, group, log, rows, count_bits(busy) / 2 + 1) & busy
            if wp.static(counting):
                todo = wp.uint32(arrived)
                while todo != wp.uint32(0):
                    lane = lowest_bit(todo)
                    todo &= todo - wp.uint32(1)
                    counters.rows[number[lane]].leaves += 1
                    counters.rows[number[lane]].triangles += group.word1[lane] >> 2
            # test
            test_leaves(triangles, group, states, slabs, t_min, best, arrived)
            # pop
            done = pop_lanes(group, log, arrived)
            busy &= ~done
            while done != wp.uint32(0):
                lane = lowest_bit(done)
                done &= done - wp.uint32(1)
                store(hits, number[lane], best[lane])
                group.node[lane] = resting_place
                if wp.static(counting):
                    counters.rows[number[lane]].nodes = group.nodes[lane]

    return wp.kernel(lockstep_kdtree, module="unique", enable_backward=False, module_options={"fuse_fp": False})
