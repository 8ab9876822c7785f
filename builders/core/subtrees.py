"""The lower part of a build: one task builds one subtree, depth first, on its own copy of the lists. Shared by all builders.

A node's triangles are kept in lists in the task's range of a memory: sorted events, or references that are scanned. What is
done with a node is a `Method`, which each builder's file lists: search, stop, classify, partition, emit. The larger child's
lists are compacted in place, the smaller one's are appended, so a task needs little more than twice the memory of its own
lists. The right child is pushed on a stack, so nodes are written in depth-first order.

A task that runs out of memory reports it and stops. The build is then repeated with more memory (`Reservation`).

References: choi-2010; wald-havran-2006.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import warp as wp

from wrt.builders.cost import Split, SplitCost, no_split
from wrt.builders.tree import PathState, StopLimits
from wrt.kernels.layout import kdtree_nodes as kdtree
from wrt.kernels.layout.struct_arrays import with_known_layout
from wrt.kernels.runtime.launch import launch, specialise
from wrt.kernels.runtime.options import specialised_kernel

STACK = kdtree.MAX_TREE_DEPTH + 1

SPARE_MEMORY = 1.5
"""Working memory of a task relative to its own lists, at least a third; doubled whenever it is too small."""


@with_known_layout
@wp.struct
class Task:
    """A subtree to build and its ranges of the memories."""

    lists_first: int
    lists_capacity: int
    triangles_first: int
    nodes_first: int
    nodes_capacity: int
    blocks_first: int
    blocks_capacity: int


@with_known_layout
@wp.struct
class Result:
    """Sizes of a finished subtree."""

    nodes: int
    blocks: int
    overflow: bool


@wp.struct
class Parts:
    """The subtrees of all tasks, each in its own range."""

    nodes: wp.array(dtype=wp.vec2i)
    """Nodes; child and block indices are relative to the task's first."""
    primitive: wp.array(dtype=int)
    """Leaf lists, padded to whole blocks with -1."""


@with_known_layout
@wp.struct
class Frame:
    """A node that is being built or waits for its left sibling."""

    low: wp.vec3
    high: wp.vec3
    inner_low: wp.vec3
    """The box of its triangles, clamped to its own; kept by methods that scan references."""
    inner_high: wp.vec3
    first: wp.vec3i
    """Starts of its lists, one per axis; methods with one list use the first."""
    count: wp.vec3i
    """Lengths of its lists."""
    top: int
    """Start of the free part of the task's range while the node is built."""
    triangles: int
    path: PathState
    depth: int
    parent: int
    """Index of the node whose right child it is; -1 for the root."""


@dataclass(frozen=True)
class Method:
    """What a task does with a node: search and stop, then emit_leaf, or emit_inner, classify and partition.

    Attributes:
        memory: a Warp struct with the lists of all tasks and scratch memory.
        search: (cost, memory, task number, frame) -> Split, the node's best plane, or `no_split()`.
        stop: (limits, cost, depth, triangles, path, split, size of the box) -> PathState, see `wrt.builders.tree.stop`.
        classify: (memory, task, frame, split): finds the side of each triangle; `in_partition` if partition does.
        partition: (memory, task, frame, split, left, right): turns two copies of the frame into its children.
        emit_inner: (parts, index, split): writes an inner node.
        emit_leaf: (memory, task, frame, parts, first lane): lists the node's triangles.
    """

    memory: type
    search: wp.Function
    stop: wp.Function
    classify: wp.Function
    partition: wp.Function
    emit_inner: wp.Function
    emit_leaf: wp.Function


@wp.func
def in_partition(memory: Any, task: Task, frame: Frame, split: Split):
    """Phase "classify" of methods whose partition finds the side of a triangle when it moves it: nothing."""


@cache
def make_build_subtrees(method: Method) -> wp.Kernel:
    """The kernel that builds the tasks' subtrees. Item i: the task order[i]. frames: (tasks,) roots. stack: (tasks, STACK)."""
    memory_type, search, stop = method.memory, method.search, method.stop
    classify, partition, emit_inner, emit_leaf = method.classify, method.partition, method.emit_inner, method.emit_leaf

    def build_subtrees(
        first: int,
        cost: SplitCost,
        limits: StopLimits,
        order: wp.array(dtype=int),
        tasks: wp.array(dtype=Task),
        frames: wp.array(dtype=Frame),
        memory: memory_type,
        parts: Parts,
        stack: wp.array2d(dtype=Frame),
        results: wp.array(dtype=Result),
    ):
        number = order[first + wp.tid()]
        task = tasks[number]
        frame = frames[number]
        width = 1 << cost.width_bits
        result = Result()
        waiting = int(0)
        building = bool(True)
        while building:
            length = frame.count[0] + frame.count[1] + frame.count[2]
            leaf_blocks = (frame.triangles + width - 1) / width
            if (
                frame.top + length > task.lists_first + task.lists_capacity
                or result.nodes >= task.nodes_capacity
                or result.blocks + leaf_blocks > task.blocks_capacity
            ):
                result.overflow = True
                break
            split = no_split()
            if frame.depth < limits.depth:
                split = search(cost, memory, number, frame)
            path = stop(limits, cost, frame.depth, frame.triangles, frame.path, split, frame.high - frame.low)
            index = result.nodes
            result.nodes += 1
            if frame.parent >= 0:
                link_right(parts, task.nodes_first + frame.parent, index)
            if path.bad_splits < 0:
                parts.nodes[task.nodes_first + index] = kdtree.leaf_node(result.blocks, frame.triangles)
                begin = (task.blocks_first + result.blocks) * width
                emit_leaf(memory, task, frame, parts, begin)
                result.blocks += leaf_blocks
                for lane in range(begin + frame.triangles, begin + leaf_blocks * width):
                    parts.primitive[lane] = -1
                waiting -= 1
                building = waiting >= 0
                if building:
                    frame = stack[number, waiting]
            else:
                emit_inner(parts, task.nodes_first + index, split)
                left = frame
                right = frame
                left.high[split.axis] = split.position
                right.low[split.axis] = split.position
                left.path = path
                right.path = path
                left.depth += 1
                right.depth += 1
                left.parent = -1
                right.parent = index
                classify(memory, task, frame, split)
                partition(memory, task, frame, split, left, right)
                stack[number, waiting] = right
                waiting += 1
                frame = left
        results[number] = result

    return specialised_kernel(build_subtrees)


