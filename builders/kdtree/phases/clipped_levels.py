"""Split clipping in the top levels of the in-place build.

**Problem.** In the levels, events stay where they are, and a triangle knows its nodes (`membership`). A clipped triangle
has another box, and so other events, in each of its nodes.

**Algorithm.** What is classified are *references*, at first one per triangle. A reference lies in one node. If its box
straddles the node's plane, it is clipped to both children's cells (`core.clip`): the part on the left keeps its number,
the one on the right becomes a new reference, and a part that does not exist lies in no node. Events are those of references.
So the search of a level does not change. After it, the events of the straddlers are left out of the sorted lists, and those of
their parts are sorted and merged in, chunk by chunk (`clipped_events` does the same within a task).

**Complexity.** O(N) per level, as without clipping: about sqrt(N) references straddle a plane.

The parts are clipped as in tasks, so the tree does not depend on the level at which tasks begin.

References: wald-havran-2006; choi-2010.
"""

import numpy as np
import warp as wp

from wrt.builders.core.clip import ClippedMesh, clipped_mesh
from wrt.builders.core.levels import LiveNode, side_of, starts_of
from wrt.builders.kdtree.events.event_sort import END, PLANAR, START, Events, event_position, event_value, item_sizes
from wrt.builders.kdtree.phases.membership import Membership
from wrt.builders.triangle_boxes import Boxes, TriangleBoxes
from wrt.kernels.layout.unchecked import load_byte, load_int, store_byte, store_int
from wrt.kernels.runtime import native
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import exact_kernel

MERGE_CHUNK = 8192
"""Events of a list that one item merges with new ones."""

NOWHERE = wp.constant(-1)
"""`Membership.node` of a reference that lies in no node: the first list of `Membership.shared`, which is empty."""


@wp.func
def side_in(boxes: Boxes, nodes: wp.array(dtype=LiveNode), own: int, reference: int):
    """The children to which a reference belongs, by its box: 1 left, 2 right, 3 both; of a finished node 1, of no node 0."""
    side = int(0)
    if own >= 0:
        node = nodes[own]
        side = 1
        if not node.finished:
            axis = node.split.axis
            side = side_of(node.split, boxes.low[axis, reference], boxes.high[axis, reference])
    return side


@exact_kernel
def count_straddlers(
    first: int,
    size: int,
    references: int,
    boxes: Boxes,
    nodes: wp.array(dtype=LiveNode),
    membership: Membership,
    counts: wp.array(dtype=int),
):
    """Item: a chunk of references. counts: (chunks,) those that straddle their node's plane."""
    chunk = first + wp.tid()
    count = int(0)
    for reference in range(chunk * size, wp.min(references, (chunk + 1) * size)):
        count += wp.where(side_in(boxes, nodes, load_int(membership.node, reference), reference) == 3, 1, 0)
    counts[chunk] = count


@exact_kernel
def classify_references(
    first: int,
    size: int,
    references: int,
    boxes: Boxes,
    nodes: wp.array(dtype=LiveNode),
    membership: Membership,
    places: wp.array(dtype=int),
    refined: Membership,
    straddlers: wp.array(dtype=int),
    straddles: wp.array(dtype=wp.uint8),
):
    """Item: a chunk of references. Writes the nodes of those that do not straddle, and lists and marks the others.

    places: (chunks,) where the chunk's straddlers are listed."""
    chunk = first + wp.tid()
    to = places[chunk]
    for reference in range(chunk * size, wp.min(references, (chunk + 1) * size)):
        own = load_int(membership.node, reference)
        side = side_in(boxes, nodes, own, reference)
        store_byte(straddles, reference, wp.uint8(wp.where(side == 3, 1, 0)))
        if side == 3:
            store_int(straddlers, to, reference)
            to += 1
        elif side == 0:
            store_int(refined.node, reference, NOWHERE)
        else:
            store_int(refined.node, reference, nodes[own].left + side - 1)


@native.func_native("clip.h", "return wrt::clip_part(lists, wrt::cell_of(low, high, lists.pad), boxes, triangle, source, to);")
def clip_part(lists: ClippedMesh, boxes: Boxes, triangle: int, low: wp.vec3, high: wp.vec3, source: int, to: int) -> bool:
    """Writes the box of a reference's part in a cell; False if there is none."""


@wp.func
def clip_to_children(mesh: ClippedMesh, boxes: Boxes, node: LiveNode, triangle: int, reference: int, added: int):
    """Clips a reference to the cells of both children of a node; the part on the right is the reference `added`. Returns where
    there are parts: 1 left, 2 right, 3 both, 0 nowhere."""
    left_high = wp.vec3(node.frame.high)
    right_low = wp.vec3(node.frame.low)
    left_high[node.split.axis] = node.split.position
    right_low[node.split.axis] = node.split.position
    side = int(0)
    if clip_part(mesh, boxes, triangle, right_low, node.frame.high, reference, added):
        side = 2
    if clip_part(mesh, boxes, triangle, node.frame.low, left_high, reference, reference):
        side += 1
    return side


