"""Pruning: in the triangle's own frame, each comparison cuts off a region that the triangle does not reach.

**Comparisons** of a point Q of the frame (`wrt.kernels.classics.triangle.ferko.similarity`), in which C' = (x, y):

    below    the longest edge: Q_y < 0
    above    C': Q_y > y
    left     of A'C': Q_y x > Q_x y
    right    of C'B': y (Q_x - 1) + Q_y (1 - x) > 0

A test makes three of them (3-fold, without `above`) or all four (4-fold), each an exit, in the order of their cost or in the
triangle's own order.

**The triangle's own order.** Assume that rays meet the bounding circle uniformly. The comparison whose region has the largest
share of the circle should then come first. A weighted share is multiplied by the number of operations of all other comparisons,
which moves cheap comparisons forward. Shares and order are properties of a triangle and are computed with its record. The
weights are a property of the variant of the test. Nothing depends on the scene.

**Shares.** Let the circle have centre (1/2, m) and radius r. Below is the segment that the x-axis cuts off, at distance m from
the centre. Left is the segment that A'C' cuts off, at distance (y / 2 - x m) / |C'|; the formula holds for acute and obtuse
triangles. Above C', for an obtuse triangle (m = 0, r = 1/2), is the segment at distance y. What is left of A'C' but not above
C' is then a triangle over the chord from the circle to C', and the segment between that chord's end and A'. Right is the rest
of the circle. Above an acute triangle the share is almost 0, and the comparison is skipped.

**Consequence.** The order of three comparisons is always below, left, right: A'B' is longer than A'C', which, as x >= 1/2, is
longer than C'B'; a longer chord cuts off more; and the weights decrease in the same order. So three-fold pruning with
probabilities equals three-fold pruning with the circle tested first, and the savings that the thesis reports for it come from
the circle. Only the comparison above C' has no fixed position.

**Lanes.** Neighbouring triangles have different orders, so lanes that test W triangles, or W rays, at once cannot branch on the
order: all comparisons are computed anyway. For triangles with an order of their own, the lane form makes all comparisons in one
step, with the same result. Only the scalar form follows the order.

**Errors in the printed form.** The text speaks of a normal distribution but computes with a uniform one. cos(beta) lacks a
square that the algorithm has. The test for acute triangles (see `similarity`) computes the shares of some of them with a circle
that does not contain them; the order of three comparisons comes out the same. Heron's formula and two auxiliary triangles
compute what half of base times height gives. We keep the operation counts of the weights (below 1, above 1, left 5, right 6).

References: pichler-2018.
"""

from functools import cache
from typing import Any

import warp as wp

from wrt.kernels.classics.triangle.ferko.record_part import Part
from wrt.kernels.classics.triangle.ferko.similarity import IN_PLANE, Similarity, similarity
from wrt.kernels.classics.triangle.ferko.triangle_bounds import circle_height
from wrt.kernels.classics.triangle.published import StepText
from wrt.kernels.triangle.support.record_blocks import Corners

BELOW, ABOVE, LEFT, RIGHT = range(1, 5)
"""Digits of an order, which is an octal number. The first comparison is the lowest digit."""

FIXED_ORDER = {3: BELOW | LEFT << 3 | RIGHT << 6, 4: BELOW | ABOVE << 3 | LEFT << 6 | RIGHT << 9}
"""Orders without probabilities: cheap comparisons first. Every triangle has the same number of comparisons."""

OPERATIONS = wp.constant(wp.vec4d(1.0, 1.0, 5.0, 6.0))
"""Comparisons, additions and multiplications of each comparison, as the thesis counts them."""

ORDER_OF_FOUR = 0o1000
"""Orders at or above this number have four comparisons."""

PI = wp.constant(wp.float64(3.141592653589793))


@wp.func
def segment(radius: wp.float64, distance: wp.float64):
    """Area that a line at a signed distance from the centre cuts off a circle."""
    cosine = wp.min(distance / radius, wp.float64(1.0))
    return radius * radius * (wp.acos(cosine) - cosine * wp.sqrt(wp.float64(1.0) - cosine * cosine))


@wp.func
def shares(frame: Similarity, above: bool):
    """Shares of the circle below, above, left and right. The share above is -1 if that comparison is skipped."""
    zero, half, one = wp.float64(0.0), wp.float64(0.5), wp.float64(1.0)
    height = circle_height(frame)
    radius = wp.sqrt(half * half + height * height)
    circle = PI * radius * radius
    to_left = (half * frame.y - frame.x * height) / wp.sqrt(frame.x * frame.x + frame.y * frame.y)
    below = segment(radius, height) / circle
    left = segment(radius, to_left) / circle
    top = zero
    if above and height == zero:
        reach = wp.sqrt(wp.max(half * half - frame.y * frame.y, zero))
        sine = wp.min(frame.y / half, one)
        top = segment(half, frame.y) / circle
        arc = wp.float64(0.125) * (wp.asin(sine) - sine)
        left = (half * (frame.x - half + reach) * frame.y + arc) / circle
    right = wp.max(one - half * frame.y / circle - below - top - left, zero)
    return wp.vec4d(below, wp.where(above and height == zero, top, -one), left, right)


@wp.func
def order_by(values: wp.vec4d):
    """The comparisons by decreasing value. Of two equal values the cheaper comparison comes first. Negative values are
    omitted."""
    rest = values
    order = int(0)
    for place in range(4):
        best = int(0)
        for comparison in range(1, 4):
            if rest[comparison] > rest[best]:
                best = comparison
        if rest[best] >= wp.float64(0.0):
            order += (best + 1) << (3 * place)
        rest[best] = wp.float64(-1.0)
    return order


Order = wp.types.vector(length=1, dtype=wp.float32)


@cache
def order_part(fold: int, weighted: bool) -> Part:
    """The order of a triangle's `fold` comparisons as an integer. An acute triangle has three."""
    above = fold == 4

    @wp.func
    def derive_order(corners: Corners):
        values = shares(similarity(corners), wp.static(above))
        if wp.static(weighted):
            of_all = OPERATIONS[0] + OPERATIONS[2] + OPERATIONS[3]
            if wp.static(above):
                of_all += OPERATIONS[1]
            for comparison in range(4):
                values[comparison] *= of_all - OPERATIONS[comparison]
        return Order(float(order_by(values)))

    return Part(("order",), derive_order)


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


def pruning_steps(fold: int, ordered: bool) -> list[StepText]:
    """The comparisons as steps: one step each, or a single step if each triangle has its own order."""
    digits = [BELOW, LEFT, RIGHT] if fold == 3 else [BELOW, ABOVE, LEFT, RIGHT]
    if not ordered:
        first, *others = digits
        return [(_EXITS[first], IN_PLANE, _PASSES[first]), *((_EXITS[digit], "", _PASSES[digit]) for digit in others)]
    passes = {digit: f"({_PASSES[digit]})" for digit in digits}
    if fold == 4:  # acute triangles skip this comparison
        passes[ABOVE] = f"(({_PASSES[ABOVE]}) | (order < {ORDER_OF_FOUR}.0f))"
    return [("outside the triangle", IN_PLANE, " & ".join(passes.values()))]
