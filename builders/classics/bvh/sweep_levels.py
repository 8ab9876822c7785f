"""The top levels of the exact sweep build (`wrt.builders.core.levels`). A node has the same range in three lists.

    search      every chunk of a list finds the box of its triangles; a scan over the chunks of a list gives each the boxes
                before it and behind it; every chunk then tries the partitions that begin in it: areas to the right, from its
                end on, then those to the left
    stop        every node takes the best of its chunks, by axis and place; where there is none, it is halved
    classify    sides are marked by the list of the partition's axis; every chunk counts them
    partition   every chunk moves its ids to the other buffer

Children that are no longer large become tasks (`sweep`).
"""

import numpy as np
import warp as wp

from wrt.builders.bvh.bvh_config import BuildRules
from wrt.builders.bvh.phases.binary_tree import BinaryTree, Frame, half_area, middle, must_split_at_median, split_cost
from wrt.builders.classics.bvh.sweep_lists import (
    Box,
    Partition,
    SweepLists,
    area_of,
    empty_box,
    enlarged,
    joined,
    mark_sides,
    store_box,
)
from wrt.builders.core.levels import Chunk, Levels, cut, place
from wrt.builders.cost import leaf_cost
from wrt.kernels.layout.struct_arrays import with_known_layout
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.boxes import INFINITY

exact_module(__name__)

CHUNK = 4096
"""Triangles of a list that an item of a kernel takes together."""

MAX_LEVELS = 32
"""Levels after which the remaining nodes become tasks in any case."""


@with_known_layout
@wp.struct
class SweptNode:
    """A large node of the current level."""

    frame: Frame
    chunk_first: wp.vec3i
    """First chunk of each of its lists; the chunks of a list are contiguous, and their places are without the buffer's."""
    chunk_count: wp.vec3i
    best: Partition


@wp.struct
class Part:
    """The search in a chunk."""

    box: Box
    before: Box
    """Of the node's triangles before it in the list."""
    behind: Box
    best: Partition


@wp.kernel
def bound_chunks(
    first: int,
    lists: SweepLists,
    nodes: wp.array(dtype=SweptNode),
    chunks: wp.array(dtype=Chunk),
    parts: wp.array(dtype=Part),
):
    """Item: a chunk."""
    index = first + wp.tid()
    chunk = chunks[index]
    buffer = nodes[chunk.node].frame.buffer
    part = Part()
    part.box = empty_box()
    for i in range(chunk.begin, chunk.end):
        part.box = enlarged(part.box, lists, lists.sorted[chunk.axis, buffer + i])
    parts[index] = part


@wp.kernel
def scan_boxes(first: int, nodes: wp.array(dtype=SweptNode), parts: wp.array(dtype=Part)):
    """Item: 3 * node + axis."""
    item = first + wp.tid()
    begin = nodes[item / 3].chunk_first[item % 3]
    count = nodes[item / 3].chunk_count[item % 3]
    box = empty_box()
    for index in range(begin, begin + count):
        part = parts[index]
        part.before = box
        parts[index] = part
        box = joined(box, part.box)
    box = empty_box()
    for k in range(count):
        index = begin + count - 1 - k
        part = parts[index]
        part.behind = box
        parts[index] = part
        box = joined(box, part.box)


@wp.kernel
def search_chunks(
    first: int,
    rules: BuildRules,
    lists: SweepLists,
    nodes: wp.array(dtype=SweptNode),
    chunks: wp.array(dtype=Chunk),
    parts: wp.array(dtype=Part),
):
    """Item: a chunk. Tries the partitions whose right side begins in it."""
    index = first + wp.tid()
    chunk = chunks[index]
    axis = chunk.axis
    frame = nodes[chunk.node].frame
    part = parts[index]
    box = part.behind
    for k in range(chunk.end - chunk.begin):
        i = chunk.end - 1 - k
        box = enlarged(box, lists, lists.sorted[axis, frame.buffer + i])
        lists.suffix[axis, i] = area_of(box)
    best = Partition()
    best.cost = INFINITY
    best.axis = axis
    box = part.before
    for i in range(chunk.begin, chunk.end):
        left = i - frame.first
        if left > 0:
            cost = split_cost(
                area_of(box), leaf_cost(rules.cost, left), lists.suffix[axis, i], leaf_cost(rules.cost, frame.count - left)
            )
            if cost < best.cost:
                best.cost = cost
                best.left = left
        box = enlarged(box, lists, lists.sorted[axis, frame.buffer + i])
    part.best = best
    parts[index] = part


@wp.kernel
def decide(first: int, rules: BuildRules, nodes: wp.array(dtype=SweptNode), parts: wp.array(dtype=Part), tree: BinaryTree):
    """Item: a node."""
    index = first + wp.tid()
    node = nodes[index]
    frame = node.frame
    last = parts[node.chunk_first[0] + node.chunk_count[0] - 1]
    store_box(tree.box, frame.node, joined(last.before, last.box))
    best = Partition()
    best.cost = INFINITY
    if half_area(tree.box, frame.node) > 0.0 and not must_split_at_median(frame.depth, frame.count):
        for chunk in range(node.chunk_first[0], node.chunk_first[2] + node.chunk_count[2]):
            candidate = parts[chunk].best
            if candidate.cost < best.cost:
                best = candidate
    if best.cost == INFINITY:
        best.left = middle(frame.count, rules.cost.width_bits)
    node.best = best
    nodes[index] = node
    tree.range[frame.node] = wp.vec2i(frame.first, frame.count)
    tree.pair[frame.node] = frame.first + best.left


