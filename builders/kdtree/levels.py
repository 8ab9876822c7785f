"""The top of the in-place build: all live nodes of a level at once (Choi et al. 2010; survey, Algorithm 4.2.2).

Data does not move: events stay in the order in which they were sorted once, and triangles know the nodes they lie in
(`Membership`). A level takes four phases, each parallel over chunks of events or triangles from the root on:

    search      FindBestPlane: every chunk counts, per live node, the triangles that begin and end in it; a scan over the
                chunks gives each chunk the counts to its left; every chunk then evaluates its planes; the best of all
                chunks is the node's split
    stop, emit  NewGen: a node with a split gets two children, the others are finished
    classify    ClassifyTriangles: every triangle exchanges its nodes for their children (count, scan, fill)

Chunks begin where the position changes, so that planes are never shared; the winner among chunks is taken in the order
of the axes and positions. So neither threads nor chunks show in the result.
"""

import warp as wp
from wrt.builders.common import StopLimits, bad_splits_after
from wrt.builders.cost import Split, SplitCost, axis_frame, better_split, no_split
from wrt.builders.kdtree.events import END, PLANAR, START, Boxes, Events

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

EVENT_CHUNK = 8192


@wp.struct
class LiveNode:
    """A node of the current level."""

    low: wp.vec3
    high: wp.vec3
    triangles: int
    bad_splits: int
    depth: int
    finished: bool
    """True once the node is known to be a leaf; it then waits for the end of the levels."""
    left: int
    """Live index of its left child on the next level (the right one follows); of itself if it is finished."""
    split: Split


@wp.struct
class Membership:
    """Which live nodes each triangle lies in."""

    first: wp.array(dtype=int)
    """(triangles + 1,) where a triangle's nodes begin in `node`."""
    node: wp.array(dtype=int)
    """Live node indices, ascending within a triangle."""


@wp.struct
class Progress:
    """Where a sweep stands in one node."""

    left: int
    """Triangles that begin before `position`."""
    right: int
    """Triangles that end after `position`."""
    planar: int
    """Triangles that lie in the plane at `position`."""
    started: int
    """Triangles that start at `position`."""
    position: float
    best: Split


@wp.func
def advance(cost: SplitCost, low: wp.vec3, high: wp.vec3, axis: int, progress: Progress):
    """Evaluates the plane at the current position, whose events have all been seen, and passes it."""
    progress.best = better_split(
        cost,
        axis_frame(axis, low, high),
        progress.position,
        progress.left,
        progress.planar,
        progress.right,
        progress.best,
    )
    progress.left += progress.started + progress.planar
    progress.started = 0
    progress.planar = 0
    return progress


@wp.func
def chunk_begin(events: Events, axis: int, chunk: int):
    """First event of a chunk: its nominal one, or the next at which the position changes."""
    begin = wp.min(chunk * EVENT_CHUNK, events.count[axis])
    while begin > 0 and begin < events.count[axis] and events.position[axis, begin] == events.position[axis, begin - 1]:
        begin += 1
    return begin


@wp.kernel
def count_events(
    first: int,
    events: Events,
    membership: Membership,
    nodes: wp.array(dtype=LiveNode),
    counts: wp.array3d(dtype=wp.vec2i),
):
    """Item: axis * chunks + chunk. counts: (3, chunks, nodes), (triangles that begin, triangles that end) in the chunk."""
    item = first + wp.tid()
    axis = item / counts.shape[1]
    chunk = item % counts.shape[1]
    for node in range(counts.shape[2]):
        counts[axis, chunk, node] = wp.vec2i(0, 0)
    for i in range(chunk_begin(events, axis, chunk), chunk_begin(events, axis, chunk + 1)):
        value = events.value[axis, i]
        kind = value & 3
        change = wp.vec2i(wp.where(kind == END, 0, 1), wp.where(kind == START, 0, 1))
        triangle = value >> 2
        for m in range(membership.first[triangle], membership.first[triangle + 1]):
            counts[axis, chunk, membership.node[m]] += change


@wp.kernel
def scan_chunks(first: int, counts: wp.array3d(dtype=wp.vec2i)):
    """Item: axis * nodes + node. Turns the counts of chunks into the counts before them."""
    item = first + wp.tid()
    axis = item / counts.shape[2]
    node = item % counts.shape[2]
    total = wp.vec2i(0, 0)
    for chunk in range(counts.shape[1]):
        here = counts[axis, chunk, node]
        counts[axis, chunk, node] = total
        total += here


