"""Serial sweep that sorts every node anew: the reference for the fast builders (Wald and Havran 2006, O(N log^2 N)).

**Problem.** Comparing every plane with every triangle takes O(N^2).

**Idea.** Sort the events of a node, and sweep a plane over them with the numbers of triangles on both sides. A node takes over
nothing from its parent except the list of its triangles and their boxes.

**Steps** of a node (`build_serially`), with the survey's names N_L, N_P, N_R:

1. `list_events`, for each axis: end, planar, start; `merge_sort` by position, then kind, then triangle.
2. `sweep_axis`: at each position N_R falls by the ending and planar triangles; the cost is evaluated; N_L grows by the planar
   and starting ones.
3. `wrt.builders.tree.stop`, then `partition`: `classify` for each triangle; if triangles are clipped, those that straddle the
   plane are clipped to both children's cells (`wrt.builders.core.clip`), and enter them with the boxes of their parts.
4. The left child is next; the right one waits.

**Data.** A list of triangle ids and boxes per node on the path from the root, and the events of the current node and axis
(`Workspace`).

**Complexity.** O(N log^2 N): a sort at each of O(log N) levels. One thread.

**What we changed.** The algorithm as printed in Rahikainen 2013 (4.1.3) updates N_L only when a plane is the best so far, and
adds the ends to it. The counts must follow every plane: after the evaluation, N_L grows by the planar and the starting
triangles.

The build shares only the cost model, the stop rules and the clipping of a triangle with the other builders. If it makes the
same tree as they do, their sorted lists, counts across chunks, classification and assembly are right.

References: wald-havran-2006; rahikainen-2013 (algorithm 4.1.3).
"""

from time import perf_counter

import warp as wp

from wrt.builders.classics.kdtree.early_cutting import cut_slab
from wrt.builders.core.clip import PAD
from wrt.builders.cost import AxisFrame, Split, SplitCost, axis_frame, better_split, no_split
from wrt.builders.kdtree.events.event_sort import END, PLANAR, START
from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.tree import BuildStats, KdTree, PathState, StopLimits, stop
from wrt.builders.triangle_boxes import Boxes, TriangleBoxes
from wrt.kernels.layout import kdtree_nodes as kdtree
from wrt.kernels.runtime import native
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.simd.boxes import INFINITY

STACK = kdtree.MAX_TREE_DEPTH + 1


@wp.struct
class PendingNode:
    """A node whose triangles are listed and that is not built yet."""

    low: wp.vec3
    high: wp.vec3
    first: int
    """Start of its list in `Workspace.triangle`."""
    triangles: int
    path: PathState
    depth: int
    parent: int
    """Index of the node whose right child it is; -1 if it is a left child or the root."""


@wp.struct
class Workspace:
    """Memory of the build."""

    triangle: wp.array(dtype=int)
    """Lists of the nodes on the path from the root to the current one."""
    box: wp.array(dtype=float)
    """Their boxes, 8 floats each: low, 0, -high, 0."""
    cutting: bool
    """Whether large empty slabs are cut off first."""
    clipping: bool
    """Whether triangles are clipped to cells. The members `vertices`, `faces`, `pad` and `shrinks` are for clipping."""
    vertices: wp.array(dtype=wp.vec3)
    faces: wp.array(dtype=wp.vec3i)
    pad: float
    """Enlargement of cells and boxes, in scene units."""
    shrinks: bool
    """Whether clipped triangles get the boxes of their parts."""
    position: wp.array(dtype=float)
    """Events of the current node and axis, in two buffers of equal size for the sort."""
    value: wp.array(dtype=int)
    """triangle << 2 | type."""
    stack: wp.array(dtype=PendingNode)
    nodes: wp.array(dtype=wp.vec2i)
    primitive: wp.array(dtype=int)
    used: wp.array(dtype=int)
    """(3,) results: number of nodes, number of lanes of `primitive`, and 1 if the memory was too small."""


@wp.func
def precedes(work: Workspace, a: int, b: int):
    """Whether event a is not after event b: by position, then end, planar, start, then triangle."""
    if work.position[a] != work.position[b]:
        return work.position[a] < work.position[b]
    kind_a = work.value[a] & 3
    kind_b = work.value[b] & 3
    return kind_a < kind_b or (kind_a == kind_b and work.value[a] <= work.value[b])


@wp.func
def merge_sort(work: Workspace, count: int):
    """Sorts the events [0, count). The second half of the buffers is scratch. Returns the start of the sorted list."""
    half = work.position.shape[0] / 2
    source = int(0)
    run = int(1)
    while run < count:
        target = half - source
        begin = int(0)
        while begin < count:
            middle = wp.min(begin + run, count)
            end = wp.min(begin + 2 * run, count)
            a = int(begin)
            b = int(middle)
            for to in range(begin, end):
                take_a = b >= end or (a < middle and precedes(work, source + a, source + b))
                chosen = wp.where(take_a, a, b)
                a += wp.where(take_a, 1, 0)
                b += wp.where(take_a, 0, 1)
                work.position[target + to] = work.position[source + chosen]
                work.value[target + to] = work.value[source + chosen]
            begin += 2 * run
        source = target
        run *= 2
    return source


