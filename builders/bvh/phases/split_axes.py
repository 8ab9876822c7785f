"""Choice of the axis along which a node is split: longest side, splitting planes facing away from the rays, by depth, or all.

**Problem.** Trying the planes of one axis costs a third of trying all. The longest side is the usual choice. It is the worst
one if rays run along it, because nearly every ray that meets one child then meets the other. The splitting plane facing
heuristic (Falcone 2024, chapter 4) prefers axes across the rays.

**Algorithm.** Each heuristic orders the axes and gives each a quality in [0, 1] (`axis_order`). Axes are tried in that order.
The search ends when the children are excellent, or when the next axis has too little quality and the children are acceptable.
If they are not acceptable, the longest side is tried as a fallback (Algorithm 5.1). The measure of children is the sum of their
hit probabilities over the node's: 1 if no ray meets both and none misses both.

**What we changed.** The printed quality of an axis is the share of the rays' direction along it, which is low for good axes,
although Algorithm 5.1 rejects low qualities. Here quality is 1 minus that share. The fallback is measured by the same cost as
the other axes, not by surface area, because the two costs are not comparable. If no axis tried so far has a plane with
triangles on both sides, the remaining axes are tried too.

References: falcone-2024.
"""

from dataclasses import dataclass

import warp as wp

from wrt.kernels.validation import convert_fields

ALL, LONGEST, FACING, IN_TURN = range(4)

WP_LONGEST = wp.constant(LONGEST)
WP_FACING = wp.constant(FACING)
WP_IN_TURN = wp.constant(IN_TURN)


@wp.struct
class AxisRules:
    """`AxisChoice` for kernels."""

    order: int
    least_quality: float
    acceptable: float
    excellent: float


@dataclass(frozen=True)
class AxisChoice:
    """The axes of a node that a build tries.

    Attributes:
        order: "all" three; "longest", by length of the box; "facing", by the angle between the axis and the rays; "in_turn", by
            depth.
        least_quality: quality in [0, 1] below which an axis is not tried. Quality is the side over the longest one, 1 minus the
            share of the rays' direction along the axis, or 1 for the axis whose turn it is and 0 for the others.
        acceptable: sum of the children's hit probabilities, over the node's, up to which no further axis is tried once all axes
            of sufficient quality have been.
        excellent: sum up to which no further axis is tried at all.

    Raises:
        TypeError: a quality or a sum is not a number.
        ValueError: an unknown order, or a value out of its range.
    """

    order: str = "facing"
    least_quality: float = 0.4
    acceptable: float = 1.3
    excellent: float = 0.9

    def __post_init__(self) -> None:
        convert_fields(self)
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
"""Heuristics by name, with the thresholds of the published experiments."""


@wp.struct
class AxisOrder:
    """The axes of a node in the order in which they are tried."""

    axis: wp.vec3i
    quality: wp.vec3
    """Quality of the axis at the same position."""


@wp.func
def axis_order(rules: AxisRules, size: wp.vec3, along: wp.vec3, depth: int):
    """Orders the axes of a node. size: sides of its box. along: share of the rays' direction along each axis, at most 1 in
    total."""
    quality = wp.vec3(1.0, 1.0, 1.0)
    if rules.order == WP_LONGEST:
        quality = size / wp.max(size)
    if rules.order == WP_FACING:
        quality = wp.vec3(1.0, 1.0, 1.0) - along
    if rules.order == WP_IN_TURN:
        quality = wp.vec3()
        quality[depth % 3] = 1.0
    axis = wp.vec3i(0, 1, 2)
    for i in range(2):  # sorts by quality; of equal axes, the smaller one comes first
        for j in range(2 - i):
            if quality[j + 1] > quality[j]:
                worse = quality[j]
                quality[j] = quality[j + 1]
                quality[j + 1] = worse
                other = axis[j]
                axis[j] = axis[j + 1]
                axis[j + 1] = other
    return AxisOrder(axis, quality)


@wp.func
def longest_axis(size: wp.vec3):
    """The longest side; of equal sides, the smallest axis."""
    return wp.where(size[0] >= size[1], wp.where(size[0] >= size[2], 0, 2), wp.where(size[1] >= size[2], 1, 2))
