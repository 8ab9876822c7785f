"""The top levels of the nested build (`wrt.builders.core.levels`): every large node has its own sorted events, which move with
it.

Each phase of a level is parallel over nodes and, within a node, over chunks of its lists (Choi et al. 2010):

    search      FindBestPlane: every chunk of events counts the triangles that begin and end in it; a scan over the chunks of a
                list gives each the counts before it; every chunk then evaluates its planes
    stop        every node takes the best plane of its chunks
    classify    every chunk of triangles finds their sides by their boxes; every chunk of events counts its events on both sides
    partition   FilterGeom: every chunk moves its triangles or its events to the children's lists

The kernels are in `event_chunks`.

**Data.** The lists of a level are consecutive: node by node, the events along x, y and z. An event holds the index of its
triangle within the node, so a node with its lists is a task as it stands. Nodes that wait for the end of the levels are copied.

**Clipping.** As in the levels of the in-place build (`clipped_levels`), lists then hold references, at first one per triangle.
A straddler is clipped to both children's cells; the part on the left keeps its number, and the one on the right gets a new one.
Here data moves with the nodes: the straddlers' events are not moved to the children's lists, which leave room for the events of
the parts. These are sorted, and merged into each list from the back, by one thread per list (`clipped_events` does the same
within a task). The kernels are in `clipped_event_chunks`.

References: wald-havran-2006; choi-2010.
"""

import numpy as np
import warp as wp

from wrt.builders.classics.kdtree.nested.clipped_event_chunks import clip_listed, count_parts, list_straddlers, merge_lists
from wrt.builders.classics.kdtree.nested.event_chunks import (
    COPIED,
    ChunkSweep,
    LevelLists,
    classify_triangles,
    copy_events,
    copy_tasks,
    count_chunks,
    count_sides,
    decide,
    list_ids,
    move_events,
    move_triangles,
    scan_chunks,
    search_chunks,
)
from wrt.builders.core.levels import (
    Chunk,
    Levels,
    LiveNode,
    both_children,
    children_of,
    cut,
    of_children,
    place,
    root_level,
    starts_of,
)
from wrt.builders.core.subtrees import Frame, Reservation
from wrt.builders.kdtree.events.clipped_events import lists_for
from wrt.builders.kdtree.events.event_lists import EventLists
from wrt.builders.kdtree.events.event_sort import sorted_events
from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.kdtree.phases.clipped_levels import ClippedReferences, events_of, name_triangles
from wrt.builders.triangle_boxes import Boxes, TriangleBoxes
from wrt.kernels.runtime.launch import launch


