"""Exact sweep SAH build of a bounding volume hierarchy: the reference for the binned build.

**Problem.** Bins approximate the best plane. An exact build is needed to measure what they lose.

**Idea.** Sort the triangles by centroid once per axis. Then two passes over a sorted list give the cost of all of its n - 1
partitions: the box of a growing prefix in one, that of a growing suffix in the other. Partitioning a list stably leaves both
parts sorted, so no node sorts again. (The cost is that of Goldsmith and Salmon 1987.)

**Steps.**

1. `sorted_lists`: the boxes of all triangles, and their ids sorted by centroid along x, y and z.
2. `search`, in a node: for each axis, `sweep_axis` computes the area of every suffix from the right, then evaluates every
   partition from the left. The least cost wins; of equal ones the earlier axis, then the smaller left side.
3. `partition`: the sides are marked by the list of the best axis, and the three lists are partitioned, in order.
4. `build_by_sweep`: depth first, until a node is a leaf (`wrt.builders.bvh.phases.large_boxes.is_small`).

**Threads.** `split_large` splits the largest nodes on one thread; what is left are tasks, each of which builds a subtree. The
tree is the same for any number of threads and tasks.

**Complexity.** O(N log N) for a balanced tree: the sort, then O(N) per level. The build shares only the cost model, the stop
rules and the collapse with the other builders.

References: goldsmith-salmon-1987; wald-2007-deformable.
"""

import numpy as np
import warp as wp

from wrt.builders.bvh.bvh_config import BuildRules, BvhConfig
from wrt.builders.bvh.phases import binary_tree as binary
from wrt.builders.bvh.phases.bin_heuristic import SURFACE
from wrt.builders.bvh.phases.binary_build import BinaryBuild
from wrt.builders.bvh.phases.binary_tree import LEAF, BinaryTree, Frame, child_of, half_area
from wrt.builders.bvh.phases.collapse import collapse_kernels, improved
from wrt.builders.bvh.phases.large_boxes import is_small
from wrt.builders.classics.bvh.reinsertion import find_insertion_positions
from wrt.builders.cost import leaf_cost
from wrt.builders.radix_sort import sort_rows
from wrt.builders.tree import Bvh, Phases
from wrt.builders.triangle_boxes import Boxes, TriangleBoxes
from wrt.kernels.layout.bvh_nodes import MAX_WIDE_DEPTH
from wrt.kernels.runtime.launch import get_num_threads, launch, load
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.simd.boxes import INFINITY, max_of, min_of

STACK = MAX_WIDE_DEPTH + 1

TASKS_PER_THREAD = 2
"""A node of more than its share of triangles, with this many tasks per thread, is split before there are tasks."""

MIN_LARGE = 4096
"""Triangles below which a node is not worth more than one thread."""

EMIT_CHUNK = 4096
"""Triangles whose keys are worth a chunk of their own."""


@wp.struct
class SweepLists:
    """Memory of the build. A node has the same part, `frame.first` .. `frame.first + frame.count`, of each of the lists."""

    corner: wp.array(dtype=wp.vec3)
    """(2 * triangles,) lower and upper corner of each triangle's box."""
    sorted: wp.array2d(dtype=int)
    """(3, 2 * triangles) ids by centroid along each axis, then by id; the second half is room to sort."""
    suffix: wp.array2d(dtype=float)
    """(3, 2 * triangles) half areas of the boxes of all triangles from here to the end of the node's list; before the build,
    the centroids, and room to sort them."""
    spare: wp.array(dtype=int)
    """(triangles,) the right side of a list while it is partitioned."""
    on_left: wp.array(dtype=wp.uint8)
    """(triangles,)"""


@wp.struct
class Partition:
    """The best partition found."""

    cost: float
    axis: int
    left: int
    """Triangles on the left."""


@wp.struct
class Box:
    """The box of some triangles."""

    low: wp.vec3
    high: wp.vec3


@wp.func
def empty_box():
    """The box of no triangle."""
    corner = wp.vec3(INFINITY, INFINITY, INFINITY)
    return Box(corner, -corner)


@wp.func
def enlarged(box: Box, lists: SweepLists, triangle: int):
    """A box that holds a triangle too."""
    return Box(min_of(box.low, lists.corner[2 * triangle]), max_of(box.high, lists.corner[2 * triangle + 1]))


@wp.func
def area_of(box: Box):
    """Half the surface area of a box."""
    size = box.high - box.low
    return size[0] * size[1] + size[1] * size[2] + size[2] * size[0]


