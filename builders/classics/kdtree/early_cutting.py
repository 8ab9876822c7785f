"""Early cutting of empty space: a large empty slab of a node is cut off before other planes are tried.

**Problem.** A greedy search takes the plane of least cost, which may leave empty space to be cut off below, node by node.

**Idea.** Cut off large empty slabs first, whatever other planes cost.

**Steps** of a node (`cut_slab`), before its search:

1. The box of the node's triangles leaves up to six empty slabs of the node's own box.
2. Those that fill at least `MIN_SHARE` of the node along their axis are candidates.
3. The one whose cut costs least is the node's split, if it costs less than a leaf. Otherwise the node is searched as usual.

**What we changed.** Rahikainen 2013 (4.1) says that Havran tried three ways to cut off empty space, and does not describe them.
Here they are: by a factor on the cost (`wrt.builders.cost`), early, and late, in leaves (`postprocess`).

References: havran-2001; rahikainen-2013 (section 4.1).
"""

from functools import cache

import warp as wp

from wrt.builders.core.reference_lists import ReferenceLists
from wrt.builders.core.subtrees import Frame
from wrt.builders.cost import SplitCost, axis_frame, cheaper_split, leaf_cost, no_split
from wrt.builders.kdtree.events.event_lists import EventLists
from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.kernels.layout.unchecked import load_pair
from wrt.kernels.simd.boxes import INFINITY

MIN_SHARE = wp.constant(0.2)
"""Least length of an empty slab, relative to the node's along the same axis."""


@wp.func
def cut_slab(cost: SplitCost, low: wp.vec3, high: wp.vec3, inner_low: wp.vec3, inner_high: wp.vec3, triangles: int):
    """The split that cuts off a large empty slab; `no_split()` if none is worth it.

    inner_low, inner_high: the box of the node's triangles."""
    best = no_split()
    if triangles > 0:
        for axis in range(3):
            along = axis_frame(cost, axis, low, high, triangles)
            min_length = MIN_SHARE * (high[axis] - low[axis])
            if inner_low[axis] - low[axis] >= min_length:
                best = cheaper_split(cost, along, inner_low[axis], 0, triangles, False, best)
            if high[axis] - inner_high[axis] >= min_length:
                best = cheaper_split(cost, along, inner_high[axis], triangles, 0, True, best)
    if not (best.cost < leaf_cost(cost, triangles)):
        best = no_split()
    return best


@wp.func
def box_of_events(lists: EventLists, frame: Frame, axis: int):
    """The interval of a node's triangles along an axis, within its box: from the first event to the last."""
    first = wp.cast(load_pair(lists.event, frame.first[axis])[0], wp.float32)
    last = wp.cast(load_pair(lists.event, frame.first[axis] + frame.count[axis] - 1)[0], wp.float32)
    return wp.vec2(wp.max(first, frame.low[axis]), wp.min(last, frame.high[axis]))


@cache
def cutting_early(search: wp.Function, memory: type) -> wp.Function:
    """A search of `Method` with early cutting; memory: the struct with its lists."""

    @wp.func
    def search_references(cost: SplitCost, lists: ReferenceLists, number: int, frame: Frame):
        split = cut_slab(cost, frame.low, frame.high, frame.inner_low, frame.inner_high, frame.triangles)
        if split.cost == INFINITY:
            split = search(cost, lists, number, frame)
        return split

    @wp.func
    def search_events(cost: SplitCost, lists: EventLists, number: int, frame: Frame):
        split = no_split()
        if frame.triangles > 0:
            low = wp.vec3()
            high = wp.vec3()
            for axis in range(3):
                interval = box_of_events(lists, frame, axis)
                low[axis] = interval[0]
                high[axis] = interval[1]
            split = cut_slab(cost, frame.low, frame.high, low, high, frame.triangles)
        if split.cost == INFINITY:
            split = search(cost, lists, number, frame)
        return split

    return search_events if memory is EventLists else search_references


def early(config: KdTreeConfig, search: wp.Function, memory: type = ReferenceLists) -> wp.Function:
    """`search`, with early cutting if the configuration asks for it."""
    return cutting_early(search, memory) if config.cuts_early else search