@wp.func
def emit_inner(parts: Parts, index: int, split: Split):
    """Phase "emit" of an inner node, whose right child is not known yet."""
    parts.nodes[index] = kdtree.inner_node(split.axis, split.position, 0)


@wp.func
def link_right(parts: Parts, parent: int, child: int):
    """Stores the right child of an inner node."""
    node = parts.nodes[parent]
    parts.nodes[parent] = kdtree.inner_node(kdtree.split_axis(node), kdtree.split_position(node), child)


class Reservation:
    """Memory ranges for tasks of given sizes.

    Args:
        sizes: (tasks,) triangles of each task.
        entries: list entries per triangle.
        spare: working memory relative to a task's own lists.
        width: triangles per block.
        device: device on which the tasks are built.
    """

    def __init__(self, sizes: np.ndarray, entries: int, spare: float, width: int, device: wp.Device) -> None:
        sizes = sizes.astype(np.int64)
        self.ranges = np.zeros(len(sizes), dtype=Task.numpy_dtype())
        """The tasks, on the host."""
        self.entries = self._share("lists", ((1 + spare) * entries * sizes).astype(np.int64) + 64)
        """List entries of all tasks together."""
        self.triangles = self._share("triangles", sizes)
        self.parts = Parts()
        total = self._share("nodes", (spare * sizes).astype(np.int64) + 64)
        self.parts.nodes = wp.empty(total, dtype=wp.vec2i, device=device)
        total = self._share("blocks", ((1 + spare) * 2 * sizes / width).astype(np.int64) + 64)
        self.parts.primitive = wp.empty(total * width, dtype=int, device=device)
        self.tasks = wp.array(self.ranges, dtype=Task, device=device)
        self.order = wp.array(np.argsort(-sizes, kind="stable"), dtype=int, device=device)
        """Tasks from the largest to the smallest: a thread that begins a large one last keeps the others waiting."""

    def _share(self, name: str, capacity: np.ndarray) -> int:
        self.ranges[f"{name}_first"] = np.cumsum(capacity) - capacity
        if f"{name}_capacity" in self.ranges.dtype.names:
            self.ranges[f"{name}_capacity"] = capacity
        return int(capacity.sum())


def build_subtrees(
    method: Method, rules: tuple[SplitCost, StopLimits], reservation: Reservation, frames: wp.array, memory: Any
) -> wp.array:
    """Builds all subtrees, the largest first; the threads take them from one pool. Returns the result of each task.

    Args:
        method: how subtrees are built.
        rules: cost model and stop rules.
        reservation: the tasks and their memory ranges.
        frames: (tasks,) their roots.
        memory: the lists, as the method defines them.
    """
    device, count = frames.device, len(frames)
    stack = wp.empty((count, STACK), dtype=Frame, device=device)
    results = wp.empty(count, dtype=Result, device=device)
    inputs = [*rules, reservation.order, reservation.tasks, frames, memory, reservation.parts, stack, results]
    launch(specialise(make_build_subtrees, method), count, inputs, device=device, chunk=1, chunks_per_thread=count)
    return results


def build_tasks(
    method: Method,
    rules: tuple[SplitCost, StopLimits],
    make_tasks: Callable[[float], tuple[Reservation, Any, wp.array]],
    spare: float | None = None,
    phase: Callable[[str], AbstractContextManager] = nullcontext,
    name: str = "subtrees",
) -> tuple[Reservation, Any, wp.array]:
    """Makes tasks and builds their subtrees; again with twice the memory if it was too small for one of them.

    Args:
        method, rules: as in `build_subtrees`.
        make_tasks: spare -> the tasks, their lists and their roots.
        spare: as in `Reservation`, for the first attempt; None for `SPARE_MEMORY`.
        phase: times the phases `name`, of `make_tasks`, and "subtrees".
        name: see `phase`.

    Returns:
        The tasks, their lists, and the result of each task.
    """
    spare = SPARE_MEMORY if spare is None else spare
    while True:
        with phase(name):
            reservation, memory, frames = make_tasks(spare)
        with phase("subtrees"):
            results = build_subtrees(method, rules, reservation, frames, memory)
        if not results.numpy()["overflow"].any():
            return reservation, memory, results
        spare *= 2.0
