"""Single-ray traversal of a wide BVH: W boxes at a time, then W triangles at a time.

**Problem.** In a binary tree, one ray has little to compute between two decisions. With W children per node, a step tests W
boxes in the lanes of one loop, and the tree is log2(W) times shallower (Wald, Benthin and Boulos 2008; Dammertz, Hanika and
Keller 2008; Ernst and Greiner 2008).

**Two forms of the step.** The children that a ray meets are not sorted onto a stack: the length of that list, and every
comparison in the sort, is a branch that the processor cannot predict. Each level keeps its W keys, and the next child is their
minimum, computed in the lanes (`wrt.kernels.traversal.single.key_walk`). Up to four children, and on CUDA, where the lanes of a
thread are a loop, the ray continues with the nearest child and pushes the others on a stack, with their entries, unsorted.
Figures: notebooks/records/2026-11-21-single-rays.md.

**The stack** of the second form: children to be visited, each with its t of entry. On the CPU it is in local memory. Warp
clears local memory, which is negligible there, but on CUDA it is hundreds of stores per ray
(notebooks/records/2026-11-21-single-rays.md). There the stack is in the block's shared memory, which is not cleared,
interleaved word by word for all threads of the block, so that neighbouring threads use different banks.

References: wald-2008; dammertz-2008; ernst-greiner-2008.
"""

from dataclasses import dataclass
from functools import cache

import warp as wp

from wrt.kernels.answers.answer_kind import BestHit, start
from wrt.kernels.layout import bvh_nodes as bvh
from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.ray_batch import Ray
from wrt.kernels.layout.unchecked import load_int
from wrt.kernels.simd.box_lanes import intersected_boxes
from wrt.kernels.simd.boxes import INFINITY, BoxRay, RaySlabs, ray_slabs, reach
from wrt.kernels.simd.lanes import lanes
from wrt.kernels.traversal.crossings import make_leaf_step
from wrt.kernels.traversal.leaf import Counters, Leaf, begin_search, block_step, leaf_search
from wrt.kernels.traversal.single.key_walk import make_key_walk
from wrt.kernels.traversal.single.single_kernel import make_ray_kernel
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks

SHARED_BYTES = 48 * 1024
"""Shared memory in bytes that a block can use by default."""


@dataclass(frozen=True)
class WaitingStack:
    """The functions of a traversal stack.

    Attributes:
        local: ints of local memory that it needs.
        open: `wp.func(local memory) -> stack`.
        push: `wp.func(stack, place, child, entry)`.
        pop: `wp.func(stack, place, entry) -> child`, `entry` by reference.
    """

    local: int
    open: wp.Function
    push: wp.Function
    pop: wp.Function


def fits(size: int, threads: int) -> bool:
    """Whether the stacks of `threads` threads, of `size` children each, fit into the shared memory of a block."""
    return 0 < 8 * size * threads <= SHARED_BYTES


@cache
def waiting_stack(size: int, threads: int) -> WaitingStack:
    """A stack of up to `size` children; `threads`: threads per CUDA block, or 0 for local memory."""
    if fits(size, threads):
        local, step = 1, threads
        place = f"__shared__ int words[{2 * size * threads}]; return (unsigned long long)(words + threadIdx.x);"
    else:
        local, step = 2 * size, 1
        place = "return (unsigned long long)memory.data;"

    @wp.func_native(place)
    def open_stack(memory: wp.array(dtype=int)) -> wp.uint64: ...

    @wp.func_native(f"""
        int* words = (int*)stack + 2 * place * {step};
        words[0] = child; words[{step}] = __builtin_bit_cast(int, entry);
    """)
    def push(stack: wp.uint64, place: int, child: int, entry: float): ...

    @wp.func_native(f"""
        const int* words = (const int*)stack + 2 * place * {step};
        entry = __builtin_bit_cast(float, words[{step}]);
        return words[0];
    """)
    def pop(stack: wp.uint64, place: int, entry: wp.ref[float]) -> int: ...

    return WaitingStack(local, open_stack, push, pop)


STACKED = 4
"""Greatest number of children per node for which the walk uses a stack instead of keys."""


def make_bvh_walk(config: TraversalConfig) -> wp.Function:
    """`wp.func(tree, triangles, ray, hits, i, work) -> best` for ray number i, which must be valid."""
    return make_walk_with_stack(config) if config.width <= STACKED else make_walk_with_keys(config)


@cache
def make_leaf_loop(config: TraversalConfig, Tree: type) -> wp.Function:
    """`wp.func(tree, leaf, cells, search, hits, i, best, work) -> best`: tests the triangles of a leaf.

    leaf: `Leaf` that ray i is in. cells: the ray in the space of the tree. search: of the triangles, in theirs.
    """
    LeafSearch, nearest, Results = leaf_search(config.triangle_test), config.answer.nearest, config.answer.search.State
    test_block = block_step(config) if nearest else make_leaf_step(config, Tree)
    width, counting = config.width, config.counters

    @wp.func
    def test_blocks(
        tree: Tree,
        leaf: Leaf,
        cells: wp.ref[RaySlabs],
        search: wp.ref[LeafSearch],
        hits: wp.ref[Results],
        i: int,
        best: BestHit,
        work: wp.ref[Counters],
    ):
        block = int(leaf.block)
        count = int(leaf.count)
        if wp.static(counting):
            work.leaves += 1
            work.triangles += count
        while count > 0:
            if wp.static(not nearest):
                best = test_block(tree, leaf, block, search, cells, hits, i, best)
            else:
                best = test_block(search.triangles, block, search.state, search.slabs, search.t_min, best)
            block += 1
            count -= wp.static(width)
        return best

    return test_blocks


