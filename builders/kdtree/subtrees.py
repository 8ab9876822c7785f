"""The lower part of the in-place build: one task builds one subtree, depth first, on its own copy of the events.

Once a level has enough live nodes to keep every core busy, each becomes a task. Fill copies a node's triangles and events
to the task's arena (count, scan, fill, so still in sorted order). From there the lists of a node are split between its
children in one pass each, as in Wald and Havran's O(N log N) build; boxes are not clipped to nodes, so nothing has to be
merged or sorted again. The larger child's lists are compacted in place, the smaller one's are appended to the arena, so a task
needs little more than twice the room of its own lists. The right child waits on a stack: nodes come out in depth-first order.

Phases of a node: search, stop, classify, partition, emit. A task that runs out of its share of an arena says so and stops;
the build is then repeated with larger shares (`InPlaceBuilder`).

References:
    B. Choi et al.: Parallel SAH k-D tree construction. High Performance Graphics 2010.
    I. Wald, V. Havran: On building fast kd-trees for ray tracing, and on doing that in O(N log N).
        IEEE Symposium on Interactive Ray Tracing 2006.
"""

import warp as wp

from wrt.builders.common import StopLimits, bad_splits_after
from wrt.builders.cost import Split, SplitCost, axis_frame, no_split
from wrt.builders.kdtree.events import CHUNK, END, START, Events, event_position, event_value
from wrt.builders.kdtree.levels import EVENT_CHUNK, LiveNode, Membership
from wrt.builders.kdtree.planes import close_planar, start_sweep, sweep_event
from wrt.kernels import kdtree
from wrt.kernels.memory import load_byte, load_int, load_pair, store_byte, store_pair

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

STACK = kdtree.MAX_TREE_DEPTH + 1


@wp.struct
class Task:
    """A subtree to build and its share of the arenas."""

    events_first: int
    events_capacity: int
    triangles_first: int
    nodes_first: int
    nodes_capacity: int
    blocks_first: int
    blocks_capacity: int


@wp.struct
class Result:
    """What a task made."""

    nodes: int
    blocks: int
    overflow: bool


@wp.struct
class Arena:
    """Memory of all tasks, each using its own share."""

    event: wp.array(dtype=wp.vec2i)
    """Events: bits of the position, and index of the triangle within the task << 2 | type."""
    triangle: wp.array(dtype=int)
    """Ids of a task's triangles, ascending."""
    side: wp.array(dtype=wp.uint8)
    """Scratch of the classify phase, one per triangle of a task: 1 left, 2 right, 3 both."""
    nodes: wp.array(dtype=wp.vec2i)
    """Nodes; child and block indices count from the task's first."""
    primitive: wp.array(dtype=int)
    """Leaf lists, padded to whole blocks with -1."""


@wp.struct
class Frame:
    """A node that is being built or waits for its left sibling."""

    low: wp.vec3
    high: wp.vec3
    first: wp.vec3i
    """Where its events begin in the arena, per axis."""
    count: wp.vec3i
    """Number of its events, per axis."""
    top: int
    """Where the arena is free while the node is built."""
    triangles: int
    bad_splits: int
    depth: int
    parent: int
    """Index of the node whose right child it is; -1 for the root."""


@wp.kernel
def count_task_triangles(first: int, triangles: int, membership: Membership, counts: wp.array2d(dtype=int)):
    """Item: a chunk of triangles. counts: (chunks, tasks)."""
    chunk = first + wp.tid()
    row = counts[chunk]
    for task in range(counts.shape[1]):
        row[task] = 0
    begin = chunk * CHUNK
    end = wp.min(triangles, begin + CHUNK)
    for m in range(membership.first[begin], membership.first[end]):
        row[load_int(membership.node, m)] += 1


@wp.kernel
def scan_task_triangles(first: int, tasks: wp.array(dtype=Task), counts: wp.array2d(dtype=int)):
    """Item: a task. Turns counts of chunks into places in `Arena.triangle`."""
    task = first + wp.tid()
    place = tasks[task].triangles_first
    for chunk in range(counts.shape[0]):
        count = counts[chunk, task]
        counts[chunk, task] = place
        place += count


@wp.kernel
def fill_task_triangles(
    first: int,
    triangles: int,
    membership: Membership,
    tasks: wp.array(dtype=Task),
    places: wp.array2d(dtype=int),
    local: wp.array(dtype=int),
    arena: Arena,
):
    """Item: a chunk of triangles. local: per membership, the triangle's index within the task."""
    chunk = first + wp.tid()
    row = places[chunk]
    for triangle in range(chunk * CHUNK, wp.min(triangles, (chunk + 1) * CHUNK)):
        for m in range(load_int(membership.first, triangle), load_int(membership.first, triangle + 1)):
            task = load_int(membership.node, m)
            place = row[task]
            row[task] = place + 1
            arena.triangle[place] = triangle
            local[m] = place - tasks[task].triangles_first


