"""The top levels of a build that scans references: all large nodes of a level at once, parallel over chunks of references.

    search      every chunk bins its references (`kdtree_bins`)
    stop        every node merges the bins of its chunks, and stops, or splits at the best plane between bins
    classify    every chunk counts its references on both sides of its node's plane, and computes their boxes
    emit        the host lists the children and computes the write positions of the chunks; the only host round trip of a level
    partition   every chunk moves its references to the next level's buffer, in order

A node that is small enough, or is a leaf, waits for the end of the levels; its references are copied unchanged. Counts and
minima do not depend on the grouping. So the result does not depend on chunks or threads, and a node gets the same split as in a
task.

A builder's file calls these phases of `ReferenceLevels`. It may search without bins (`make_decide`): then one thread searches
each node.

References:
    M. Shevtsov, A. Soupikov, A. Kapustin: Highly parallel fast KD-tree construction for interactive ray tracing of dynamic
        scenes. Computer Graphics Forum 26(3), 2007.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import warp as wp

from wrt.builders.cost import Split, SplitCost
from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.kdtree.phases.kdtree_subtrees import Frame
from wrt.builders.kdtree.scan.kdtree_bins import best_bin_plane, bin_range, counters_for, make_binning, merge_bins
from wrt.builders.kdtree.scan.reference_lists import Sides, measure_sides, move_range
from wrt.builders.tree import StopLimits, stop
from wrt.builders.triangle_boxes import Boxes, TriangleBoxes
from wrt.builders.triangle_references import copy_references, write_references
from wrt.kernels.layout.struct_arrays import with_known_layout
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import exact_module, specialised_kernel

exact_module(__name__)

CHUNK = 8192
"""References in a chunk; the last chunk of a node has fewer."""

MIN_PLANES_PER_ITEM = 2048
"""Planes per axis whose evaluation justifies an item of its own."""

UNIFORM_CHUNKS_PER_THREAD = 4
"""Chunks per thread in kernels whose items all cost the same."""


@dataclass(frozen=True)
class LevelRules:
    """Parameters of the top levels.

    Attributes:
        large: nodes of more triangles are split here; the others become tasks.
        bins: bins per axis.
        sampled: in a node of at least this many triangles only every l-th is counted, l = log10(triangles); 0: always all.
    """

    large: int
    bins: int
    sampled: int


@with_known_layout
@wp.struct
class LiveRange:
    """A node of the current level. Its list is the frame.count[0] references from frame.first[0] on."""

    frame: Frame
    split: Split
    finished: bool
    """Whether it waits for the end of the levels."""
    left: int
    """Index of its left child on the next level (the right one follows); of itself if it is finished."""
    chunk_first: int
    """First chunk; the chunks of a node are contiguous."""
    chunk_count: int


@with_known_layout
@wp.struct
class Chunk:
    """A part of a node's references."""

    node: int
    begin: int
    count: int
    to_left: int
    """Position to which its references on the left of the plane are written; all of them if the node is finished."""
    to_right: int


@wp.func
def sample_step(triangles: int, sampled: int):
    """Step of the sample: every step-th triangle of a node is counted."""
    step = int(1)
    if sampled > 0 and triangles >= sampled:
        rest = triangles / 100
        while rest > 0:
            rest /= 10
            step += 1
    return step


@wp.kernel
def make_references(first: int, boxes: Boxes, triangles: int, size: int, references: wp.array(dtype=float)):
    """Item: a chunk of `size` triangles. Writes their references."""
    begin = (first + wp.tid()) * size
    write_references(boxes, begin, wp.min(triangles, begin + size), references)


@wp.kernel
def bin_chunks(
    first: int,
    bins: int,
    sampled: int,
    references: wp.array(dtype=float),
    nodes: wp.array(dtype=LiveRange),
    chunks: wp.array(dtype=Chunk),
    counter: wp.array2d(dtype=int),
):
    """Item: a chunk. Bins its references in its slot of counters."""
    slot = first + wp.tid()
    chunk = chunks[slot]
    node = nodes[chunk.node]
    if not node.finished:
        step = sample_step(node.frame.triangles, sampled)
        behind = (chunk.begin - node.frame.first[0]) % step
        skip = (step - behind) % step
        node_binning = make_binning(node.frame, bins)
        bin_range(references, chunk.begin + skip, chunk.count - skip, step, node_binning, counter, slot)


@wp.kernel
def decide(
    first: int,
    cost: SplitCost,
    limits: StopLimits,
    bins: int,
    sampled: int,
    nodes: wp.array(dtype=LiveRange),
    counter: wp.array2d(dtype=int),
    merged: int,
):
    """Item: a live node. Merges its bins, and stops or splits. Slots from `merged` on hold the bins of nodes."""
    index = first + wp.tid()
    node = nodes[index]
    if not node.finished:
        slot = merged + index
        merge_bins(counter, slot, node.chunk_first, node.chunk_first + node.chunk_count, bins)
        step = sample_step(node.frame.triangles, sampled)
        node.split = best_bin_plane(cost, node.frame, counter, slot, bins, step)
        frame = node.frame
        path = stop(limits, cost, frame.depth, frame.triangles, frame.path, node.split, frame.high - frame.low)
        node.finished = path.bad_splits < 0
        if path.bad_splits >= 0:
            node.frame.path = path
        nodes[index] = node


