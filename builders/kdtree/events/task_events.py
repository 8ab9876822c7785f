"""Events of a task, generated from its references and sorted in the memory in which the task uses them (`event_lists`).

Ends are written first, then planar events, then starts, each by triangle. A stable radix sort by position keeps that order
among equal positions. So the lists equal the corresponding part of the events of the whole mesh.
"""

import warp as wp

from wrt.builders.core.subtrees import Frame, Task
from wrt.builders.kdtree.events.event_lists import EventLists
from wrt.builders.kdtree.events.event_sort import END, PLANAR, START
from wrt.builders.triangle_references import write_order
from wrt.kernels.runtime.options import exact_module

exact_module(__name__)


@wp.func_native(
    f"""
    const float* __restrict__ from = references.data + (size_t)first * 8 + axis;
    auto* to = lists.event.data + begin;
    for (int kind = {int(END)}; kind <= {int(START)}; ++kind) {{
        for (int i = 0; i < count; ++i) {{
            const float low = from[(size_t)i * 8], high = -from[(size_t)i * 8 + 4] + 0.0f;
            const bool planar = !(low < high);
            if (planar == (kind == {int(PLANAR)})) {{
                const float position = kind == {int(END)} ? high : low;
                int bits;
                memcpy(&bits, &position, 4);
                to->c[0] = bits;
                to->c[1] = (i << 2) | kind;
                ++to;
            }}
        }}
    }}
    return (int)(to - (lists.event.data + begin));
"""
)
def write_events(references: wp.array(dtype=float), first: int, count: int, axis: int, lists: EventLists, begin: int) -> int:
    """Writes the events of a range of references along one axis, unsorted; returns their number."""
    ...


@wp.func_native(
    """
    auto* from = lists.event.data + begin;
    auto* to = from + count;
    for (int shift = 0; shift < 32; shift += 8) {
        int place[256];
        for (int digit = 0; digit < 256; ++digit) place[digit] = 0;
        // bits of floats in the order of their values: negative ones turned over, the others above them
        for (int i = 0; i < count; ++i) {
            const unsigned bits = (unsigned)from[i].c[0];
            ++place[((bits ^ ((bits >> 31) != 0 ? 0xffffffffu : 0x80000000u)) >> shift) & 255];
        }
        int before = 0;
        for (int digit = 0; digit < 256; ++digit) { const int here = place[digit]; place[digit] = before; before += here; }
        for (int i = 0; i < count; ++i) {
            const unsigned bits = (unsigned)from[i].c[0];
            to[place[((bits ^ ((bits >> 31) != 0 ? 0xffffffffu : 0x80000000u)) >> shift) & 255]++] = from[i];
        }
        auto* sorted = to; to = from; from = sorted;
    }
"""
)
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
