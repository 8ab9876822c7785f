"""Events of a task, generated from its references and sorted in the memory in which the task uses them (`event_lists`).

Ends are written first, then planar events, then starts, each by triangle. A stable radix sort by position keeps that order
among equal positions. So the lists equal the corresponding part of the events of the whole mesh.
"""

import warp as wp

from wrt.builders.core.subtrees import Frame, Task
from wrt.builders.kdtree.events.event_lists import EventLists
from wrt.builders.kdtree.events.event_sort import SAME_KINDS
from wrt.builders.triangle_references import write_order
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module

exact_module(__name__)


@native.func_native(
    "events.h",
    f"{SAME_KINDS}return wrt::write_events(references.data + (size_t)first * 8, count, axis, lists.event.data + begin);",
)
def write_events(references: wp.array(dtype=float), first: int, count: int, axis: int, lists: EventLists, begin: int) -> int:
    """Writes the events of a range of references along one axis, unsorted; returns their number."""
    ...


@native.func_native("events.h", "wrt::sort_pairs(lists.event.data + begin, count);")
def sort_events(lists: EventLists, begin: int, count: int):
    """Sorts a range of events by position, stably. An equal amount of memory behind it is scratch."""
    ...


@wp.kernel
def list_task_events(
    first: int,
    references: wp.array(dtype=float),
    source: wp.array(dtype=int),
    tasks: wp.array(dtype=Task),
    frames: wp.array(dtype=Frame),
    lists: EventLists,
):
    """Item: a task. Lists its triangles and their events. Its range must have room for a third more than these."""
    number = first + wp.tid()
    task = tasks[number]
    frame = frames[number]
    write_order(references, source[number], frame.triangles, lists.triangle, task.triangles_first)
    frame.top = task.lists_first
    for axis in range(3):
        count = write_events(references, source[number], frame.triangles, axis, lists, frame.top)
        sort_events(lists, frame.top, count)
        frame.first[axis] = frame.top
        frame.count[axis] = count
        frame.top += count
    frames[number] = frame
