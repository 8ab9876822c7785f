"""Median splits: a node is halved in space or in number; the cost only decides when to stop (Fussell and Subramanian 1988).

**Problem.** A search for the cheapest plane takes most of the time of a build.

**Idea.** The spatial median is the middle of the node's box along an axis. The object median is the plane with equally many
triangles on both sides, here the median of the boxes' centres. The axis is the longest of the node, or x, y, z in turn
(`KdTreeConfig.axis`). The longest was long considered the better choice; Wald (2004) found that it need not be.

**Steps** of a node (`median_method`):

1. `first_axis`; the axis after it, and the third, if no plane on it divides the node (`along_first_axis`).
2. `split_space` halves the box; `split_objects` selects the centre of middle rank by partition (`select`, Hoare 1961).
3. `split_at`: one scan counts the triangles on both sides of the plane. Another classifies and partitions the references.

**Data.** One list of references per node (`wrt.builders.core.reference_lists`).

**Complexity.** O(N) per level: one scan of the node for the spatial median; a selection by partition (Hoare 1961), O(N) on
average, for the object median.

**What we changed.** The older builds stop at a fixed depth or leaf size. Here every builder stops by the same rules
(`wrt.builders.tree.StopRules`), so that trees differ by their planes alone.

References: fussell-subramanian-1988; hoare-1961; wald-2004; rahikainen-2013 (chapter 4).
"""

from functools import cache

import warp as wp

from wrt.builders.classics.kdtree.early_cutting import early
from wrt.builders.core.reference_lists import ReferenceLists, Sides, measure_sides
from wrt.builders.core.subtrees import Frame, Method
from wrt.builders.cost import SplitCost, axis_frame, cheaper_by_area, no_split
from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.kdtree.scan.scanning import build_scanning, scan_method, uniform_scan
from wrt.builders.tree import KdTree
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.kernels.layout.unchecked import load_float
from wrt.kernels.simd.boxes import INFINITY


@wp.func
def longest_axis(frame: Frame):
    """The axis along which a node is longest."""
    size = frame.high - frame.low
    longest = wp.where(size[1] > size[0], 1, 0)
    return wp.where(size[2] > size[longest], 2, longest)


@wp.func
def first_axis(lists: ReferenceLists, frame: Frame):
    """The axis to split, if a plane on it divides the node."""
    if lists.rules.round_robin:
        return frame.depth % 3
    return longest_axis(frame)


@wp.func
def split_at(cost: SplitCost, lists: ReferenceLists, frame: Frame, axis: int, position: float):
    """The split at a position, with planar triangles on the right; `no_split()` if it is not inside the node."""
    sides = Sides()
    measure_sides(lists.reference, frame.first[0], frame.triangles, axis, position, False, sides)
    along = axis_frame(cost, axis, frame.low, frame.high, frame.triangles)
    return cheaper_by_area(cost, along, position, sides.left, sides.right, False, no_split())


@cache
def along_first_axis(search_axis: wp.Function) -> wp.Function:
    """The search of `Method` that takes the first axis on which a plane divides the node.

    search_axis: `wp.func(cost, lists, number, frame, axis) -> Split`."""

    @wp.func
    def search(cost: SplitCost, lists: ReferenceLists, number: int, frame: Frame):
        split = no_split()
        axis = first_axis(lists, frame)
        for _turn in range(3):
            if frame.triangles > 0 and split.cost == INFINITY:
                split = search_axis(cost, lists, number, frame, axis)
            axis = (axis + 1) % 3
        return split

    return search


@wp.func
def split_space(cost: SplitCost, lists: ReferenceLists, number: int, frame: Frame, axis: int):
    """The plane that halves the node."""
    return split_at(cost, lists, frame, axis, 0.5 * (frame.low[axis] + frame.high[axis]))


@wp.func
def select(lists: ReferenceLists, number: int, count: int, rank: int):
    """The value of a given rank among the first `count` of a task's values. Reorders them."""
    begin = int(0)
    end = count - 1
    while begin < end:
        pivot = lists.value[number, (begin + end) / 2]
        i = int(begin)
        j = int(end)
        while i <= j:
            while lists.value[number, i] < pivot:
                i += 1
            while lists.value[number, j] > pivot:
                j -= 1
            if i <= j:
                swapped = lists.value[number, i]
                lists.value[number, i] = lists.value[number, j]
                lists.value[number, j] = swapped
                i += 1
                j -= 1
        # [begin, j] <= pivot <= [i, end], and what lies between is the pivot
        if rank <= j:
            end = j
        elif rank >= i:
            begin = i
        else:
            begin = rank
            end = rank
    return lists.value[number, rank]


@wp.func
def median_position(lists: ReferenceLists, number: int, frame: Frame, axis: int):
    """The median of the centres of the boxes of the node's triangles."""
    for i in range(frame.triangles):
        at = (frame.first[0] + i) * 8 + axis
        lists.value[number, i] = 0.5 * (load_float(lists.reference, at) - load_float(lists.reference, at + 4))
    return select(lists, number, frame.triangles, frame.triangles / 2)


@wp.func
def split_objects(cost: SplitCost, lists: ReferenceLists, number: int, frame: Frame, axis: int):
    """The plane that halves the number of triangles."""
    return split_at(cost, lists, frame, axis, median_position(lists, number, frame, axis))


def median_method(search_axis: wp.Function, config: KdTreeConfig) -> Method:
    """What is done with a node; search_axis: finds the median."""
    return scan_method(config, early(config, along_first_axis(search_axis)))


def build_spatial(triangles: TriangleBoxes, config: KdTreeConfig) -> KdTree:
    """Builds the tree of spatial medians on the device that holds the boxes."""
    return build_scanning(triangles, config, uniform_scan(median_method(split_space, config), triangles, config, values=1))


def build_object(triangles: TriangleBoxes, config: KdTreeConfig) -> KdTree:
    """Builds the tree of object medians on the device that holds the boxes."""
    return build_scanning(triangles, config, uniform_scan(median_method(split_objects, config), triangles, config, values=None))
