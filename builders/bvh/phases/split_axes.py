"""Along which axis a node is split: longest side, splitting planes that face away from the rays, in turn, or all three.

**Problem.** The planes of one axis cost a third of those of all. The longest side is the usual choice; where rays run along it,
it is the worst: nearly every ray that meets one child meets the other. The splitting plane facing heuristic (Falcone 2024,
chapter 4) prefers axes across the rays.

**Algorithm.** Each way orders the axes and gives each a quality in [0, 1] (`axis_order`). They are tried in that order, until
the children are excellent, or until an axis is of too little quality while the children are acceptable; if they are not, the
longest side is tried as a last resort (Algorithm 5.1). Children are judged by the sum of their hit probabilities over the
node's, 1 if no ray meets both and none misses both.

**What we changed.** The printed quality of an axis is the share of the rays' direction along it, which is low for good axes,
while Algorithm 5.1 rejects low qualities: here quality is 1 less that share. The last resort is judged by the same cost as
the other axes, not by surface area: prices of two kinds do not compare. If all that was tried has no plane with triangles on
both sides, the remaining axes are tried too.

References:
    L. Falcone: Ray distribution aware heuristics for BVHs construction in ray tracing. MSc thesis, Politecnico di Milano,
        2024.
"""

from dataclasses import dataclass

import warp as wp

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

ALL, LONGEST, FACING, IN_TURN = range(4)

WP_LONGEST = wp.constant(LONGEST)
WP_FACING = wp.constant(FACING)
WP_IN_TURN = wp.constant(IN_TURN)


@wp.struct
class AxisRules:
    """`AxisChoice` as kernels see it."""

    order: int
    least_quality: float
    acceptable: float
    excellent: float


@dataclass(frozen=True)
class AxisChoice:
    """Which axes of a node are tried.

    Attributes:
        order: "all" three; "longest", by length of the box; "facing", by how much the axis is across the rays; "in_turn", by
            depth.
        least_quality: quality below which an axis is not tried, in [0, 1]. Quality is the side over the longest one, 1 less the
            share of the rays' direction along the axis, or 1 for the axis whose turn it is and 0 for the others.
        acceptable: what the children's hit probabilities may add up to, over the node's, so that no further axis is tried where
            all of enough quality have been.
        excellent: what they may add up to so that no further axis is tried in any case.

    Raises:
        ValueError: an unknown order, or a value out of its range.
    """

    order: str = "facing"
    least_quality: float = 0.4
    acceptable: float = 1.3
    excellent: float = 0.9

    def __post_init__(self) -> None:
        if self.order not in ORDERS:
            raise ValueError(f"order {self.order!r} is unknown; choose from {', '.join(ORDERS)}")
        if not 0.0 <= self.least_quality <= 1.0:
            raise ValueError(f"least_quality is {self.least_quality}; it must be from 0 to 1")
        for name in ("acceptable", "excellent"):
            if not getattr(self, name) >= 0.0:
                raise ValueError(f"{name} is {getattr(self, name)}; it must not be negative")

    def struct(self) -> AxisRules:
        """The values for a kernel."""
        rules = AxisRules()
        rules.order = ORDERS[self.order]
        rules.least_quality = self.least_quality
        rules.acceptable = self.acceptable
        rules.excellent = self.excellent
        return rules


ORDERS = {"all": ALL, "longest": LONGEST, "facing": FACING, "in_turn": IN_TURN}

AXIS_CHOICES = {
    "all": AxisChoice("all", least_quality=0.0, acceptable=0.0, excellent=0.0),
    "longest": AxisChoice("longest", least_quality=0.99),
    "facing": AxisChoice("facing"),
    "in_turn": AxisChoice("in_turn", least_quality=0.5),
}
"""Ways to choose axes by name, with the thresholds of the published experiments."""


@wp.struct
class AxisOrder:
    """The axes of a node in the order in which they are tried."""

    axis: wp.vec3i
    quality: wp.vec3
    """Of the axis in the same place."""


@wp.func
def axis_order(rules: AxisRules, size: wp.vec3, along: wp.vec3, depth: int):
    """Orders the axes of a node. size: sides of its box; along: how much rays run along each axis, adding up to at most 1."""
    quality = wp.vec3(1.0, 1.0, 1.0)
    if rules.order == WP_LONGEST:
        quality = size / wp.max(size)
    if rules.order == WP_FACING:
        quality = wp.vec3(1.0, 1.0, 1.0) - along
    if rules.order == WP_IN_TURN:
        quality = wp.vec3()
        quality[depth % 3] = 1.0
    axis = wp.vec3i(0, 1, 2)
    for i in range(2):  # sorts by quality; of equals, the smaller axis comes first
        for j in range(2 - i):
            if quality[j + 1] > quality[j]:
                worse = quality[j]
                quality[j] = quality[j + 1]
                quality[j + 1] = worse
                other = axis[j]
                axis[j] = axis[j + 1]
                axis[j + 1] = other
    order = AxisOrder()
    order.axis = axis
    order.quality = quality
    return order


@wp.func
def longest_axis(size: wp.vec3):
    """The longest side; of equals, the smallest axis."""
    return wp.where(size[0] >= size[1], wp.where(size[0] >= size[2], 0, 2), wp.where(size[1] >= size[2], 1, 2))
