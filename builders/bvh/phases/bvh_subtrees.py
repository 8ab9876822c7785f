"""The lower part of the binned build: one task builds one subtree, depth first.

A node's references lie in one of two buffers. Its children's references are written to the same positions of the other one. The
right child is pushed on a stack. Phases of a node: stop, search, partition, emit.
"""

from functools import cache

import warp as wp

from wrt.builders.bvh.bvh_config import BuildRules
from wrt.builders.bvh.phases.bin_heuristic import Heuristic
from wrt.builders.bvh.phases.binary_tree import LEAF, BinaryTree, Frame, child_of, half_area, middle, must_split_at_median
from wrt.builders.bvh.phases.bvh_bins import (
    Binning,
    Plane,
    Scratch,
    bin_range,
    bins_for,
    centroid_domain,
    make_binning,
    no_plane,
    partition_range,
    range_box,
    write_child_boxes,
)
from wrt.builders.bvh.phases.large_boxes import is_small
from wrt.builders.triangle_boxes import Boxes
from wrt.builders.triangle_references import write_order, write_references, write_sizes
from wrt.kernels.layout.bvh_nodes import MAX_WIDE_DEPTH
from wrt.kernels.runtime.options import specialised_kernel
from wrt.kernels.simd.boxes import INFINITY

STACK = MAX_WIDE_DEPTH + 2


@wp.struct
class SubtreeMemory:
    """What builders of subtrees read and write; each has a slot."""

    references: wp.array(dtype=float)
    """Two buffers of references."""
    triangles: int
    """References in a buffer."""
    scratch: Scratch
    domain: wp.array(dtype=float)
    """(slots * STACK * 8,) centroid boxes of the waiting nodes, followed by that of the current one."""


def subtree_memory(references: wp.array, triangles: int, scratch: Scratch, domain: wp.array) -> SubtreeMemory:
    """The members in one struct."""
    memory = SubtreeMemory()
    memory.references, memory.triangles, memory.scratch, memory.domain = references, triangles, scratch, domain
    return memory


@wp.func
def divide_at_plane(
    memory: SubtreeMemory, slot: int, binning: Binning, plane: Plane, at: int, frame: Frame, pair: int, tree: BinaryTree
):
    """Moves a node's triangles to the other buffer, those on the left of the plane first."""
    write_child_boxes(memory.scratch, slot, binning.bins, plane.axis, plane.bin, tree.box, pair)
    begin = frame.buffer + frame.first
    to = memory.triangles - frame.buffer + frame.first
    partition_range(
        memory.references,
        begin,
        frame.count,
        binning,
        plane,
        wp.vec2i(to, to + plane.left),
        memory.domain,
        wp.vec2i(at + 1, at),
    )


@wp.func
def divide_in_the_middle(memory: SubtreeMemory, left: int, at: int, frame: Frame, pair: int, tree: BinaryTree):
    """Splits a node's list without moving it: the first `left` triangles belong to the left child."""
    begin = frame.buffer + frame.first
    range_box(memory.references, begin, left, tree.box, 2 * pair)
    range_box(memory.references, begin + left, frame.count - left, tree.box, 2 * pair + 1)
    centroid_domain(memory.references, begin, left, memory.domain, at + 1)
    centroid_domain(memory.references, begin + left, frame.count - left, memory.domain, at)


@cache
def make_build_subtree(heuristic: Heuristic) -> wp.Function:
    """`wp.func(rules, rays, memory, stack, slot, task, tree) -> end` of the pairs made, which begin at `task.first + 1`."""
    rays_type, search, is_leaf = heuristic.rays, heuristic.search, heuristic.is_leaf

    @wp.func
    def build_subtree(
        rules: BuildRules,
        rays: rays_type,
        memory: SubtreeMemory,
        stack: wp.array2d(dtype=Frame),
        slot: int,
        task: Frame,
        tree: BinaryTree,
    ):
        frame = task
        next_pair = frame.first + 1
        waiting = int(0)
        centroid_domain(memory.references, frame.buffer + frame.first, frame.count, memory.domain, slot * STACK)
        building = bool(True)
        while building:
            tree.range[frame.node] = wp.vec2i(frame.first, frame.count)
            if is_small(rules, tree, frame.node, frame.count) or is_leaf(rules, rays, tree, frame):
                # stop, emit
                tree.pair[frame.node] = LEAF
                write_order(memory.references, frame.buffer + frame.first, frame.count, tree.order, frame.first)
                waiting -= 1
                building = waiting >= 0
                if building:
                    frame = stack[slot, waiting]
            else:
                # search
                at = slot * STACK + waiting
                binning = make_binning(memory.domain, at, bins_for(rules, frame.count))
                plane = no_plane()
                if half_area(tree.box, frame.node) > 0.0 and not must_split_at_median(frame.depth, frame.count):
                    bin_range(memory.references, frame.buffer + frame.first, frame.count, binning, memory.scratch, slot)
                    plane = search(rules, rays, binning, memory.scratch, slot, tree, frame)
                # partition
                pair = next_pair
                next_pair += 1
                tree.pair[frame.node] = pair
                if plane.cost < INFINITY:
                    divide_at_plane(memory, slot, binning, plane, at, frame, pair, tree)
                    frame.buffer = memory.triangles - frame.buffer
                else:
                    plane.left = middle(frame.count, rules.cost.width_bits)
                    divide_in_the_middle(memory, plane.left, at, frame, pair, tree)
                # emit
                stack[slot, waiting] = child_of(frame, plane.left, pair, 1)
                waiting += 1
                frame = child_of(frame, plane.left, pair, 0)
        return next_pair

    return build_subtree


def make_references(
    first: int, boxes: Boxes, triangles: int, size: int, references: wp.array(dtype=float), parts: wp.array(dtype=float)
):
    """The function of a kernel. Item: a chunk of `size` triangles. Writes their references, and the centroid box of the
    chunk to part 2 * chunk."""
    chunk = first + wp.tid()
    begin = chunk * size
    end = wp.min(triangles, begin + size)
    write_references(boxes, begin, end, references)
    write_sizes(references, begin, end)
    centroid_domain(references, begin, end - begin, parts, 2 * chunk)


def make_build_subtrees(heuristic: Heuristic) -> wp.Kernel:
    """The kernel that builds the tasks' subtrees."""
    rays_type, build_subtree = heuristic.rays, make_build_subtree(heuristic)

    def build_subtrees(
        first: int,
        rules: BuildRules,
        rays: rays_type,
        memory: SubtreeMemory,
        tasks: wp.array(dtype=Frame),
        each: int,
        stack: wp.array2d(dtype=Frame),
        tree: BinaryTree,
        subtrees: wp.array(dtype=wp.vec2i),
    ):
        """Item: a slot, for `each` tasks, one after the other.

        stack: (slots, STACK) waiting nodes. subtrees: (tasks,) range of the pairs that each task made.
        """
        slot = first + wp.tid()
        for number in range(slot * each, wp.min((slot + 1) * each, subtrees.shape[0])):
            task = tasks[number]
            end = build_subtree(rules, rays, memory, stack, slot, task, tree)
            subtrees[number] = wp.vec2i(task.first + 1, end)

    return specialised_kernel(build_subtrees, beside=heuristic.rays.__name__)


@cache
def subtree_kernels(heuristic: Heuristic) -> list[wp.Kernel]:
    """What every build launches: the kernel of `make_build_subtrees`, and the one that writes references."""
    return [make_build_subtrees(heuristic), specialised_kernel(make_references, beside=heuristic.rays.__name__)]
