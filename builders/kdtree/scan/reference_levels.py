"""The top levels of a build that scans references (`wrt.builders.core.levels`).

    search      every chunk bins its references (`kdtree_bins`)
    stop        every node merges the bins of its chunks, and takes the best plane between bins
    classify    every chunk counts its references on both sides of its node's plane, and computes their boxes
    partition   every chunk moves its references to the next level's buffer

If triangles are clipped, a straddler enters each side with the box of its part there, or not at all (`core.clip`). The counts
say where chunks write, so straddlers are clipped twice: to be counted, and to be moved. Few references straddle a plane. Tasks
clip the same references to the same boxes, so the tree does not depend on the level at which tasks begin.

The kernels are in `reference_chunks`.

References: shevtsov-2007-kdtree; popov-2006.
"""

from dataclasses import dataclass

import numpy as np
import warp as wp

from wrt.builders.core.clip import ClippedMesh, clipped_mesh
from wrt.builders.core.levels import (
    CHUNK,
    Chunk,
    Levels,
    LiveNode,
    both_children,
    children_of,
    cut,
    of_children,
    place,
    root_level,
    starts_of,
)
from wrt.builders.core.reference_lists import Sides
from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.kdtree.scan.kdtree_bins import counters_for
from wrt.builders.kdtree.scan.reference_chunks import bin_chunks, decide, make_references, measure_chunks, move_chunks
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.kernels.runtime.launch import launch

MIN_PLANES_PER_ITEM = 2048
"""Planes per axis whose evaluation justifies an item of its own."""


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

    def waits(self, frame: np.ndarray) -> np.ndarray:
        """Whether nodes are left to tasks."""
        of_median = frame["depth"] < self.median_levels
        return frame["triangles"] <= np.where(of_median, min(self.large, self.bins), self.large)


class ReferenceLevels(Levels):
    """The top levels while they are split.

    Args:
        triangles: boxes of the mesh's triangles.
        config: cost model and stop rules.
        rules: which nodes are split, and how they are binned.
    """

    def __init__(self, triangles: TriangleBoxes, config: KdTreeConfig, rules: LevelRules) -> None:
        super().__init__(triangles.boxes.low.device, root_level(triangles))
        self.triangles, (self.cost, self.limits) = triangles, config.rules(triangles)
        self.rules, count = rules, triangles.count
        self.mesh = clipped_mesh(triangles, triangles.size, config.split_clipping) if config.tests_nodes else ClippedMesh()
        self.nodes["finished"] = rules.waits(self.nodes["frame"])
        self.references = wp.empty(8 * count, dtype=float, device=self.device)
        """The lists of the nodes, one after the other."""
        self.run(make_references, -(-count // CHUNK), triangles.boxes, count, CHUNK, self.references)

    def search(self) -> None:
        """Every chunk bins its references."""
        self.cut()
        slots, rules = len(self.chunks), self.rules
        self.counter = wp.empty((slots + len(self.nodes), counters_for(rules.bins)), dtype=int, device=self.device)
        self.run(bin_chunks, slots, rules.bins, rules.sampled, self.references, self.live, self.parts, self.counter)

    def stop(self) -> None:
        """Every node merges the bins of its chunks, and becomes a leaf, or is split at the best plane between bins."""
        rules = self.rules
        binned = [rules.bins, rules.sampled, rules.median_levels, self.live, self.counter, len(self.chunks)]
        chunk = max(1, MIN_PLANES_PER_ITEM // rules.bins)
        launch(decide, len(self.nodes), [self.cost, self.limits, *binned], device=self.device, chunk=chunk)

    def classify(self) -> None:
        """Every chunk counts its references on both sides of its node's plane, and computes their boxes."""
        measured = wp.empty(len(self.chunks), dtype=Sides, device=self.device)
        self.run(measure_chunks, len(self.chunks), self.mesh, self.references, self.live, self.parts, measured)
        self.nodes, self.sides = self.live.numpy(), measured.numpy()

    def emit(self) -> None:
        """Lists the children, with the boxes of their triangles, and computes where each chunk writes."""
        nodes, sides, chunks = self.nodes, self.sides, self.chunks
        self.children = children = children_of(nodes)
        frame, divided, chunk_first = children["frame"], ~children["finished"], nodes["chunk_first"][:, 0]

        def reduced(function: np.ufunc, name: str) -> np.ndarray:
            left, right = (function.reduceat(sides[f"{side}{name}"], chunk_first) for side in ("left", "right"))
            return of_children(nodes, left, right)

        frame["triangles"] = frame["count"][:, 0] = reduced(np.add, "")
        frame["first"][:, 0] = starts_of(frame["triangles"])
        low, high = reduced(np.minimum, "_low"), reduced(np.maximum, "_high")
        frame["inner_low"][divided] = np.maximum(frame["low"], low)[divided]
        frame["inner_high"][divided] = np.minimum(frame["high"], high)[divided]
        children["finished"] |= self.rules.waits(frame)
        chunks["left"], chunks["right"] = sides["left"], sides["right"]
        place(chunks, *both_children(nodes, frame["first"]))

    def partition(self) -> None:
        """Every chunk moves its references to the next level's buffer."""
        target = wp.empty(8 * int(self.children["frame"]["triangles"].sum()), dtype=float, device=self.device)
        parts = wp.array(self.chunks, dtype=Chunk, device=self.device)
        self.run(move_chunks, len(self.chunks), self.mesh, self.references, self.live, parts, target)
        self.levels.append(self.nodes)
        self.nodes, self.references = self.children, target

    def cut(self) -> None:
        """Divides the nodes' lists into chunks."""
        frame = self.nodes["frame"]
        self.chunks, first, pieces = cut(frame["first"][:, :1], frame["count"][:, :1])
        self.nodes["chunk_first"][:, :1], self.nodes["chunk_count"][:, :1] = first, pieces
        self.live = wp.array(self.nodes, dtype=LiveNode, device=self.device)
        self.parts = wp.array(self.chunks, dtype=Chunk, device=self.device)