@wp.func
def box_low(work: Workspace, i: int, axis: int):
    """Lower end of a listed triangle's box."""
    return work.box[8 * i + axis]


@wp.func
def box_high(work: Workspace, i: int, axis: int):
    """Upper end of a listed triangle's box. Adding 0 turns -0 into +0."""
    return 0.0 - work.box[8 * i + 4 + axis]


@wp.func
def list_events(work: Workspace, node: PendingNode, axis: int):
    """Writes the events of the node's triangles; returns their number."""
    count = int(0)
    for i in range(node.first, node.first + node.triangles):
        triangle = work.triangle[i]
        low = box_low(work, i, axis)
        high = box_high(work, i, axis)
        work.position[count] = low
        work.value[count] = (triangle << 2) | wp.where(low < high, START, PLANAR)
        count += 1
        if low < high:
            work.position[count] = high
            work.value[count] = (triangle << 2) | END
            count += 1
    return count


@wp.func
def count_kind(work: Workspace, begin: int, end: int, position: float, kind: int):
    """Number of events of one kind at one position, from `begin` on."""
    i = int(begin)
    while i < end and work.position[wp.min(i, end - 1)] == position and (work.value[wp.min(i, end - 1)] & 3) == kind:
        i += 1
    return i - begin


@wp.func
def sweep_axis(cost: SplitCost, along: AxisFrame, work: Workspace, first: int, events: int, triangles: int, best: Split):
    """The best of `best` and all planes along one axis."""
    left = int(0)
    right = int(triangles)
    i = int(first)
    end = first + events
    while i < end:
        position = work.position[i]
        ends = count_kind(work, i, end, position, END)
        planar = count_kind(work, i + ends, end, position, PLANAR)
        starts = count_kind(work, i + ends + planar, end, position, START)
        right -= planar + ends
        best = better_split(cost, along, position, left, planar, right, best)
        left += planar + starts
        i += wp.max(ends + planar + starts, 1)  # NaN equals no position, not even its own
    return best


@wp.func
def cut_early(cost: SplitCost, work: Workspace, node: PendingNode):
    """The split that cuts off a large empty slab, if there is one (`early_cutting`)."""
    low, high = wp.vec3(node.high), wp.vec3(node.low)
    for i in range(node.first, node.first + node.triangles):
        for axis in range(3):
            low[axis] = wp.min(low[axis], box_low(work, i, axis))
            high[axis] = wp.max(high[axis], box_high(work, i, axis))
    return cut_slab(cost, node.low, node.high, wp.max(low, node.low), wp.min(high, node.high), node.triangles)


@wp.func
def search(cost: SplitCost, work: Workspace, node: PendingNode):
    """The best plane of a node."""
    best = no_split()
    if work.cutting:
        best = cut_early(cost, work, node)
    if best.cost < INFINITY:
        return best
    for axis in range(3):
        events = list_events(work, node, axis)
        first = merge_sort(work, events)
        along = axis_frame(cost, axis, node.low, node.high, node.triangles)
        best = sweep_axis(cost, along, work, first, events, node.triangles, best)
    return best


@wp.func
def classify(work: Workspace, i: int, split: Split):
    """The children that contain a listed triangle: 1 for the left one, plus 2 for the right one."""
    low = box_low(work, i, split.axis)
    high = box_high(work, i, split.axis)
    if not (low < high) and low == split.position:  # planar
        return wp.where(split.planar_left, 1, 2)
    return wp.where(low < split.position, 1, 0) + wp.where(high > split.position, 2, 0)


@wp.func_native(
    """
    const auto* from = lists.box.data + (size_t)source * 8;
    auto* const to = lists.box.data + (size_t)target * 8;
    lists.triangle.data[target] = lists.triangle.data[source];
    if (to != from) memcpy(to, from, 8 * sizeof(float));
"""
)
def copy_entry(lists: Workspace, source: int, target: int):
    """Lists a triangle and its box a second time."""


@native.func_native(
    "clip.h",
    "const auto cell = wrt::cell_of(low, high, pad);\n"
    "return wrt::clip(lists, cell, lists.triangle.data[i], lists.box.data + (size_t)i * 8);",
)
def clip(lists: Workspace, i: int, pad: float, low: wp.vec3, high: wp.vec3) -> bool:
    """Shrinks the box of a listed triangle to its part in a cell; False if there is none."""


@wp.func
def partition(work: Workspace, node: PendingNode, split: Split, left: wp.ref[PendingNode], right: wp.ref[PendingNode]):
    """Lists the triangles of the children. The right child's list replaces the node's, the left child's is appended."""
    left.first = node.first + node.triangles
    left.triangles = 0
    right.triangles = 0
    for i in range(node.first, node.first + node.triangles):
        sides = classify(work, i, split)
        clipped = work.clipping and sides == 3
        if (sides & 1) != 0:
            to = left.first + left.triangles
            copy_entry(work, i, to)
            if not clipped or clip(work, to, work.pad, left.low, left.high):
                left.triangles += 1
        if (sides & 2) != 0:
            to = right.first + right.triangles
            copy_entry(work, i, to)
            if not clipped or clip(work, to, work.pad, right.low, right.high):
                right.triangles += 1