@exact_kernel
def clip_straddlers(
    first: int,
    mesh: ClippedMesh,
    references: int,
    nodes: wp.array(dtype=LiveNode),
    membership: Membership,
    straddlers: wp.array(dtype=int),
    boxes: Boxes,
    triangle: wp.array(dtype=int),
    refined: Membership,
):
    """Item: a straddler. Clips it to both children's cells; its right part is the reference `references` + item."""
    item = first + wp.tid()
    reference = straddlers[item]
    added = references + item
    node = nodes[membership.node[reference]]
    triangle[added] = triangle[reference]
    side = clip_to_children(mesh, boxes, node, triangle[reference], reference, added)
    refined.node[added] = wp.where(side >= 2, node.left + 1, NOWHERE)
    refined.node[reference] = wp.where((side & 1) != 0, node.left, NOWHERE)


@wp.func
def precedes(position_a: float, kind_a: int, position_b: float, kind_b: int):
    """Whether an event is not after another: by position, then end, planar, start."""
    return position_a < position_b or (position_a == position_b and kind_a <= kind_b)


@wp.func
def new_before(events: Events, parts: Events, axis: int, place: int):
    """Number of new events before the event at a place of the old list; all of them at its end."""
    low = int(0)
    high = parts.count[axis]
    if place <= 0:
        high = 0
    if place < events.count[axis]:
        position = event_position(events, axis, place)
        kind = event_value(events, axis, place) & 3
        while low < high:
            middle = (low + high) / 2
            if precedes(position, kind, event_position(parts, axis, middle), event_value(parts, axis, middle) & 3):
                high = middle
            else:
                low = middle + 1
    return high


@exact_kernel
def count_kept(first: int, events: Events, straddles: wp.array(dtype=wp.uint8), kept: wp.array2d(dtype=int)):
    """Item: axis * chunks + chunk. kept: (3, chunks) events that are not of straddlers."""
    item = first + wp.tid()
    axis = item / kept.shape[1]
    chunk = item % kept.shape[1]
    count = int(0)
    for i in range(chunk * events.chunk, wp.min(events.count[axis], (chunk + 1) * events.chunk)):
        count += 1 - int(load_byte(straddles, event_value(events, axis, i) >> 2))
    kept[axis, chunk] = count


@wp.func
def copy_event(source: Events, axis: int, i: int, target: Events, to: int):
    """Copies an event."""
    target.position[axis, to] = event_position(source, axis, i)
    target.value[axis, to] = event_value(source, axis, i)


@exact_kernel
def merge_events(
    first: int,
    events: Events,
    straddles: wp.array(dtype=wp.uint8),
    parts: Events,
    before: wp.array2d(dtype=int),
    target: Events,
):
    """Item: axis * chunks + chunk. Merges the kept events of a chunk with the new ones between its ends.

    before: (3, chunks) kept events before the chunk."""
    item = first + wp.tid()
    axis = item / before.shape[1]
    chunk = item % before.shape[1]
    end = wp.min(events.count[axis], (chunk + 1) * events.chunk)
    fresh = new_before(events, parts, axis, wp.min(events.count[axis], chunk * events.chunk))
    last = new_before(events, parts, axis, end)
    to = before[axis, chunk] + fresh
    for i in range(chunk * events.chunk, end):
        value = event_value(events, axis, i)
        if load_byte(straddles, value >> 2) == wp.uint8(0):
            position = event_position(events, axis, i)
            while fresh < last and not precedes(
                position, value & 3, event_position(parts, axis, fresh), event_value(parts, axis, fresh) & 3
            ):
                copy_event(parts, axis, fresh, target, to)
                fresh += 1
                to += 1
            copy_event(events, axis, i, target, to)
            to += 1
    while fresh < last:
        copy_event(parts, axis, fresh, target, to)
        fresh += 1
        to += 1


@exact_kernel
def name_triangles(first: int, triangle: wp.array(dtype=int), listed: wp.array(dtype=int)):
    """Item: an entry of a list of references. Replaces it by its triangle."""
    i = first + wp.tid()
    listed[i] = triangle[listed[i]]


