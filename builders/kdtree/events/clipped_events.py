"""Split clipping with sorted events, in O(N log N) ("perfect splits"; Wald and Havran 2006).

**Problem.** A triangle that is clipped to the children gets new boxes, and so new events: the remainder of a sorted list no
longer contains all events of a child. Sorting every child's list again would cost a factor of log N.

**Algorithm.** Partition removes the events of straddlers from both children's lists, and assembles from them the boxes of the
straddlers (axis by axis: no box of a reference is stored elsewhere). Each straddler is clipped to both cells
(`core.clip`). The events of the remaining parts are sorted separately and merged into the child's lists, from the back, so
that a list grows in place.

**Data.** A clipped triangle has at most as many events on an axis as before. So the child that is compacted in place has room
for them in its own list, and the appended child leaves as much room as the straddlers' events took.

**Complexity.** A plane straddles about sqrt(N) of the N triangles of a surface, so sorting them is negligible against the O(N)
of the node. If it straddles most triangles (long ones that overlap), the build sorts at every level, O(N log^2 N).

**What we changed.** Events of one kind at one position have no defined order, because neither planes nor sides depend on it.
Many parts begin at the plane that clipped them, so leaves list their triangles by id: the order of their starts would depend on
which of them were clipped in tasks.

**Limits.** The build takes about twice as long, and the gain depends on the scene: large for long slanted triangles, small for
scanned surfaces (notebooks/records/2026-11-21-split-clipping.md).

References: wald-havran-2006.
"""

import warp as wp

from wrt.builders.core.clip import give_mesh
from wrt.builders.core.subtrees import Frame, Parts, Reservation, Task
from wrt.builders.kdtree.events.event_lists import EventLists, emit_leaf, partition_by
from wrt.builders.kdtree.events.event_sort import END
from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.kernels.layout.unchecked import load_byte, load_int, load_pair, store_int, store_pair
from wrt.kernels.runtime import native

LEFT, RIGHT, BOTH = wp.constant(1), wp.constant(2), wp.constant(3)
"""Values of `EventLists.side`."""


@native.func_native("events.h", "wrt::note_event(event, axis, lists.straddler.data + ((size_t)first * 2 + number) * 8);")
def note_event(lists: EventLists, first: int, number: int, axis: int, event: wp.vec2i):
    """Stores an event as a side of a straddler's box."""


@native.func_native(
    "clip.h",
    "float *from = lists.straddler.data + (size_t)first * 16, *to = from + (size_t)count * 8;\n"
    "return wrt::clip_straddlers(lists, wrt::cell_of(low, high, pad), from, count, lists.triangle.data + first, to);",
)
def clip_straddlers(lists: EventLists, first: int, count: int, pad: float, low: wp.vec3, high: wp.vec3) -> int:
    """Writes the parts of the straddlers in a cell behind them; returns the number of nonempty parts.

    first: the task's first triangle."""


@native.func_native(
    "events.h",
    "const float* from = lists.straddler.data + ((size_t)first * 2 + straddlers) * 8;\n"
    "return wrt::write_new_events(from, count, axis, lists.new_events.data + (size_t)first * 4);",
)
def list_new_events(lists: EventLists, first: int, straddlers: int, count: int, axis: int) -> int:
    """Lists the events, along one axis and unsorted, of the parts that `clip_straddlers` wrote; returns their number."""


@wp.func
def precedes(a: wp.vec2i, b: wp.vec2i):
    """Whether event a is not after event b: by position, then end, planar, start."""
    at_a = wp.cast(a[0], wp.float32)
    at_b = wp.cast(b[0], wp.float32)
    return at_a < at_b or (at_a == at_b and (a[1] & 3) <= (b[1] & 3))


@wp.func
def sort_new_events(lists: EventLists, begin: int, count: int):
    """Sorts the new events by merging runs; an equal amount of memory behind them is scratch. Returns the start of the list."""
    source = int(begin)
    target = int(begin + count)
    run = int(1)
    while run < count:
        for first in range(0, count, 2 * run):
            middle = wp.min(first + run, count)
            end = wp.min(first + 2 * run, count)
            a = int(first)
            b = int(middle)
            for to in range(first, end):
                take_a = b >= end
                if a < middle and not take_a:
                    take_a = precedes(load_pair(lists.new_events, source + a), load_pair(lists.new_events, source + b))
                store_pair(lists.new_events, target + to, load_pair(lists.new_events, source + wp.where(take_a, a, b)))
                a += wp.where(take_a, 1, 0)
                b += wp.where(take_a, 0, 1)
        swap = source
        source = target
        target = swap
        run *= 2
    return source


@wp.func
def merge_new_events(lists: EventLists, new_first: int, count: int, begin: int, kept: int):
    """Merges sorted new events from the back into the list [begin, begin + kept), which has room for them behind."""
    old = int(begin + kept)
    new = int(new_first + count)
    while new > new_first:
        to = old + (new - new_first) - 1
        event = load_pair(lists.new_events, new - 1)
        if old > begin and not precedes(load_pair(lists.event, wp.max(old - 1, 0)), event):
            old -= 1
            event = load_pair(lists.event, old)
        else:
            new -= 1
        store_pair(lists.event, to, event)