@wp.func
def emit_leaf(work: Workspace, node: PendingNode, index: int, lanes: int, width: int):
    """Writes a leaf and its list, padded to whole blocks; returns the end of the list."""
    work.nodes[index] = kdtree.leaf_node(lanes / width, node.triangles)
    to = int(lanes)
    for i in range(node.triangles):
        work.primitive[to] = work.triangle[node.first + i]
        to += 1
    while to % width != 0:
        work.primitive[to] = -1
        to += 1
    return to


@wp.func
def link_right(work: Workspace, parent: int, index: int):
    """Stores the right child of an inner node."""
    node = work.nodes[parent]
    work.nodes[parent] = kdtree.inner_node(kdtree.split_axis(node), kdtree.split_position(node), index)


@exact_kernel
def build_serially(first: int, cost: SplitCost, limits: StopLimits, root: PendingNode, work: Workspace):
    """One item: the whole build. The caller has listed all triangles as the root's."""
    width = 1 << cost.width_bits
    node = root
    nodes = int(0)
    lanes = int(0)
    waiting = int(0)
    busy = bool(True)
    while busy:
        if (
            node.first + 2 * node.triangles > work.triangle.shape[0]
            or nodes >= work.nodes.shape[0]
            or lanes + node.triangles + width > work.primitive.shape[0]
        ):
            work.used[2] = 1
            break
        if node.parent >= 0:
            link_right(work, node.parent, nodes)
        split = search(cost, work, node)
        path = stop(limits, cost, node.depth, node.triangles, node.path, split, node.high - node.low)
        if path.bad_splits < 0:
            lanes = emit_leaf(work, node, nodes, lanes, width)
            waiting -= 1
            busy = waiting >= 0
            if busy:
                node = work.stack[waiting]
        else:
            work.nodes[nodes] = kdtree.inner_node(split.axis, split.position, 0)  # whose right child is not known yet
            left = node
            right = node
            left.high[split.axis] = split.position
            right.low[split.axis] = split.position
            partition(work, node, split, left, right)
            left.path = path
            right.path = path
            left.depth += 1
            right.depth += 1
            left.parent = -1
            right.parent = nodes
            work.stack[waiting] = right
            waiting += 1
            node = left
        nodes += 1
    work.used[0] = nodes
    work.used[1] = lanes


@exact_kernel
def list_all(first: int, boxes: Boxes, work: Workspace):
    """Item: a triangle. Lists it in the root."""
    i = first + wp.tid()
    work.triangle[i] = i
    for axis in range(3):
        work.box[8 * i + axis] = boxes.low[axis, i]
        work.box[8 * i + 4 + axis] = -boxes.high[axis, i]


def build(triangles: TriangleBoxes, config: KdTreeConfig) -> KdTree:
    """Builds the tree on the device that holds the boxes, on a single thread."""
    start = perf_counter()
    device, count, width = triangles.boxes.low.device, triangles.count, config.cost.width
    root = PendingNode()
    root.low, root.high = wp.vec3(*triangles.low), wp.vec3(*triangles.high)
    root.triangles = count
    root.parent = -1
    capacity = 4 * count + 64
    while True:
        work = Workspace()
        work.triangle = wp.empty(capacity, dtype=int, device=device)
        work.box = wp.zeros(8 * capacity, dtype=float, device=device)
        work.cutting, work.clipping, work.shrinks = config.cuts_early, config.tests_nodes, config.split_clipping
        if config.tests_nodes:
            work.vertices, work.faces, work.pad = triangles.vertices, triangles.faces, PAD * triangles.size
        work.position = wp.empty(4 * count, dtype=float, device=device)
        work.value = wp.empty(4 * count, dtype=int, device=device)
        work.stack = wp.empty(STACK, dtype=PendingNode, device=device)
        work.nodes = wp.empty(capacity, dtype=wp.vec2i, device=device)
        work.primitive = wp.empty(capacity + capacity % width + width, dtype=int, device=device)
        work.used = wp.zeros(3, dtype=int, device=device)
        launch(list_all, count, [triangles.boxes, work], device=device, chunk=4096)
        inputs = [config.cost.struct(), config.stop.limits(count, triangles.size), root, work]
        launch(build_serially, 1, inputs, device=device)
        nodes, lanes, overflow = map(int, work.used.numpy())
        if not overflow:
            break
        capacity *= 2
    nodes, primitive = wp.clone(work.nodes[:nodes]), wp.clone(work.primitive[:lanes])
    tree = KdTree(nodes=nodes, primitive=primitive, low=root.low, high=root.high, width=width, stats=BuildStats())
    tree.stats.reserve(
        *(triangles.boxes.low, triangles.boxes.high, work.triangle, work.box, work.position, work.value),
        *(work.nodes, work.primitive),
    )
    tree.stats.seconds["build"] = perf_counter() - start
    return tree
