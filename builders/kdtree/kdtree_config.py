"""Configuration of a build of a kd-tree."""

from dataclasses import dataclass, field

from wrt.builders.cost import SurfaceAreaCost
from wrt.builders.tree import StopRules

LONGEST = "longest"
ROUND_ROBIN = "round_robin"
AXES = {LONGEST: "the node's longest axis", ROUND_ROBIN: "x, y, z in turn, level by level"}
"""The axis of a median split, by name."""


@dataclass(frozen=True)
class KdTreeConfig:
    """Cost model and stop rules, the same for every kd-tree builder.

    Attributes:
        cost: the cost of splits and leaves.
        stop: when a node becomes a leaf.
        axis: key in `AXES`, for builders that split at a median; the others try all axes.
        split_clipping: whether triangles are clipped to the cells that contain them, for builders that support it (`clipping`).

    Raises:
        ValueError: unknown axis.
    """

    cost: SurfaceAreaCost = field(default_factory=SurfaceAreaCost)
    stop: StopRules = field(default_factory=StopRules)
    axis: str = LONGEST
    split_clipping: bool = False

    def __post_init__(self) -> None:
        if self.axis not in AXES:
            raise ValueError(f"axis is {self.axis!r}; choose from {', '.join(AXES)}")
