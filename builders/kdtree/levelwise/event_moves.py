"""Events to the children of their nodes: count, scan, fill (ClassifyTriangles and Fill of Choi et al. 2010, of a level at once).

An event looks at the box of its triangle and at its node's plane, and goes to one child or to both. Nodes, and the children of
a node, are in order, and so are the events of each; therefore events keep their order, and four sums over all events before one
say where it goes: events that go to left and to right children, and triangles that begin with them. An event of a leaf ends
there; where the triangle begins on the first axis, it is listed.

References: choi-2010.
"""

import warp as wp

from wrt.builders.core.levels import side_of
from wrt.builders.kdtree.levelwise.cell_nodes import LEFT, RIGHT, CellNode
from wrt.builders.kdtree.levelwise.paired_events import ITEM, event_at, event_words, store_words
from wrt.builders.triangle_boxes import Boxes
from wrt.kernels.runtime.options import exact_kernel

PARTS = 4
"""Sums of an item, part by part: events to the left and to the right; triangles that begin there, likewise."""


@exact_kernel
def count_sides(
    first: int,
    items: int,
    total: int,
    boxes: Boxes,
    events: wp.array(dtype=wp.vec4i),
    nodes: wp.array(dtype=CellNode),
    sides: wp.array(dtype=int),
    counts: wp.array(dtype=int),
):
    """Item: some events. sides: (items,) two bits for each event, 1 left, 2 right. counts: (PARTS * items,) its sums."""
    item = first + wp.tid()
    begin = item * ITEM
    to_left = int(0)
    to_right = int(0)
    begin_left = int(0)
    begin_right = int(0)
    found = int(0)
    for i in range(begin, wp.min(begin + ITEM, 6 * total)):
        event = event_at(events, i)
        if not nodes[event.node].is_leaf:
            split = nodes[event.node].split
            side = side_of(split, boxes.low[split.axis, event.triangle], boxes.high[split.axis, event.triangle])
            found = found | (side << (2 * (i - begin)))
            to_left += side & 1
            to_right += side >> 1
            begin_left += side & event.kind & 1
            begin_right += (side >> 1) & event.kind & 1
    sides[item] = found
    counts[item] = to_left
    counts[items + item] = to_right
    counts[2 * items + item] = begin_left
    counts[3 * items + item] = begin_right


@exact_kernel
def move_events(
    first: int,
    items: int,
    total: int,
    events: wp.array(dtype=wp.vec4i),
    nodes: wp.array(dtype=CellNode),
    totals: wp.array(dtype=int),
    sides: wp.array(dtype=int),
    before: wp.array(dtype=int),
    moved: wp.array(dtype=wp.vec4i),
    listed: wp.array(dtype=int),
):
    """Item: some events. Writes them to the next level, and the triangles of leaves.

    totals: of `make_children`. before: sums of all counts before each place. moved: the next level's events. listed: as in
    `BuiltNodes`."""
    item = first + wp.tid()
    begin = item * ITEM
    left = before[item]
    right = before[items + item] - before[items]
    left_begun = before[2 * items + item] - before[2 * items]
    right_begun = before[3 * items + item] - before[3 * items]
    lefts = totals[LEFT]
    rights = totals[RIGHT]
    side = sides[item]
    for i in range(begin, wp.min(begin + ITEM, 6 * total)):
        event = event_at(events, i)
        node = nodes[event.node]
        begins = event.kind & 1
        if node.is_leaf:
            if begins == 1 and event.axis == 0:
                listed[node.child + event.begun] = event.triangle
        else:
            left_first = event.axis * lefts + node.left_before
            right_first = event.axis * rights + node.right_before
            child = event
            if (side & 1) != 0:
                child.node = node.child
                child.begun = left_begun - left_first
                store_words(moved, 2 * right_first + left, event_words(child))
                left += 1
                left_begun += begins
            if (side & 2) != 0:
                child.node = node.child + 1
                child.begun = right_begun - right_first
                store_words(moved, 2 * (left_first + node.split.left) + right, event_words(child))
                right += 1
                right_begun += begins
        side = side >> 2
