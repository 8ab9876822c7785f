"""The surface area heuristic as an object: every builder evaluates the cost of a split through the same functions.

**Formula.** For a box of surface area A split into two of areas A_L and A_R, with n_L and n_R triangles,

    cost = f (C_t + C_b (A_L / A * blocks(n_L) + A_R / A * blocks(n_R)))        leaf = C_b blocks(n)

(MacDonald and Booth 1990; Wald and Havran 2006; Rahikainen 2013, equations 4.6 and 4.7). `blocks(n) = ceil(n / W)`, because a
leaf tests W triangles at once; W = 1 gives the textbook formula. f < 1 rewards a split that cuts off empty space. Triangles in
the splitting plane are tried on both sides.

**Mailbox.** With a mailbox (`wrt.kernels.traversal.mailbox`), a ray that passes through both children tests a triangle that
straddles the plane once, not twice (Hunt 2008). It passes through both with probability A_L / A + A_R / A - 1, which is F / A
for F, the area of the plane's two faces. The expected tests of the n_L + n_R - n straddlers decrease accordingly:

    cost = f (C_t + C_b (blocks(n_L) (A_L - F) / A + blocks(n_R) (A_R - F) / A + blocks(n) F / A))

In this form every term increases with its count, on which a sweep that meets a plane several times relies
(`wrt.builders.kdtree.events.sweep_planes`). The sum is the one above with a different face area and a different initial cost
(`axis_frame`). Trees for a mailbox have more nodes, and rays test fewer triangles
(notebooks/records/2026-11-21-kdtree-builders.md).

**Rays that end.** The heuristic assumes that no ray hits anything. In fact a ray that passes through one child may end there
and never reach the other. Let P = A_L / A + A_R / A - 1 be the probability that a ray passes through both; half of these rays
meet the left child first. If a ray through a child ends there with probability b, the expected cost decreases by what is not
visited:

    cost = f (C_t + C_b (...)) - P / 2 (b_L C_b blocks(n_R) + b_R C_b blocks(n_L))

A triangle of area a has a mean projected area of a / 2, and a box of surface area A one of A / 4 (Cauchy), so the triangle ends
a ray through the box with probability 2 a / A. For n triangles that lie independently of each other, b = 1 - exp(-2 a n / A).
The survey (Rahikainen 2013, 4.1) reports a model of this kind (Havran 2001), and that at best it saves 1 % of the time; it
prints no formula. This one is derived here, with the mean area of the mesh's triangles for a (`SurfaceAreaCost.occluder`). b
increases with a count, so the cost does not: sweeps that meet a plane several times cannot use it.

**Determinism.** Builders that call these functions with the same counts get the same bits, so builders that make the same
choices build the same tree. Ties go to the smaller axis, then to the smaller position, then to planar triangles on the right.

References: goldsmith-salmon-1987; macdonald-booth-1990; havran-2001; wald-havran-2006; hunt-2008; rahikainen-2013.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.simd.boxes import INFINITY


@wp.struct
class SplitCost:
    """`SurfaceAreaCost` for kernels."""

    traversal: float
    block: float
    empty_factor: float
    width_bits: int
    """log2 of the triangles in a block."""
    unit_bits: int
    """log2 of the triangles that cost `block` together."""
    mailbox: bool
    occluder: float
    """Area of a triangle that may end a ray; 0: none does."""


COST_MODELS = {
    "surface_area": "no ray hits anything: the surface area heuristic",
    "blocking": "rays end in a cell with the probability that triangles of the mesh's mean area give",
}
"""What a cost assumes of rays, by name."""


@dataclass(frozen=True)
class SurfaceAreaCost:
    """The surface area heuristic.

    Attributes:
        traversal: cost C_t of visiting an inner node.
        block: cost C_b of testing one block of `width` triangles.
        width: triangles per block: 1, 2, 4, 8 or 16.
        empty_factor: factor f in (0, 1] for the cost of a split with an empty side; 1 turns the bonus off.
        unit: number of triangles that cost `block` together: 1, 2, 4, 8 or 16; None for a block. With 1, `block` is the cost of
            testing one triangle, as in the textbooks, whatever the width of blocks.
        mailbox: whether rays remember the triangles against which they have been tested.
        occluder: mean area of a triangle, for the cost of rays that end; 0 for rays that hit nothing.

    Raises:
        ValueError: a cost is not positive and finite, width or unit is not a power of two up to 16, the factor is not in
            (0, 1], or rays end and have a mailbox.
    """

    traversal: float = 1.0
    block: float = 0.5
    width: int = 8
    empty_factor: float = 0.8
    unit: int | None = None
    mailbox: bool = False
    occluder: float = 0.0

    def __post_init__(self) -> None:
        for name, count in (("width", self.width), ("unit", self.width if self.unit is None else self.unit)):
            if count not in (1, 2, 4, 8, 16):
                raise ValueError(f"{name} is {count}; it must be 1, 2, 4, 8 or 16")
        if not (0.0 <= self.traversal < float("inf") and 0.0 < self.block < float("inf")):
            raise ValueError(f"costs must be finite and positive, got traversal={self.traversal}, block={self.block}")
        if not 0.0 < self.empty_factor <= 1.0:
            raise ValueError(f"empty_factor is {self.empty_factor}; it must be above 0 and at most 1")
        if self.mailbox and self.occluder > 0.0:
            raise ValueError("costs of rays that end do not know mailboxes; choose one of them")

    def struct(self) -> SplitCost:
        """The values for a kernel."""
        cost = SplitCost()
        cost.traversal = self.traversal
        cost.block = self.block
        cost.empty_factor = self.empty_factor
        cost.width_bits = self.width.bit_length() - 1
        cost.unit_bits = (self.unit or self.width).bit_length() - 1
        cost.mailbox = self.mailbox
        cost.occluder = self.occluder
        return cost

    def of_leaf(self, triangles: np.ndarray) -> np.ndarray:
        """Cost of leaves with these numbers of triangles."""
        unit = self.unit or self.width
        return self.block * -(-triangles // unit)


@wp.struct
class Split:
    """A splitting plane and its cost."""

    cost: float
    """inf if no plane was found."""
    axis: int
    position: float
    planar_left: bool
    """Whether triangles in the plane go to the left child."""
    left: int
    """Triangles in the left child, including planar ones if they go there."""
    right: int


@wp.struct
class AxisFrame:
    """A box along one axis: the area of a slice of it is linear in the slice's length."""

    axis: int
    low: float
    high: float
    face: float
    """Half the area of the two faces perpendicular to the axis; 0 with a mailbox, see the module's docstring."""
    perimeter: float
    """Half the perimeter of such a face."""
    inverse_area: float
    base: float
    """Cost of a split without its children."""


