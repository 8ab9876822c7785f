"""Inputs and results of builders: stop rules, the finished tree, and the time and memory of a build."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import log2
from time import perf_counter
from typing import Any

import numpy as np
import warp as wp

from wrt.builders.cost import Split, SplitCost, leaf_cost
from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.kdtree_nodes import MAX_TREE_DEPTH, KdNodes
from wrt.kernels.simd.boxes import INFINITY

MAX_GROWTH = wp.constant(63.0)
"""Largest growth of the references on a path, less 1: a split that would reach it makes a leaf. Without a bound, overlapping
triangles that every plane straddles multiply without end (notebooks/records/2026-11-21-kdtree-builders.md)."""


@wp.struct
class StopLimits:
    """`StopRules` for a given number of triangles, for kernels."""

    depth: int
    bad_splits: int
    quality: float
    """A split is bad if it costs at least this many times as much as the leaf."""
    leaf_triangles: int
    least_size: float
    """Least length of a node's longest side; a smaller node is a leaf."""


COST, AUTOMATIC, FIXED = "cost", "automatic", "fixed"
TERMINATIONS = {
    COST: "splits must cost less than the leaf, but for some",
    AUTOMATIC: "splits must cost less than 3/4 of the leaf, but for more in larger meshes (Havran, Bittner 2002)",
    FIXED: "every node is split until it is deep or small enough, whatever that costs",
}
"""Rules by name: which splits are bad, and how many of them a path may have."""


@dataclass(frozen=True)
class StopRules:
    """When a node becomes a leaf.

    A node becomes a leaf if no plane splits it, or if it has reached the greatest depth, the least number of triangles or the
    least size. It also becomes a leaf if its best split is bad and its ancestors have used up the allowance of bad splits: a
    bad split may lead to good ones (Wald and Havran 2006 call the alternative a local minimum), but not repeatedly. Finally, a
    node is not split if the splits on its path would have multiplied its triangles by 64 (`PathState`).

    Attributes:
        max_depth: greatest depth of a leaf, 0 (the root is a leaf) to 64; None for 8 + 1.3 log2(triangles), a bound of the form
            that Havran and Bittner (2002) found, with the constants of Pharr and Humphreys (2004). With termination
            "automatic", None gives the constants of Havran and Bittner, 2 + 1.2 log2(triangles).
        bad_splits: bad splits allowed between the root and a leaf; "automatic" allows 1 + max_depth / 5 instead.
        termination: key in `TERMINATIONS` that selects which splits are bad.
        leaf_triangles: a node of at most this many triangles is a leaf.
        least_size: a node whose longest side is at most this long is a leaf; relative to the scene's longest side, in [0, 1).

    Raises:
        ValueError: a value is out of range, or the termination is unknown.

    References: havran-bittner-2002; pharr-humphreys-2004.
    """

    max_depth: int | None = None
    bad_splits: int = 1
    termination: str = COST
    leaf_triangles: int = 0
    least_size: float = 0.0

    def __post_init__(self) -> None:
        if self.max_depth is not None and not 0 <= self.max_depth <= MAX_TREE_DEPTH:
            raise ValueError(f"max_depth is {self.max_depth}; it must be None or from 0 to {MAX_TREE_DEPTH}")
        if self.bad_splits < 0:
            raise ValueError(f"bad_splits is {self.bad_splits}; it must not be negative")
        if self.termination not in TERMINATIONS:
            raise ValueError(f"termination is {self.termination!r}; choose from {', '.join(TERMINATIONS)}")
        if self.leaf_triangles < 0:
            raise ValueError(f"leaf_triangles is {self.leaf_triangles}; it must not be negative")
        if not 0.0 <= self.least_size < 1.0:
            raise ValueError(f"least_size is {self.least_size}; it must be at least 0 and below 1")

    def limits(self, triangles: int, size: float = 0.0) -> StopLimits:
        """The rules for a mesh of `triangles` triangles whose box has a longest side of `size`."""
        limits = StopLimits()
        havran = self.termination == AUTOMATIC
        base, slope = (2.0, 1.2) if havran else (8.0, 1.3)
        automatic = min(MAX_TREE_DEPTH, round(base + slope * log2(max(triangles, 1))))
        limits.depth = automatic if self.max_depth is None else self.max_depth
        limits.bad_splits = 1 + limits.depth // 5 if havran else self.bad_splits
        limits.quality = {COST: 1.0, AUTOMATIC: 0.75, FIXED: float("inf")}[self.termination]
        limits.leaf_triangles = self.leaf_triangles
        limits.least_size = self.least_size * size
        return limits


@wp.struct
class PathState:
    """Allowances that the splits between the root and a node have used up; zeros at the root."""

    bad_splits: int
    growth: float
    """Product of the growth of the references, (left + right) / triangles, over the splits on the path, less 1."""


@wp.func
def stop(limits: StopLimits, cost: SplitCost, depth: int, triangles: int, path: PathState, split: Split, size: wp.vec3):
    """Phase "stop": the allowances of the children of a node whose box has this size; `bad_splits` is -1 if it becomes a leaf.

    The bound on the growth of every path bounds the references of all leaves together, to the same multiple of the triangles.
    """
    below = PathState()
    below.bad_splits = -1
    large = triangles > limits.leaf_triangles and not (wp.max(size[0], wp.max(size[1], size[2])) <= limits.least_size)
    if large and depth < limits.depth and split.cost < INFINITY:
        below.growth = (1.0 + path.growth) * float(split.left + split.right) / float(triangles) - 1.0
        if below.growth < MAX_GROWTH:
            if split.cost < limits.quality * leaf_cost(cost, triangles):
                below.bad_splits = path.bad_splits
            elif path.bad_splits < limits.bad_splits:
                below.bad_splits = path.bad_splits + 1
    return below


