"""Several rays taken through a wide BVH in turn, one step each. For rays that have nothing in common.

**Problem.** A step of a single ray is a chain: the least key, its child, the child's boxes, their entries, the least of
those. None of it can begin before what comes before it is done, and where the processor guesses ahead (is a level exhausted,
is the child a leaf), it guesses wrong for random rays every second time. Most of a core's arithmetic units are idle.

**Idea.** Take a few rays and make a step of each in turn: their chains do not depend on one another, so the processor works
on several at a time. That needs steps without branches, because a wrong guess throws away the work on all rays. A step
tests the boxes of the child *and* finds the least key one level up, and selects; a ray at a leaf, or done, repeats a step
that changes nothing. Leaves are tested when two of the rays wait at one, and rays that are done make room for the next.

**Measured** (Zen 5, bunny, one thread): random rays 1.1 to 1.2 times as fast as one by one, with 8 rays under way (4, 6, 12
and 16 were tried, and waiting for one to four rays); ambient occlusion 0.9 to 1.0 times: occluded rays take few steps, and
what a step gains is lost in steps that change nothing.

References:
    I. Wald, C. Benthin, S. Boulos: Getting rid of packets: efficient SIMD single-ray traversal using multi-branching BVHs.
        IEEE Symposium on Interactive Ray Tracing 2008 (the step).
    T. Aila, S. Laine: Understanding the efficiency of ray traversal on GPUs. High Performance Graphics 2009 (waiting at
        leaves for company).
"""

from functools import cache

import warp as wp

from wrt.kernels import bvh
from wrt.kernels.box_lanes import NO_CHILD, NO_CHILD_CONSTANT, nearest_child, ray_boxes
from wrt.kernels.boxes import RaySlabs, ray_slabs, reach
from wrt.kernels.bvh import WideNodes
from wrt.kernels.lanes import FOR_LANES, count_bits, lowest_bit
from wrt.kernels.rays import HitBatch, RayBatch, load_ray
from wrt.kernels.traversal.config import ANY, TraversalConfig
from wrt.kernels.traversal.leaf import Candidate, Counters, block_step, start, store_best
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.records import TriangleBlocks

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

SLOTS = 8
"""Rays under way at a time."""

COMPANY = 2
"""Rays that wait at leaves, or are done, before leaves are tested."""

RUN = 256
"""Rays of an item."""


@wp.struct
class Walk:
    """Where a ray is. Level 0 is above the root: no keys there, and the end of the search."""

    slabs: RaySlabs
    t_min: float
    t_max: float
    """Of the best hit so far."""
    level: int
    key: int
    """Least key of the level."""
    child: int
    """The child that the last step looked at."""
    nodes: int


_ADVANCE = """
    unsigned waiting = 0;
    for (int s = 0; s < SLOTS; ++s) {
        auto& walk = walks.data[s];
        const int level = walk.level, least = walk.key, lane = least & (W - 1), above = level > 0 ? level - 1 : 0;
        int *rows = &keys.data[s * ROWS * W], *row = rows + level * W, *nodes = &path.data[s * ROWS];
        const int here = nodes[level], word = child.data[here * W + lane];
        const bool near = __builtin_bit_cast(float, least & -W) <= walk.t_max;
        const bool inner = near & (word >= 0), leaf = near & (word < 0);
        row[lane] = NO_CHILD;
        const int node = inner ? word : here;
        nodes[level + 1] = node;
        const float* box = &bounds.data[(size_t)node * (6 * W)];
        const float ix = walk.slabs.inverse.c[0], iy = walk.slabs.inverse.c[1], iz = walk.slabs.inverse.c[2];
        const int sx = ix < 0.0f ? 3 * W : 0, sy = iy < 0.0f ? 3 * W : 0, sz = iz < 0.0f ? 3 * W : 0;
        const float *near_x = box + sx, *near_y = box + W + sy, *near_z = box + 2 * W + sz;
        const float *far_x = box + 3 * W - sx, *far_y = box + 4 * W - sy, *far_z = box + 5 * W - sz;
        const float in_x = walk.slabs.origin_in.c[0], in_y = walk.slabs.origin_in.c[1], in_z = walk.slabs.origin_in.c[2];
        const float out_x = walk.slabs.origin_out.c[0], out_y = walk.slabs.origin_out.c[1], out_z = walk.slabs.origin_out.c[2];
        const float t_min = walk.t_min, t_max = walk.t_max;
        int* down = row + W;
        const int* up = rows + above * W;
        int least_down = NO_CHILD, least_up = NO_CHILD;
        WRT_FOR_LANES(i) {
            float enter = t_min, leave = t_max, t;
            t = (near_x[i] - in_x) * ix; enter = t > enter ? t : enter;
            t = (near_y[i] - in_y) * iy; enter = t > enter ? t : enter;
            t = (near_z[i] - in_z) * iz; enter = t > enter ? t : enter;
            t = (far_x[i] - out_x) * ix; leave = t < leave ? t : leave;
            t = (far_y[i] - out_y) * iy; leave = t < leave ? t : leave;
            t = (far_z[i] - out_z) * iz; leave = t < leave ? t : leave;
            int k = (__builtin_bit_cast(int, enter) & -W) | i;
            k = enter <= leave ? k : NO_CHILD;
            down[i] = k;
            least_down = k < least_down ? k : least_down;
        }
        WRT_FOR_LANES(i) { least_up = up[i] < least_up ? up[i] : least_up; }
        walk.child = word;
        walk.nodes += inner ? 1 : 0;
        walk.key = inner ? least_down : leaf ? least : least_up;
        walk.level = inner ? level + 1 : leaf ? level : above;
        waiting |= (leaf | (walk.level == 0)) ? 1u << s : 0u;
    }
    return waiting;
"""


