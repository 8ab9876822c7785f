"""The kernels of a level of the nested build: what each chunk of a node's events and triangles does (`nested`).

Chunks of events end where the position changes, so no plane is shared between them. The best plane is taken in the order of
axes and chunks. So the result does not depend on chunks or threads, and a node gets the same split as in a task.

References: choi-2010.
"""

import warp as wp

from wrt.builders.core.levels import Chunk, LiveNode, decided, side_of
from wrt.builders.core.subtrees import Task
from wrt.builders.cost import Split, SplitCost, axis_frame, no_split
from wrt.builders.kdtree.events.event_lists import EventLists, sweep_range
from wrt.builders.kdtree.events.event_sort import END, START, Events, event_position, event_value
from wrt.builders.kdtree.events.sweep_planes import start_sweep
from wrt.builders.tree import StopLimits
from wrt.builders.triangle_boxes import Boxes
from wrt.kernels.layout.unchecked import load_byte, load_int, load_pair, store_byte, store_int, store_pair
from wrt.kernels.runtime.options import exact_kernel

COPIED = 8192
"""Events or triangles of the root that are copied as one chunk."""


@wp.struct
class ChunkSweep:
    """The search in a chunk of events."""

    begins: int
    """Triangles that begin in it; after the scan, before it."""
    ends: int
    any_planar: bool
    best: Split
    """Its best plane."""


@wp.struct
class LevelLists:
    """The lists of a level."""

    event: wp.array(dtype=wp.vec2i)
    """As in `EventLists`, with the index of the triangle within its node."""
    triangle: wp.array(dtype=int)
    """Triangle ids, node after node."""
    side: wp.array(dtype=wp.uint8)
    """Of each of these triangles, where its events go: 1 left, 2 right, 3 both; plus 4 times where the triangle goes. They
    differ if the triangle is clipped, because its parts have events of their own (`nested`)."""
    right: wp.array(dtype=int)
    """Of each of these triangles, its id on the right; `triangle`, unless triangles are clipped."""
    child: wp.array(dtype=wp.vec2i)
    """Of each of these triangles: its index within the left child and within the right one, if it is there."""


@exact_kernel
def copy_events(first: int, events: Events, axis_first: wp.vec3i, lists: LevelLists):
    """Item: axis * chunks + chunk. Writes the lists of the root; a triangle's index there is its id."""
    item = first + wp.tid()
    axis = item % 3
    begin = item / 3 * COPIED
    for i in range(begin, wp.min(begin + COPIED, events.count[axis])):
        event = wp.vec2i(wp.cast(event_position(events, axis, i), wp.int32), event_value(events, axis, i))
        store_pair(lists.event, axis_first[axis] + i, event)


@exact_kernel
def list_ids(first: int, triangle: wp.array(dtype=int)):
    """Item: a triangle."""
    triangle[first + wp.tid()] = first + wp.tid()


@wp.func
def change_of_position(lists: LevelLists, begin: int, nominal: int, end: int):
    """The first event of the list [begin, end) from `nominal` on whose position is not that of the event before it."""
    low = int(nominal)
    if low > begin and low < end:
        position = wp.cast(load_pair(lists.event, low - 1)[0], wp.float32)
        high = int(end)
        while low < high:
            middle = (low + high) / 2
            if wp.cast(load_pair(lists.event, middle)[0], wp.float32) > position:
                high = middle
            else:
                low = middle + 1
    return low


@exact_kernel
def count_chunks(
    first: int,
    lists: LevelLists,
    nodes: wp.array(dtype=LiveNode),
    chunks: wp.array(dtype=Chunk),
    sweeps: wp.array(dtype=ChunkSweep),
):
    """Item: a chunk of events. Moves its ends to changes of the position, and counts what begins and ends between them."""
    index = first + wp.tid()
    chunk = chunks[index]
    node = nodes[chunk.node]
    list_first = node.frame.first[chunk.axis]
    list_end = list_first + node.frame.count[chunk.axis]
    chunk.begin = change_of_position(lists, list_first, chunk.begin, list_end)
    chunk.end = change_of_position(lists, list_first, chunk.end, list_end)
    begins = int(0)
    ends = int(0)
    for i in range(chunk.begin, chunk.end):
        kind = load_pair(lists.event, i)[1] & 3
        begins += wp.where(kind == END, 0, 1)
        ends += wp.where(kind == START, 0, 1)
    chunks[index] = chunk
    sweep = ChunkSweep()
    sweep.begins = begins
    sweep.ends = ends
    sweep.any_planar = begins + ends > chunk.end - chunk.begin
    sweeps[index] = sweep


@exact_kernel
def scan_chunks(first: int, nodes: wp.array(dtype=LiveNode), sweeps: wp.array(dtype=ChunkSweep)):
    """Item: 3 * node + axis. Turns counts of chunks into the counts before them."""
    item = first + wp.tid()
    node = nodes[item / 3]
    begins = int(0)
    ends = int(0)
    for index in range(node.chunk_first[item % 3], node.chunk_first[item % 3] + node.chunk_count[item % 3]):
        sweep = sweeps[index]
        here = wp.vec2i(sweep.begins, sweep.ends)
        sweep.begins = begins
        sweep.ends = ends
        sweeps[index] = sweep
        begins += here[0]
        ends += here[1]


