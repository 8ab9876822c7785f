"""Split clipping in the top levels of the nested build.

As in the levels of the in-place build (`clipped_levels`), lists hold references, at first one per triangle. A straddler is
clipped to both children's cells; the part on the left keeps its number, and the one on the right gets a new one. Here data
moves with the nodes: the straddlers' events are not moved to the children's lists, which leave room for the events of the
parts. These are sorted, and merged into each list from the back, by one thread per list (`clipped_events` does the same within
a task).

References:
    I. Wald, V. Havran: On building fast kd-trees for ray tracing, and on doing that in O(N log N).
        IEEE Symposium on Interactive Ray Tracing 2006.
    B. Choi, R. Komuravelli, V. Lu, H. Sung, R. L. Bocchino, S. V. Adve, J. C. Hart: Parallel SAH k-D tree construction.
        High Performance Graphics 2010.
"""

from typing import Any

import numpy as np
import warp as wp

from wrt.builders.core.clip import ClippedMesh
from wrt.builders.core.subtrees import Reservation
from wrt.builders.kdtree.events.clipped_events import precedes
from wrt.builders.kdtree.events.event_lists import EventLists
from wrt.builders.kdtree.events.event_sort import END, PLANAR, START
from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.kdtree.phases.clipped_levels import ClippedReferences, clip_part, name_triangles
from wrt.builders.kdtree.phases.event_chunks import EventNode, LevelLists, TriangleChunk
from wrt.builders.kdtree.phases.event_levels import EventLevels
from wrt.builders.triangle_boxes import Boxes, TriangleBoxes
from wrt.kernels.layout.unchecked import load_byte, load_int, load_pair, store_byte, store_int, store_pair
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import exact_module

exact_module(__name__)

STRADDLES = wp.constant(15)
"""`LevelLists.side` of a straddler before it is clipped: it and its events go to both sides."""


@wp.kernel
def list_straddlers(
    first: int,
    lists: LevelLists,
    chunks: wp.array(dtype=TriangleChunk),
    places: wp.array(dtype=int),
    straddlers: wp.array(dtype=wp.vec2i),
):
    """Item: a chunk of references. Lists its straddlers, (place in the level's list, node), from places[chunk] on, and notes
    that the others have the same id on both sides."""
    index = first + wp.tid()
    chunk = chunks[index]
    to = places[index]
    for i in range(chunk.begin, chunk.end):
        store_int(lists.right, i, load_int(lists.triangle, i))
        if int(load_byte(lists.side, i)) == STRADDLES:
            straddlers[to] = wp.vec2i(i, chunk.node)
            to += 1


@wp.kernel
def clip_listed(
    first: int,
    mesh: ClippedMesh,
    references: int,
    lists: LevelLists,
    nodes: wp.array(dtype=EventNode),
    straddlers: wp.array(dtype=wp.vec2i),
    boxes: Boxes,
    triangle: wp.array(dtype=int),
):
    """Item: a straddler. Clips it to both children's cells; its right part is the reference `references` + item."""
    item = first + wp.tid()
    place = straddlers[item][0]
    node = nodes[straddlers[item][1]]
    reference = lists.triangle[place]
    added = references + item
    left_high = wp.vec3(node.frame.high)
    right_low = wp.vec3(node.frame.low)
    left_high[node.split.axis] = node.split.position
    right_low[node.split.axis] = node.split.position
    triangle[added] = triangle[reference]
    lists.right[place] = added
    side = int(0)
    if clip_part(mesh, boxes, triangle[reference], right_low, node.frame.high, reference, added):
        side = 2
    if clip_part(mesh, boxes, triangle[reference], node.frame.low, left_high, reference, reference):
        side += 1
    store_byte(lists.side, place, wp.uint8(side << 2))


@wp.kernel
def count_parts(first: int, lists: LevelLists, chunks: wp.array(dtype=TriangleChunk)):
    """Item: a chunk of references. Counts what goes to both sides, after clipping."""
    index = first + wp.tid()
    chunk = chunks[index]
    left = int(0)
    right = int(0)
    for i in range(chunk.begin, chunk.end):
        side = int(load_byte(lists.side, i)) >> 2
        left += side & 1
        right += side >> 1
    chunk.left = left
    chunk.right = right
    chunks[index] = chunk


@wp.kernel
def merge_lists(
    first: int, ends: wp.array(dtype=wp.vec3i), begin: wp.array(dtype=int), parts: wp.array(dtype=wp.vec2i), target: LevelLists
):
    """Item: a list, which ends with room for the events of parts. Merges these from the back.

    ends: (lists,) where the kept events end; the first event of its parts, and their end. begin: (lists,) start of the list."""
    item = first + wp.tid()
    old = ends[item][0]
    part = ends[item][2]
    while part > ends[item][1]:
        to = old + (part - ends[item][1]) - 1
        event = load_pair(parts, part - 1)
        if old > begin[item] and not precedes(load_pair(target.event, wp.max(old - 1, 0)), event):
            old -= 1
            event = load_pair(target.event, old)
        else:
            part -= 1
        store_pair(target.event, to, event)


