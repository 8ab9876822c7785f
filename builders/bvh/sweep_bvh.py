"""Exact sweep SAH build of a bounding volume hierarchy: the reference for the binned build.

**Problem.** Bins approximate the best plane. An exact build is needed to measure what they lose.

**Algorithm.** The triangles are sorted by centroid once per axis. In a node, a sweep from the right computes the area of every
suffix, and a sweep from the left evaluates all n - 1 partitions of each axis. The sides of the best one are marked, and the
three lists are partitioned stably, so that they stay sorted. (The cost is that of Goldsmith and Salmon 1987.)

**Data.** Three lists of triangle ids, sorted by centroid, and the areas of the suffixes of one list (`Workspace`).

**Phases** of a node, in `build_by_sweep`: stop, `search`, `partition`, emit.

**Complexity.** O(N log N) for a balanced tree. One thread.

The build shares only the cost model, the stop rules and the collapse with the other builders.

References:
    J. Goldsmith, J. Salmon: Automatic creation of object hierarchies for ray tracing. IEEE CG&A 7(5), 1987.
    I. Wald, S. Boulos, P. Shirley: Ray tracing deformable scenes using dynamic bounding volume hierarchies.
        ACM Transactions on Graphics 26(1), 2007.
"""

from time import perf_counter

import numpy as np
import warp as wp

from wrt.builders.bvh.bvh_config import BuildRules, BvhConfig
from wrt.builders.bvh.phases.binary_tree import LEAF, BinaryTree, empty_tree, half_area, middle, must_halve, price_of_areas
from wrt.builders.bvh.phases.collapse import BinaryBuild, collapse
from wrt.builders.bvh.phases.reinsertion import find_places, reinsert
from wrt.builders.cost import leaf_cost
from wrt.builders.tree import BuildStats, Bvh
from wrt.builders.triangle_boxes import Boxes, TriangleBoxes
from wrt.kernels.layout.bvh_nodes import MAX_WIDE_DEPTH
from wrt.kernels.runtime.launch import launch, load
from wrt.kernels.simd.boxes import INFINITY, greatest, least

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

STACK = MAX_WIDE_DEPTH + 1


@wp.struct
class Waiting:
    """A node that is not built yet."""

    node: int
    first: int
    count: int
    depth: int


@wp.struct
class Workspace:
    """Memory of the build."""

    sorted: wp.array2d(dtype=int)
    """(3, triangles) ids by centroid along each axis, then by id. The lists of a node are the same range of each row."""
    spare: wp.array(dtype=int)
    """(triangles,) the right side of a list while it is partitioned."""
    on_left: wp.array(dtype=wp.uint8)
    """(triangles,) 1 for triangles on the left of the chosen partition."""
    suffix: wp.array(dtype=float)
    """(triangles,) half areas of the boxes of all triangles from each position to the end of the node's list."""
    stack: wp.array(dtype=Waiting)


@wp.struct
class Partition:
    """The best partition found."""

    price: float
    axis: int
    left: int
    """Triangles on the left."""


@wp.func
def area_of(low: wp.vec3, high: wp.vec3):
    """Half the surface area of a box."""
    size = high - low
    return size[0] * size[1] + size[1] * size[2] + size[2] * size[0]


@wp.func
def triangle_low(boxes: Boxes, triangle: int):
    """Lower corner of a triangle's box."""
    return wp.vec3(boxes.low[0, triangle], boxes.low[1, triangle], boxes.low[2, triangle])


@wp.func
def triangle_high(boxes: Boxes, triangle: int):
    """Upper corner of a triangle's box."""
    return wp.vec3(boxes.high[0, triangle], boxes.high[1, triangle], boxes.high[2, triangle])


@wp.func
def search(rules: BuildRules, boxes: Boxes, work: Workspace, item: Waiting):
    """The partition of least cost; ties go to the smaller axis, then to the smaller left side."""
    best = Partition()
    best.price = INFINITY
    for axis in range(3):
        low = wp.vec3(INFINITY, INFINITY, INFINITY)
        high = -low
        for k in range(item.count - 1):
            i = item.first + item.count - 1 - k
            triangle = work.sorted[axis, i]
            low = least(low, triangle_low(boxes, triangle))
            high = greatest(high, triangle_high(boxes, triangle))
            work.suffix[i] = area_of(low, high)
        low = wp.vec3(INFINITY, INFINITY, INFINITY)
        high = -low
        for left in range(1, item.count):
            triangle = work.sorted[axis, item.first + left - 1]
            low = least(low, triangle_low(boxes, triangle))
            high = greatest(high, triangle_high(boxes, triangle))
            price = price_of_areas(
                area_of(low, high),
                leaf_cost(rules.cost, left),
                work.suffix[item.first + left],
                leaf_cost(rules.cost, item.count - left),
            )
            if price < best.price:
                best.price = price
                best.axis = axis
                best.left = left
    return best