@exact_kernel
def search_chunks(
    first: int,
    cost: SplitCost,
    lists: LevelLists,
    nodes: wp.array(dtype=LiveNode),
    chunks: wp.array(dtype=Chunk),
    sweeps: wp.array(dtype=ChunkSweep),
):
    """Item: a chunk of events. Finds its best plane."""
    index = first + wp.tid()
    chunk = chunks[index]
    sweep = sweeps[index]
    node = nodes[chunk.node]
    sweep.best = no_split()
    if not node.finished and chunk.begin < chunk.end:
        frame = node.frame
        along = axis_frame(cost, chunk.axis, frame.low, frame.high, frame.triangles)
        found = start_sweep(sweep.begins, frame.triangles - sweep.ends)
        sweep_range(cost, along, lists.event, chunk.begin, chunk.end, sweep.any_planar, found)
        sweep.best = found.best
    sweeps[index] = sweep


@exact_kernel
def decide(
    first: int, cost: SplitCost, limits: StopLimits, nodes: wp.array(dtype=LiveNode), sweeps: wp.array(dtype=ChunkSweep)
):
    """Item: a node. Takes the best plane of all axes and chunks, in this order, and stops or splits."""
    index = first + wp.tid()
    node = nodes[index]
    if not node.finished:
        best = no_split()
        for c in range(node.chunk_first[0], node.chunk_first[2] + node.chunk_count[2]):
            if sweeps[c].best.cost < best.cost:
                best = sweeps[c].best
        nodes[index] = decided(cost, limits, node, best)


@exact_kernel
def classify_triangles(
    first: int, boxes: Boxes, lists: LevelLists, nodes: wp.array(dtype=LiveNode), chunks: wp.array(dtype=Chunk)
):
    """Item: a chunk of triangles. Finds and counts their sides. Those of a finished node are all on the left."""
    index = first + wp.tid()
    chunk = chunks[index]
    node = nodes[chunk.node]
    split = node.split
    left = int(0)
    right = int(0)
    for i in range(chunk.begin, chunk.end):
        side = int(1)
        if not node.finished:
            triangle = load_int(lists.triangle, i)
            side = side_of(split, boxes.low[split.axis, triangle], boxes.high[split.axis, triangle])
        store_byte(lists.side, i, wp.uint8(5 * side))
        left += side & 1
        right += side >> 1
    chunk.left = left
    chunk.right = right
    chunks[index] = chunk


@exact_kernel
def count_sides(first: int, lists: LevelLists, nodes: wp.array(dtype=LiveNode), chunks: wp.array(dtype=Chunk)):
    """Item: a chunk of events. Counts them on both sides."""
    index = first + wp.tid()
    chunk = chunks[index]
    triangles_first = nodes[chunk.node].triangles_first
    left = int(0)
    right = int(0)
    for i in range(chunk.begin, chunk.end):
        side = int(load_byte(lists.side, triangles_first + (load_pair(lists.event, i)[1] >> 2)))
        left += side & 1
        right += (side >> 1) & 1
    chunk.left = left
    chunk.right = right
    chunks[index] = chunk


@exact_kernel
def move_triangles(
    first: int,
    lists: LevelLists,
    nodes: wp.array(dtype=LiveNode),
    children: wp.array(dtype=LiveNode),
    chunks: wp.array(dtype=Chunk),
    target: LevelLists,
):
    """Item: a chunk of triangles. Lists them in the children, and notes their indices there."""
    chunk = chunks[first + wp.tid()]
    node = nodes[chunk.node]
    left = chunk.to_left
    right = chunk.to_right
    left_first = children[node.left].triangles_first
    right_first = int(0)
    if not node.finished:
        right_first = children[node.left + 1].triangles_first
    for i in range(chunk.begin, chunk.end):
        side = int(load_byte(lists.side, i)) >> 2
        store_pair(lists.child, i, wp.vec2i(left - left_first, right - right_first))
        if (side & 1) != 0:
            store_int(target.triangle, left, load_int(lists.triangle, i))
            left += 1
        if (side & 2) != 0:
            store_int(target.triangle, right, load_int(lists.right, i))
            right += 1


@exact_kernel
def move_events(
    first: int, lists: LevelLists, nodes: wp.array(dtype=LiveNode), chunks: wp.array(dtype=Chunk), target: LevelLists
):
    """Item: a chunk of events. Moves them to the children's lists, in order."""
    chunk = chunks[first + wp.tid()]
    triangles_first = nodes[chunk.node].triangles_first
    left = chunk.to_left
    right = chunk.to_right
    for i in range(chunk.begin, chunk.end):
        event = load_pair(lists.event, i)
        place = triangles_first + (event[1] >> 2)
        side = int(load_byte(lists.side, place))
        child = load_pair(lists.child, place)
        kind = event[1] & 3
        if (side & 1) != 0:
            store_pair(target.event, left, wp.vec2i(event[0], (child[0] << 2) | kind))
            left += 1
        if (side & 2) != 0:
            store_pair(target.event, right, wp.vec2i(event[0], (child[1] << 2) | kind))
            right += 1


@exact_kernel
def copy_tasks(first: int, source: LevelLists, nodes: wp.array(dtype=LiveNode), tasks: wp.array(dtype=Task), lists: EventLists):
    """Item: a task. Copies its node's lists."""
    number = first + wp.tid()
    node = nodes[number]
    task = tasks[number]
    count = node.frame.count
    for i in range(count[0] + count[1] + count[2]):
        store_pair(lists.event, task.lists_first + i, load_pair(source.event, node.frame.first[0] + i))
    for i in range(node.frame.triangles):
        store_int(lists.triangle, task.triangles_first + i, load_int(source.triangle, node.triangles_first + i))