@wp.func
def no_split():
    """A split that costs more than any plane."""
    split = Split()
    split.cost = INFINITY
    return split


@native.func_native("cost.h", "return wrt::leaf_cost(cost, triangles);")
def leaf_cost(cost: SplitCost, triangles: int) -> float:
    """Cost of a leaf."""


@wp.func
def axis_frame(cost: SplitCost, axis: int, low: wp.vec3, high: wp.vec3, triangles: int):
    """The frame of a box with this many triangles along `axis`."""
    size = high - low
    one = wp.where(axis == 0, size[1], size[0])
    two = wp.where(axis == 2, size[1], size[2])
    frame = AxisFrame()
    frame.axis = axis
    frame.low = low[axis]
    frame.high = high[axis]
    frame.face = one * two
    frame.perimeter = one + two
    frame.inverse_area = 1.0 / (frame.face + size[axis] * frame.perimeter)
    frame.base = cost.traversal
    if cost.mailbox:
        frame.base = cost.traversal + leaf_cost(cost, triangles) * (frame.face * frame.inverse_area)
        frame.face = 0.0
    return frame


@native.func_native("cost.h", "return wrt::plane_cost(cost, frame, position, left, right);")
def plane_cost(cost: SplitCost, frame: AxisFrame, position: float, left: int, right: int) -> float:
    """Cost of a split into children with these numbers of triangles."""


@wp.func
def saved_by_hits(cost: SplitCost, frame: AxisFrame, position: float, left: int, right: int):
    """By how much rays that end in one child lower the cost of a split: see the module's docstring."""
    half_left = frame.face + (position - frame.low) * frame.perimeter
    half_right = frame.face + (frame.high - position) * frame.perimeter
    ends_left = 1.0 - wp.exp(-cost.occluder * float(left) / half_left)
    ends_right = 1.0 - wp.exp(-cost.occluder * float(right) / half_right)
    first = 0.5 * frame.face * frame.inverse_area
    return first * (ends_left * leaf_cost(cost, right) + ends_right * leaf_cost(cost, left))


@cache
def split_comparison(ends_rays: bool) -> wp.Function:
    """The function that keeps the cheaper split. ends_rays: whether it knows the cost of rays that end; if not, it does not
    contain that formula, and searches are faster. It is compiled for one of them, because a search calls it for every plane."""

    @wp.func
    def compare(cost: SplitCost, frame: AxisFrame, position: float, left: int, right: int, planar_left: bool, best: Split):
        """`best`, or a split at `position` if that is strictly inside the box and costs less."""
        if position > frame.low and position < frame.high:
            candidate = plane_cost(cost, frame, position, left, right)
            if wp.static(ends_rays) and cost.occluder > 0.0:
                candidate -= saved_by_hits(cost, frame, position, left, right)
            if candidate < best.cost:
                best.cost = candidate
                best.axis = frame.axis
                best.position = position
                best.planar_left = planar_left
                best.left = left
                best.right = right
        return best

    return compare


cheaper_split = split_comparison(True)
"""For either cost model."""

cheaper_by_area = split_comparison(False)
"""For costs whose `occluder` is 0."""


@cache
def planar_comparison(ends_rays: bool) -> wp.Function:
    """`split_comparison` with the planar triangles on the right, then on the left."""
    compare = split_comparison(ends_rays)

    @wp.func
    def compare_both(cost: SplitCost, frame: AxisFrame, position: float, left: int, planar: int, right: int, best: Split):
        """`best`, or the cheaper split at `position`."""
        best = compare(cost, frame, position, left, planar + right, False, best)
        return compare(cost, frame, position, left + planar, right, True, best)

    return compare_both


better_split = planar_comparison(True)
"""For either cost model."""