@wp.func
def divide_axis(lists: EventLists, sides_first: int, axis: int, begin: int, count: int, to_left: int, to_right: int):
    """Splits one axis' events [begin, begin + count) between the children, except those of straddlers, which are stored.
    Returns the counts of both children, the number of events of straddlers and, on the first axis, the number of straddlers.

    The first axis numbers the straddlers: a triangle's first event there is its start or its planar event."""
    left = int(to_left)
    right = int(to_right)
    straddlers = int(0)
    for i in range(begin, begin + count):
        event = load_pair(lists.event, i)
        place = sides_first + (event[1] >> 2)
        side = int(load_byte(lists.side, place)) & 3
        if side == BOTH:
            if axis == 0 and (event[1] & 3) != END:
                store_int(lists.number, place, straddlers)
                straddlers += 1
            note_event(lists, sides_first, load_int(lists.number, place), axis, event)
        else:
            # always written, kept by advancing the end: no branch to mispredict
            store_pair(lists.event, left, event)
            left += wp.where(side == LEFT, 1, 0)
            store_pair(lists.event, right, event)
            right += wp.where(side == RIGHT, 1, 0)
    lefts = left - to_left
    rights = right - to_right
    return wp.vec4i(lefts, rights, count - lefts - rights, straddlers)


@wp.func
def add_straddlers(lists: EventLists, sides_first: int, straddlers: int, child: wp.ref[Frame]):
    """Clips the straddlers to a child's cell and merges the remaining parts into its lists."""
    kept = clip_straddlers(lists, sides_first, straddlers, lists.pad, child.low, child.high)
    child.triangles += kept
    axis = int(0)
    while axis < 3:  # a loop that Warp does not unroll; unrolling only lengthens compilation
        count = list_new_events(lists, sides_first, straddlers, kept, axis)
        new_first = sort_new_events(lists, 4 * sides_first, count)
        merge_new_events(lists, new_first, count, child.first[axis], child.count[axis])
        child.count[axis] += count
        axis += 1


@wp.func
def add_parts(lists: EventLists, sides_first: int, straddlers: int, left: wp.ref[Frame], right: wp.ref[Frame]):
    """Clips the straddlers to both children; the lists have room for all of their events."""
    add_straddlers(lists, sides_first, straddlers, left)
    add_straddlers(lists, sides_first, straddlers, right)


partition_clipping = partition_by(divide_axis, add_parts)
"""`event_lists.partition`, with clipping of the straddlers."""


@wp.func
def sort_ids(ids: wp.array(dtype=int), begin: int, count: int):
    """Sorts a range by heapsort, which needs no memory and is never slow."""
    start = count / 2
    end = int(count)
    while end > 1:
        if start > 0:
            start -= 1
        else:
            end -= 1
            greatest = ids[begin]
            ids[begin] = ids[begin + end]
            ids[begin + end] = greatest
        root = int(start)
        child = 2 * root + 1
        while child < end:
            if child + 1 < end and ids[begin + child] < ids[begin + child + 1]:
                child += 1
            if ids[begin + root] < ids[begin + child]:
                sinking = ids[begin + root]
                ids[begin + root] = ids[begin + child]
                ids[begin + child] = sinking
                root = child
                child = 2 * root + 1
            else:
                child = end


@wp.func
def emit_sorted_leaf(lists: EventLists, task: Task, frame: Frame, parts: Parts, begin: int):
    """`event_lists.emit_leaf`, by id."""
    emit_leaf(lists, task, frame, parts, begin)
    sort_ids(parts.primitive, begin, frame.triangles)


def lists_for(reservation: Reservation, triangles: TriangleBoxes, config: KdTreeConfig) -> EventLists:
    """The lists of all tasks, still empty and, if clipping is requested, the mesh and scratch memory."""
    device, count = triangles.boxes.low.device, reservation.triangles
    lists = EventLists()
    lists.event = wp.empty(reservation.entries, dtype=wp.vec2i, device=device)
    lists.triangle = wp.empty(count, dtype=int, device=device)
    lists.side = wp.empty(count, dtype=wp.uint8, device=device)
    if config.tests_nodes:
        give_mesh(lists, triangles, triangles.size, config.split_clipping)
        lists.number = wp.zeros(count, dtype=int, device=device)
        lists.straddler = wp.empty(16 * count, dtype=float, device=device)
        lists.new_events = wp.empty(4 * count, dtype=wp.vec2i, device=device)
    return lists


def arrays_of(lists: EventLists) -> list[wp.array]:
    """The arrays of the lists and their scratch memory."""
    reserved = (lists.event, lists.triangle, lists.side, lists.number, lists.straddler, lists.new_events)
    return [array for array in reserved if array is not None]
