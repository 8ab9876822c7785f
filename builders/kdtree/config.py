"""How a kd-tree is to be built."""

from dataclasses import dataclass, field

from wrt.builders.common import StopRules
from wrt.builders.cost import SurfaceAreaCost


@dataclass(frozen=True)
class KdTreeConfig:
    """Cost model and stop rules: the same for every kd-tree builder."""

    cost: SurfaceAreaCost = field(default_factory=SurfaceAreaCost)
    stop: StopRules = field(default_factory=StopRules)