@cache
def make_decide(memory_type: type, search: wp.Function) -> wp.Kernel:
    """The kernel whose item is a live node, and which searches it as a task does; search: as of `subtrees.Method`."""

    def decide_by_search(
        first: int, cost: SplitCost, limits: StopLimits, memory: memory_type, nodes: wp.array(dtype=LiveRange)
    ):
        index = first + wp.tid()
        node = nodes[index]
        if not node.finished:
            node.split = search(cost, memory, index, node.frame)
            frame = node.frame
            path = stop(limits, cost, frame.depth, frame.triangles, frame.path, node.split, frame.high - frame.low)
            node.finished = path.bad_splits < 0
            if path.bad_splits >= 0:
                node.frame.path = path
            nodes[index] = node

    return specialised_kernel(decide_by_search)


@wp.kernel
def measure_chunks(
    first: int,
    references: wp.array(dtype=float),
    nodes: wp.array(dtype=LiveRange),
    chunks: wp.array(dtype=Chunk),
    measured: wp.array(dtype=Sides),
):
    """Item: a chunk. Measures the sides of its node's plane. In a finished node everything is on the left."""
    slot = first + wp.tid()
    chunk = chunks[slot]
    node = nodes[chunk.node]
    sides = Sides()
    if node.finished:
        sides.left = chunk.count
    else:
        split = node.split
        measure_sides(references, chunk.begin, chunk.count, split.axis, split.position, split.planar_left, sides)
    measured[slot] = sides


@wp.kernel
def move_chunks(
    first: int,
    references: wp.array(dtype=float),
    nodes: wp.array(dtype=LiveRange),
    chunks: wp.array(dtype=Chunk),
    target: wp.array(dtype=float),
):
    """Item: a chunk. Moves its references to the next level's buffer."""
    chunk = chunks[first + wp.tid()]
    node = nodes[chunk.node]
    split = node.split
    sides = Sides()
    if node.finished:
        copy_references(references, chunk.begin, chunk.count, target, chunk.to_left)
    else:
        move_range(
            references,
            chunk.begin,
            chunk.count,
            split.axis,
            split.position,
            split.planar_left,
            target,
            chunk.to_left,
            chunk.to_right,
            sides,
        )


@dataclass
class TopLevels:
    """Result of the top levels.

    Attributes:
        levels: live nodes of each level, structured arrays of `LiveRange`; those of the last level become tasks.
        references: the lists of the last level's nodes, one after the other.
    """

    levels: list[np.ndarray]
    references: wp.array


