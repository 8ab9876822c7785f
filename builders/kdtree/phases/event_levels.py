"""The top levels of the nested build: every large node of a level has its own sorted events, which move with it.

Each phase of a level is parallel over nodes and, within a node, over chunks of its lists (Choi et al. 2010):

    search      FindBestPlane: every chunk of events counts the triangles that begin and end in it; a scan over the chunks of a
                list gives each the counts before it; every chunk then evaluates its planes
    stop        every node takes the best plane of its chunks, and stops, or splits
    classify    every chunk of triangles finds their sides by their boxes; every chunk of events counts its events on both sides
    emit        the host lists the children and computes where each chunk writes; the only host round trip of a level
    partition   FilterGeom: every chunk moves its triangles or its events to the children's lists

The kernels are in `event_chunks`.

**Data.** The lists of a level are consecutive: node by node, the events along x, y and z. An event holds the index of its
triangle within the node, so a node with its lists is a task as it stands. Nodes that wait for the end of the levels are copied.

References:
    B. Choi, R. Komuravelli, V. Lu, H. Sung, R. L. Bocchino, S. V. Adve, J. C. Hart: Parallel SAH k-D tree construction.
        High Performance Graphics 2010.
"""

import numpy as np
import warp as wp

from wrt.builders.core.subtrees import Frame, Reservation
from wrt.builders.kdtree.events.clipped_events import lists_for
from wrt.builders.kdtree.events.event_lists import EventLists
from wrt.builders.kdtree.events.event_sort import sorted_events
from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.kdtree.phases.event_chunks import (
    CHUNK,
    EventChunk,
    EventNode,
    LevelLists,
    TriangleChunk,
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
from wrt.builders.triangle_boxes import Boxes, TriangleBoxes
from wrt.kernels.runtime.launch import launch

CHUNKS_PER_THREAD = 4
"""Chunks of items per thread in a launch: items cost about the same."""


class EventLevels:
    """The top levels while they are split. The phases of a level are called in the order of the module's docstring.

    Args:
        triangles: boxes of the mesh's triangles.
        config: cost model and stop rules.
        large: nodes of more triangles are split; the others become tasks.
    """

    def __init__(self, triangles: TriangleBoxes, config: KdTreeConfig, large: int) -> None:
        self.triangles, self.config, self.large = triangles, config, large
        self.device = triangles.boxes.low.device
        self.cost, self.limits = config.cost.struct(), config.stop.limits(triangles.count, triangles.size)
        self.levels: list[np.ndarray] = []
        """The levels that are split, structured arrays of `EventNode`."""
        events, count = sorted_events(triangles), triangles.count
        counts = np.array(events.count)
        self.nodes = np.zeros(1, dtype=EventNode.numpy_dtype())
        """The current level."""
        frame = self.nodes["frame"]
        frame["low"], frame["high"], frame["triangles"], frame["parent"] = triangles.low, triangles.high, count, -1
        frame["count"], frame["first"] = counts, np.cumsum(counts) - counts
        self.nodes["finished"] = count <= large
        self.lists = self.make_lists(int(counts.sum()), count)
        """Its lists."""
        inputs = [events, wp.vec3i(*map(int, frame["first"][0])), self.lists]
        self.run(copy_events, 3 * -(-int(counts.max()) // CHUNK), *inputs)
        launch(list_ids, count, [self.lists.triangle], device=self.device, chunk=CHUNK)

    def make_lists(self, events: int, triangles: int) -> LevelLists:
        """Lists of this many events and triangles, still empty."""
        lists = LevelLists()
        lists.event = wp.empty(events, dtype=wp.vec2i, device=self.device)
        lists.triangle = wp.empty(triangles, dtype=int, device=self.device)
        lists.right = lists.triangle
        lists.side = wp.empty(triangles, dtype=wp.uint8, device=self.device)
        lists.child = wp.empty(triangles, dtype=wp.vec2i, device=self.device)
        return lists

    def run(self, kernel: wp.Kernel, count: int, *inputs: object) -> None:
        """Launches a kernel whose items are large."""
        launch(kernel, count, inputs, device=self.device, chunk=1, chunks_per_thread=CHUNKS_PER_THREAD)

    def any_large(self) -> bool:
        """Whether a node of the current level is to be split; if not, the nodes are the roots of tasks."""
        return not self.nodes["finished"].all()

    def search(self) -> None:
        """Finds the best plane of every chunk of events."""
        self.chunks = wp.array(cut_events(self.nodes), dtype=EventChunk, device=self.device)
        self.live = wp.array(self.nodes, dtype=EventNode, device=self.device)
        self.run(count_chunks, len(self.chunks), self.lists, self.live, self.chunks)
        self.run(scan_chunks, 3 * len(self.live), self.live, self.chunks)
        self.run(search_chunks, len(self.chunks), self.cost, self.lists, self.live, self.chunks)

    def stop(self) -> None:
        """Every node becomes a leaf, or is split at the best plane of its chunks."""
        self.run(decide, len(self.live), self.cost, self.limits, self.live, self.chunks)

    def classify(self) -> None:
        """Finds the sides of all triangles, and counts triangles and events on both sides."""
        self.triangle_chunks = wp.array(cut_triangles(self.nodes), dtype=TriangleChunk, device=self.device)
        self.run(classify_triangles, len(self.triangle_chunks), self.boxes, self.lists, self.live, self.triangle_chunks)
        self.clip()
        self.run(count_sides, len(self.chunks), self.lists, self.live, self.chunks)

    def clip(self) -> None:
        """Clips the straddlers to both sides: not here."""

    def reserve(self) -> None:
        """Makes room in the children's lists for the events of clipped triangles: none here."""

    def merge(self, target: LevelLists) -> None:
        """Merges these events into the children's lists: none here."""

    @property
    def boxes(self) -> Boxes:
        """The boxes of what the lists hold."""
        return self.triangles.boxes

    def emit(self) -> None:
        """Lists the nodes of the next level, and computes where each chunk writes."""
        self.nodes, events, triangles = (a.numpy() for a in (self.live, self.chunks, self.triangle_chunks))
        self.children = next_level(self.nodes, events, triangles, self.large)
        self.reserve()
        place_chunks(events, triangles, self.nodes, self.children)
        self.chunks = wp.array(events, dtype=EventChunk, device=self.device)
        self.triangle_chunks = wp.array(triangles, dtype=TriangleChunk, device=self.device)
        self.live = wp.array(self.nodes, dtype=EventNode, device=self.device)

    def partition(self) -> None:
        """Moves triangles and events to the lists of the next level, which is then the current one."""
        frame = self.children["frame"]
        target = self.make_lists(int(frame["count"].sum()), int(frame["triangles"].sum()))
        children = wp.array(self.children, dtype=EventNode, device=self.device)
        self.run(move_triangles, len(self.triangle_chunks), self.lists, self.live, children, self.triangle_chunks, target)
        self.run(move_events, len(self.chunks), self.lists, self.live, self.chunks, target)
        self.merge(target)
        self.levels.append(self.nodes)
        self.nodes, self.lists = self.children, target

    def make_tasks(self, spare: float) -> tuple[Reservation, EventLists, wp.array]:
        """Makes one task of each node of the last level: its memory, its lists, and the roots of the tasks."""
        roots = self.nodes["frame"].copy()
        reservation = Reservation(roots["triangles"], 6, spare, self.config.cost.width, self.device)
        lists = lists_for(reservation, self.triangles, self.config)
        nodes = wp.array(self.nodes, dtype=EventNode, device=self.device)
        self.run(copy_tasks, len(roots), self.lists, nodes, reservation.tasks, lists)
        roots["first"] += (reservation.ranges["lists_first"] - roots["first"][:, 0])[:, None]
        roots["top"] = reservation.ranges["lists_first"] + roots["count"].sum(axis=1)
        return reservation, lists, wp.array(roots, dtype=Frame, device=self.device)


def cut(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Divides lists of these lengths into chunks, at least one each: the list of each chunk, and where it begins and ends."""
    pieces = np.maximum(1, -(-counts // CHUNK))
    owner = np.repeat(np.arange(len(counts)), pieces)
    begin = (np.arange(len(owner)) - (np.cumsum(pieces) - pieces)[owner]) * CHUNK
    return owner, begin, np.minimum(begin + CHUNK, counts[owner])


def cut_events(nodes: np.ndarray) -> np.ndarray:
    """The chunks of the nodes' events; stores their ranges in the nodes."""
    frame = nodes["frame"]
    owner, begin, end = cut(frame["count"].ravel())
    chunks = np.zeros(len(owner), dtype=EventChunk.numpy_dtype())
    chunks["node"], chunks["axis"] = owner // 3, owner % 3
    chunks["begin"], chunks["end"] = (frame["first"].ravel()[owner] + at for at in (begin, end))
    pieces = np.bincount(owner, minlength=3 * len(nodes))
    nodes["chunk_count"] = pieces.reshape(-1, 3)
    nodes["chunk_first"] = (np.cumsum(pieces) - pieces).reshape(-1, 3)
    return chunks


def cut_triangles(nodes: np.ndarray) -> np.ndarray:
    """The chunks of the nodes' triangles."""
    owner, begin, end = cut(nodes["frame"]["triangles"])
    chunks = np.zeros(len(owner), dtype=TriangleChunk.numpy_dtype())
    chunks["node"] = owner
    chunks["begin"], chunks["end"] = (nodes["triangles_first"][owner] + at for at in (begin, end))
    return chunks


def next_level(nodes: np.ndarray, events: np.ndarray, triangles: np.ndarray, large: int) -> np.ndarray:
    """Lists the children in order, with a finished node as its own child, and stores their indices in the nodes.

    events, triangles: the counted chunks of the nodes' events and triangles."""
    child_counts = np.where(nodes["finished"], 1, 2)
    nodes["left"] = np.cumsum(child_counts) - child_counts
    owner = np.repeat(np.arange(len(nodes)), child_counts)
    children = nodes[owner]
    frame, split = children["frame"], children["split"]
    divided = ~children["finished"]
    frame["depth"] += divided
    list_starts = nodes["chunk_first"].ravel()
    triangle_starts = np.searchsorted(triangles["node"], np.arange(len(nodes)))
    for side, moved, here in (("left", "high", 0), ("right", "low", 1)):
        of_side = np.flatnonzero(np.arange(len(children)) - nodes["left"][owner] == here)
        parent = owner[of_side]
        frame["triangles"][of_side] = np.add.reduceat(triangles[side], triangle_starts)[parent]
        frame["count"][of_side] = np.add.reduceat(events[side], list_starts).reshape(-1, 3)[parent]
        cut_off = of_side[divided[of_side]]
        frame[moved][cut_off, split["axis"][cut_off]] = split["position"][cut_off]
    children["triangles_first"] = np.cumsum(frame["triangles"]) - frame["triangles"]
    counts = frame["count"].ravel()
    frame["first"] = (np.cumsum(counts) - counts).reshape(-1, 3)
    children["finished"] |= frame["triangles"] <= large
    return children


def place_chunks(events: np.ndarray, triangles: np.ndarray, nodes: np.ndarray, children: np.ndarray) -> None:
    """Computes where each chunk writes."""
    axis = events["axis"]
    for side, here in (("left", 0), ("right", 1)):
        for chunks, first, key in (
            (triangles, children["triangles_first"], triangles["node"]),
            (events, children["frame"]["first"], 3 * events["node"] + axis),
        ):
            child = np.minimum(nodes["left"][chunks["node"]] + here, len(children) - 1)  # of a finished node unused
            start = first[child] if chunks is triangles else first[child, axis]
            before = np.cumsum(chunks[side]) - chunks[side]
            chunks[f"to_{side}"] = start + before - before[np.searchsorted(key, key)]
