"""The nodes of a level: their best planes, and their children.

**Search.** Each event is a plane of its node. Triangles begun and ended before it are known, so its cost is, by the same
arithmetic as everywhere (`wrt.builders.cost`). A node's best plane is the least of 64-bit keys: bits of the cost, axis, place
among the node's events. So ties go to the smaller axis, then to the smaller position, then to planar triangles on the right,
whatever thread comes first. Of the ends at one position only the last counts, and of the planar ones only the last with all of
them on the left: it has the least triangles on the right, so it costs no more than those before it
(`wrt.builders.kdtree.events.sweep_planes`).

**Children.** Four sums over the nodes of a level, by one scan, number the children and find where their events and the
triangles of leaves are written.

References: choi-2010.
"""

import warp as wp

from wrt.builders.cost import AxisFrame, Split, SplitCost, axis_frame, no_split, plane_cost
from wrt.builders.kdtree.levelwise.grid_sums import SUMS, Tiles, keep_least, keep_less, sums_before
from wrt.builders.kdtree.levelwise.paired_events import PLANAR_END, Event, event_at
from wrt.builders.tree import PathState, StopLimits, stop
from wrt.kernels.layout import kdtree_nodes as kdtree
from wrt.kernels.layout.struct_arrays import with_known_layout
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.simd.boxes import INFINITY

NO_PLANE = wp.constant(wp.int64(0x7F800000 << 32))
"""Key that is above that of each plane: the bits of an infinite cost."""

SEARCHED_EACH = wp.constant(8)
"""Consecutive events of a thread that searches."""

LOW_BITS = wp.constant(wp.int64(0xFFFFFFFF))

AXIS_SHIFT, PLACE_BITS = wp.constant(wp.int64(30)), wp.constant(wp.int64((1 << 30) - 2))
"""Where the axis and the place among the node's events on that axis are in the lower word of a key; its last bit is whether
planar triangles go to the left."""

INNER, LEFT, RIGHT, LISTED = wp.constant(0), wp.constant(1), wp.constant(2), wp.constant(3)
"""What is summed over the nodes of a level: those with children; triangles of left and of right children; those of leaves."""


@with_known_layout
@wp.struct
class CellNode:
    """A node of a level."""

    low: wp.vec3
    high: wp.vec3
    triangles: int
    before: int
    """Triangles of the nodes before it on its level."""
    path: PathState
    split: Split
    is_leaf: bool
    left_before: int
    """Triangles of left children of the nodes before it."""
    right_before: int
    child: int
    """Its left child's place on the next level, which the right one follows; of a leaf, where its triangles are listed."""


@wp.func
def plane_key(cost: float, axis: int, place: int, planar_left: bool):
    """A plane as a number: the least one is the best plane."""
    low = wp.int64(axis) << AXIS_SHIFT
    low = low | wp.int64((place << 1) | wp.where(planar_left, 1, 0))
    return (wp.int64(wp.cast(cost, wp.int32)) << wp.int64(32)) | low


@wp.func
def first_event(node: CellNode, axis: int, total: int):
    """Place of the node's first event on the axis; total: triangles of all nodes of the level."""
    return 2 * (axis * total + node.before)


@wp.func
def no_key():
    """A key that may become less: Warp takes a constant for one value with all others of its name."""
    return NO_PLANE


@wp.func
def is_followed_by_same(events: wp.array(dtype=wp.vec4i), i: int, end: int, event: Event):
    """Whether the event after event i, among its node's on the axis, is of the same kind at the same position."""
    if i + 1 == end:
        return False
    following = event_at(events, i + 1)
    return following.kind == event.kind and following.position == event.position


@exact_kernel
def search_planes(
    first: int,
    cost: SplitCost,
    total: int,
    events: wp.array(dtype=wp.vec4i),
    nodes: wp.array(dtype=CellNode),
    keys: wp.array(dtype=wp.int64),
):
    """Item: `SEARCHED_EACH` events. keys: (nodes,) the least key of each node, `NO_PLANE` before."""
    begin = (first + wp.tid()) * SEARCHED_EACH
    here = int(-1)
    axis = int(-1)
    triangles = int(0)
    origin = int(0)
    along = AxisFrame()
    least = no_key()
    for i in range(begin, wp.min(begin + SEARCHED_EACH, 6 * total)):
        event = event_at(events, i)
        if event.node != here or event.axis != axis:
            if event.node != here and least < NO_PLANE:
                keep_less(keys, here, least)
                least = no_key()
            here = event.node
            axis = event.axis
            node = nodes[here]
            triangles = node.triangles
            origin = first_event(node, axis, total)
            along = axis_frame(cost, axis, node.low, node.high, triangles)
        if event.position > along.low and event.position < along.high:
            ends = (event.kind & 1) == 0
            if not (ends and is_followed_by_same(events, i, origin + 2 * triangles, event)):
                right = triangles - (i - origin - event.begun) - wp.where(ends, 1, 0)
                candidate = plane_cost(cost, along, event.position, event.begun, right)
                if candidate < INFINITY:
                    least = wp.min(least, plane_key(candidate, axis, i - origin, event.kind >= PLANAR_END))
    keep_least(keys, here, least)