class ReferenceLevels:
    """The top levels while they are split. The phases of a level are called in this order.

    Args:
        triangles: boxes of the mesh's triangles.
        config: cost model and stop rules.
        rules: which nodes are split, and how they are binned.
    """

    def __init__(self, triangles: TriangleBoxes, config: KdTreeConfig, rules: LevelRules) -> None:
        count, self.device = triangles.count, triangles.boxes.low.device
        self.cost, self.limits, self.rules = config.cost.struct(), config.stop.limits(count, triangles.size), rules
        self.levels: list[np.ndarray] = []
        """The levels that are split."""
        self.nodes = root_level(triangles, rules)
        """The current level."""
        self.references = wp.empty(8 * count, dtype=float, device=self.device)
        """The lists of its nodes."""
        self.run(make_references, -(-count // CHUNK), triangles.boxes, count, CHUNK, self.references)

    def run(self, kernel: wp.Kernel, count: int, *inputs: object) -> None:
        """Launches a kernel whose items all cost the same."""
        launch(kernel, count, inputs, device=self.device, chunk=1, chunks_per_thread=UNIFORM_CHUNKS_PER_THREAD)

    def any_large(self) -> bool:
        """Whether a node of the current level is to be split; if not, the nodes are the roots of tasks."""
        return not self.nodes["finished"].all()

    def search(self) -> None:
        """Every chunk bins its references."""
        self._cut()
        slots, rules = len(self.chunks), self.rules
        self.counter = wp.empty((slots + len(self.nodes), counters_for(rules.bins)), dtype=int, device=self.device)
        self.run(bin_chunks, slots, rules.bins, rules.sampled, self.references, self.live, self.parts, self.counter)

    def stop(self) -> None:
        """Every node merges the bins of its chunks, and becomes a leaf, or is split at the best plane between bins."""
        bins, sampled = self.rules.bins, self.rules.sampled
        inputs = [self.cost, self.limits, bins, sampled, self.live, self.counter, len(self.chunks)]
        launch(decide, len(self.nodes), inputs, device=self.device, chunk=max(1, MIN_PLANES_PER_ITEM // bins))

    def search_and_stop(self, kernel: wp.Kernel, memory: Any) -> None:
        """In place of both: one thread searches a node as a task does. kernel: of `make_decide`; memory: as of `Method`."""
        self._cut()
        inputs = [self.cost, self.limits, memory, self.live]
        launch(kernel, len(self.nodes), inputs, device=self.device, chunk=1)

    def classify(self) -> None:
        """Every chunk counts its references on both sides of its node's plane, and computes their boxes."""
        measured = wp.empty(len(self.chunks), dtype=Sides, device=self.device)
        self.run(measure_chunks, len(self.chunks), self.references, self.live, self.parts, measured)
        self.nodes, self.sides = self.live.numpy(), measured.numpy()

    def emit(self) -> None:
        """Lists the nodes of the next level, and computes where each chunk writes. The host does."""
        self.children = next_level(self.nodes, self.sides, self.rules.large)
        place_chunks(self.chunks, self.nodes, self.children, self.sides)

    def partition(self) -> None:
        """Every chunk moves its references; the next level is then the current one."""
        target = wp.empty(8 * int(self.children["frame"]["count"][:, 0].sum()), dtype=float, device=self.device)
        parts = wp.array(self.chunks, dtype=Chunk, device=self.device)
        self.run(move_chunks, len(self.chunks), self.references, self.live, parts, target)
        self.levels.append(self.nodes)
        self.nodes, self.references = self.children, target

    def finished(self) -> TopLevels:
        """The levels, when no node is to be split any more."""
        return TopLevels([*self.levels, self.nodes], self.references)

    def _cut(self) -> None:
        """Divides the nodes' lists into chunks."""
        self.chunks = cut_chunks(self.nodes)
        self.live = wp.array(self.nodes, dtype=LiveRange, device=self.device)
        self.parts = wp.array(self.chunks, dtype=Chunk, device=self.device)


def root_level(triangles: TriangleBoxes, rules: LevelRules) -> np.ndarray:
    """The first level: the root, which is finished if it is not large."""
    nodes = np.zeros(1, dtype=LiveRange.numpy_dtype())
    frame = nodes["frame"]
    for name, corner in (("low", triangles.low), ("high", triangles.high)):
        frame[name] = frame[f"inner_{name}"] = corner
    frame["triangles"] = triangles.count
    frame["count"][:, 0] = triangles.count
    frame["parent"] = -1
    nodes["finished"] = triangles.count <= rules.large
    return nodes


def cut_chunks(nodes: np.ndarray) -> np.ndarray:
    """Divides the nodes' lists into chunks, at least one each, and stores their ranges in the nodes."""
    first, count = nodes["frame"]["first"][:, 0], nodes["frame"]["count"][:, 0]
    pieces = np.maximum(1, -(-count // CHUNK))
    nodes["chunk_count"] = pieces
    nodes["chunk_first"] = np.cumsum(pieces) - pieces
    chunks = np.zeros(pieces.sum(), dtype=Chunk.numpy_dtype())
    node = np.repeat(np.arange(len(nodes)), pieces)
    behind = (np.arange(len(chunks)) - nodes["chunk_first"][node]) * CHUNK
    chunks["node"] = node
    chunks["begin"] = first[node] + behind
    chunks["count"] = np.minimum(CHUNK, count[node] - behind)
    return chunks


def next_level(nodes: np.ndarray, sides: np.ndarray, large: int) -> np.ndarray:
    """Lists the children in order, with a finished node as its own child, and stores their indices in the nodes. sides: of the
    nodes' chunks."""
    child_counts = np.where(nodes["finished"], 1, 2)
    nodes["left"] = np.cumsum(child_counts) - child_counts
    owner = np.repeat(np.arange(len(nodes)), child_counts)
    children = nodes[owner]
    frame, split = children["frame"], children["split"]
    divided = ~children["finished"]
    frame["depth"] += divided
    chunk_first = nodes["chunk_first"]
    for side, moved, here in (("left", "high", 0), ("right", "low", 1)):
        of_side = np.flatnonzero(divided & (np.arange(len(children)) - nodes["left"][owner] == here))
        parent = owner[of_side]
        frame[moved][of_side, split["axis"][of_side]] = split["position"][of_side]
        frame["triangles"][of_side] = np.add.reduceat(sides[side], chunk_first)[parent]
        low = np.minimum.reduceat(sides[f"{side}_low"], chunk_first)[parent]
        high = np.maximum.reduceat(sides[f"{side}_high"], chunk_first)[parent]
        frame["inner_low"][of_side] = np.maximum(frame["low"][of_side], low)
        frame["inner_high"][of_side] = np.minimum(frame["high"][of_side], high)
    frame["count"][:, 0] = frame["triangles"]
    frame["first"][:, 0] = np.cumsum(frame["triangles"]) - frame["triangles"]
    children["finished"] |= frame["triangles"] <= large
    return children


def place_chunks(chunks: np.ndarray, nodes: np.ndarray, children: np.ndarray, sides: np.ndarray) -> None:
    """Computes the write positions of each chunk."""
    first = children["frame"]["first"][:, 0]
    left = nodes["left"][chunks["node"]]
    right = np.where(nodes["finished"][chunks["node"]], left, left + 1)
    for side, child in (("left", left), ("right", right)):
        before = np.cumsum(sides[side]) - sides[side]
        chunks[f"to_{side}"] = first[child] + before - before[nodes["chunk_first"][chunks["node"]]]