@wp.func
def partition(work: Workspace, item: Waiting, best: Partition):
    """Partitions the three lists of a node stably."""
    for i in range(item.first, item.first + item.count):
        work.on_left[work.sorted[best.axis, i]] = wp.where(i < item.first + best.left, wp.uint8(1), wp.uint8(0))
    for axis in range(3):
        left = int(item.first)
        right = int(0)
        for i in range(item.first, item.first + item.count):
            triangle = work.sorted[axis, i]
            if work.on_left[triangle] == wp.uint8(1):
                work.sorted[axis, left] = triangle
                left += 1
            else:
                work.spare[right] = triangle
                right += 1
        for i in range(right):
            work.sorted[axis, left + i] = work.spare[i]


@wp.func
def write_box(boxes: Boxes, work: Workspace, item: Waiting, tree: BinaryTree):
    """Writes the box of a node's triangles."""
    low = wp.vec3(INFINITY, INFINITY, INFINITY)
    high = -low
    for i in range(item.first, item.first + item.count):
        low = least(low, triangle_low(boxes, work.sorted[0, i]))
        high = greatest(high, triangle_high(boxes, work.sorted[0, i]))
    for axis in range(3):
        tree.box[item.node * 8 + axis] = low[axis]
        tree.box[item.node * 8 + 4 + axis] = -high[axis]


@wp.kernel
def build_by_sweep(
    first: int, rules: BuildRules, boxes: Boxes, work: Workspace, tree: BinaryTree, subtrees: wp.array(dtype=wp.vec2i)
):
    """One item. subtrees: (1,) range of the pairs made."""
    next_pair = int(1)
    item = Waiting()
    item.count = work.sorted.shape[1]
    waiting = int(0)
    building = bool(True)
    while building:
        # stop, search
        write_box(boxes, work, item, tree)
        tree.range[item.node] = wp.vec2i(item.first, item.count)
        area = half_area(tree.box, item.node)
        best = Partition()
        best.price = INFINITY
        split = item.count > rules.grain
        if split and area > 0.0 and not must_halve(item.depth, item.count):
            best = search(rules, boxes, work, item)
        if not split:
            # emit
            tree.pair[item.node] = LEAF
            for i in range(item.first, item.first + item.count):
                tree.order[i] = work.sorted[0, i]
            waiting -= 1
            building = waiting >= 0
            if building:
                item = work.stack[waiting]
        else:
            # partition
            if best.price == INFINITY:
                best.left = middle(item.count, rules.cost.width_bits)
            partition(work, item, best)
            tree.pair[item.node] = next_pair
            right = item
            right.node = 2 * next_pair + 1
            right.first += best.left
            right.count -= best.left
            right.depth += 1
            work.stack[waiting] = right
            waiting += 1
            item.node = 2 * next_pair
            item.count = best.left
            item.depth += 1
            next_pair += 1
    subtrees[0] = wp.vec2i(1, next_pair)


def build(triangles: TriangleBoxes, config: BvhConfig) -> Bvh:
    """Builds the tree on the device that holds the boxes, in one thread."""
    device, count = triangles.boxes.low.device, triangles.count
    load([build_by_sweep, find_places], device)
    stats = BuildStats()
    start = perf_counter()
    centroids = triangles.boxes.low.numpy() + triangles.boxes.high.numpy()
    work = Workspace()
    work.sorted = wp.array(np.argsort(centroids, axis=1, kind="stable"), dtype=int, device=device)
    work.spare = wp.empty(count, dtype=int, device=device)
    work.on_left = wp.empty(count, dtype=wp.uint8, device=device)
    work.suffix = wp.empty(count, dtype=float, device=device)
    work.stack = wp.empty(STACK, dtype=Waiting, device=device)
    tree = empty_tree(count, device)
    subtrees = wp.empty(1, dtype=wp.vec2i, device=device)
    launch(build_by_sweep, 1, [config.struct(), triangles.boxes, work, tree, subtrees], device=device)
    wp.synchronize_device(device)
    stats.seconds["sweep"] = perf_counter() - start
    binary = BinaryBuild(tree, subtrees, None, wp.empty(16 * count, dtype=float, device=device))
    if config.reinsertion:
        start = perf_counter()
        binary = reinsert(binary, count, config, stats)
        wp.synchronize_device(device)
        stats.seconds["reinsertion"] = perf_counter() - start
    start = perf_counter()
    result = collapse(binary, triangles, config, stats)
    wp.synchronize_device(device)
    stats.seconds["collapse"] = perf_counter() - start
    return result