@wp.kernel
def count_task_events(first: int, events: Events, membership: Membership, counts: wp.array3d(dtype=int)):
    """Item: axis * chunks + chunk. counts: (3, chunks, tasks)."""
    item = first + wp.tid()
    axis = item / counts.shape[1]
    chunk = item % counts.shape[1]
    row = counts[axis, chunk]
    for task in range(counts.shape[2]):
        row[task] = 0
    for i in range(chunk * EVENT_CHUNK, wp.min(events.count[axis], (chunk + 1) * EVENT_CHUNK)):
        triangle = event_value(events, axis, i) >> 2
        for m in range(load_int(membership.first, triangle), load_int(membership.first, triangle + 1)):
            row[load_int(membership.node, m)] += 1


@wp.kernel
def scan_task_events(first: int, tasks: wp.array(dtype=Task), counts: wp.array3d(dtype=int), totals: wp.array(dtype=wp.vec3i)):
    """Item: a task. Turns counts of chunks into places in the arena; the axes follow one another."""
    task = first + wp.tid()
    place = tasks[task].events_first
    for axis in range(3):
        begin = place
        for chunk in range(counts.shape[1]):
            count = counts[axis, chunk, task]
            counts[axis, chunk, task] = place
            place += count
        totals[task][axis] = place - begin


@wp.kernel
def fill_task_events(
    first: int,
    events: Events,
    membership: Membership,
    local: wp.array(dtype=int),
    places: wp.array3d(dtype=int),
    arena: Arena,
):
    """Item: axis * chunks + chunk. Copies events to the tasks of their triangles."""
    item = first + wp.tid()
    axis = item / places.shape[1]
    chunk = item % places.shape[1]
    row = places[axis, chunk]
    for i in range(chunk * EVENT_CHUNK, wp.min(events.count[axis], (chunk + 1) * EVENT_CHUNK)):
        position = event_position(events, axis, i)
        value = event_value(events, axis, i)
        triangle = value >> 2
        for m in range(load_int(membership.first, triangle), load_int(membership.first, triangle + 1)):
            task = load_int(membership.node, m)
            place = row[task]
            row[task] = place + 1
            store_pair(arena.event, place, wp.vec2i(wp.cast(position, wp.int32), (load_int(local, m) << 2) | (value & 3)))


@wp.func
def search(cost: SplitCost, arena: Arena, frame: Frame):
    """The best plane of a node: one sweep per axis."""
    best = no_split()
    for axis in range(3):
        along = axis_frame(axis, frame.low, frame.high)
        sweep = start_sweep(0, frame.triangles)
        sweep.best = best
        for i in range(frame.first[axis], frame.first[axis] + frame.count[axis]):
            event = load_pair(arena.event, i)
            sweep_event(cost, along, event[1] & 3, wp.cast(event[0], wp.float32), sweep)
        close_planar(cost, along, sweep)
        best = sweep.best
    return best


@wp.func
def classify(arena: Arena, sides_first: int, frame: Frame, split: Split):
    """Marks the children of every triangle of the node, from its events along the split axis."""
    position = split.position
    begin = frame.first[split.axis]
    for i in range(begin, begin + frame.count[split.axis]):
        event = load_pair(arena.event, i)
        at = wp.cast(event[0], wp.float32)
        kind = event[1] & 3
        side = sides_first + (event[1] >> 2)
        if kind == START:
            store_byte(arena.side, side, wp.where(at >= position, wp.uint8(2), wp.uint8(3)))
        elif kind == END:
            if at <= position:
                store_byte(arena.side, side, wp.uint8(1))
        else:
            in_left = at < position or (at == position and split.planar_left)
            store_byte(arena.side, side, wp.where(in_left, wp.uint8(1), wp.uint8(2)))


@wp.func
def partition(arena: Arena, sides_first: int, begin: int, count: int, to_left: int, to_right: int):
    """Splits one axis' events [begin, begin + count) between the children. Returns their counts.

    One of `to_left` and `to_right` is `begin`: that child's events are compacted in place."""
    left = int(to_left)
    right = int(to_right)
    for i in range(begin, begin + count):
        event = load_pair(arena.event, i)
        side = int(load_byte(arena.side, sides_first + (event[1] >> 2)))
        # written whether wanted or not, kept by moving the end: no branch to mispredict
        store_pair(arena.event, left, event)
        left += side & 1
        store_pair(arena.event, right, event)
        right += side >> 1
    return wp.vec2i(left - to_left, right - to_right)


