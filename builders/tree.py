"""What builders take and give: stop rules, the finished tree, and what the build cost."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import log2
from time import perf_counter

import numpy as np
import warp as wp

from wrt.builders.cost import Split, SplitCost, leaf_cost
from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.kdtree_nodes import MAX_TREE_DEPTH, KdNodes
from wrt.kernels.simd.boxes import INFINITY

wp.set_module_options({"enable_backward": False, "fuse_fp": False})


MAX_GROWTH = wp.constant(63.0)
"""Triangles that lie across each other are straddled by every plane: without a bound, 3,000 of them that fill a square make
7 million references, each split of which is worth its cost. (Meshes of surfaces, on average over all ways: 0.3 to 2.3.)"""


@wp.struct
class StopLimits:
    """`StopRules` for a given number of triangles, as kernels see them."""

    depth: int
    bad_splits: int
    quality: float
    """A split is bad if it costs at least so many times as much as the leaf."""
    leaf_triangles: int
    least_size: float
    """Of a node's longest side."""


COST, AUTOMATIC, FIXED = "cost", "automatic", "fixed"
TERMINATIONS = {
    COST: "splits must cost less than the leaf, but for some",
    AUTOMATIC: "splits must cost less than 3/4 of the leaf, but for more in larger meshes (Havran, Bittner 2002)",
    FIXED: "every node is split until it is deep or small enough, whatever that costs",
}
"""When a split is bad, and how many are allowed on a way."""


@dataclass(frozen=True)
class StopRules:
    """When a node becomes a leaf.

    A node is a leaf if no plane splits it, if it is as deep, has as few triangles, or is as small as a leaf may be, or if its
    best split is bad and its ancestors have used up the allowance of such: a bad split may make good ones possible (Wald and
    Havran 2006 call the alternative a local minimum), but not again and again. Nor is a node split if the splits on the way to
    it would have multiplied its triangles by 64 (`Descent`).

    Attributes:
        max_depth: greatest depth of a leaf, 0 (the root is a leaf) to 64; None for 8 + 1.3 log2(triangles), a
            bound of the form that Havran and Bittner (2002) found, with the constants of Pharr and Humphreys (2004);
            "automatic" has their own, 2 + 1.2 log2(triangles).
        bad_splits: bad splits allowed between the root and a leaf; "automatic" allows 1 + max_depth / 5 instead.
        termination: key in `TERMINATIONS`: which splits are bad.
        leaf_triangles: a node of at most so many triangles is a leaf.
        least_size: a node none of whose sides is longer than this is a leaf; a share of the scene's longest side, below 1.

    Raises:
        ValueError: a value is out of range, or an unknown termination.

    References:
        V. Havran, J. Bittner: On improving kd-trees for ray shooting. WSCG 2002.
        M. Pharr, G. Humphreys: Physically based rendering. Morgan Kaufmann, 2004.
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
        """The rules for a mesh of so many triangles, whose box has a longest side of this size."""
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
class Descent:
    """What the splits on the way down from the root have used up of what is allowed; zeros at the root."""

    bad_splits: int
    growth: float
    """By what the references of a node are multiplied on the way, (left + right) / triangles a split, less 1."""


@wp.func
def descend(limits: StopLimits, cost: SplitCost, depth: int, triangles: int, path: Descent, split: Split, size: wp.vec3):
    """The way to the children of a node, whose box has this size; its `bad_splits` are -1 if the node becomes a leaf instead.

    What bounds the growth on every way bounds the references of all leaves together, to so many times the triangles.
    """
    below = Descent()
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
    """What a build cost.

    Attributes:
        seconds: wall time of each phase, by name.
        peak_bytes: most memory reserved at a time for boxes, lists, work space and the finished tree. Not all of what is
            reserved is written, and what is not written costs nothing on the CPU.
    """

    seconds: dict[str, float] = field(default_factory=dict)
    peak_bytes: int = 0

    def reserve(self, *arrays: wp.array) -> None:
        """Notes arrays that are held at the same time."""
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
        width: triangles a block.
        stats: what the build cost.
        built_costs: (nodes,) what each subtree cost when it was built, if somebody had to know
            (`wrt.builders.rebuild_heuristic`).
    """

    nodes: wp.array
    primitive: wp.array
    low: wp.vec3
    high: wp.vec3
    width: int
    stats: BuildStats
    built_costs: np.ndarray | None = None

    @property
    def bytes(self) -> int:
        """Memory of nodes and leaf lists; the triangle records come on top."""
        return self.nodes.capacity + self.primitive.capacity

    def struct(self) -> KdNodes:
        """The tree for a traversal kernel; to be left as it is."""
        return self._struct

    @cached_property
    def _struct(self) -> KdNodes:
        tree = KdNodes()
        tree.nodes = self.nodes
        tree.low = self.low
        tree.high = self.high
        return tree

    def to(self, device: wp.Device) -> "KdTree":
        """The tree on another device; itself if it is there already."""
        if device == self.nodes.device:
            return self
        return replace(self, nodes=self.nodes.to(device), primitive=self.primitive.to(device))


@dataclass
class Bvh:
    """A finished wide bounding volume hierarchy on a device.

    Attributes:
        bounds: (nodes * 6 * width,) float32, see `wrt.kernels.layout.bvh_nodes`.
        child: (nodes * width,) int32, see `wrt.kernels.layout.bvh_nodes`.
        primitive: (blocks * width,) int32: triangle ids, leaf after leaf, -1 in unused lanes.
        low, high: the root's box.
        width: children a node and triangles a block.
        level_first: first node of each level, and the number of nodes at the end: nodes are in breadth-first order.
        stats: what the build cost.
        built_costs: as of a `KdTree`.
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

    @property
    def bytes(self) -> int:
        """Memory of nodes and leaf lists; the triangle records come on top."""
        return self.bounds.capacity + self.child.capacity + self.primitive.capacity

    @property
    def depth(self) -> int:
        """Most inner nodes on a path from the root."""
        return len(self.level_first) - 1

    def struct(self) -> WideNodes:
        """The tree for a traversal kernel; to be left as it is."""
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
        """The tree on another device; itself if it is there already."""
        if device == self.bounds.device:
            return self
        arrays = {name: getattr(self, name).to(device) for name in ("bounds", "child", "primitive")}
        return replace(self, **arrays)