# -- 1. sort -------------------------------------------------------------------------------------------------------------------


@exact_kernel
def emit_keys(first: int, boxes: Boxes, lists: SweepLists):
    """Item: a triangle. Writes its box, and its centroids, which are sorted later, to `SweepLists.suffix`."""
    i = first + wp.tid()
    low = wp.vec3(boxes.low[0, i], boxes.low[1, i], boxes.low[2, i])
    high = wp.vec3(boxes.high[0, i], boxes.high[1, i], boxes.high[2, i])
    lists.corner[2 * i] = low
    lists.corner[2 * i + 1] = high
    for axis in range(3):
        lists.suffix[axis, i] = low[axis] + high[axis]
        lists.sorted[axis, i] = i


def sorted_lists(triangles: TriangleBoxes) -> SweepLists:
    """The lists of the root. No centroid is NaN or -0.0, as no corner is."""
    count, device = triangles.count, triangles.boxes.low.device
    lists = SweepLists()
    lists.corner = wp.empty(2 * count, dtype=wp.vec3, device=device)
    lists.sorted = wp.empty((3, 2 * count), dtype=int, device=device)
    lists.suffix = wp.empty((3, 2 * count), dtype=float, device=device)
    lists.spare = wp.empty(count, dtype=int, device=device)
    lists.on_left = wp.empty(count, dtype=wp.uint8, device=device)
    launch(emit_keys, count, [triangles.boxes, lists], device=device, chunk=EMIT_CHUNK)
    sort_rows(lists.suffix, lists.sorted, wp.vec3i(count, count, count))
    return lists


# -- 2. search -----------------------------------------------------------------------------------------------------------------


