"""Exact sweep SAH build of a bounding volume hierarchy: the reference for the binned build.

**Problem.** Bins approximate the best plane. An exact build is needed to measure what they lose.

**Algorithm.** The triangles are sorted by centroid once per axis. In a node, a sweep from the right computes the area of every
suffix, and a sweep from the left evaluates all n - 1 partitions of each axis. The sides of the best one are marked, and the
three lists are partitioned stably, so that they stay sorted. (The cost is that of Goldsmith and Salmon 1987.)

**Data.** Three lists of triangle ids, sorted by centroid, and the areas of the suffixes of one list (`Workspace`).

**Phases** of a node, called by `build_by_sweep`: `stop`, then `search` (`sweep_axis` for each axis), `partition`, which
classifies by `mark_sides`, and `emit_inner`, or `emit_leaf`.

Large nodes are split level by level, parallel over chunks of their lists (`sweep_levels`). The others are tasks, each of which
builds a subtree depth first.

**Complexity.** O(N log N) for a balanced tree. The tree is the same for any number of threads, chunks and tasks.

The build shares only the cost model, the stop rules and the collapse with the other builders.

References: goldsmith-salmon-1987; wald-2007-deformable.
"""

import numpy as np
import warp as wp

from wrt.builders.bvh.bvh_config import BuildRules, BvhConfig
from wrt.builders.bvh.phases.bin_heuristic import SURFACE
from wrt.builders.bvh.phases.binary_build import BinaryBuild
from wrt.builders.bvh.phases.binary_tree import (
    LEAF,
    BinaryTree,
    Frame,
    child_of,
    empty_tree,
    half_area,
    middle,
    must_split_at_median,
    split_cost,
)
from wrt.builders.bvh.phases.collapse import collapse_kernels, improved
from wrt.builders.bvh.phases.large_boxes import is_small
from wrt.builders.classics.bvh.reinsertion import find_insertion_positions
from wrt.builders.classics.bvh.sweep_levels import SweepLevels, bound_chunks
from wrt.builders.classics.bvh.sweep_lists import (
    Partition,
    SweepLists,
    area_of,
    emit_keys,
    empty_box,
    enlarged,
    mark_sides,
    sorted_lists,
    store_box,
)
from wrt.builders.cost import leaf_cost
from wrt.builders.tree import Bvh, Phases
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.kernels.layout.bvh_nodes import MAX_WIDE_DEPTH
from wrt.kernels.runtime.launch import get_num_threads, launch, load
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.boxes import INFINITY

exact_module(__name__)

STACK = MAX_WIDE_DEPTH + 1

TASKS_PER_THREAD = 2
"""A node of more than its share of triangles, if there were so many tasks per thread, is split by all threads together."""

MIN_LARGE = 4096
"""Triangles below which a node is not worth more than one thread."""


@wp.func
def sweep_axis(rules: BuildRules, lists: SweepLists, frame: Frame, axis: int, best: Partition):
    """The better of `best` and the partitions along an axis; ties go to `best`, then to the smaller left side."""
    box = empty_box()
    for k in range(frame.count - 1):
        i = frame.first + frame.count - 1 - k
        box = enlarged(box, lists, lists.sorted[axis, frame.buffer + i])
        lists.suffix[axis, i] = area_of(box)
    box = empty_box()
    for left in range(1, frame.count):
        i = frame.first + left
        box = enlarged(box, lists, lists.sorted[axis, frame.buffer + i - 1])
        cost = split_cost(
            area_of(box), leaf_cost(rules.cost, left), lists.suffix[axis, i], leaf_cost(rules.cost, frame.count - left)
        )
        if cost < best.cost:
            best.cost = cost
            best.axis = axis
            best.left = left
    return best


@wp.func
def search(rules: BuildRules, lists: SweepLists, tree: BinaryTree, frame: Frame):
    """The partition of least cost; the middle of the list if there is no finite cost, or the tree is too deep."""
    best = Partition()
    best.cost = INFINITY
    if half_area(tree.box, frame.node) > 0.0 and not must_split_at_median(frame.depth, frame.count):
        for axis in range(3):
            best = sweep_axis(rules, lists, frame, axis, best)
    if best.cost == INFINITY:
        best.left = middle(frame.count, rules.cost.width_bits)
    return best


