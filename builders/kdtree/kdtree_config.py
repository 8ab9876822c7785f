"""Configuration of a build of a kd-tree."""

from dataclasses import dataclass, field

from wrt.builders.cost import SurfaceAreaCost
from wrt.builders.tree import StopRules
from wrt.kernels.layout.kdtree_nodes import MAX_INDEX

LONGEST = "longest"
ROUND_ROBIN = "round_robin"
AXES = {LONGEST: "the node's longest axis", ROUND_ROBIN: "x, y, z in turn, level by level"}
"""The axis of a median split, by name."""

ALL_AXES = "all"
SEARCHED_AXES = {
    ALL_AXES: "all three",
    LONGEST: "the node's longest axis, and the others if no plane on it divides the node",
    "mixed": "the longest axis in nodes of more than 1,000 triangles, all three in the others",
}
"""The axes on which adaptive samples are taken, by name."""

MIXED_FROM = 1000
"""Triangles above which only the longest axis is searched with "mixed"."""


@dataclass(frozen=True)
class KdTreeConfig:
    """Cost model and stop rules, the same for every kd-tree builder.

    Attributes:
        cost: the cost of splits and leaves.
        stop: when a node becomes a leaf.
        axis: key in `AXES`, for builders that split at a median; the others try all axes.
        split_clipping: whether triangles are clipped to the cells that contain them, for builders that support it (`clipping`).
        searched_axes: key in `SEARCHED_AXES`, for the builder that takes adaptive samples.

    Raises:
        ValueError: unknown axis or axes.
    """

    cost: SurfaceAreaCost = field(default_factory=SurfaceAreaCost)
    stop: StopRules = field(default_factory=StopRules)
    axis: str = LONGEST
    split_clipping: bool = False
    searched_axes: str = ALL_AXES

    def __post_init__(self) -> None:
        if self.axis not in AXES:
            raise ValueError(f"axis is {self.axis!r}; choose from {', '.join(AXES)}")
        if self.searched_axes not in SEARCHED_AXES:
            raise ValueError(f"searched_axes is {self.searched_axes!r}; choose from {', '.join(SEARCHED_AXES)}")

    @property
    def longest_from(self) -> int:
        """Triangles of a node from which on only its longest axis is searched (`searched_axes`)."""
        return {ALL_AXES: MAX_INDEX + 1, LONGEST: 0}.get(self.searched_axes, MIXED_FROM + 1)
