"""Sorted events as a node's lists: exact planes, divided without sorting (Wald and Havran 2006).

A node has one list per axis. Search sweeps the three lists, 16 events at a time where possible (`find_best_plane`). Classify
marks every triangle from the list of the split axis. Partition splits each list between the children in one pass. A part of a
sorted list is sorted, so nothing is merged or sorted again, unless triangles are clipped to nodes (`clipped_events`).

References: wald-havran-2006; rahikainen-2013 (algorithms 4.1.4 and 4.1.5).
"""

from functools import cache

import warp as wp

from wrt.builders.core.subtrees import Frame, Parts, Task
from wrt.builders.cost import AxisFrame, Split, SplitCost, axis_frame, no_split
from wrt.builders.kdtree.events.event_sort import END, PLANAR, START
from wrt.builders.kdtree.events.sweep_planes import BestPlane, Sweep, close_planar, find_best_plane, start_sweep, sweep_event
from wrt.kernels.layout.unchecked import load_byte, load_pair, store_byte, store_pair
from wrt.kernels.simd.boxes import INFINITY


@wp.struct
class EventLists:
    """Lists of all tasks. Each task has its own range."""

    event: wp.array(dtype=wp.vec2i)
    """Events: bits of the position, and index of the triangle within the task << 2 | type."""
    triangle: wp.array(dtype=int)
    """Ids of a task's triangles, ascending."""
    side: wp.array(dtype=wp.uint8)
    """Scratch of the classify phase, one per triangle of a task: 1 left, 2 right, 3 both."""
    vertices: wp.array(dtype=wp.vec3)
    """The mesh, for builds that clip (`clipped_events`). The members below are for clipping too."""
    faces: wp.array(dtype=wp.vec3i)
    pad: float
    """Enlargement of cells and boxes for clipping, in scene units."""
    shrinks: bool
    """Whether clipped triangles get the boxes of their parts."""
    number: wp.array(dtype=int)
    """Scratch, one per triangle of a task: its number among the node's straddlers."""
    straddler: wp.array(dtype=float)
    """Scratch, 16 per triangle: a node's straddlers as references (8 floats each), followed by their remaining parts in a
    child. The id of a reference is the index of the triangle within the task."""
    new_events: wp.array(dtype=wp.vec2i)
    """Scratch, 4 per triangle: new events along one axis, and room to sort them."""


@wp.func
def sweep_until(
    cost: SplitCost,
    along: AxisFrame,
    events: wp.array(dtype=wp.vec2i),
    begin: int,
    end: int,
    min_cost: float,
    sweep: wp.ref[Sweep],
):
    """Passes the events begin .. end - 1, or fewer: it stops when it has passed a plane of the least cost."""
    i = int(begin)
    while i < end:
        event = load_pair(events, i)
        position = wp.cast(event[0], wp.float32)
        if sweep.best.cost <= min_cost and position != sweep.best.position:
            break
        sweep_event(cost, along, event[1] & 3, position, sweep)
        i += 1
    close_planar(cost, along, sweep)


@wp.func
def sweep_range(
    cost: SplitCost,
    along: AxisFrame,
    events: wp.array(dtype=wp.vec2i),
    begin: int,
    end: int,
    any_planar: bool,
    sweep: wp.ref[Sweep],
):
    """Improves the best plane of a sweep by the best plane at the events begin .. end - 1: passes them, from the block of least
    cost on if that is known.

    any_planar: whether there may be events of planar triangles."""
    start = int(begin)
    plane = BestPlane()
    plane.cost = -INFINITY
    if not any_planar:
        find_best_plane(cost, along, events, begin, end - begin, sweep.left, sweep.right, plane)
        start = plane.event
        sweep.left = plane.left
        sweep.right = plane.right
    if plane.cost < sweep.best.cost:
        sweep_until(cost, along, events, start, end, plane.cost, sweep)


@wp.func
def search(cost: SplitCost, lists: EventLists, number: int, frame: Frame):
    """Phase "search": the best plane of a node, by a sweep per axis."""
    best = no_split()
    for axis in range(3):
        along = axis_frame(cost, axis, frame.low, frame.high, frame.triangles)
        begin = frame.first[axis]
        end = begin + frame.count[axis]
        any_planar = end - begin != 2 * frame.triangles
        sweep = start_sweep(0, frame.triangles)
        sweep.best = best
        sweep_range(cost, along, lists.event, begin, end, any_planar, sweep)
        best = sweep.best
    return best


