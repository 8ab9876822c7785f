"""The lower part of a build: one task builds one subtree, depth first, on its own copy of the lists. Written once for all.

A node's triangles are kept in lists in the task's share of a memory: sorted events, or references that are scanned. What
differs between builders is a `Method`: how the best plane is found, how lists are divided, how a leaf is listed. The larger
child's lists are compacted in place, the smaller one's are appended, so a task needs little more than twice the room of its
own lists. The right child waits on a stack: nodes come out in depth-first order.

Phases of a node: search, stop, classify, partition, emit. A task that runs out of its share says so and stops; the build is
then repeated with larger shares (`Reservation`).

References:
    B. Choi et al.: Parallel SAH k-D tree construction. High Performance Graphics 2010.
    I. Wald, V. Havran: On building fast kd-trees for ray tracing, and on doing that in O(N log N).
        IEEE Symposium on Interactive Ray Tracing 2006.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import warp as wp

from wrt.builders.cost import SplitCost, no_split
from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.tree import Descent, StopLimits, descend
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.kernels.layout import kdtree_nodes as kdtree
from wrt.kernels.layout.struct_arrays import with_known_layout
from wrt.kernels.runtime.launch import launch, specialise

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

STACK = kdtree.MAX_TREE_DEPTH + 1


@with_known_layout
@wp.struct
class Task:
    """A subtree to build and its share of the memories."""

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
    """What a task made."""

    nodes: int
    blocks: int
    overflow: bool


@wp.struct
class Parts:
    """The subtrees of all tasks, each in its own share."""

    nodes: wp.array(dtype=wp.vec2i)
    """Nodes; child and block indices count from the task's first."""
    primitive: wp.array(dtype=int)
    """Leaf lists, padded to whole blocks with -1."""


@with_known_layout
@wp.struct
class Frame:
    """A node that is being built or waits for its left sibling."""

    low: wp.vec3
    high: wp.vec3
    inner_low: wp.vec3
    """The box of its triangles, cut off at its own; kept by methods that scan references."""
    inner_high: wp.vec3
    first: wp.vec3i
    """Where its lists begin: one an axis, or only the first in use."""
    count: wp.vec3i
    """Length of its lists."""
    top: int
    """Where the task's share is free while the node is built."""
    triangles: int
    path: Descent
    depth: int
    parent: int
    """Index of the node whose right child it is; -1 for the root."""


@dataclass(frozen=True)
class Method:
    """What a builder supplies.

    Attributes:
        memory: a Warp struct: the lists of all tasks, and room to work in.
        search: (cost, memory, task number, frame) -> Split, the node's best plane, or `no_split()`.
        divide: (memory, task, frame, split, left, right): turns two copies of the frame into its children.
        emit_leaf: (memory, task, frame, parts, first lane): lists the node's triangles.
    """

    memory: type
    search: wp.Function
    divide: wp.Function
    emit_leaf: wp.Function


@cache
def make_build_subtrees(method: Method) -> wp.Kernel:
    """The kernel whose item is a task; frames: (tasks,) the roots, stack: (tasks, STACK)."""
    memory_type, search, divide, emit_leaf = method.memory, method.search, method.divide, method.emit_leaf

    def build_subtrees(
        first: int,
        cost: SplitCost,
        limits: StopLimits,
        tasks: wp.array(dtype=Task),
        frames: wp.array(dtype=Frame),
        memory: memory_type,
        parts: Parts,
        stack: wp.array2d(dtype=Frame),
        results: wp.array(dtype=Result),
    ):
        number = first + wp.tid()
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
            below = descend(limits, cost, frame.depth, frame.triangles, frame.path, split, frame.high - frame.low)
            index = result.nodes
            result.nodes += 1
            if frame.parent >= 0:
                link_right(parts, task.nodes_first + frame.parent, index)
            if below.bad_splits < 0:
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
                parts.nodes[task.nodes_first + index] = kdtree.inner_node(split.axis, split.position, 0)
                left = frame
                right = frame
                left.high[split.axis] = split.position
                right.low[split.axis] = split.position
                left.path = below
                right.path = below
                left.depth += 1
                right.depth += 1
                left.parent = -1
                right.parent = index
                divide(memory, task, frame, split, left, right)
                stack[number, waiting] = right
                waiting += 1
                frame = left
        results[number] = result

    return wp.kernel(build_subtrees, module="unique", enable_backward=False, module_options={"fuse_fp": False})


@wp.func
def link_right(parts: Parts, parent: int, child: int):
    """Tells an inner node its right child."""
    node = parts.nodes[parent]
    parts.nodes[parent] = kdtree.inner_node(kdtree.split_axis(node), kdtree.split_position(node), child)


class Reservation:
    """Shares of memory for tasks of given sizes.

    Args:
        sizes: (tasks,) triangles of each task.
        entries: list entries a triangle.
        spare: room for the work, as a multiple of a task's own lists.
        width: triangles a block.
        device: where the tasks are built.
    """

    def __init__(self, sizes: np.ndarray, entries: int, spare: float, width: int, device: wp.Device) -> None:
        sizes = sizes.astype(np.int64)
        self.rooms = np.zeros(len(sizes), dtype=Task.numpy_dtype())
        """The tasks as the host sees them."""
        self.entries = self._share("lists", ((1 + spare) * entries * sizes).astype(np.int64) + 64)
        """List entries of all tasks together."""
        self.triangles = self._share("triangles", sizes)
        self.parts = Parts()
        total = self._share("nodes", (spare * sizes).astype(np.int64) + 64)
        self.parts.nodes = wp.empty(total, dtype=wp.vec2i, device=device)
        total = self._share("blocks", ((1 + spare) * 2 * sizes / width).astype(np.int64) + 64)
        self.parts.primitive = wp.empty(total * width, dtype=int, device=device)
        self.tasks = wp.array(self.rooms, dtype=Task, device=device)

    def _share(self, name: str, capacity: np.ndarray) -> int:
        self.rooms[f"{name}_first"] = np.cumsum(capacity) - capacity
        if f"{name}_capacity" in self.rooms.dtype.names:
            self.rooms[f"{name}_capacity"] = capacity
        return int(capacity.sum())


def build_subtrees(
    method: Method, triangles: TriangleBoxes, config: KdTreeConfig, room: Reservation, frames: wp.array, memory: Any
) -> wp.array:
    """Builds all subtrees, the threads taking them from one pool; returns what each task made.

    Args:
        method: how they are built.
        triangles: of the mesh.
        config: cost model and stop rules.
        room: the tasks and their shares.
        frames: (tasks,) their roots.
        memory: the lists, as the method has them.
    """
    device, count = frames.device, len(frames)
    stack = wp.empty((count, STACK), dtype=Frame, device=device)
    results = wp.empty(count, dtype=Result, device=device)
    rules = [config.cost.struct(), config.stop.limits(triangles.count, triangles.size)]
    inputs = [*rules, room.tasks, frames, memory, room.parts, stack, results]
    launch(specialise(make_build_subtrees, method), count, inputs, device=device, chunk=1, chunks_per_thread=count)
    return results
