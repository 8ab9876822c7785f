"""The top of the exact sweep build: the large nodes of a level at once, parallel over chunks of their lists.

    bound       every chunk of a list finds the box of its triangles; a scan over a node's chunks gives each the boxes before it
                and behind it
    search      every chunk tries the partitions that begin in it: areas to the right, from its end on, then those to the left
    decide      every node takes the best of its chunks, by axis and place; where there is none, it is halved
    partition   sides are marked by the list of the partition's axis; every chunk counts them, a scan tells it where to write,
                and it moves its ids to the other buffer, in order

The host then lists the children; those that are no longer large become tasks (`sweep`). Minima and counts are the same in any
grouping, so neither chunks nor threads show in the result, and a node gets the partition that a task would give it.
"""

import numpy as np
import warp as wp

from wrt.builders.bvh.bvh_config import BuildRules
from wrt.builders.bvh.phases.binary_tree import BinaryTree, Frame, half_area, middle, must_split_at_median, split_cost
from wrt.builders.bvh.phases.sweep_lists import (
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
from wrt.builders.cost import leaf_cost
from wrt.kernels.layout.struct_arrays import with_known_layout
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.boxes import INFINITY

exact_module(__name__)

CHUNK = 4096
"""Triangles of a list that an item of a kernel takes together."""

MAX_LEVELS = 32
"""Levels after which the remaining nodes become tasks in any case."""


@with_known_layout
@wp.struct
class LiveNode:
    """A large node of the current level."""

    frame: Frame
    chunk_first: int
    """Its chunks of this level follow one another."""
    chunk_count: int
    best: Partition


@with_known_layout
@wp.struct
class Chunk:
    """A range of a live node's lists."""

    node: int
    begin: int
    """First place in the lists, without the buffer's."""
    end: int


@wp.struct
class Part:
    """A chunk of one list."""

    box: Box
    before: Box
    """Of the node's triangles before it in the list."""
    behind: Box
    best: Partition
    left: int
    """How many of its triangles are on the left of the node's partition."""
    to_left: int
    """Where they are written to."""
    to_right: int


@wp.kernel
def bound_chunks(
    first: int,
    lists: SweepLists,
    nodes: wp.array(dtype=LiveNode),
    chunks: wp.array(dtype=Chunk),
    parts: wp.array2d(dtype=Part),
):
    """Item: axis * chunks + chunk. parts: (3, chunks)."""
    item = first + wp.tid()
    axis = item / chunks.shape[0]
    index = item % chunks.shape[0]
    chunk = chunks[index]
    buffer = nodes[chunk.node].frame.buffer
    part = Part()
    part.box = empty_box()
    for i in range(chunk.begin, chunk.end):
        part.box = enlarged(part.box, lists, lists.sorted[axis, buffer + i])
    parts[axis, index] = part


@wp.kernel
def scan_boxes(first: int, nodes: wp.array(dtype=LiveNode), parts: wp.array2d(dtype=Part)):
    """Item: axis * nodes + node."""
    item = first + wp.tid()
    axis = item / nodes.shape[0]
    node = nodes[item % nodes.shape[0]]
    box = empty_box()
    for index in range(node.chunk_first, node.chunk_first + node.chunk_count):
        part = parts[axis, index]
        part.before = box
        parts[axis, index] = part
        box = joined(box, part.box)
    box = empty_box()
    for k in range(node.chunk_count):
        index = node.chunk_first + node.chunk_count - 1 - k
        part = parts[axis, index]
        part.behind = box
        parts[axis, index] = part
        box = joined(box, part.box)


@wp.kernel
def search_chunks(
    first: int,
    rules: BuildRules,
    lists: SweepLists,
    nodes: wp.array(dtype=LiveNode),
    chunks: wp.array(dtype=Chunk),
    parts: wp.array2d(dtype=Part),
):
    """Item: axis * chunks + chunk. Tries the partitions whose right side begins in the chunk."""
    item = first + wp.tid()
    axis = item / chunks.shape[0]
    index = item % chunks.shape[0]
    chunk = chunks[index]
    frame = nodes[chunk.node].frame
    part = parts[axis, index]
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
    parts[axis, index] = part


@wp.kernel
def decide(first: int, rules: BuildRules, nodes: wp.array(dtype=LiveNode), parts: wp.array2d(dtype=Part), tree: BinaryTree):
    """Item: a live node."""
    index = first + wp.tid()
    node = nodes[index]
    frame = node.frame
    last = parts[0, node.chunk_first + node.chunk_count - 1]
    store_box(tree.box, frame.node, joined(last.before, last.box))
    best = Partition()
    best.cost = INFINITY
    if half_area(tree.box, frame.node) > 0.0 and not must_split_at_median(frame.depth, frame.count):
        for axis in range(3):
            for chunk in range(node.chunk_first, node.chunk_first + node.chunk_count):
                candidate = parts[axis, chunk].best
                if candidate.cost < best.cost:
                    best = candidate
    if best.cost == INFINITY:
        best.left = middle(frame.count, rules.cost.width_bits)
    node.best = best
    nodes[index] = node
    tree.range[frame.node] = wp.vec2i(frame.first, frame.count)
    tree.pair[frame.node] = frame.first + best.left


@wp.kernel
def mark_chunks(first: int, lists: SweepLists, nodes: wp.array(dtype=LiveNode), chunks: wp.array(dtype=Chunk)):
    """Item: a chunk of the list of its node's axis."""
    chunk = chunks[first + wp.tid()]
    node = nodes[chunk.node]
    mark_sides(lists, node.frame, node.best, chunk.begin, chunk.end)


@wp.kernel
def count_chunks(
    first: int,
    lists: SweepLists,
    nodes: wp.array(dtype=LiveNode),
    chunks: wp.array(dtype=Chunk),
    parts: wp.array2d(dtype=Part),
):
    """Item: axis * chunks + chunk."""
    item = first + wp.tid()
    axis = item / chunks.shape[0]
    index = item % chunks.shape[0]
    chunk = chunks[index]
    buffer = nodes[chunk.node].frame.buffer
    left = int(0)
    for i in range(chunk.begin, chunk.end):
        left += int(lists.on_left[lists.sorted[axis, buffer + i]])
    part = parts[axis, index]
    part.left = left
    parts[axis, index] = part


@wp.kernel
def scan_counts(
    first: int, nodes: wp.array(dtype=LiveNode), chunks: wp.array(dtype=Chunk), triangles: int, parts: wp.array2d(dtype=Part)
):
    """Item: axis * nodes + node."""
    item = first + wp.tid()
    axis = item / nodes.shape[0]
    node = nodes[item % nodes.shape[0]]
    to_left = triangles - node.frame.buffer + node.frame.first
    to_right = to_left + node.best.left
    for index in range(node.chunk_first, node.chunk_first + node.chunk_count):
        part = parts[axis, index]
        part.to_left = to_left
        part.to_right = to_right
        parts[axis, index] = part
        to_left += part.left
        to_right += chunks[index].end - chunks[index].begin - part.left


@wp.kernel
def move_chunks(
    first: int,
    lists: SweepLists,
    nodes: wp.array(dtype=LiveNode),
    chunks: wp.array(dtype=Chunk),
    parts: wp.array2d(dtype=Part),
):
    """Item: axis * chunks + chunk."""
    item = first + wp.tid()
    axis = item / chunks.shape[0]
    index = item % chunks.shape[0]
    chunk = chunks[index]
    buffer = nodes[chunk.node].frame.buffer
    part = parts[axis, index]
    left = part.to_left
    right = part.to_right
    for i in range(chunk.begin, chunk.end):
        triangle = lists.sorted[axis, buffer + i]
        if lists.on_left[triangle] == wp.uint8(1):
            lists.sorted[axis, left] = triangle
            left += 1
        else:
            lists.sorted[axis, right] = triangle
            right += 1


def split_top(rules: BuildRules, lists: SweepLists, tree: BinaryTree, large: int) -> tuple[np.ndarray, np.ndarray]:
    """Splits nodes of more than `large` triangles.

    Returns:
        The others, as frames, the largest first; and the pairs made, parents before children.
    """
    count = len(lists.on_left)
    root = np.zeros(1, dtype=Frame.numpy_dtype())
    root["count"] = count
    open_nodes, finished, top = root, [], []
    for _level in range(MAX_LEVELS):
        is_large = open_nodes["count"] > large
        finished.append(open_nodes[~is_large])
        open_nodes = open_nodes[is_large]
        if not len(open_nodes):
            break
        best = split_level(rules, lists, tree, open_nodes)
        pairs = open_nodes["first"] + best["left"]
        top.append(pairs)
        open_nodes = children_of(open_nodes, best["left"], count)
    tasks = np.concatenate([*finished, open_nodes])
    return tasks[np.argsort(-tasks["count"], kind="stable")], np.concatenate(top) if top else np.empty(0, dtype=np.int32)


def split_level(rules: BuildRules, lists: SweepLists, tree: BinaryTree, frames: np.ndarray) -> np.ndarray:
    """Finds the best partition of each node, and moves its triangles to the other buffer; returns the partitions."""
    device, count = lists.corner.device, len(frames)
    pieces = -(-frames["count"] // CHUNK)
    live = np.zeros(count, dtype=LiveNode.numpy_dtype())
    live["frame"], live["chunk_count"], live["chunk_first"] = frames, pieces, np.cumsum(pieces) - pieces
    chunks = np.zeros(pieces.sum(), dtype=Chunk.numpy_dtype())
    node = chunks["node"] = np.repeat(np.arange(count), pieces)
    chunks["begin"] = frames["first"][node] + (np.arange(len(chunks)) - live["chunk_first"][node]) * CHUNK
    chunks["end"] = np.minimum(chunks["begin"] + CHUNK, (frames["first"] + frames["count"])[node])
    nodes = wp.array(live, dtype=LiveNode, device=device)
    cut = wp.array(chunks, dtype=Chunk, device=device)
    parts = wp.empty((3, len(chunks)), dtype=Part, device=device)

    def run(kernel: wp.Kernel, items: int, *inputs: object) -> None:
        launch(kernel, items, inputs, device=device, chunk=1)

    run(bound_chunks, 3 * len(chunks), lists, nodes, cut, parts)
    run(scan_boxes, 3 * count, nodes, parts)
    run(search_chunks, 3 * len(chunks), rules, lists, nodes, cut, parts)
    run(decide, count, rules, nodes, parts, tree)
    run(mark_chunks, len(chunks), lists, nodes, cut)
    run(count_chunks, 3 * len(chunks), lists, nodes, cut, parts)
    run(scan_counts, 3 * count, nodes, cut, len(lists.on_left), parts)
    run(move_chunks, 3 * len(chunks), lists, nodes, cut, parts)
    return nodes.numpy()["best"]


def children_of(frames: np.ndarray, left: np.ndarray, triangles: int) -> np.ndarray:
    """The frames of both children of each node, one node's after the other's."""
    children = np.repeat(frames, 2)
    right = np.tile([False, True], len(frames))
    pairs, lefts = np.repeat(frames["first"] + left, 2), np.repeat(left, 2)
    children["node"] = 2 * pairs + right
    children["first"] += np.where(right, lefts, 0)
    children["count"] = np.where(right, children["count"] - lefts, lefts)
    children["buffer"] = triangles - children["buffer"]
    children["depth"] += 1
    return children
