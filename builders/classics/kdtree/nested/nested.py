"""Nested parallel build of an SAH kd-tree: parallel over nodes and within nodes (Choi et al. 2010).

**Problem.** The sequential build (`sweep`) has one node, then two, then four to share among the cores. Most of the time at the
top goes into passes over long lists of events, which a single thread makes.

**Algorithm.** The build is the sequential one, with both levels of parallelism nested. Nodes are independent of each other.
Within a large node, the lists of events are divided into chunks. The search takes three steps: each chunk counts its starts and
ends; a sum over the chunks gives the counts before each of them; each chunk then evaluates its planes, and the best plane of
all chunks is the node's. The lists are divided in three steps too: each chunk counts its events on both sides; a sum gives the
places; each chunk moves its events. The SAH is exact everywhere, so the tree is that of `sweep`.

**Steps.** The levels of large nodes (`wrt.builders.core.levels`), each phase parallel over nodes and, within a node, over
chunks of its lists (`event_chunks`, `clipped_event_chunks`):

    search      FindBestPlane: every chunk of events counts the triangles that begin and end in it; a scan over the chunks of a
                list gives each the counts before it; every chunk then evaluates its planes
    stop        every node takes the best plane of its chunks
    classify    every chunk of triangles finds their sides by their boxes; every chunk of events counts its events on both sides
    partition   FilterGeom: every chunk moves its triangles or its events to the children's lists

The other nodes are tasks of one pool, each of which builds a subtree depth first by the phases of `event_method`; `assemble`
combines the parts.

**Data.** One list of sorted events per axis and node, as in `sweep`: data moves with the nodes. This is the difference to
`in_place`, in which events stay where they are. The lists of a level are consecutive: node by node, the events along x, y and
z. An event holds the index of its triangle within the node, so a node with its lists is a task as it stands. Nodes that wait
for the end of the levels are copied.

**Clipping.** As in the levels of the in-place build (`clipped_levels`), lists then hold references, at first one per triangle.
A straddler is clipped to both children's cells; the part on the left keeps its number, and the one on the right gets a new one.
Here data moves with the nodes: the straddlers' events are not moved to the children's lists, which leave room for the events of
the parts. These are sorted, and merged into each list from the back, by one thread per list (`clipped_events` does the same
within a task).

**Complexity.** O(N log N): the sort, then O(N) per level.

**What we changed.** The paper makes a task of each node. Here the large nodes of a level are one batch, and its chunks are
shared among the threads. The paper does not classify in parallel, because marks that threads write share cache lines. Here
triangles are classified by their boxes, in chunks of a node's list of triangles, so each chunk writes its own range. The tree
is the same for any number of threads, chunks and tasks, also if triangles are clipped.

References: choi-2010; wald-havran-2006; rahikainen-2013 (section 4.2).
"""

import numpy as np
import warp as wp

from wrt.builders.classics.kdtree.nested import clipped_event_chunks as clip_phase
from wrt.builders.classics.kdtree.nested import event_chunks as chunk_phase
from wrt.builders.classics.kdtree.nested.event_chunks import COPIED, ChunkSweep, LevelLists
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
from wrt.builders.core.subtrees import Frame, Reservation, build_tasks, make_build_subtrees
from wrt.builders.kdtree.events.clipped_events import arrays_of, lists_for
from wrt.builders.kdtree.events.event_lists import EventLists
from wrt.builders.kdtree.events.event_method import event_method
from wrt.builders.kdtree.events.event_sort import emit_events, sorted_events
from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.kdtree.phases.assembly import assemble, copy_subtrees
from wrt.builders.kdtree.phases.clipped_levels import ClippedReferences, events_of, name_triangles
from wrt.builders.tree import KdTree, Phases
from wrt.builders.triangle_boxes import Boxes, TriangleBoxes
from wrt.kernels.runtime.launch import get_num_threads, launch, load, specialise

TASKS_PER_THREAD = 2
"""Tasks per thread that define a large node: one with more than the average share of triangles is split by all threads."""

MIN_LARGE = 1 << 12
"""Triangles below which a node is not worth more than one thread."""