@wp.func
def split_of(key: wp.int64, node: CellNode, total: int, events: wp.array(dtype=wp.vec4i)):
    """The plane with this key."""
    split = no_split()
    if key < NO_PLANE:
        low = key & LOW_BITS
        split.cost = wp.cast(int(key >> wp.int64(32)), wp.float32)
        split.axis = int(low >> AXIS_SHIFT)
        split.planar_left = (low & wp.int64(1)) != wp.int64(0)
        place = int((low & PLACE_BITS) >> wp.int64(1))
        event = event_at(events, first_event(node, split.axis, total) + place)
        split.position = event.position
        split.left = event.begun
        split.right = node.triangles - (place - event.begun) - wp.where((event.kind & 1) == 0, 1, 0)
    return split


@wp.struct
class Level:
    """Numbers of a level."""

    nodes: int
    triangles: int
    """Of all its nodes."""
    depth: int
    first: int
    """Nodes of the levels above."""
    listed: int
    """Triangles of their leaves."""


@wp.struct
class BuiltNodes:
    """All nodes, level after level; the children of a node are adjacent."""

    node: wp.array(dtype=wp.vec2i)
    """As `wrt.kernels.layout.kdtree_nodes` has them, in pairs; instead of its first block, a leaf has the place of its first
    triangle in `listed`."""
    parent: wp.array(dtype=int)
    """Its parent << 1 | whether it is the right child; -1 for the root."""
    size: wp.array(dtype=wp.int64)
    """What `numbering` sums up."""
    listed: wp.array(dtype=int)
    """Triangles of leaves."""


@exact_kernel
def make_children(
    first: int,
    cost: SplitCost,
    limits: StopLimits,
    level: Level,
    events: wp.array(dtype=wp.vec4i),
    keys: wp.array(dtype=wp.int64),
    nodes: wp.array(dtype=CellNode),
    tiles: Tiles,
    children: wp.array(dtype=CellNode),
    child_keys: wp.array(dtype=wp.int64),
    built: BuiltNodes,
    totals: wp.array(dtype=int),
    told: wp.array(dtype=int),
):
    """Item: a node, in one chunk. Splits it at its best plane, or makes it a leaf; writes it to the tree, and its children.

    children, child_keys: (2 level.nodes,) output, of which twice the nodes with children are written. totals, told: (SUMS,)
    output, the sums over all nodes, for kernels and for the host."""
    index = first + wp.tid()
    node = CellNode()
    node.is_leaf = True
    if index < level.nodes:
        node = nodes[index]
        node.split = split_of(keys[index], node, level.triangles, events)
        node.path = stop(limits, cost, level.depth, node.triangles, node.path, node.split, node.high - node.low)
        node.is_leaf = node.path.bad_splits < 0
    own = wp.vec4i(1, node.split.left, node.split.right, 0)
    if node.is_leaf:
        own = wp.vec4i(0, 0, 0, node.triangles)
    before = sums_before(tiles, own)
    if index < level.nodes:
        here = level.first + index
        below = level.first + level.nodes
        if index == level.nodes - 1:
            for k in range(SUMS):
                totals[k] = before[k] + own[k]
                told[k] = before[k] + own[k]
        if node.is_leaf:
            node.child = level.listed + before[LISTED]
            built.node[here] = kdtree.leaf_node(node.child, node.triangles)
        else:
            node.child = 2 * before[INNER]
            node.left_before = before[LEFT]
            node.right_before = before[RIGHT]
            split = node.split
            built.node[here] = kdtree.inner_node(split.axis, split.position, below + node.child)
            child = node
            child.triangles = split.left
            child.before = node.left_before + node.right_before
            child.high[split.axis] = split.position
            children[node.child] = child
            child.high[split.axis] = node.high[split.axis]
            child.low[split.axis] = split.position
            child.before += split.left
            child.triangles = split.right
            children[node.child + 1] = child
            for side in range(2):
                child_keys[node.child + side] = NO_PLANE
                built.parent[below + node.child + side] = (here << 1) | side
        nodes[index] = node