class EventLevels(Levels):
    """The top levels while they are split.

    Args:
        triangles: boxes of the mesh's triangles.
        config: cost model and stop rules, and whether triangles are clipped.
        large: nodes of more triangles are split; the others become tasks.
    """

    def __init__(self, triangles: TriangleBoxes, config: KdTreeConfig, large: int) -> None:
        super().__init__(triangles.boxes.low.device, root_level(triangles))
        self.triangles, (self.cost, self.limits) = triangles, config.rules(triangles)
        self.config, self.large, count = config, large, triangles.count
        self.parts = ClippedReferences(triangles, config.split_clipping) if config.tests_nodes else None
        """What the lists hold in place of triangles, if they are clipped."""
        events = sorted_events(triangles)
        counts = np.array(events.count)
        frame = self.nodes["frame"]
        frame["count"], frame["first"] = counts, starts_of(counts)
        self.nodes["finished"] = count <= large
        self.lists = self.make_lists(int(counts.sum()), count)
        """The lists of the current level."""
        inputs = [events, wp.vec3i(*map(int, frame["first"][0])), self.lists]
        self.run(copy_events, 3 * -(-int(counts.max()) // COPIED), *inputs)
        launch(list_ids, count, [self.lists.triangle], device=self.device, chunk=COPIED)

    @property
    def boxes(self) -> Boxes:
        """The boxes of what the lists hold."""
        return self.parts.boxes if self.parts else self.triangles.boxes

    def make_lists(self, events: int, triangles: int) -> LevelLists:
        """Lists of this many events and triangles, still empty."""
        lists = LevelLists()
        lists.event = wp.empty(events, dtype=wp.vec2i, device=self.device)
        lists.triangle = wp.empty(triangles, dtype=int, device=self.device)
        lists.right = wp.empty(triangles, dtype=int, device=self.device) if self.parts else lists.triangle
        lists.side = wp.empty(triangles, dtype=wp.uint8, device=self.device)
        lists.child = wp.empty(triangles, dtype=wp.vec2i, device=self.device)
        return lists

    def search(self) -> None:
        """Finds the best plane of every chunk of events."""
        frame = self.nodes["frame"]
        chunks, self.nodes["chunk_first"], self.nodes["chunk_count"] = cut(frame["first"], frame["count"])
        self.chunks = wp.array(chunks, dtype=Chunk, device=self.device)
        self.sweeps = wp.empty(len(chunks), dtype=ChunkSweep, device=self.device)
        self.live = wp.array(self.nodes, dtype=LiveNode, device=self.device)
        self.run(count_chunks, len(chunks), self.lists, self.live, self.chunks, self.sweeps)
        self.run(scan_chunks, 3 * len(self.live), self.live, self.sweeps)
        self.run(search_chunks, len(chunks), self.cost, self.lists, self.live, self.chunks, self.sweeps)

    def stop(self) -> None:
        """Every node becomes a leaf, or is split at the best plane of its chunks."""
        self.run(decide, len(self.live), self.cost, self.limits, self.live, self.sweeps)

    def classify(self) -> None:
        """Finds the sides of all triangles, and counts triangles and events on both sides."""
        triangles = self.nodes["triangles_first"][:, None], self.nodes["frame"]["triangles"][:, None]
        chunks, self.list_first, _ = cut(*triangles)
        self.triangle_chunks = wp.array(chunks, dtype=Chunk, device=self.device)
        self.run(classify_triangles, len(chunks), self.boxes, self.lists, self.live, self.triangle_chunks)
        if self.parts:
            self.clip(self.parts)
        self.run(count_sides, len(self.chunks), self.lists, self.live, self.chunks)

    def emit(self) -> None:
        """Lists the children, and computes where each chunk writes."""
        self.nodes = nodes = self.live.numpy()
        events, triangles = self.chunks.numpy(), self.triangle_chunks.numpy()
        self.children = children = children_of(nodes)
        frame = children["frame"]

        def counted(chunks: np.ndarray, first: np.ndarray) -> np.ndarray:
            sides = (np.add.reduceat(chunks[side], first.ravel()).reshape(first.shape) for side in ("left", "right"))
            return of_children(nodes, *sides)

        frame["triangles"] = counted(triangles, self.list_first)[:, 0]
        frame["count"] = counted(events, nodes["chunk_first"])
        if self.parts:
            self.reserve()
        children["triangles_first"], frame["first"] = starts_of(frame["triangles"]), starts_of(frame["count"])
        children["finished"] |= frame["triangles"] <= self.large
        place(triangles, *both_children(nodes, children["triangles_first"][:, None]))
        place(events, *both_children(nodes, frame["first"]))
        self.chunks = wp.array(events, dtype=Chunk, device=self.device)
        self.triangle_chunks = wp.array(triangles, dtype=Chunk, device=self.device)
        self.live = wp.array(nodes, dtype=LiveNode, device=self.device)

    def partition(self) -> None:
        """Moves triangles and events to the lists of the next level."""
        frame = self.children["frame"]
        target = self.make_lists(int(frame["count"].sum()), int(frame["triangles"].sum()))
        children = wp.array(self.children, dtype=LiveNode, device=self.device)
        self.run(move_triangles, len(self.triangle_chunks), self.lists, self.live, children, self.triangle_chunks, target)
        self.run(move_events, len(self.chunks), self.lists, self.live, self.chunks, target)
        if self.parts:
            self.merge(target)
        self.levels.append(self.nodes)
        self.nodes, self.lists = self.children, target

    # -- clipping --------------------------------------------------------------------------------------------------------

    def clip(self, parts: ClippedReferences) -> None:
        """Clips the straddlers to both sides, and counts references anew."""
        chunks = self.triangle_chunks.numpy()
        sizes = chunks["left"] + chunks["right"] - (chunks["end"] - chunks["begin"])
        added, count = int(sizes.sum()), parts.count
        places = wp.array(starts_of(sizes).astype(np.int32), dtype=int, device=self.device)
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
        side = self.lists.side.numpy()[places] >> 2
        ids = [ids.numpy()[places] for ids in (self.lists.triangle, self.lists.right)]
        exists = [np.flatnonzero(side & bit) for bit in (1, 2)]
        self.part_side = np.repeat([0, 1], [*map(len, exists)])
        self.part_place = np.concatenate([places[own] for own in exists])
        self.part_id = np.concatenate([of_side[own] for of_side, own in zip(ids, exists, strict=True)])
        self.part_child = self.nodes["left"][np.concatenate([owners[own] for own in exists])] + self.part_side
        count = self.children["frame"]["count"]
        self.kept = count.copy()
        for axis in range(3):
            which, _, _ = events_of(self.boxes, axis, self.part_id, self.part_id)
            count[:, axis] += np.bincount(self.part_child[which], minlength=len(count)).astype(np.int32)

    def merge(self, target: LevelLists) -> None:
        """Merges the events of the parts into the children's lists, in which they have the indices of the references."""
        number = self.lists.child.numpy()[self.part_place, self.part_side]
        listed, position, value = [], [], []
        for axis in range(3):
            which, at, of_axis = events_of(self.boxes, axis, self.part_id, number)
            listed.append(3 * self.part_child[which] + axis)
            position.append(at)
            value.append(of_axis)
        listed, position, value = map(np.concatenate, (listed, position, value))
        order = np.lexsort((value & 3, position, listed))
        if not len(order):
            return
        events = np.stack([position[order].view(np.int32), value[order].astype(np.int32)], axis=1)
        lists = np.unique(listed)
        sorted_lists, first = listed[order], self.children["frame"]["first"].ravel()[lists]
        bounds = [np.searchsorted(sorted_lists, lists, side=side) for side in ("left", "right")]
        ends = np.stack([first + self.kept.ravel()[lists], *bounds], axis=1).astype(np.int32)
        inputs = [wp.array(ends, dtype=wp.vec3i, device=self.device), wp.array(first, dtype=int, device=self.device)]
        self.run(merge_lists, len(lists), *inputs, wp.array(events, dtype=wp.vec2i, device=self.device), target)

    # -- tasks -----------------------------------------------------------------------------------------------------------

    def make_tasks(self, spare: float) -> tuple[Reservation, EventLists, wp.array]:
        """Makes one task of each node of the last level: its memory, its lists, and the roots of the tasks."""
        roots = self.nodes["frame"].copy()
        reservation = Reservation(roots["triangles"], 6, spare, self.config.cost.width, self.device)
        lists = lists_for(reservation, self.triangles, self.config)
        nodes = wp.array(self.nodes, dtype=LiveNode, device=self.device)
        self.run(copy_tasks, len(roots), self.lists, nodes, reservation.tasks, lists)
        if self.parts:
            self.run(name_triangles, len(lists.triangle), self.parts.triangle, lists.triangle)
        roots["first"] += (reservation.ranges["lists_first"] - roots["first"][:, 0])[:, None]
        roots["top"] = reservation.ranges["lists_first"] + roots["count"].sum(axis=1)
        return reservation, lists, wp.array(roots, dtype=Frame, device=self.device)
