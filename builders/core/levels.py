"""The top levels of a tree: all large nodes of a level at once, parallel over chunks of their lists.

    search      finds planes: of every chunk, or of every node
    stop        every node is split at its best plane, or finished (`decided`)
    classify    every chunk counts what goes to both sides of its node's plane
    emit        the host lists the children, and where each chunk writes; the only host round trip of a level
    partition   every chunk moves its part of a list to the next level's lists, in order

`Levels` is what all kinds of lists have in common; its subclasses have the phases: lists of references (`reference_levels`),
events that stay where they are (`in_place`), and sorted events that move with nodes (`wrt.builders.classics.kdtree.nested`).

A node of a kd-tree that is small enough, or a leaf, is finished: it waits for the end of the levels, as its own child, and then
becomes a task (`subtrees`), which makes the same decision.

Counts, minima and the order of planes do not depend on the grouping. So neither chunks nor threads show in the result, and a
node gets the same split as in a task.
"""

import numpy as np
import warp as wp

from wrt.builders.core.subtrees import Frame
from wrt.builders.cost import Split, SplitCost
from wrt.builders.tree import StopLimits, stop
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.kernels.layout.struct_arrays import with_known_layout
from wrt.kernels.runtime.launch import launch

CHUNK = 8192
"""Entries of a list in a chunk; the last chunk of a list has fewer."""


@with_known_layout
@wp.struct
class LiveNode:
    """A node of the current level of a kd-tree. Its lists are those of its frame."""

    frame: Frame
    split: Split
    finished: bool
    """Whether it waits for the end of the levels."""
    left: int
    """Index of its left child on the next level (the right one follows); of itself if it is finished."""
    triangles_first: int
    """Start of its list of triangles, if it has one beside those of events."""
    chunk_first: wp.vec3i
    """First chunk of each of its lists; the chunks of a list are contiguous."""
    chunk_count: wp.vec3i


@with_known_layout
@wp.struct
class Chunk:
    """A part of a list of a node."""

    node: int
    axis: int
    """Which of the node's lists."""
    begin: int
    end: int
    left: int
    """Number of its entries that go to the left child; all of them if the node is finished."""
    right: int
    to_left: int
    """Where they are written."""
    to_right: int


@wp.func
def decided(cost: SplitCost, limits: StopLimits, node: LiveNode, best: Split):
    """Phase "stop": the node, split at its best plane or finished."""
    frame = node.frame
    path = stop(limits, cost, frame.depth, frame.triangles, frame.path, best, frame.high - frame.low)
    node.split = best
    node.finished = path.bad_splits < 0
    if path.bad_splits >= 0:
        node.frame.path = path
    return node


@wp.func
def side_of(split: Split, low: float, high: float):
    """The children of a box with this interval on the split axis: 1 left, 2 right, 3 both."""
    if not (low < high) and low == split.position:
        return wp.where(split.planar_left, 1, 2)
    return wp.where(low < split.position, 1, 0) + wp.where(high > split.position, 2, 0)


class Levels:
    """The top levels while they are split.

    Args:
        device: of the build.
        nodes: the first level, a structured array.
    """

    chunks_per_thread = 4
    """Chunks of items per thread in launches: items cost about the same."""

    def __init__(self, device: wp.Device, nodes: np.ndarray) -> None:
        self.device = device
        self.levels: list[np.ndarray] = []
        """The levels that are split."""
        self.nodes = nodes
        """The current level; when no node is to be split any more, the roots of tasks."""

    def run(self, kernel: wp.Kernel, count: int, *inputs: object, chunk: int = 1) -> None:
        """Launches a kernel, `chunk` items at a time."""
        launch(kernel, count, inputs, device=self.device, chunk=chunk, chunks_per_thread=self.chunks_per_thread)

    def should_split(self) -> bool:
        """Whether the current level is to be split."""
        return not self.nodes["finished"].all()

    def split(self) -> None:
        """Splits level after level."""
        while self.should_split():
            self.search()
            self.stop()
            self.classify()
            self.emit()
            self.partition()

    def search(self) -> None:
        """Finds planes."""
        raise NotImplementedError

    def stop(self) -> None:
        """Every node is split, or finished."""
        raise NotImplementedError

    def classify(self) -> None:
        """Counts both sides; not if the search did."""

    def emit(self) -> None:
        """Makes the children, with their numbers of triangles and their lists, and computes where each chunk writes."""
        raise NotImplementedError

    def partition(self) -> None:
        """Makes the lists of the children, and these the current level."""
        raise NotImplementedError


