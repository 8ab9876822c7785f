"""How a bounding volume hierarchy is to be built."""

from dataclasses import dataclass, field

import warp as wp

from wrt.builders.cost import SplitCost, SurfaceAreaCost
from wrt.kernels.bvh import MAX_LEAF_TRIANGLES

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

MAX_BINS = 32
"""Bins along an axis that the work space has room for."""

SMALLEST_LEAF = 8
"""Triangles that a leaf may always hold: with narrow blocks, nodes of less would not pay for themselves."""


@wp.struct
class BuildRules:
    """`BvhConfig` as kernels see it."""

    cost: SplitCost
    bins: int
    fine: int
    """Triangles below which a node of the binary tree is split only if that pays: leaves are put together afterwards."""
    max_leaf: int


@dataclass(frozen=True)
class BvhConfig:
    """Cost model and leaf size: the same for every builder of bounding volume hierarchies.

    Attributes:
        cost: the cost model; its width is that of blocks and of nodes. `empty_factor` plays no part.
        bins: bins along an axis, 2 to 32, for builders that bin.
        max_leaf_triangles: most triangles in a leaf, 1 to 63; None for one block, but at least 8 triangles.

    Raises:
        ValueError: a value is out of range.
    """

    cost: SurfaceAreaCost = field(default_factory=SurfaceAreaCost)
    bins: int = 16
    max_leaf_triangles: int | None = None
    fine: int | None = None

    def __post_init__(self) -> None:
        if not 2 <= self.bins <= MAX_BINS:
            raise ValueError(f"bins is {self.bins}; it must be from 2 to {MAX_BINS}")
        if self.max_leaf_triangles is not None and not 1 <= self.max_leaf_triangles <= MAX_LEAF_TRIANGLES:
            raise ValueError(f"max_leaf_triangles is {self.max_leaf_triangles}; it must be from 1 to {MAX_LEAF_TRIANGLES}")

    @property
    def leaf_limit(self) -> int:
        """Most triangles in a leaf."""
        return self.max_leaf_triangles or max(SMALLEST_LEAF, 3 * self.cost.width)

    def struct(self) -> BuildRules:
        """The values for a kernel."""
        rules = BuildRules()
        rules.cost = self.cost.struct()
        rules.bins = self.bins
        rules.max_leaf = self.leaf_limit
        rules.fine = min(self.leaf_limit, self.fine or max(SMALLEST_LEAF, self.cost.width))
        return rules