@cache
def advance(width: int, rows: int) -> wp.Function:
    """`wp.func(bounds, child, walks, keys, path) -> mask`: one step of every ray; the rays at a leaf, or done."""
    constants = f"    constexpr int W = {width}, ROWS = {rows}, SLOTS = {SLOTS}, NO_CHILD = {NO_CHILD_CONSTANT};"

    @wp.func_native(FOR_LANES + constants + _ADVANCE)
    def advance_native(
        bounds: wp.array(dtype=float),
        child: wp.array(dtype=int),
        walks: wp.array(dtype=Walk),
        keys: wp.array(dtype=int),
        path: wp.array(dtype=int),
    ) -> wp.uint32: ...

    return advance_native


def rays_per_item(config: TraversalConfig) -> int:
    """Length of a run."""
    return RUN


@cache
def make_kernel(config: TraversalConfig) -> wp.Kernel:
    """The kernel for one specialisation."""
    test = TRIANGLE_TESTS[config.triangle_test]
    prepare, RayState = test.prepare, test.ray_state
    width, counting, any_hit = config.width, config.counters, config.query == ANY
    rows = config.levels + 2
    advance_rays, nearest, test_boxes = advance(width, rows), nearest_child(width), ray_boxes(width)
    test_block, store = block_step(config), store_best(config)
    all_slots = (1 << SLOTS) - 1

    def interleaved_bvh(
        first: int,
        tree: WideNodes,
        triangles: TriangleBlocks,
        rays: RayBatch,
        hits: HitBatch,
        counters: wp.array(dtype=Counters),
    ):
        """Item: a run of consecutive rays."""
        upcoming = (first + wp.tid()) * wp.static(RUN)
        end = wp.min(upcoming + wp.static(RUN), rays.count)
        walks = wp.zeros(shape=(wp.static(SLOTS),), dtype=Walk)
        keys = wp.zeros(shape=(wp.static(SLOTS * rows * width),), dtype=int)
        path = wp.zeros(shape=(wp.static(SLOTS * rows),), dtype=int)
        number = wp.zeros(shape=(wp.static(SLOTS),), dtype=int)
        states = wp.zeros(shape=(wp.static(SLOTS),), dtype=RayState)
        best = wp.zeros(shape=(wp.static(SLOTS),), dtype=Candidate)
        for slot in range(wp.static(SLOTS)):
            walks[slot].key = NO_CHILD
            for i in range(width):
                keys[slot * wp.static(rows * width) + i] = NO_CHILD
        idle = wp.uint32(wp.static(all_slots))
        running = bool(True)
        while running:
            while idle != wp.uint32(0) and upcoming < end:
                ray = load_ray(rays, upcoming)
                if wp.static(counting):
                    counters[upcoming] = Counters()
                if ray.valid:
                    slot = lowest_bit(idle)
                    idle = idle & (idle - wp.uint32(1))
                    slabs = ray_slabs(ray.origin, ray.direction, reach(ray.origin, tree.low, tree.high))
                    number[slot] = upcoming
                    states[slot] = prepare(ray.origin, ray.direction)
                    best[slot] = start(ray.t_max)
                    walks[slot].slabs = slabs
                    walks[slot].t_min = ray.t_min
                    walks[slot].t_max = ray.t_max
                    walks[slot].level = 1
                    walks[slot].nodes = 1
                    path[slot * rows + 1] = 0
                    walks[slot].key = test_boxes(tree.bounds, 0, slabs, ray.t_min, ray.t_max, keys, (slot * rows + 1) * width)
                else:
                    store(hits, upcoming, start(ray.t_max))
                upcoming += 1
            waiting = advance_rays(tree.bounds, tree.child, walks, keys, path)
            while count_bits(waiting) < wp.static(COMPANY):
                waiting = advance_rays(tree.bounds, tree.child, walks, keys, path)
            todo = waiting & ~idle
            while todo != wp.uint32(0):
                slot = lowest_bit(todo)
                todo = todo & (todo - wp.uint32(1))
                if walks[slot].level > 0:
                    child = walks[slot].child
                    count = bvh.leaf_triangles(child)
                    block = bvh.first_block(child)
                    found = best[slot]
                    if wp.static(counting):
                        counters[number[slot]].leaves += 1
                        counters[number[slot]].triangles += count
                    while count > 0:
                        found = test_block(triangles, block, states[slot], walks[slot].slabs, walks[slot].t_min, found)
                        block += 1
                        count -= wp.static(width)
                    best[slot] = found
                    walks[slot].t_max = found.t
                    walks[slot].key = nearest(keys, (slot * rows + walks[slot].level) * width)
                    if wp.static(any_hit) and found.primitive >= 0:
                        walks[slot].level = 0
                        walks[slot].key = NO_CHILD
                if walks[slot].level == 0:
                    store(hits, number[slot], best[slot])
                    idle = idle | (wp.uint32(1) << wp.uint32(slot))
                    if wp.static(counting):
                        counters[number[slot]].nodes = walks[slot].nodes
            running = upcoming < end or idle != wp.uint32(wp.static(all_slots))

    return wp.kernel(interleaved_bvh, module="unique", enable_backward=False, module_options={"fuse_fp": False})