@wp.func
def divide(arena: Arena, task: Task, frame: Frame, split: Split, left: wp.ref[Frame], right: wp.ref[Frame]):
    """Classify and partition: turns two copies of a node into its children, boxes and lists."""
    classify(arena, task.triangles_first, frame, split)
    append_left = split.left < split.right
    to = int(frame.top)
    for axis in range(3):
        if append_left:
            left.first[axis] = to
        else:
            right.first[axis] = to
        count = partition(
            arena, task.triangles_first, frame.first[axis], frame.count[axis], left.first[axis], right.first[axis]
        )
        left.count[axis] = count[0]
        right.count[axis] = count[1]
        to += wp.where(append_left, count[0], count[1])
    # behind `top` nothing waits; in front of it the right child does, or a right child further up
    left.top = to
    right.top = wp.where(append_left, frame.top, to)
    left.high[split.axis] = split.position
    right.low[split.axis] = split.position
    left.triangles = split.left
    right.triangles = split.right
    left.depth += 1
    right.depth += 1


@wp.func
def emit_leaf(arena: Arena, task: Task, frame: Frame, width: int, blocks: int):
    """Lists the node's triangles, by the position at which they begin in x; returns the number of blocks used."""
    begin = (task.blocks_first + blocks) * width
    to = int(begin)
    for i in range(frame.first[0], frame.first[0] + frame.count[0]):
        value = load_pair(arena.event, i)[1]
        if (value & 3) != END:
            arena.primitive[to] = arena.triangle[task.triangles_first + (value >> 2)]
            to += 1
    while (to - begin) % width != 0:
        arena.primitive[to] = -1
        to += 1
    return (to - begin) / width


@wp.kernel
def build_subtrees(
    first: int,
    cost: SplitCost,
    limits: StopLimits,
    live: wp.array(dtype=LiveNode),
    tasks: wp.array(dtype=Task),
    event_counts: wp.array(dtype=wp.vec3i),
    arena: Arena,
    stack: wp.array2d(dtype=Frame),
    results: wp.array(dtype=Result),
):
    """Item: a task. stack: (tasks, STACK)."""
    number = first + wp.tid()
    task = tasks[number]
    root = live[number]
    width = 1 << cost.width_bits
    frame = Frame()
    frame.low = root.low
    frame.high = root.high
    frame.count = event_counts[number]
    frame.first = wp.vec3i(
        task.events_first, task.events_first + frame.count[0], task.events_first + frame.count[0] + frame.count[1]
    )
    frame.top = frame.first[2] + frame.count[2]
    frame.triangles = root.triangles
    frame.bad_splits = root.bad_splits
    frame.depth = root.depth
    frame.parent = -1
    result = Result()
    waiting = int(0)
    building = bool(True)
    while building:
        events = frame.count[0] + frame.count[1] + frame.count[2]
        leaf_blocks = (frame.triangles + width - 1) / width
        if (
            frame.top + events > task.events_first + task.events_capacity
            or result.nodes >= task.nodes_capacity
            or result.blocks + leaf_blocks > task.blocks_capacity
        ):
            result.overflow = True
            break
        split = no_split()
        if not (root.finished or frame.depth >= limits.depth):
            split = search(cost, arena, frame)
        bad = bad_splits_after(limits, cost, frame.depth, frame.triangles, frame.bad_splits, split)
        index = result.nodes
        result.nodes += 1
        if frame.parent >= 0:
            parent = arena.nodes[task.nodes_first + frame.parent]
            arena.nodes[task.nodes_first + frame.parent] = kdtree.inner_node(
                kdtree.split_axis(parent), kdtree.split_position(parent), index
            )
        if bad < 0:
            arena.nodes[task.nodes_first + index] = kdtree.leaf_node(result.blocks, frame.triangles)
            result.blocks += emit_leaf(arena, task, frame, width, result.blocks)
            waiting -= 1
            building = waiting >= 0
            if building:
                frame = stack[number, waiting]
        else:
            arena.nodes[task.nodes_first + index] = kdtree.inner_node(split.axis, split.position, 0)
            left = frame
            right = frame
            divide(arena, task, frame, split, left, right)
            left.bad_splits = bad
            right.bad_splits = bad
            left.parent = -1
            right.parent = index
            stack[number, waiting] = right
            waiting += 1
            frame = left
    results[number] = result
