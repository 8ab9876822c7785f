"""How a kd-tree is to be built."""

from dataclasses import dataclass, field

from wrt.builders.cost import SurfaceAreaCost
from wrt.builders.tree import StopRules

LONGEST = "longest"
ROUND_ROBIN = "round_robin"
AXES = {LONGEST: "the node's longest axis", ROUND_ROBIN: "x, y, z in turn, level by level"}
"""Which axis a median split takes."""


@dataclass(frozen=True)
class KdTreeConfig:
    """Cost model and stop rules, the same for every kd-tree builder.

    Attributes:
        cost: what a split is worth.
        stop: when a node becomes a leaf.
        split_clipping: whether triangles are clipped to the cells that they are in, for builders that can (`clipping`).
        axis: key in `AXES`, for builders that split at a median; the others try all axes.

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