@wp.kernel
def mark_chunks(first: int, lists: SweepLists, nodes: wp.array(dtype=SweptNode), chunks: wp.array(dtype=Chunk)):
    """Item: a chunk. Marks the sides of its triangles, if its list is that of its node's axis."""
    chunk = chunks[first + wp.tid()]
    node = nodes[chunk.node]
    if chunk.axis == node.best.axis:
        mark_sides(lists, node.frame, node.best, chunk.begin, chunk.end)


@wp.kernel
def count_chunks(first: int, lists: SweepLists, nodes: wp.array(dtype=SweptNode), chunks: wp.array(dtype=Chunk)):
    """Item: a chunk. Counts its triangles on both sides."""
    index = first + wp.tid()
    chunk = chunks[index]
    buffer = nodes[chunk.node].frame.buffer
    left = int(0)
    for i in range(chunk.begin, chunk.end):
        left += int(lists.on_left[lists.sorted[chunk.axis, buffer + i]])
    chunk.left = left
    chunk.right = chunk.end - chunk.begin - left
    chunks[index] = chunk


@wp.kernel
def move_chunks(first: int, lists: SweepLists, nodes: wp.array(dtype=SweptNode), chunks: wp.array(dtype=Chunk)):
    """Item: a chunk."""
    chunk = chunks[first + wp.tid()]
    axis = chunk.axis
    buffer = nodes[chunk.node].frame.buffer
    left = chunk.to_left
    right = chunk.to_right
    for i in range(chunk.begin, chunk.end):
        triangle = lists.sorted[axis, buffer + i]
        if lists.on_left[triangle] == wp.uint8(1):
            lists.sorted[axis, left] = triangle
            left += 1
        else:
            lists.sorted[axis, right] = triangle
            right += 1


class SweepLevels(Levels):
    """The top levels while they are split; `nodes` are large nodes only.

    Args:
        rules: costs and leaf size.
        lists: of the root.
        tree: to be written.
        large: nodes of more triangles are split; the others become tasks.
    """

    def __init__(self, rules: BuildRules, lists: SweepLists, tree: BinaryTree, large: int) -> None:
        self.rules, self.lists, self.tree, self.large = rules, lists, tree, large
        self.count = len(lists.on_left)
        self.small: list[np.ndarray] = []
        """Frames of the nodes that are not large, level by level."""
        self.pairs: list[np.ndarray] = []
        """The pairs made, level by level."""
        root = np.zeros(1, dtype=SweptNode.numpy_dtype())
        root["frame"]["count"] = self.count
        super().__init__(lists.corner.device, self.only_large(root))

    def only_large(self, nodes: np.ndarray) -> np.ndarray:
        """The large ones of some nodes; notes the others."""
        is_large = nodes["frame"]["count"] > self.large
        self.small.append(nodes["frame"][~is_large])
        return nodes[is_large]

    def should_split(self) -> bool:
        """Until there are only small nodes."""
        return len(self.nodes) > 0 and len(self.pairs) < MAX_LEVELS

    def search(self) -> None:
        """Finds the best partition of every chunk."""
        frame = self.nodes["frame"]
        first, count = (np.repeat(frame[name][:, None], 3, axis=1) for name in ("first", "count"))
        chunks, self.nodes["chunk_first"], self.nodes["chunk_count"] = cut(first, count, CHUNK)
        self.chunks = wp.array(chunks, dtype=Chunk, device=self.device)
        self.parts = wp.empty(len(chunks), dtype=Part, device=self.device)
        self.live = wp.array(self.nodes, dtype=SweptNode, device=self.device)
        self.run(bound_chunks, len(chunks), self.lists, self.live, self.chunks, self.parts)
        self.run(scan_boxes, 3 * len(self.live), self.live, self.parts)
        self.run(search_chunks, len(chunks), self.rules, self.lists, self.live, self.chunks, self.parts)

    def stop(self) -> None:
        """Every node is divided by the best partition of its chunks."""
        self.run(decide, len(self.live), self.rules, self.live, self.parts, self.tree)
        self.nodes = self.live.numpy()

    def classify(self) -> None:
        """Marks and counts both sides."""
        for kernel in (mark_chunks, count_chunks):
            self.run(kernel, len(self.chunks), self.lists, self.live, self.chunks)

    def emit(self) -> None:
        """Lists the children, and computes where each chunk writes, in the other buffer."""
        frame, left, chunks = self.nodes["frame"], self.nodes["best"]["left"], self.chunks.numpy()
        self.pairs.append(frame["first"] + left)
        to_left = self.count - frame["buffer"] + frame["first"]
        place(chunks, *(np.repeat(to[:, None], 3, axis=1) for to in (to_left, to_left + left)))
        self.chunks = wp.array(chunks, dtype=Chunk, device=self.device)
        self.children = children_of(self.nodes, self.count)

    def partition(self) -> None:
        """Moves all ids to the other buffer."""
        self.run(move_chunks, len(self.chunks), self.lists, self.live, self.chunks)
        self.levels.append(self.nodes)
        self.nodes = self.only_large(self.children)

    def tasks(self) -> np.ndarray:
        """Frames of the nodes that are left, the largest first."""
        frames = np.concatenate([*self.small, self.nodes["frame"]])
        return frames[np.argsort(-frames["count"], kind="stable")]


def children_of(nodes: np.ndarray, triangles: int) -> np.ndarray:
    """Both children of each node, one node's after the other's."""
    children = np.repeat(nodes, 2)
    frame, left = children["frame"], children["best"]["left"]
    right = np.tile([False, True], len(nodes))
    frame["node"] = 2 * (frame["first"] + left) + right
    frame["first"] += np.where(right, left, 0)
    frame["count"] = np.where(right, frame["count"] - left, left)
    frame["buffer"] = triangles - frame["buffer"]
    frame["depth"] += 1
    return children
