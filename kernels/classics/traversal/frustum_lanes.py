"""The frusta of a block in the lanes of a vector: their bounds, a node's boxes against all of them, and the stack.

**A child against 16 frusta.** With one origin o, a ray enters the widened slab of a box at (low - (o + slack)) / d if it goes
forward, and at (high - (o - slack)) / d if it goes backward. Let `ahead` be the first distance and `behind` the second one with
its sign changed: at most one of them is positive. They are numbers of the box, the same for all frusta; what differs are the
ends of the interval of 1 / d. A frustum has, for each axis:

    near_forward   least 1 / d of the rays that go forward; the largest float if there are none
    near_backward  least -1 / d of the rays that go backward; likewise
    far_forward    greatest 1 / d if all rays go forward; inf if they go both ways, 0 if all go backward
    far_backward   greatest -1 / d if all rays go backward; inf if they go both ways, 0 if all go forward

No ray enters before ahead * near_forward, nor before behind * near_backward, and all of them have left after the greater one of
-behind * far_forward and -ahead * far_backward. These are the products that each ray computes (`wrt.kernels.simd.boxes`), with
factors that are not less, or not greater; rounding is monotone. A product 0 * inf is NaN, which bounds nothing.

**Both signs.** Where an interval of directions contains 0, nothing is known of the far planes, and a box is beyond the frustum
if it lies farther along the axis than the farthest-going ray gets while it is within the other slabs: the box around the rays
against the node's box, as Benthin and Wald have it, within these limits.

**Memory**, rows of 16 floats from the first cache line on: 12 rows of factors in the order above, x, y, z each; `t_min` and
`t_max`, the ranges; `block`, the same 14 numbers for all frusta as one; `origin`, o + slack and o - slack; then the stack, for
each waiting child the t at which each frustum enters its box, inf for those that miss it. Which child it is, is in another
array.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.ray_batch import RayBatch
from wrt.kernels.layout.unchecked import CACHE_LINE
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout

exact_module(__name__)

FRUSTA = 16
"""Frusta of a block."""

_STACK = 16

_ROWS = f"wrt::FrustumRows<{FRUSTA}>(lanes.data)"


def lane_memory(waiting: int) -> int:
    """Floats of the memory of a block, for a stack of so many children."""
    return (_STACK + waiting) * FRUSTA + CACHE_LINE


@cache
def gather_directions(layout: PacketLayout) -> wp.Function:
    """`wp.func(rays, first, lanes, f)`: the ends of the directions and of the ranges of the P rays at `first`, in lane f.

    No ray is made. An interval of no active ray is inf .. -inf.
    """
    code = f"wrt::gather_directions<{layout.rays}, {layout.width}>(rays, first, {_ROWS}, f);"

    @native.func_native("frustum.h", code)
    def gather_directions_native(rays: RayBatch, first: int, lanes: wp.array(dtype=float), f: int): ...

    return gather_directions_native


@native.func_native("frustum.h", f"wrt::bound_block(rays, low, high, {_ROWS}, count);")
def bound_block(rays: RayBatch, low: wp.vec3, high: wp.vec3, lanes: wp.array(dtype=float), count: int):
    """Derives the factors of a block from the ends of the directions of its first `count` frusta; low, high: bounds of the
    scene."""
    ...


@native.func_native("frustum.h", f"wrt::frustum_bounds({_ROWS}, f, bounds);")
def frustum_bounds(lanes: wp.array(dtype=float), f: int, bounds: wp.ref[PacketBounds]):
    """Sets what `wrt.kernels.traversal.packet.culling.interval_culling` reads to the bounds of lane f."""
    ...


@cache
def push_children(width: int) -> wp.Function:
    """`wp.func(boxes, node, lanes, slots, top) -> top`: pushes the children of a node that frusta meet, nearest last.

    Only those that the block meets as a whole are tested against each frustum. top: children that wait so far. A child is given
    by its slot, node * W + lane.
    """
    box = f"boxes.data + (size_t)node * {6 * width}"

    @native.func_native(
        "frustum.h",
        f"""static_assert(wrt::FrustumRows<{FRUSTA}>::STACK == {_STACK});
        return wrt::push_children<{width}>({box}, node, {_ROWS}, slots.data, top);""",
    )
    def push_children_native(
        boxes: wp.array(dtype=float), node: int, lanes: wp.array(dtype=float), slots: wp.array(dtype=int), top: int
    ) -> int: ...

    return push_children_native


@native.func_native("frustum.h", f"return wrt::frusta_waiting({_ROWS}, place);")
def frusta_waiting(lanes: wp.array(dtype=float), place: int) -> wp.uint32:
    """The frusta that enter a waiting child before their best hits, one bit each."""
    ...


@native.func_native("frustum.h", f"{_ROWS}.t_max[f] = end;")
def shorten_frustum(lanes: wp.array(dtype=float), f: int, end: float):
    """Sets the end of a frustum's range; -inf if all of its rays are done."""
    ...
