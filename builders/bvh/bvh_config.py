"""Configuration of a build of a bounding volume hierarchy."""

from dataclasses import dataclass, field

import warp as wp

from wrt.builders.cost import SplitCost, SurfaceAreaCost
from wrt.kernels.layout.bvh_nodes import MAX_LEAF_TRIANGLES

MAX_BINS = 40
"""Most bins along an axis, as many as Falcone (2024) has; sizes the scratch memory."""

MAX_WIDTH = 16
"""Most children of a wide node."""

MIN_GRAIN = 4
"""Least capacity, in triangles, of a leaf of the binary tree; applies where blocks are narrower."""

LEAF_BLOCKS = 3
"""Most blocks of a leaf, unless `BvhConfig.max_leaf_triangles` says otherwise."""

MAX_ROUNDS = 1000
"""Largest number of reinsertion rounds that can be requested. Reinsertion converges in a few dozen rounds."""

LARGE = 1.0 / 32.0
"""Default of `BvhConfig.large` (notebooks/records/2026-11-24-large-triangles.md)."""

MIN_LEAF_LIMIT = 8
"""Least default for the triangles of a leaf; applies where LEAF_BLOCKS blocks hold fewer."""


@wp.struct
class BuildRules:
    """`BvhConfig` for kernels."""

    cost: SplitCost
    bins: int
    grain: int
    """A node of the binary tree with at most this many triangles is a leaf unless its box is large."""
    max_leaf: int
    """Most triangles in a leaf of the finished tree."""
    large: float
    """See `BvhConfig`."""


@dataclass(frozen=True)
class BvhConfig:
    """Cost model and leaf size: the same for every builder of bounding volume hierarchies.

    Attributes:
        cost: the cost model. Its width, at least 2, is that of blocks and of nodes. `traversal` is the cost of visiting a node
            of W children; `empty_factor` is not used.
        bins: bins along an axis, 2 to 40, for builders that bin.
        max_leaf_triangles: most triangles in a leaf, 1 to 63; None for three blocks, but at least 8 triangles.
        reinsertion: most rounds of `wrt.builders.classics.bvh.reinsertion`, 0 to 1000. With at least one, leaves of the binary
            tree hold half a block. The builder "hploc" takes `wrt.builders.bvh.phases.parallel_reinsertion`.
        subset: share of the triangles, above 0 and at most 1, that decides the upper levels of a builder that bins
            (`wrt.builders.classics.bvh.subset_levels`).
        large: share of the root's surface area above which a box is large (`wrt.builders.bvh.phases.large_boxes`), at least 0;
            infinity if none is.

    Raises:
        ValueError: a value is out of range.
    """

    cost: SurfaceAreaCost = field(default_factory=SurfaceAreaCost)
    bins: int = 16
    max_leaf_triangles: int | None = None
    reinsertion: int = 0
    subset: float = 1.0
    large: float = LARGE

    def __post_init__(self) -> None:
        if self.cost.width < 2:
            raise ValueError(f"cost.width is {self.cost.width}; it must be at least 2, because nodes have as many children")
        if not 2 <= self.bins <= MAX_BINS:
            raise ValueError(f"bins is {self.bins}; it must be from 2 to {MAX_BINS}")
        if (
            isinstance(self.reinsertion, bool)
            or not isinstance(self.reinsertion, int)
            or not 0 <= self.reinsertion <= MAX_ROUNDS
        ):
            raise ValueError(f"reinsertion is {self.reinsertion!r}; it must be a whole number of rounds from 0 to {MAX_ROUNDS}")
        if not 0.0 < self.subset <= 1.0:
            raise ValueError(f"subset is {self.subset}; it must be above 0 and at most 1, a share of the triangles")
        if not self.large >= 0.0:
            raise ValueError(f"large is {self.large}; it must be at least 0, a share of the root's surface area")
        if self.max_leaf_triangles is not None and not 1 <= self.max_leaf_triangles <= MAX_LEAF_TRIANGLES:
            raise ValueError(f"max_leaf_triangles is {self.max_leaf_triangles}; it must be from 1 to {MAX_LEAF_TRIANGLES}")

    @property
    def leaf_limit(self) -> int:
        """Most triangles in a leaf."""
        return self.max_leaf_triangles or max(MIN_LEAF_LIMIT, LEAF_BLOCKS * self.cost.width)

    def struct(self) -> BuildRules:
        """The values for a kernel."""
        rules = BuildRules()
        rules.cost = self.cost.struct()
        rules.bins = self.bins
        rules.max_leaf = self.leaf_limit
        rules.large = self.large
        block = self.cost.width // 2 if self.reinsertion else self.cost.width
        rules.grain = min(self.leaf_limit, max(MIN_GRAIN, block))
        return rules
