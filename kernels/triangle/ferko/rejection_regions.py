"""Which comparison rejects most: shares of the bounding circle, and the order of comparisons that follows from them.

**Idea.** Where rays that meet a triangle's bounding circle meet it anywhere with the same probability, the comparison whose
region has the largest share of the circle should come first. Weighted, a share is multiplied by the operations of all the
other comparisons: cheap ones come earlier. Shares and order belong to a triangle and are computed with its record; the
weights belong to the variant of the test; nothing belongs to the scene.

**Regions**, in the triangle's own frame (`wrt.kernels.triangle.ferko.similarity`): below the longest edge; above C', if that
is asked; left of A'C'; right of C'B', with what is left of the circle. With the circle's centre (1/2, m) and radius r, below
is the segment that the x-axis cuts off, at the distance m from the centre, and left the one that A'C' cuts off, at the
distance (y / 2 - x m) / |C'|: one formula for acute and obtuse triangles. Above C', for an obtuse triangle (m = 0, r = 1/2),
is the segment at the distance y; then left of A'C' but not above C' are a triangle over the chord from the circle to C', and
the segment between that chord's end and A'. Above an acute triangle there is next to nothing, and nothing is asked.

**What follows.** Of three comparisons the order is always below, left, right: A'B' is longer than A'C', which, as x >= 1/2, is
longer than C'B', and a longer chord cuts off more; the weights fall in the same order. So three-fold pruning with
probabilities is three-fold pruning with the circle asked first, and what the paper saves by it is the circle's doing. Only
the comparison above C' has no fixed place.

**Slips of the printed form.** It speaks of a normal distribution, and computes with a uniform one. cos(beta) misses a square
that the algorithm has. By its test for acute triangles (see `similarity`) shares of some are computed with a circle that does
not contain them; the order of three comes out the same. Heron's formula and two helper triangles give what half of base times
height gives. The count of operations of its weights (below 1, above 1, left 5, right 6) is kept.

References:
    L. Pichler: Fast ray-triangle intersection. Diploma thesis, 2018 (after A. Ferko, M. Ferko, unpublished, 2015).
"""

from functools import cache

import warp as wp

from wrt.kernels.triangle.ferko.record_part import Part
from wrt.kernels.triangle.ferko.similarity import Similarity, similarity
from wrt.kernels.triangle.ferko.triangle_bounds import circle_height
from wrt.kernels.triangle.support.record_blocks import Corners

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

COMPARISONS = ("below", "above", "left", "right")
BELOW, ABOVE, LEFT, RIGHT = range(1, 5)
"""Digits of an order: octal, the first comparison is the last digit."""

OPERATIONS = wp.constant(wp.vec4d(1.0, 1.0, 5.0, 6.0))
"""Comparisons, additions and multiplications of each, as the paper counts."""

ORDER_OF_FOUR = 0o1000
"""An order that is at least this has four comparisons."""

PI = wp.constant(wp.float64(3.141592653589793))


@wp.func
def segment(radius: wp.float64, distance: wp.float64):
    """Area of what a line at some distance from its centre cuts off a circle."""
    cosine = wp.min(distance / radius, wp.float64(1.0))
    return radius * radius * (wp.acos(cosine) - cosine * wp.sqrt(wp.float64(1.0) - cosine * cosine))


@wp.func
def shares(frame: Similarity, above: bool):
    """Shares of the circle below, above, left and right; -1 above if that is not asked."""
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
    """The comparisons by falling value, the cheaper one first where two are equal; negative values are left out."""
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
    """The order of a triangle's comparisons, `fold` of them (an acute triangle has three), as a whole number."""
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