@wp.kernel
def search_planes(
    first: int,
    cost: SplitCost,
    events: Events,
    membership: Membership,
    nodes: wp.array(dtype=LiveNode),
    before: wp.array3d(dtype=wp.vec2i),
    progress: wp.array3d(dtype=Progress),
):
    """Item: axis * chunks + chunk. progress: (3, chunks, nodes), left with each node's best plane in the chunk."""
    item = first + wp.tid()
    axis = item / before.shape[1]
    chunk = item % before.shape[1]
    for node in range(before.shape[2]):
        state = Progress()
        state.left = before[axis, chunk, node][0]
        state.right = nodes[node].triangles - before[axis, chunk, node][1]
        state.position = nodes[node].low[axis]
        state.best = no_split()
        progress[axis, chunk, node] = state
    for i in range(chunk_begin(events, axis, chunk), chunk_begin(events, axis, chunk + 1)):
        position = events.position[axis, i]
        value = events.value[axis, i]
        kind = value & 3
        triangle = value >> 2
        for m in range(membership.first[triangle], membership.first[triangle + 1]):
            node = membership.node[m]
            state = progress[axis, chunk, node]
            if position != state.position:
                state = advance(cost, nodes[node].low, nodes[node].high, axis, state)
                state.position = position
            if kind != START:
                state.right -= 1
            if kind == PLANAR:
                state.planar += 1
            if kind == START:
                state.started += 1
            progress[axis, chunk, node] = state
    for node in range(before.shape[2]):
        progress[axis, chunk, node] = advance(cost, nodes[node].low, nodes[node].high, axis, progress[axis, chunk, node])


@wp.kernel
def decide(
    first: int,
    cost: SplitCost,
    limits: StopLimits,
    progress: wp.array3d(dtype=Progress),
    nodes: wp.array(dtype=LiveNode),
):
    """Item: a live node. Takes the best plane of all axes and chunks, in this order, and stops or splits."""
    index = first + wp.tid()
    node = nodes[index]
    if not node.finished:
        best = no_split()
        for axis in range(3):
            for chunk in range(progress.shape[1]):
                candidate = progress[axis, chunk, index].best
                if candidate.cost < best.cost:
                    best = candidate
        bad = bad_splits_after(limits, cost, node.depth, node.triangles, node.bad_splits, best)
        node.split = best
        node.finished = bad < 0
        node.bad_splits = wp.max(bad, 0)
        nodes[index] = node


@wp.kernel
def new_generation(first: int, nodes: wp.array(dtype=LiveNode), children: wp.array(dtype=LiveNode), count: wp.array(dtype=int)):
    """One item. Lists the next level's nodes in order; count: (2,), its nodes and those of them that are not finished."""
    total = int(0)
    open_nodes = int(0)
    for index in range(nodes.shape[0]):
        node = nodes[index]
        node.left = total
        nodes[index] = node
        if node.finished:
            children[total] = node
            total += 1
        else:
            left = node
            right = node
            left.depth += 1
            right.depth += 1
            left.high[node.split.axis] = node.split.position
            right.low[node.split.axis] = node.split.position
            left.triangles = node.split.left
            right.triangles = node.split.right
            children[total] = left
            children[total + 1] = right
            total += 2
            open_nodes += 2
    count[0] = total
    count[1] = open_nodes


@wp.func
def sides(node: LiveNode, low: float, high: float):
    """Children that a box belongs to, by its interval on the split axis: 1 left, 2 right, 3 both."""
    if low == high and low == node.split.position:
        return wp.where(node.split.planar_left, 1, 2)
    if high <= node.split.position:
        return 1
    if low >= node.split.position:
        return 2
    return 3


@wp.kernel
def count_members(
    first: int, boxes: Boxes, nodes: wp.array(dtype=LiveNode), membership: Membership, counts: wp.array(dtype=int)
):
    """Item: a triangle. Number of nodes that it lies in on the next level."""
    triangle = first + wp.tid()
    count = int(0)
    for m in range(membership.first[triangle], membership.first[triangle + 1]):
        node = nodes[membership.node[m]]
        count += 1
        if not node.finished:
            axis = node.split.axis
            if sides(node, boxes.low[axis, triangle], boxes.high[axis, triangle]) == 3:
                count += 1
    counts[triangle] = count


@wp.kernel
def fill_members(first: int, boxes: Boxes, nodes: wp.array(dtype=LiveNode), membership: Membership, refined: Membership):
    """Item: a triangle. Writes its nodes on the next level."""
    triangle = first + wp.tid()
    to = refined.first[triangle]
    for m in range(membership.first[triangle], membership.first[triangle + 1]):
        node = nodes[membership.node[m]]
        side = int(1)
        if not node.finished:
            axis = node.split.axis
            side = sides(node, boxes.low[axis, triangle], boxes.high[axis, triangle])
        if (side & 1) != 0:
            refined.node[to] = node.left
            to += 1
        if (side & 2) != 0:
            refined.node[to] = node.left + 1
            to += 1