@wp.func
def classify(lists: EventLists, task: Task, frame: Frame, split: Split):
    """Phase "classify": marks the children of every triangle of the node, from its events along the split axis. A triangle that
    starts on the left is marked for both, until its end turns out to be on the left too."""
    position = split.position
    begin = frame.first[split.axis]
    for i in range(begin, begin + frame.count[split.axis]):
        event = load_pair(lists.event, i)
        at = wp.cast(event[0], wp.float32)
        kind = event[1] & 3
        place = task.triangles_first + (event[1] >> 2)
        before = at < position or (at == position and (kind == END or (kind == PLANAR and split.planar_left)))
        # known values are written again: no branch on the kind to mispredict
        known = load_byte(lists.side, place)
        on_left = wp.where(kind == START, wp.uint8(3), wp.uint8(1))
        on_right = wp.where(kind == END, known, wp.uint8(2))
        store_byte(lists.side, place, wp.where(before, on_left, on_right))


@wp.func
def divide_axis(lists: EventLists, sides_first: int, axis: int, begin: int, count: int, to_left: int, to_right: int):
    """Splits one axis' events [begin, begin + count) between the children. Returns their counts, and two zeros: as
    `clipped_events.divide_axis`.

    One of `to_left` and `to_right` equals `begin`: that child's events are compacted in place."""
    left = int(to_left)
    right = int(to_right)
    for i in range(begin, begin + count):
        event = load_pair(lists.event, i)
        side = int(load_byte(lists.side, sides_first + (event[1] >> 2))) & 3
        # always written, kept by advancing the end: no branch to mispredict
        store_pair(lists.event, left, event)
        left += side & 1
        store_pair(lists.event, right, event)
        right += side >> 1
    return wp.vec4i(left - to_left, right - to_right, 0, 0)


@wp.func
def keep_events(lists: EventLists, sides_first: int, straddlers: int, left: wp.ref[Frame], right: wp.ref[Frame]):
    """Leaves the lists as they are: straddlers are in both."""


@cache
def partition_by(divide: wp.Function, finish: wp.Function) -> wp.Function:
    """The phase "partition": gives the children their lists; divide, finish: as `divide_axis` and `keep_events`."""

    @wp.func
    def partition(lists: EventLists, task: Task, frame: Frame, split: Split, left: wp.ref[Frame], right: wp.ref[Frame]):
        append_left = split.left < split.right
        sides_first = task.triangles_first
        to = int(frame.top)
        straddlers = int(0)
        for axis in range(3):
            if append_left:
                left.first[axis] = to
            else:
                right.first[axis] = to
            made = divide(lists, sides_first, axis, frame.first[axis], frame.count[axis], left.first[axis], right.first[axis])
            left.count[axis] = made[0]
            right.count[axis] = made[1]
            to += wp.where(append_left, made[0], made[1]) + made[2]
            straddlers += made[3]
        # no waiting node has lists behind `top`; those of the right child, or of one further up, are in front of it
        left.top = to
        right.top = wp.where(append_left, frame.top, to)
        left.triangles = wp.max(split.left - straddlers, 0)
        right.triangles = wp.max(split.right - straddlers, 0)
        finish(lists, sides_first, straddlers, left, right)

    return partition


partition = partition_by(divide_axis, keep_events)
"""By the boxes of triangles."""


@wp.func
def emit_leaf(lists: EventLists, task: Task, frame: Frame, parts: Parts, begin: int):
    """Phase "emit" of a leaf: lists the node's triangles by their start in x."""
    to = int(begin)
    end = begin + frame.triangles  # the count of the search, which may differ from the lists if there is NaN
    for i in range(frame.first[0], frame.first[0] + frame.count[0]):
        value = load_pair(lists.event, i)[1]
        if (value & 3) != END and to < end:
            parts.primitive[to] = lists.triangle[task.triangles_first + (value >> 2)]
            to += 1
    while to < end:
        parts.primitive[to] = -1
        to += 1
