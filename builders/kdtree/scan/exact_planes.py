"""The best plane of a node by comparing every plane with every triangle: O(N^2), without sorted lists.

For few triangles this is faster than any sort, because 16 boxes are compared with a plane at once. The candidate planes are
those of a sweep, and the same one wins among equal costs: smaller axis, smaller position, planar triangles on the right.

References: wald-havran-2006; rahikainen-2013 (algorithm 4.1.2).
"""

from functools import cache

import warp as wp

from wrt.builders.core.reference_lists import ReferenceLists
from wrt.builders.core.subtrees import Frame
from wrt.builders.cost import AxisFrame, Split, SplitCost, axis_frame, no_split, planar_comparison
from wrt.kernels.runtime import native

LANES = 16
"""Boxes compared at once. Rows of `ReferenceLists.value` are padded to a multiple of it with NaN, which compares false."""


def values_for(triangles: int) -> int:
    """Number of floats that a search among this many triangles writes."""
    return 2 * (triangles + LANES)


@native.func_native(
    "scan.h",
    "float* low = lists.value.data + (size_t)number * lists.value.shape[1];\n"
    "wrt::gather_axis(lists.reference.data + (size_t)first * 8, count, axis, low, low + padded, padded);",
)
def gather_axis(lists: ReferenceLists, number: int, first: int, count: int, axis: int, padded: int):
    """Writes the intervals of a range along one axis: a row of lower ends, a row of upper ends."""


@native.func_native(
    "scan.h",
    "const float* low = lists.value.data + (size_t)number * lists.value.shape[1];\n"
    f"return wrt::count_sides<{LANES}, wp::vec3i>(low, low + padded, padded, position);",
)
def count_sides(lists: ReferenceLists, number: int, padded: int, position: float) -> wp.vec3i:
    """Numbers of triangles to the left of a plane, in it, and to the right. Straddlers count on both sides."""


@cache
def exact_search(ends_rays: bool) -> wp.Function:
    """The search of a builder; ends_rays: as in `wrt.builders.cost.split_comparison`."""
    compare = planar_comparison(ends_rays)

    @wp.func
    def try_position(
        cost: SplitCost, along: AxisFrame, lists: ReferenceLists, number: int, padded: int, position: float, best: Split
    ):
        """The better of `best` and the plane at a position. The result does not depend on the order of the planes."""
        if position > along.low and position < along.high and not (best.axis == along.axis and best.position == position):
            counts = count_sides(lists, number, padded, position)
            found = compare(cost, along, position, counts[0], counts[1], counts[2], no_split())
            first_of_equals = found.cost == best.cost and best.axis == along.axis and position < best.position
            if found.cost < best.cost or first_of_equals:
                best = found
        return best

    @wp.func
    def search_exactly(cost: SplitCost, lists: ReferenceLists, number: int, frame: Frame):
        """The best plane of a node."""
        best = no_split()
        best.axis = 3
        padded = (frame.triangles + LANES - 1) / LANES * LANES
        for axis in range(3):
            along = axis_frame(cost, axis, frame.low, frame.high, frame.triangles)
            gather_axis(lists, number, frame.first[0], frame.triangles, axis, padded)
            for i in range(frame.triangles):
                best = try_position(cost, along, lists, number, padded, lists.value[number, i], best)
                best = try_position(cost, along, lists, number, padded, lists.value[number, padded + i], best)
        return best

    return search_exactly


search_exactly = exact_search(True)
"""For either cost model."""