def root_level(triangles: TriangleBoxes) -> np.ndarray:
    """The first level of a kd-tree, with one list of all triangles."""
    nodes = np.zeros(1, dtype=LiveNode.numpy_dtype())
    frame = nodes["frame"]
    for name, corner in (("low", triangles.low), ("high", triangles.high)):
        frame[name] = frame[f"inner_{name}"] = corner
    frame["triangles"] = frame["count"][:, 0] = triangles.count
    frame["parent"] = -1
    return nodes


def starts_of(counts: np.ndarray) -> np.ndarray:
    """Where lists of these lengths begin, one after the other."""
    return (np.cumsum(counts) - counts.ravel()).reshape(counts.shape)


def cut(first: np.ndarray, count: np.ndarray, size: int | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Divides lists into chunks, at least one each.

    Args:
        first, count: (nodes, lists) where lists begin, and their lengths.
        size: entries in a chunk, but the last one of a list; None for `CHUNK`.

    Returns:
        The chunks, structured as `Chunk`, and (nodes, lists) each: the first chunk of every list, and the number of its chunks.
    """
    size = size or CHUNK
    pieces = np.maximum(1, -(-count // size))
    starts = starts_of(pieces)
    owner = np.repeat(np.arange(count.size), pieces.ravel())
    begin = (np.arange(len(owner)) - starts.ravel()[owner]) * size
    chunks = np.zeros(len(owner), dtype=Chunk.numpy_dtype())
    chunks["node"], chunks["axis"] = np.divmod(owner, count.shape[1])
    chunks["begin"] = first.ravel()[owner] + begin
    chunks["end"] = first.ravel()[owner] + np.minimum(begin + size, count.ravel()[owner])
    return chunks, starts, pieces


def of_children(nodes: np.ndarray, left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Values of the children in order, from those of the left and of the right child of every node; a finished node has a left
    one only, itself."""
    exists = np.stack([np.ones(len(nodes), dtype=bool), ~nodes["finished"]], axis=1)
    return np.stack([left, right], axis=1)[exists]


def children_of(nodes: np.ndarray) -> np.ndarray:
    """The next level, with the boxes and the depths of its nodes; stores their indices in the nodes."""
    counts = np.where(nodes["finished"], 1, 2)
    nodes["left"] = starts_of(counts)
    children = np.repeat(nodes, counts)
    is_right = np.arange(len(children)) > children["left"]
    frame, split, divided = children["frame"], children["split"], ~children["finished"]
    frame["depth"] += divided
    for corner, here in (("high", divided & ~is_right), ("low", divided & is_right)):
        frame[corner][here, split["axis"][here]] = split["position"][here]
    return children


def both_children(nodes: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values of the left and of the right child of every node, from those of the children in order; of a finished node twice
    its own."""
    left = nodes["left"]
    return values[left], values[np.where(nodes["finished"], left, left + 1)]


def place(chunks: np.ndarray, to_left: np.ndarray, to_right: np.ndarray) -> None:
    """Computes where each chunk writes, by the chunks' counts; to_left, to_right: (nodes, lists) where the children's lists
    begin."""
    node, axis = chunks["node"], chunks["axis"]
    lists = 3 * node + axis
    for side, first in (("left", to_left), ("right", to_right)):
        before = starts_of(chunks[side])
        chunks[f"to_{side}"] = first[node, axis] + before - before[np.searchsorted(lists, lists)]