class ClippedEventLevels(EventLevels):
    """`EventLevels` with clipping; arguments as there."""

    def __init__(self, triangles: TriangleBoxes, config: KdTreeConfig, large: int) -> None:
        super().__init__(triangles, config, large)
        self.parts = ClippedReferences(triangles, config.split_clipping)

    @property
    def boxes(self) -> Boxes:
        """The boxes of the references."""
        return self.parts.boxes

    def make_lists(self, events: int, triangles: int) -> LevelLists:
        """Lists of this many events and references, still empty."""
        lists = super().make_lists(events, triangles)
        lists.right = wp.empty(triangles, dtype=int, device=self.device)
        return lists

    def clip(self) -> None:
        """Clips the straddlers to both sides, and counts references anew."""
        chunks, parts = self.triangle_chunks.numpy(), self.parts
        sizes = chunks["left"] + chunks["right"] - (chunks["end"] - chunks["begin"])
        added, count = int(sizes.sum()), parts.count
        places = wp.array((np.cumsum(sizes) - sizes).astype(np.int32), dtype=int, device=self.device)
        self.straddlers = wp.empty(max(1, added), dtype=wp.vec2i, device=self.device)
        self.run(list_straddlers, len(chunks), self.lists, self.triangle_chunks, places, self.straddlers)
        self.straddlers = self.straddlers[:added]
        if added:
            parts.enlarge(count + added)
            inputs = [parts.mesh, count, self.lists, self.live, self.straddlers, parts.boxes, parts.triangle]
            launch(clip_listed, added, inputs, device=self.device, chunk=64)
            self.run(count_parts, len(chunks), self.lists, self.triangle_chunks)

    def reserve(self) -> None:
        """Makes room in the children's lists for the events of the parts."""
        places, owners = self.straddlers.numpy().reshape(-1, 2).T
        side, right = self.lists.side.numpy()[places] >> 2, self.lists.right.numpy()[places]
        left = self.lists.triangle.numpy()[places]
        exists = [np.flatnonzero(side & bit) for bit in (1, 2)]
        self.part_place, self.part_side = (
            np.concatenate([places[own] for own in exists]),
            np.repeat([0, 1], [*map(len, exists)]),
        )
        self.part_id = np.concatenate([left[exists[0]], right[exists[1]]])
        self.part_child = self.nodes["left"][np.concatenate([owners[own] for own in exists])] + self.part_side
        frame = self.children["frame"]
        self.kept = frame["count"].copy()
        for axis in range(3):
            low, high = self.interval(axis)
            frame["count"][:, axis] += np.bincount(self.part_child, 1 + (low < high), len(frame)).astype(np.int32)
        counts = frame["count"].ravel()
        frame["first"] = (np.cumsum(counts) - counts).reshape(-1, 3)

    def interval(self, axis: int) -> tuple[np.ndarray, np.ndarray]:
        """Where the parts begin and end along an axis."""
        return self.boxes.low.numpy()[axis, self.part_id], self.boxes.high.numpy()[axis, self.part_id]

    def merge(self, target: LevelLists) -> None:
        """Merges the events of the parts into the children's lists, in which they have the indices of the references."""
        number = self.lists.child.numpy()[self.part_place, self.part_side]
        listed, position, value = [], [], []
        for axis in range(3):
            low, high = self.interval(axis)
            solid = low < high
            kind = np.concatenate([np.where(solid, int(START), int(PLANAR)), np.full(solid.sum(), int(END))])
            listed.append(3 * np.concatenate([self.part_child, self.part_child[solid]]) + axis)
            position.append(np.concatenate([low, high[solid]]))
            value.append(np.concatenate([number, number[solid]]) << 2 | kind)
        listed, position, value = map(np.concatenate, (listed, position, value))
        order = np.lexsort((value & 3, position, listed))
        if not len(order):
            return
        events = np.stack([position[order].view(np.int32), value[order].astype(np.int32)], axis=1)
        lists = np.unique(listed)
        sorted_lists, first = listed[order], self.children["frame"]["first"].ravel()[lists]
        bounds = [np.searchsorted(sorted_lists, lists, side=side) for side in ("left", "right")]
        ends = np.stack([first + self.kept.ravel()[lists], *bounds], axis=1).astype(np.int32)
        inputs: list[Any] = [wp.array(ends, dtype=wp.vec3i, device=self.device), wp.array(first, dtype=int, device=self.device)]
        self.run(merge_lists, len(lists), *inputs, wp.array(events, dtype=wp.vec2i, device=self.device), target)

    def make_tasks(self, spare: float) -> tuple[Reservation, EventLists, wp.array]:
        """As there; the tasks' lists name triangles."""
        reservation, lists, frames = super().make_tasks(spare)
        self.run(name_triangles, len(lists.triangle), self.parts.triangle, lists.triangle)
        return reservation, lists, frames