@wp.func
def sweep_axis(rules: BuildRules, lists: SweepLists, frame: Frame, axis: int, best: Partition):
    """The better of `best` and the partitions along an axis; ties go to `best`, then to the smaller left side."""
    box = empty_box()
    for k in range(frame.count - 1):
        i = frame.first + frame.count - 1 - k
        box = enlarged(box, lists, lists.sorted[axis, i])
        lists.suffix[axis, i] = area_of(box)
    box = empty_box()
    for left in range(1, frame.count):
        i = frame.first + left
        box = enlarged(box, lists, lists.sorted[axis, i - 1])
        cost = binary.split_cost(
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
    if half_area(tree.box, frame.node) > 0.0 and not binary.must_split_at_median(frame.depth, frame.count):
        for axis in range(3):
            best = sweep_axis(rules, lists, frame, axis, best)
    if best.cost == INFINITY:
        best.left = binary.middle(frame.count, rules.cost.width_bits)
    return best


# -- 3. partition --------------------------------------------------------------------------------------------------------------


@wp.func
def mark_sides(lists: SweepLists, frame: Frame, best: Partition):
    """Notes on which side of a node's partition its triangles are."""
    for i in range(frame.first, frame.first + frame.count):
        triangle = lists.sorted[best.axis, i]
        lists.on_left[triangle] = wp.where(i < frame.first + best.left, wp.uint8(1), wp.uint8(0))


@wp.func
def partition(lists: SweepLists, frame: Frame, best: Partition):
    """Partitions the three lists of a node stably."""
    mark_sides(lists, frame, best)
    for axis in range(3):
        left = int(frame.first)
        right = int(0)
        for i in range(frame.first, frame.first + frame.count):
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
def split(rules: BuildRules, lists: SweepLists, tree: BinaryTree, frame: Frame, pair: int):
    """Splits a node, whose children become a pair; returns the number of triangles on the left."""
    best = search(rules, lists, tree, frame)
    partition(lists, frame, best)
    tree.pair[frame.node] = wp.where(pair < 0, frame.first + best.left, pair)
    return best.left


# -- 4. build ------------------------------------------------------------------------------------------------------------------


@wp.func
def write_range(lists: SweepLists, frame: Frame, tree: BinaryTree):
    """Writes which triangles a node has, and their box, in the layout of `BinaryTree.box`."""
    box = empty_box()
    for i in range(frame.first, frame.first + frame.count):
        box = enlarged(box, lists, lists.sorted[0, i])
    for axis in range(3):
        tree.box[frame.node * 8 + axis] = box.low[axis]
        tree.box[frame.node * 8 + 4 + axis] = -box.high[axis]
    tree.range[frame.node] = wp.vec2i(frame.first, frame.count)


@wp.func
def emit_leaf(lists: SweepLists, frame: Frame, tree: BinaryTree):
    """Writes a leaf: its triangles in the order along x."""
    tree.pair[frame.node] = LEAF
    for i in range(frame.first, frame.first + frame.count):
        tree.order[i] = lists.sorted[0, i]


@exact_kernel
def split_large(
    first: int,
    rules: BuildRules,
    lists: SweepLists,
    large: int,
    stack: wp.array2d(dtype=Frame),
    tree: BinaryTree,
    tasks: wp.array(dtype=Frame),
    pairs: wp.array(dtype=int),
    made: wp.array(dtype=int),
):
    """One item. Splits nodes of more than `large` triangles; lists the others as tasks, and the pairs, parents first. The pair
    of a node is named by the first triangle of the right child, so those of the tasks are left for them.

    stack: (1, STACK). made: (2,) number of tasks and of pairs."""
    root = Frame()
    root.count = lists.on_left.shape[0]
    stack[0, 0] = root
    waiting = int(1)
    while waiting > 0:
        waiting -= 1
        frame = stack[0, waiting]
        if frame.count > large:
            write_range(lists, frame, tree)
            left = split(rules, lists, tree, frame, -1)
            pairs[made[1]] = frame.first + left
            made[1] += 1
            stack[0, waiting] = child_of(frame, left, frame.first + left, 1)
            stack[0, waiting + 1] = child_of(frame, left, frame.first + left, 0)
            waiting += 2
        else:
            tasks[made[0]] = frame
            made[0] += 1


@exact_kernel
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
        write_range(lists, frame, tree)
        if is_small(rules, tree, frame.node, frame.count):
            emit_leaf(lists, frame, tree)
            waiting -= 1
            building = waiting >= 0
            if building:
                frame = stack[number, waiting]
        else:
            left = split(rules, lists, tree, frame, next_pair)
            stack[number, waiting] = child_of(frame, left, next_pair, 1)
            waiting += 1
            frame = child_of(frame, left, next_pair, 0)
            next_pair += 1
    subtrees[number] = wp.vec2i(begin, next_pair)


def kernels(config: BvhConfig, triangles: int) -> list[wp.Kernel]:
    """One kernel of each module that a build needs, of any number of triangles."""
    moving = [find_insertion_positions] if config.reinsertion else []
    return [build_by_sweep, *moving, *collapse_kernels(SURFACE)]


def make_tasks(rules: BuildRules, lists: SweepLists, tree: BinaryTree) -> tuple[np.ndarray, np.ndarray]:
    """Splits the large nodes: frames of the tasks, the largest first, and the pairs above them, parents before children."""
    device, count, threads = lists.corner.device, len(lists.on_left), get_num_threads()
    large = max(MIN_LARGE, count // (TASKS_PER_THREAD * threads)) if threads > 1 else count
    room = STACK * (count // (large + 1)) + 1  # the large nodes of a level have no triangle in common
    stack, tasks = wp.empty((1, STACK), dtype=Frame, device=device), wp.empty(room, dtype=Frame, device=device)
    pairs, made = wp.empty(room, dtype=int, device=device), wp.zeros(2, dtype=int, device=device)
    launch(split_large, 1, [rules, lists, large, stack, tree, tasks, pairs, made], device=device)
    of_tasks, of_pairs = map(int, made.numpy())
    frames = tasks.numpy()[:of_tasks]
    return frames[np.argsort(-frames["count"], kind="stable")], pairs.numpy()[:of_pairs]


def build(triangles: TriangleBoxes, config: BvhConfig) -> Bvh:
    """Builds the tree on the device that holds the boxes."""
    device, count, rules = triangles.boxes.low.device, triangles.count, config.struct()
    load(kernels(config, count), device)  # compilation is not a phase of the build
    phase, tree = Phases(device), binary.empty_tree(count, device)
    with phase("sort"):
        lists = sorted_lists(triangles)
    with phase("top levels"):
        frames, top = make_tasks(rules, lists, tree)
    with phase("subtrees"):
        tasks = wp.array(frames, dtype=Frame, device=device)
        stack = wp.empty((len(tasks), STACK), dtype=Frame, device=device)
        subtrees = wp.empty(len(tasks), dtype=wp.vec2i, device=device)
        inputs = [rules, lists, tasks, stack, tree, subtrees]
        launch(build_by_sweep, len(tasks), inputs, device=device, chunk=1, chunks_per_thread=len(tasks))
    above = wp.array(top, dtype=int, device=device) if len(top) else None
    built = BinaryBuild(tree, subtrees, above, wp.empty(16 * count, dtype=float, device=device))
    return improved(built, triangles, config, phase)
