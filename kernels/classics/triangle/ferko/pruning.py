"""Pruning: in the triangle's own frame, each comparison cuts off a region that the triangle does not reach.

Below the longest edge: Q_y < 0. Above C': Q_y > y. Left of A'C': Q_y x > Q_x y. Right of C'B': y (Q_x - 1) + Q_y (1 - x) > 0.
A test makes three of them (3-fold) or all four (4-fold), each an exit, in the order of their cost or in the triangle's own
order (`wrt.kernels.classics.triangle.ferko.rejection_regions`).

Neighbouring triangles have different orders, so lanes that test W triangles, or W rays, at once cannot branch on the order: all
comparisons are computed anyway. For triangles with an order of their own, the lane form makes all comparisons in one step, with
the same result. Only the scalar form follows the order.
"""

from typing import Any

import warp as wp

from wrt.kernels.classics.triangle.ferko.rejection_regions import ABOVE, BELOW, LEFT, ORDER_OF_FOUR, RIGHT
from wrt.kernels.classics.triangle.ferko.similarity import IN_PLANE
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.triangle.support.lane_form import Step

exact_module(__name__)

FIXED_ORDER = {3: BELOW | LEFT << 3 | RIGHT << 6, 4: BELOW | ABOVE << 3 | LEFT << 6 | RIGHT << 9}
"""Orders without probabilities: cheap comparisons first. Every triangle has the same number of comparisons."""


@wp.func
def keeps(comparison: int, q: wp.vec2, apex_x: float, apex_y: float):
    """Whether a comparison keeps a point Q. False if Q is NaN."""
    if comparison == wp.static(BELOW):
        return q[1] >= 0.0
    if comparison == wp.static(ABOVE):
        return q[1] <= apex_y
    if comparison == wp.static(LEFT):
        return q[1] * apex_x - q[0] * apex_y <= 0.0
    return apex_y * (q[0] - 1.0) + q[1] * (1.0 - apex_x) <= 0.0


@wp.func
def prune(order: int, q: wp.vec2, own: Any, at: int):
    """Number of comparisons made, negative if the last one cut the point off. The triangle's SIMILARITY begins at `own[at]`."""
    rest = int(order)
    made = int(0)
    while rest != 0:
        made += 1
        if not keeps(rest & 7, q, own[at + 8], own[at + 9]):
            return -made
        rest = rest >> 3
    return made


_PASSES = {
    BELOW: "qy >= 0.0f",
    ABOVE: "qy <= apex_y",
    LEFT: "qy * apex_x - qx * apex_y <= 0.0f",
    RIGHT: "apex_y * (qx - 1.0f) + qy * (1.0f - apex_x) <= 0.0f",
}
_EXITS = {BELOW: "below the longest edge", ABOVE: "above the vertex", LEFT: "left of the triangle", RIGHT: "right of it"}


def pruning_steps(fold: int, ordered: bool) -> tuple[Step, ...]:
    """The comparisons as steps: one step each, or a single step if each triangle has its own order."""
    digits = [BELOW, LEFT, RIGHT] if fold == 3 else [BELOW, ABOVE, LEFT, RIGHT]
    if not ordered:
        first, *others = (Step(_EXITS[digit], "", _PASSES[digit]) for digit in digits)
        return Step(first.exit, IN_PLANE, first.passes, ("qx", "qy")), *others
    passes = {digit: f"({_PASSES[digit]})" for digit in digits}
    if fold == 4:  # acute triangles skip this comparison
        passes[ABOVE] = f"(({_PASSES[ABOVE]}) | (order < {ORDER_OF_FOUR}.0f))"
    return (Step("outside the triangle", IN_PLANE, " & ".join(passes.values()), ("qx", "qy")),)