@cache
def make_leaf(config: TraversalConfig) -> wp.Function:
    """`wp.func(tree, child, search, hits, i, best, work) -> best`: tests the triangles of a leaf."""
    LeafSearch, Results = leaf_search(config.triangle_test), config.answer.search.State
    test_blocks = make_leaf_loop(config, WideNodes)

    @wp.func
    def test_leaf(
        tree: WideNodes,
        child: int,
        search: wp.ref[LeafSearch],
        hits: wp.ref[Results],
        i: int,
        best: BestHit,
        work: wp.ref[Counters],
    ):
        leaf = Leaf(child, wp.vec2(search.t_min, best.t), bvh.first_block(child), bvh.leaf_triangles(child))
        return test_blocks(tree, leaf, search.slabs, search, hits, i, best, work)

    return test_leaf


@cache
def inner_step(config: TraversalConfig) -> wp.Function:
    """`wp.func(tree, node, slabs, t_min, t_max, stack, waiting) -> child`: a step from an inner node.

    Returns the nearest child that the ray meets, or `EMPTY_LANE`; the others are pushed on the stack.
    """
    test_boxes, Lanes, width = intersected_boxes(config.width), lanes(config.width), config.width
    push = stack_of(config).push

    @wp.func
    def step(
        tree: WideNodes,
        node: int,
        slabs: wp.ref[RaySlabs],
        t_min: float,
        t_max: float,
        stack: wp.uint64,
        waiting: wp.ref[int],
    ):
        entry = Lanes()
        mask = test_boxes(tree.bounds, node, slabs, t_min, t_max, entry)
        child = int(bvh.EMPTY_LANE)
        nearest = float(INFINITY)
        for lane in range(wp.static(width)):
            if (mask >> wp.uint32(lane)) & wp.uint32(1) != wp.uint32(0):
                word = load_int(tree.child, node * wp.static(width) + lane)
                closer = entry[lane] < nearest
                if child != bvh.EMPTY_LANE:
                    push(stack, waiting, wp.where(closer, child, word), wp.where(closer, nearest, entry[lane]))
                    waiting += 1
                if closer or child == bvh.EMPTY_LANE:
                    child = word
                    nearest = entry[lane]
        return child

    return step


def stack_of(config: TraversalConfig) -> WaitingStack:
    """A stack with room for all children that a path can push."""
    return waiting_stack(config.stack.levels * (config.width - 1) + 1, config.stack.block)


@cache
def make_walk_with_stack(config: TraversalConfig) -> wp.Function:
    """The walk with a stack of children.

    It descends to a leaf before it tests one, so that the threads of a CUDA warp stay in the same phase for longer.
    """
    begin, test_leaf = begin_search(config.triangle_test), make_leaf(config)
    step, stacked = inner_step(config), stack_of(config)
    open_stack, pop, local = stacked.open, stacked.pop, stacked.local
    counting, any_hit, Results = config.counters, config.answer.rules.ends_at_first, config.answer.search.State

    @wp.func
    def walk_with_stack(
        tree: WideNodes, triangles: TriangleBlocks, ray: Ray, hits: wp.ref[Results], i: int, work: wp.ref[Counters]
    ):
        best = start(ray.t_max)
        slabs = ray_slabs(ray.origin, ray.direction, reach(ray.origin, tree.low, tree.high))
        search = begin(triangles, ray, slabs)
        stack = open_stack(wp.zeros(shape=(local,), dtype=int))
        waiting = int(0)
        child = int(0)
        searching = bool(True)
        while searching:
            while child >= 0:
                child = step(tree, child, slabs, ray.t_min, best.t, stack, waiting)
                if wp.static(counting):
                    work.nodes += 1
            if child != bvh.EMPTY_LANE:
                best = test_leaf(tree, child, search, hits, i, best, work)
                if wp.static(any_hit):
                    waiting = wp.where(best.primitive < 0, waiting, 0)
            searching = bool(False)
            while waiting > 0 and not searching:
                waiting -= 1
                entry = float(0.0)
                child = pop(stack, waiting, entry)
                searching = entry <= best.t
        return best

    return walk_with_stack


@cache
def make_walk_with_keys(config: TraversalConfig) -> wp.Function:
    """The walk with a row of keys per level."""
    LeafSearch, begin = leaf_search(config.triangle_test), begin_search(config.triangle_test)
    Results = config.answer.search.State
    walk_keys = make_key_walk(config, config.stack.levels, LeafSearch, make_leaf(config))

    @wp.func
    def walk_with_keys(
        tree: WideNodes, triangles: TriangleBlocks, ray: Ray, hits: wp.ref[Results], i: int, work: wp.ref[Counters]
    ):
        slabs = ray_slabs(ray.origin, ray.direction, reach(ray.origin, tree.low, tree.high))
        search = begin(triangles, ray, slabs)
        return walk_keys(tree, 0, BoxRay(slabs, ray.t_min), search, hits, i, start(ray.t_max), work)

    return walk_with_keys


@cache
def make_single_bvh_kernel(config: TraversalConfig) -> wp.Kernel:
    """The kernel for one specialisation."""
    return make_ray_kernel(config, WideNodes, make_bvh_walk(config))
