"""The top levels of a build that scans references: all large nodes of a level at once, parallel over chunks of references.

    search      every chunk bins its references (`kdtree_bins`)
    stop        every node merges the bins of its chunks, and stops, or splits at the best plane between bins
    classify    every chunk counts its references on both sides of its node's plane, and computes their boxes
    emit        the host lists the children and computes the write positions of the chunks; the only host round trip of a level
    partition   every chunk moves its references to the next level's buffer, in order

A node that is small enough, or is a leaf, waits for the end of the levels; its references are copied unchanged. The kernels are
in `reference_chunks`, those that clip triangles to cells in `clipped_chunks`.

A builder's file calls these phases of `ReferenceLevels`. It may search without bins (`make_decide`): then one thread searches
each node.

References:
    M. Shevtsov, A. Soupikov, A. Kapustin: Highly parallel fast KD-tree construction for interactive ray tracing of dynamic
        scenes. Computer Graphics Forum 26(3), 2007.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from wrt.builders.core.clip import clipped_mesh
from wrt.builders.core.reference_lists import Sides
from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.kdtree.scan.clipped_chunks import measure_clipped_chunks, move_clipped_chunks
from wrt.builders.kdtree.scan.kdtree_bins import counters_for
from wrt.builders.kdtree.scan.reference_chunks import (
    Chunk,
    LiveRange,
    bin_chunks,
    decide,
    make_references,
    measure_chunks,
    move_chunks,
)
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.kernels.runtime.launch import launch

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
        median_levels: levels whose nodes of more triangles than bins are split at medians, here and not in tasks.
    """

    large: int
    bins: int
    sampled: int
    median_levels: int = 0

    def waits(self, triangles: np.ndarray | int, depth: np.ndarray | int) -> np.ndarray:
        """Whether nodes are left to tasks."""
        return np.less_equal(triangles, np.where(np.less(depth, self.median_levels), min(self.large, self.bins), self.large))


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
        self.mesh = clipped_mesh(triangles, triangles.size, config.split_clipping) if config.tests_nodes else None
        """The triangles to clip; None if they are not clipped."""
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
        levels = self.rules.median_levels
        inputs = [self.cost, self.limits, bins, sampled, levels, self.live, self.counter, len(self.chunks)]
        launch(decide, len(self.nodes), inputs, device=self.device, chunk=max(1, MIN_PLANES_PER_ITEM // bins))

    def search_and_stop(self, kernel: wp.Kernel, memory: Any) -> None:
        """In place of both: one thread searches a node as a task does. kernel: of `make_decide`; memory: as of `Method`."""
        self._cut()
        inputs = [self.cost, self.limits, memory, self.live]
        launch(kernel, len(self.nodes), inputs, device=self.device, chunk=1)

    def classify(self) -> None:
        """Every chunk counts its references on both sides of its node's plane, and computes their boxes. If straddlers
        are clipped, they are counted by their parts."""
        measured = wp.empty(len(self.chunks), dtype=Sides, device=self.device)
        inputs = [self.references, self.live, self.parts, measured]
        if self.mesh:
            self.run(measure_clipped_chunks, len(self.chunks), self.mesh, *inputs)
        else:
            self.run(measure_chunks, len(self.chunks), *inputs)
        self.nodes, self.sides = self.live.numpy(), measured.numpy()

    def emit(self) -> None:
        """Lists the nodes of the next level, and computes where each chunk writes. The host does."""
        self.children = next_level(self.nodes, self.sides, self.rules)
        place_chunks(self.chunks, self.nodes, self.children, self.sides)

    def partition(self) -> None:
        """Every chunk moves its references; the next level is then the current one."""
        target = wp.empty(8 * int(self.children["frame"]["count"][:, 0].sum()), dtype=float, device=self.device)
        parts = wp.array(self.chunks, dtype=Chunk, device=self.device)
        inputs = [self.references, self.live, parts, target]
        if self.mesh:
            self.run(move_clipped_chunks, len(self.chunks), self.mesh, *inputs)
        else:
            self.run(move_chunks, len(self.chunks), *inputs)
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
    nodes["finished"] = rules.waits(triangles.count, 0)
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


def next_level(nodes: np.ndarray, sides: np.ndarray, rules: LevelRules) -> np.ndarray:
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
    children["finished"] |= rules.waits(frame["triangles"], frame["depth"])
    return children


def place_chunks(chunks: np.ndarray, nodes: np.ndarray, children: np.ndarray, sides: np.ndarray) -> None:
    """Computes the write positions of each chunk."""
    first = children["frame"]["first"][:, 0]
    left = nodes["left"][chunks["node"]]
    right = np.where(nodes["finished"][chunks["node"]], left, left + 1)
    for side, child in (("left", left), ("right", right)):
        before = np.cumsum(sides[side]) - sides[side]
        chunks[f"to_{side}"] = first[child] + before - before[nodes["chunk_first"][chunks["node"]]]