def large_node(count: int) -> int:
    """Nodes of more triangles are split by all threads."""
    threads = get_num_threads()
    return max(MIN_LARGE, count // (TASKS_PER_THREAD * threads)) if threads > 1 else count


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
        self.run(chunk_phase.copy_events, 3 * -(-int(counts.max()) // COPIED), *inputs)
        launch(chunk_phase.list_ids, count, [self.lists.triangle], device=self.device, chunk=COPIED)

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
        self.run(chunk_phase.count_chunks, len(chunks), self.lists, self.live, self.chunks, self.sweeps)
        self.run(chunk_phase.scan_chunks, 3 * len(self.live), self.live, self.sweeps)
        self.run(chunk_phase.search_chunks, len(chunks), self.cost, self.lists, self.live, self.chunks, self.sweeps)

    def stop(self) -> None:
        """Every node becomes a leaf, or is split at the best plane of its chunks."""
        self.run(chunk_phase.decide, len(self.live), self.cost, self.limits, self.live, self.sweeps)

    def classify(self) -> None:
        """Finds the sides of all triangles, and counts triangles and events on both sides."""
        triangles = self.nodes["triangles_first"][:, None], self.nodes["frame"]["triangles"][:, None]
        chunks, self.list_first, _ = cut(*triangles)
        self.triangle_chunks = wp.array(chunks, dtype=Chunk, device=self.device)
        self.run(chunk_phase.classify_triangles, len(chunks), self.boxes, self.lists, self.live, self.triangle_chunks)
        if self.parts:
            self.clip(self.parts)
        self.run(chunk_phase.count_sides, len(self.chunks), self.lists, self.live, self.chunks)

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
        self.run(
            chunk_phase.move_triangles, len(self.triangle_chunks), self.lists, self.live, children, self.triangle_chunks, target
        )
        self.run(chunk_phase.move_events, len(self.chunks), self.lists, self.live, self.chunks, target)
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
        self.run(clip_phase.list_straddlers, len(chunks), self.lists, self.triangle_chunks, places, self.straddlers)
        self.straddlers = self.straddlers[:added]
        if added:
            parts.enlarge(count + added)
            inputs = [parts.mesh, count, self.lists, self.live, self.straddlers, parts.boxes, parts.triangle]
            launch(clip_phase.clip_listed, added, inputs, device=self.device, chunk=64)
            self.run(clip_phase.count_parts, len(chunks), self.lists, self.triangle_chunks)

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
        self.run(clip_phase.merge_lists, len(lists), *inputs, wp.array(events, dtype=wp.vec2i, device=self.device), target)

    # -- tasks -----------------------------------------------------------------------------------------------------------

    def make_tasks(self, spare: float) -> tuple[Reservation, EventLists, wp.array]:
        """Makes one task of each node of the last level: its memory, its lists, and the roots of the tasks."""
        roots = self.nodes["frame"].copy()
        reservation = Reservation(roots["triangles"], 6, spare, self.config.cost.width, self.device)
        lists = lists_for(reservation, self.triangles, self.config)
        nodes = wp.array(self.nodes, dtype=LiveNode, device=self.device)
        self.run(chunk_phase.copy_tasks, len(roots), self.lists, nodes, reservation.tasks, lists)
        if self.parts:
            self.run(name_triangles, len(lists.triangle), self.parts.triangle, lists.triangle)
        roots["first"] += (reservation.ranges["lists_first"] - roots["first"][:, 0])[:, None]
        roots["top"] = reservation.ranges["lists_first"] + roots["count"].sum(axis=1)
        return reservation, lists, wp.array(roots, dtype=Frame, device=self.device)


def build(triangles: TriangleBoxes, config: KdTreeConfig) -> KdTree:
    """Builds the tree on the device that holds the boxes."""
    phase, method = Phases(triangles.boxes.low.device), event_method(config)
    kernels = [emit_events, chunk_phase.search_chunks, copy_subtrees, specialise(make_build_subtrees, method)]
    load([*kernels, clip_phase.merge_lists] if config.tests_nodes else kernels, phase.device)
    with phase("sort"):
        levels = EventLevels(triangles, config, large_node(triangles.count))
    with phase("top levels"):
        levels.split()
    reservation, lists, results = build_tasks(method, config.rules(triangles), levels.make_tasks, phase=phase, name="copy")
    work = [levels.lists.event, levels.lists.triangle, levels.lists.child, *arrays_of(lists)]
    return assemble(triangles, config, phase, levels.levels, (reservation, results), work)