@wp.func
def partition(lists: SweepLists, frame: Frame, best: Partition):
    """Classifies by `mark_sides`, and partitions the three lists of a node stably."""
    mark_sides(lists, frame, best, frame.first, frame.first + frame.count)
    for axis in range(3):
        left = frame.buffer + frame.first
        right = int(0)
        for i in range(frame.buffer + frame.first, frame.buffer + frame.first + frame.count):
            triangle = lists.sorted[axis, i]
            if lists.on_left[triangle] == wp.uint8(1):
                lists.sorted[axis, left] = triangle
                left += 1
            else:
                lists.spare[frame.first + right] = triangle
                right += 1
        for i in range(right):
            lists.sorted[axis, left + i] = lists.spare[frame.first + i]


@wp.func
def write_box(lists: SweepLists, frame: Frame, tree: BinaryTree):
    """Writes the box of a node's triangles."""
    box = empty_box()
    for i in range(frame.first, frame.first + frame.count):
        box = enlarged(box, lists, lists.sorted[0, frame.buffer + i])
    store_box(tree.box, frame.node, box)


@wp.func
def emit_leaf(lists: SweepLists, frame: Frame, tree: BinaryTree):
    """Writes a leaf: its triangles in the order along x."""
    tree.pair[frame.node] = LEAF
    for i in range(frame.first, frame.first + frame.count):
        tree.order[i] = lists.sorted[0, frame.buffer + i]


@wp.func
def emit_inner(tree: BinaryTree, frame: Frame, pair: int):
    """Writes an inner node, whose children are a pair."""
    tree.pair[frame.node] = pair


@wp.kernel
def build_by_sweep(
    first: int,
    rules: BuildRules,
    lists: SweepLists,
    tasks: wp.array(dtype=Frame),
    stack: wp.array2d(dtype=Frame),
    tree: BinaryTree,
    subtrees: wp.array(dtype=wp.vec2i),
):
    """Item: a task. stack: (tasks, STACK). subtrees: (tasks,) ranges of the pairs made."""
    number = first + wp.tid()
    frame = tasks[number]
    begin = frame.first + 1
    next_pair = frame.first + 1
    waiting = int(0)
    building = bool(True)
    while building:
        write_box(lists, frame, tree)
        tree.range[frame.node] = wp.vec2i(frame.first, frame.count)
        if is_small(rules, tree, frame.node, frame.count):
            emit_leaf(lists, frame, tree)
            waiting -= 1
            building = waiting >= 0
            if building:
                frame = stack[number, waiting]
        else:
            best = search(rules, lists, tree, frame)
            partition(lists, frame, best)
            emit_inner(tree, frame, next_pair)
            stack[number, waiting] = child_of(frame, best.left, next_pair, 1)
            waiting += 1
            frame = child_of(frame, best.left, next_pair, 0)
            next_pair += 1
    subtrees[number] = wp.vec2i(begin, next_pair)


def kernels(config: BvhConfig, triangles: int) -> list[wp.Kernel]:
    """One kernel of each module that a build needs, of any number of triangles."""
    moving = [find_insertion_positions] if config.reinsertion else []
    return [emit_keys, bound_chunks, build_by_sweep, *moving, *collapse_kernels(SURFACE)]


def build(triangles: TriangleBoxes, config: BvhConfig) -> Bvh:
    """Builds the tree on the device that holds the boxes."""
    device, count, rules = triangles.boxes.low.device, triangles.count, config.struct()
    load(kernels(config, count), device)  # compilation is not a phase of the build
    phase, threads = Phases(device), get_num_threads()
    large = max(MIN_LARGE, count // (TASKS_PER_THREAD * threads)) if threads > 1 else count
    tree = empty_tree(count, device)
    with phase("sort"):
        lists = sorted_lists(triangles)
    with phase("top levels"):
        levels = SweepLevels(rules, lists, tree, large)
        levels.split()
        frames, top = levels.tasks(), levels.pairs
    with phase("subtrees"):
        tasks = wp.array(frames, dtype=Frame, device=device)
        stack = wp.empty((len(tasks), STACK), dtype=Frame, device=device)
        subtrees = wp.empty(len(tasks), dtype=wp.vec2i, device=device)
        inputs = [rules, lists, tasks, stack, tree, subtrees]
        launch(build_by_sweep, len(tasks), inputs, device=device, chunk=1, chunks_per_thread=len(tasks))
    above = wp.array(np.concatenate(top), dtype=int, device=device) if top else None
    binary = BinaryBuild(tree, subtrees, above, wp.empty(16 * count, dtype=float, device=device))
    return improved(binary, triangles, config, phase)