@dataclass
class BuildStats:
    """Time and memory of a build.

    Attributes:
        seconds: wall time of each phase, by name.
        peak_bytes: most memory reserved at one time for boxes, lists, work space and the finished tree. Reserved memory that is
            never written costs nothing on the CPU.
    """

    seconds: dict[str, float] = field(default_factory=dict)
    peak_bytes: int = 0

    def reserve(self, *arrays: wp.array) -> None:
        """Records arrays that are held at the same time."""
        self.peak_bytes = max(self.peak_bytes, sum(array.capacity for array in arrays))


class Phases:
    """Times the phases of a build."""

    def __init__(self, device: wp.Device) -> None:
        self.device = device
        self.stats = BuildStats()

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Adds the time of a phase to the statistics."""
        start = perf_counter()
        yield
        wp.synchronize_device(self.device)
        self.stats.seconds[name] = self.stats.seconds.get(name, 0.0) + perf_counter() - start


@dataclass
class KdTree:
    """A finished kd-tree on a device.

    Attributes:
        nodes: (nodes,) vec2i, see `wrt.kernels.layout.kdtree_nodes`.
        primitive: (blocks * width,) int32: triangle ids, leaf after leaf, -1 in unused lanes.
        low, high: the root's box.
        width: triangles per block.
        stats: time and memory of the build.
        built_costs: (nodes,) cost of each subtree when it was built, if it was computed (`wrt.builders.rebuild_heuristic`).
        layout: key in `wrt.builders.classics.kdtree.node_layouts.LAYOUTS`.
        pairs: (nodes,) vec2i, the same nodes in pairs, in the order of the layout; None if that is the builders' own.
    """

    nodes: wp.array
    primitive: wp.array
    low: wp.vec3
    high: wp.vec3
    width: int
    stats: BuildStats
    built_costs: np.ndarray | None = None
    layout: str = "depth_first"
    pairs: wp.array | None = None

    @property
    def bytes(self) -> int:
        """Bytes of nodes and leaf lists, without the triangle records."""
        pairs = 0 if self.pairs is None else self.pairs.capacity
        return self.nodes.capacity + self.primitive.capacity + pairs

    def struct(self) -> KdNodes:
        """The tree for a traversal kernel. Do not modify it."""
        return self._struct

    def paired_struct(self) -> KdNodes:
        """The tree for a traversal kernel of nodes in pairs, which the tree must have. Do not modify it."""
        return self._paired_struct

    @cached_property
    def _paired_struct(self) -> KdNodes:
        tree = KdNodes()
        tree.nodes, tree.low, tree.high = self.pairs, self.low, self.high
        return tree

    @cached_property
    def _struct(self) -> KdNodes:
        tree = KdNodes()
        tree.nodes = self.nodes
        tree.low = self.low
        tree.high = self.high
        return tree

    def to(self, device: wp.Device) -> "KdTree":
        """The tree on another device; the tree itself if it is already there."""
        if device == self.nodes.device:
            return self
        pairs = None if self.pairs is None else self.pairs.to(device)
        return replace(self, nodes=self.nodes.to(device), primitive=self.primitive.to(device), pairs=pairs)


@dataclass
class Bvh:
    """A finished wide bounding volume hierarchy on a device.

    Attributes:
        bounds: (nodes * 6 * width,) float32, see `wrt.kernels.layout.bvh_nodes`.
        child: (nodes * width,) int32, see `wrt.kernels.layout.bvh_nodes`.
        primitive: (blocks * width,) int32: triangle ids, leaf after leaf, -1 in unused lanes.
        low, high: the root's box.
        width: children per node and triangles per block.
        level_first: first node of each level, followed by the number of nodes. Nodes are in breadth-first order.
        stats: time and memory of the build.
        built_costs: as in `KdTree`.
        shared: whether a triangle may be in several leaves, each of which has a box around the part of it there.
        upward: what a refit on CUDA keeps for the next one (`wrt.builders.bvh.update.bvh_update`); None before the first.
    """

    bounds: wp.array
    child: wp.array
    primitive: wp.array
    low: wp.vec3
    high: wp.vec3
    width: int
    level_first: tuple[int, ...]
    stats: BuildStats
    built_costs: np.ndarray | None = None
    shared: bool = False
    upward: Any = None

    @property
    def bytes(self) -> int:
        """Bytes of nodes and leaf lists, without the triangle records."""
        return self.bounds.capacity + self.child.capacity + self.primitive.capacity

    @property
    def depth(self) -> int:
        """Largest number of inner nodes on a path from the root."""
        return len(self.level_first) - 1

    def struct(self) -> WideNodes:
        """The tree for a traversal kernel. Do not modify it."""
        return self._struct

    @cached_property
    def _struct(self) -> WideNodes:
        tree = WideNodes()
        tree.bounds = self.bounds
        tree.child = self.child
        tree.low = self.low
        tree.high = self.high
        return tree

    def to(self, device: wp.Device) -> "Bvh":
        """The tree on another device; the tree itself if it is already there."""
        if device == self.bounds.device:
            return self
        arrays = {name: getattr(self, name).to(device) for name in ("bounds", "child", "primitive")}
        return replace(self, **arrays, upward=None)