class ClippedReferences:
    """The references of a build that clips, and their boxes.

    Args:
        triangles: boxes of the mesh's triangles.
        shrinks: whether references get the boxes of their parts.
    """

    def __init__(self, triangles: TriangleBoxes, shrinks: bool) -> None:
        self.device = triangles.boxes.low.device
        self.mesh = clipped_mesh(triangles, triangles.size, shrinks)
        self.count = triangles.count
        self.boxes = triangles.boxes
        self.triangle = wp.array(np.arange(self.count, dtype=np.int32), device=self.device)
        """(count,) the triangle of each reference."""

    def run(self, kernel: wp.Kernel, count: int, *inputs: object) -> None:
        """Launches a kernel whose items are chunks."""
        launch(kernel, count, inputs, device=self.device, chunk=1)

    def classify(self, events: Events, membership: Membership, nodes: wp.array) -> Membership:
        """The nodes of the references on the next level; adds the parts of straddlers, and replaces the events."""
        count, size, device = self.count, item_sizes(self.device).triangles, self.device
        chunks = -(-count // size)
        counts = wp.empty(chunks, dtype=int, device=device)
        self.run(count_straddlers, chunks, size, count, self.boxes, nodes, membership, counts)
        sizes = counts.numpy()
        added = int(sizes.sum())
        places = wp.array(starts_of(sizes), dtype=int, device=device)
        refined = Membership()
        refined.node = wp.empty(count + added, dtype=int, device=device)
        refined.shared = wp.zeros(1, dtype=int, device=device)
        straddlers = wp.empty(max(1, added), dtype=int, device=device)
        straddles = wp.empty(count, dtype=wp.uint8, device=device)
        inputs = [size, count, self.boxes, nodes, membership, places, refined, straddlers, straddles]
        self.run(classify_references, chunks, *inputs)
        if added:
            self.enlarge(count + added)
            inputs = [self.mesh, count, nodes, membership, straddlers, self.boxes, self.triangle, refined]
            launch(clip_straddlers, added, inputs, device=device, chunk=64)
            parts = np.concatenate([straddlers.numpy(), np.arange(count, count + added)])
            self.replace_events(events, straddles, parts[refined.node.numpy()[parts] >= 0])
        return refined

    def enlarge(self, count: int) -> None:
        """Makes room for more references."""
        boxes = Boxes()
        for name in ("low", "high"):
            room = np.empty((3, count), dtype=np.float32)
            room[:, : self.count] = getattr(self.boxes, name).numpy()
            setattr(boxes, name, wp.array(room, dtype=float, device=self.device))
        triangle = np.zeros(count, dtype=np.int32)
        triangle[: self.count] = self.triangle.numpy()
        self.boxes, self.triangle, self.count = boxes, wp.array(triangle, dtype=int, device=self.device), count

    def replace_events(self, events: Events, straddles: wp.array, parts: np.ndarray) -> None:
        """Leaves out the events of straddlers, and merges in those of these references."""
        new = self.new_events(parts)
        events.chunk = MERGE_CHUNK
        chunks = max(1, -(-max(events.count) // MERGE_CHUNK))
        kept = wp.empty((3, chunks), dtype=int, device=self.device)
        self.run(count_kept, 3 * chunks, events, straddles, kept)
        counts = kept.numpy()
        total = [int(n) for n in counts.sum(axis=1) + np.array(new.count)]
        target = empty_events(max(total), self.device)
        before = wp.array(np.cumsum(counts, axis=1) - counts, dtype=int, device=self.device)
        self.run(merge_events, 3 * chunks, events, straddles, new, before, target)
        events.position, events.value, events.count = target.position, target.value, wp.vec3i(*total)

    def new_events(self, parts: np.ndarray) -> Events:
        """The sorted events of these references."""
        new = empty_events(max(1, 2 * len(parts)), self.device)
        counts = []
        for axis in range(3):
            _, position, value = events_of(self.boxes, axis, parts, parts)
            order = np.lexsort((value & 3, position))
            counts.append(len(order))
            new.position.numpy()[axis, : len(order)] = position[order]
            new.value.numpy()[axis, : len(order)] = value[order]
        new.count = wp.vec3i(*counts)
        return new


def events_of(boxes: Boxes, axis: int, parts: np.ndarray, number: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The events of references along an axis, unsorted: which reference, position, and number << 2 | type.

    Args:
        boxes: of all references.
        axis: 0 to 2.
        parts: ids of the references.
        number: what the events name them by."""
    low, high = (corner.numpy()[axis, parts] for corner in (boxes.low, boxes.high))
    solid = low < high
    which = np.concatenate([np.arange(len(parts)), np.flatnonzero(solid)])
    kind = np.concatenate([np.where(solid, int(START), int(PLANAR)), np.full(solid.sum(), int(END))])
    return which, np.concatenate([low, high[solid]]), number[which] << 2 | kind


def empty_events(capacity: int, device: wp.Device) -> Events:
    """Events of this many per axis, not yet written."""
    events = Events()
    events.position = wp.empty((3, capacity), dtype=float, device=device)
    events.value = wp.empty((3, capacity), dtype=int, device=device)
    return events
