"""The lower part of the binned build: one task builds one subtree, depth first.

A node's references lie in one of two buffers; its children's are written to the same places of the other one. The right
child waits on a stack. Phases of a node: stop, search, partition, emit.
"""

import warp as wp

from wrt.builders.bvh.bins import (
    Scratch,
    best_plane,
    bin_range,
    bins_for,
    centroid_domain,
    partition_range,
    place,
    range_box,
    write_child_boxes,
    write_order,
)
from wrt.builders.bvh.config import BuildRules
from wrt.builders.bvh.tree import LEAF, BinaryTree, half_area, middle, must_halve
from wrt.kernels.boxes import INFINITY
from wrt.kernels.bvh import MAX_WIDE_DEPTH

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

STACK = MAX_WIDE_DEPTH + 2


@wp.struct
class Frame:
    """A node that is being built or waits for its left sibling."""

    node: int
    first: int
    """Its first triangle in the tree's order."""
    count: int
    buffer: int
    """Where the buffer begins that holds its references: 0 or the number of triangles."""
    depth: int


@wp.kernel
def build_subtrees(
    first: int,
    rules: BuildRules,
    references: wp.array(dtype=float),
    triangles: int,
    tasks: wp.array(dtype=Frame),
    scratch: Scratch,
    domain: wp.array(dtype=float),
    stack: wp.array2d(dtype=Frame),
    tree: BinaryTree,
    subtrees: wp.array(dtype=wp.vec2i),
):
    """Item: a task. subtrees: (tasks,) the pairs it made. stack: (tasks, STACK). domain: (tasks * STACK * 8,) centroid box of
    each waiting node, then of the current one."""
    slot = first + wp.tid()
    frame = tasks[slot]
    next_pair = frame.first + 1
    waiting = int(0)
    centroid_domain(references, frame.buffer + frame.first, frame.count, domain, slot * STACK)
    building = bool(True)
    while building:
        # stop, search
        at = slot * STACK + waiting
        begin = frame.buffer + frame.first
        split = frame.count > rules.grain
        placement = place(domain, at, bins_for(rules, frame.count))
        area = half_area(tree.box, frame.node)
        price = float(INFINITY)
        axis = int(0)
        plane = int(0)
        left_count = int(0)
        if split and area > 0.0 and not must_halve(frame.depth, frame.count):
            bin_range(references, begin, frame.count, placement, scratch, slot)
            best = best_plane(rules.cost, scratch, slot, placement.bins, frame.count)
            price = best.price
            axis = best.axis
            plane = best.bin
            left_count = best.left
        tree.range[frame.node] = wp.vec2i(frame.first, frame.count)
        if split:
            # partition
            pair = next_pair
            next_pair += 1
            tree.pair[frame.node] = pair
            buffer = int(frame.buffer)
            if price < INFINITY:
                buffer = triangles - frame.buffer
                write_child_boxes(scratch, slot, placement.bins, axis, plane, tree.box, pair)
                to = buffer + frame.first
                partition_range(references, begin, frame.count, placement, axis, plane, to, to + left_count, domain, at + 1, at)
            else:
                left_count = middle(frame.count, rules.cost.width_bits)
                right_count = frame.count - left_count
                range_box(references, begin, left_count, tree.box, 2 * pair)
                range_box(references, begin + left_count, right_count, tree.box, 2 * pair + 1)
                centroid_domain(references, begin, left_count, domain, at + 1)
                centroid_domain(references, begin + left_count, right_count, domain, at)
            right = frame
            right.node = 2 * pair + 1
            right.first = frame.first + left_count
            right.count = frame.count - left_count
            right.buffer = buffer
            right.depth = frame.depth + 1
            stack[slot, waiting] = right
            waiting += 1
            frame.node = 2 * pair
            frame.count = left_count
            frame.buffer = buffer
            frame.depth += 1
        else:
            # emit
            tree.pair[frame.node] = LEAF
            write_order(references, begin, frame.count, tree.order, frame.first)
            waiting -= 1
            building = waiting >= 0
            if building:
                frame = stack[slot, waiting]
    subtrees[slot] = wp.vec2i(tasks[slot].first + 1, next_pair)
