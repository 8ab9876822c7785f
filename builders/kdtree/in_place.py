"""In-place parallel build of an SAH kd-tree (Choi et al. 2010).

**Problem.** A depth-first build has one node, then two, then four to share among the cores, and meanwhile copies every list at
every level.

**Algorithm.** The events of all triangles are sorted once per axis (`event_sort`). The top levels are built breadth first, in
parallel over the geometry and in place: nodes are assigned to triangles, triangles are not moved to nodes (`in_place_levels`).
As soon as there are enough live nodes, each becomes a task that builds its subtree depth first (`core.subtrees`). The parts
are then assembled in depth-first order (`assembly`). The SAH is exact everywhere: every plane at which a triangle's box starts
or ends is tried.

**Data.** Sorted events of the whole mesh (`event_sort`), and for each triangle the list of its nodes (`membership.Membership`);
in the tasks, sorted events per node (`event_lists`).

**Phases.** Sort: `sorted_events`. Top levels: `search`, `stop`, `emit` and `classify` of `InPlaceBuilder`, for one level after
the other; no triangle is moved. Fill: `make_tasks` copies events and triangles to the tasks. Subtrees: the phases of
`event_method`. Assembly: `assemble`.

**Complexity.** O(N log N): the sort, then O(N) per level.

**What we changed.** The paper builds breadth first while a level has fewer nodes than cores; here until it has several times as
many, so that tasks balance. Sweeps start from the counts of the preceding chunks, as in the same paper's nested algorithm,
instead of from a shared counter. The split of a node does not depend on the phase in which it is built, so the tree is the same
for any number of threads, chunks and tasks, also if triangles are clipped, in the levels (`clipped_levels`) and in the tasks
(`clipped_events`).

References:
    B. Choi, R. Komuravelli, V. Lu, H. Sung, R. L. Bocchino, S. V. Adve, J. C. Hart: Parallel SAH k-D tree construction.
        High Performance Graphics 2010.
    V. Rahikainen: On real-time ray tracing. M.Sc. thesis, University of Tampere, 2013 (section 4.2, algorithm 4.2.2).
"""

from functools import partial
from typing import NamedTuple

import numpy as np
import warp as wp

from wrt.builders.core.subtrees import (
    Frame,
    Method,
    Reservation,
    build_tasks,
    make_build_subtrees,
)
from wrt.builders.cost import AxisFrame, SplitCost
from wrt.builders.kdtree.events.clipped_events import arrays_of, lists_for
from wrt.builders.kdtree.events.event_lists import EventLists
from wrt.builders.kdtree.events.event_method import event_method
from wrt.builders.kdtree.events.event_sort import CHUNK, EVENT_CHUNK, Events, emit_events, sorted_events
from wrt.builders.kdtree.events.sweep_planes import Sweep
from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.kdtree.phases import in_place_levels as level_phase
from wrt.builders.kdtree.phases import level_members as members_phase
from wrt.builders.kdtree.phases import task_fill as fill_phase
from wrt.builders.kdtree.phases.assembly import assemble, copy_subtrees
from wrt.builders.kdtree.phases.clipped_levels import ClippedReferences, merge_events, name_triangles
from wrt.builders.kdtree.phases.in_place_levels import LiveNode
from wrt.builders.kdtree.phases.membership import Membership
from wrt.builders.tree import KdTree, Phases, StopLimits
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.kernels.layout.struct_arrays import array_of_structs
from wrt.kernels.runtime.launch import get_num_threads, launch, load, specialise

MIN_TASKS = 8
"""Least number of live nodes at which the build switches to subtrees, with two to eight threads; with more, one per thread.
Small, because every level that the threads split together costs each of them a pass over memory
(notebooks/records/2026-11-22-scaling.md)."""

LARGEST_SHARE = 1.2
"""Greatest size of a live node at which the build switches to subtrees, in triangles of the mesh per thread: one large subtree
would keep its thread busy after all others have finished (notebooks/records/2026-11-22-scaling.md)."""

MAX_LEVELS = 12
"""Levels after which the build switches to subtrees whatever the number of live nodes."""

SPARE_MEMORY = 1.5
"""Working memory of a task relative to its own lists; doubled whenever it is too small."""

ITEM_CHUNKS_PER_THREAD = 8
"""Chunks of items per thread: enough to balance the load, because claiming a chunk costs almost nothing."""

EVENTS_PER_NODE = 256
"""Events of a chunk per live node; a chunk stores a few hundred bytes for each live node."""

CHUNKS_PER_THREAD = 4
"""Least number of chunks per thread, over all axes, if there are enough events."""

KERNELS = (emit_events, level_phase.search_planes, members_phase.count_shared, fill_phase.fill_task_events, copy_subtrees)
"""One kernel of each module, compiled before the phases of the build are timed."""


SCAN_COUNTS = 4096
"""Counts per block of the scan over chunks."""


class TaskTarget(NamedTuple):
    """When the build switches from levels to subtrees.

    Attributes:
        tasks: least number of live nodes.
        triangles: greatest number of triangles of a live node.
    """

    tasks: int
    triangles: int


def build(triangles: TriangleBoxes, config: KdTreeConfig) -> KdTree:
    """Builds the tree on the device that holds the boxes."""
    return build_in_place(triangles, config, event_method(config), task_target(triangles.count))


def task_target(count: int) -> TaskTarget:
    """Tasks that balance the load of the threads."""
    threads = get_num_threads()
    return TaskTarget(max(threads, min(4 * threads, MIN_TASKS)), int(LARGEST_SHARE * count / threads))


def build_in_place(triangles: TriangleBoxes, config: KdTreeConfig, method: Method, target: TaskTarget) -> KdTree:
    """Builds the tree; levels are split together until the live nodes meet the target. method: what tasks do with a node."""
    builder = InPlaceBuilder(triangles, config)
    clipping = (merge_events,) if config.tests_nodes else ()
    load((*KERNELS, *clipping, specialise(make_build_subtrees, method)), builder.device)
    with builder.phase("sort"):
        events = sorted_events(triangles)
    with builder.phase("top levels"):
        membership = builder.build_levels(events, target)
    tasks = partial(builder.make_tasks, events, membership)
    reservation, lists, results = build_tasks(method, config.rules(triangles), tasks, SPARE_MEMORY, builder.phase, "fill")
    work = [events.position, events.value, membership.node, membership.shared, *arrays_of(lists)]
    return assemble(triangles, config, builder.phase, builder.levels[:-1], (reservation, results), work)


def cut_events(events: Events, nodes: int) -> int:
    """Sets the size of chunks for this number of live nodes; returns the number of chunks of an axis."""
    most = max(events.count)
    longest = max(EVENT_CHUNK, -(-3 * most // (CHUNKS_PER_THREAD * get_num_threads())))
    events.chunk = min(max(EVENT_CHUNK, EVENTS_PER_NODE * nodes), longest)
    return max(1, -(-most // events.chunk))


class InPlaceBuilder:
    """The state of one build."""

    def __init__(self, triangles: TriangleBoxes, config: KdTreeConfig) -> None:
        self.triangles = triangles
        self.config = config
        self.device = triangles.boxes.low.device
        self.cost: SplitCost = config.cost.struct()
        self.limits: StopLimits = config.stop.limits(triangles.count, triangles.size)
        self.width = config.cost.width
        self.phase = Phases(self.device)
        self.parts = ClippedReferences(triangles, config.split_clipping) if config.tests_nodes else None
        """What is classified in place of triangles, if they are clipped."""
        self.levels: list[np.ndarray] = []
        """Live nodes of each level so far."""
        root = LiveNode()
        root.low = wp.vec3(*triangles.low)
        root.high = wp.vec3(*triangles.high)
        root.triangles = triangles.count
        self.live = array_of_structs([root], LiveNode, self.device)

    @property
    def count(self) -> int:
        """Triangles, or references to them."""
        return self.parts.count if self.parts else self.triangles.count

    def run(self, kernel: wp.Kernel, count: int, *inputs: object, chunk: int = 1) -> None:
        """Launches a kernel on the build's device."""
        launch(kernel, count, inputs, device=self.device, chunk=chunk, chunks_per_thread=ITEM_CHUNKS_PER_THREAD)

    def build_levels(self, events: Events, target: TaskTarget) -> Membership:
        """Builds level after level until the live nodes meet the target; returns the nodes that contain each triangle."""
        membership = Membership()
        membership.node = wp.zeros(self.triangles.count, dtype=int, device=self.device)
        membership.shared = wp.empty(1, dtype=int, device=self.device)
        open_nodes, largest = 1, self.triangles.count
        while open_nodes > 0 and len(self.levels) < MAX_LEVELS and (open_nodes < target.tasks or largest > target.triangles):
            self.search(events, membership)
            self.stop()
            children, open_nodes, largest = self.emit()
            parts, parents = self.parts, self.live
            membership = parts.classify(events, membership, parents) if parts else self.classify(membership)
            self.levels.append(self.live.numpy())
            self.live = children
            if parts:
                self.count_members(membership)
        self.count_members(membership)
        self.levels.append(self.live.numpy())
        return membership

    def count_members(self, membership: Membership) -> None:
        """Sets the triangle counts of the last level's nodes to the actual numbers, because what is copied to them must fit.
        The counts of a sweep may differ if there is NaN."""
        chunks = -(-self.count // CHUNK)
        self.members = wp.empty((chunks, len(self.live)), dtype=int, device=self.device)
        self.run(fill_phase.count_task_triangles, chunks, self.count, membership, self.members)
        self.run(fill_phase.total_triangles, len(self.live), self.members, self.live, chunk=64)

    def search(self, events: Events, membership: Membership) -> None:
        """Finds the best plane of every live node, in each chunk of events."""
        nodes = len(self.live)
        chunks = cut_events(events, nodes)
        counts = wp.empty((3, chunks, nodes), dtype=wp.vec3i, device=self.device)
        frames = wp.empty((3, chunks, nodes), dtype=AxisFrame, device=self.device)
        self.sweeps = sweeps = wp.empty((3, chunks, nodes), dtype=Sweep, device=self.device)
        self.run(level_phase.count_events, 3 * chunks, events, membership, counts)
        min_known_cost = self.scan(events, counts)
        work = [membership, self.live, counts, min_known_cost, frames, sweeps]
        self.run(level_phase.search_planes, 3 * chunks, self.cost, events, *work)

    def scan(self, events: Events, counts: wp.array) -> wp.array:
        """Turns counts of chunks into the counts before them; returns each node's least cost of its first
        planes in the chunks."""
        chunks, nodes = counts.shape[1:]
        block_chunks = max(1, SCAN_COUNTS // nodes)
        blocks = -(-chunks // block_chunks)
        before = wp.zeros((3, blocks, nodes), dtype=wp.vec2i, device=self.device)
        if blocks > 1:
            self.run(level_phase.sum_blocks, 3 * blocks, block_chunks, counts, before)
            self.run(level_phase.scan_blocks, 3, before)
        block_cost = wp.empty((3, blocks, nodes), dtype=float, device=self.device)
        self.run(level_phase.scan_chunks, 3 * blocks, self.cost, events, self.live, block_chunks, counts, before, block_cost)
        min_known_cost = wp.empty(nodes, dtype=float, device=self.device)
        self.run(level_phase.min_of_blocks, nodes, block_cost, min_known_cost, chunk=64)
        return min_known_cost

    def stop(self) -> None:
        """Takes the best plane of all chunks; a node becomes a leaf, or is split there."""
        self.run(level_phase.decide, len(self.live), self.cost, self.limits, self.sweeps, self.live, chunk=16)

    def emit(self) -> tuple[wp.array, int, int]:
        """The next level's live nodes, how many of them may be split, and the triangles of the largest of these."""
        children = wp.empty(2 * len(self.live), dtype=LiveNode, device=self.device)
        counts = wp.empty(3, dtype=int, device=self.device)
        self.run(level_phase.emit_children, 1, self.live, children, counts)
        total, open_nodes, largest = map(int, counts.numpy())
        return children[:total], open_nodes, largest

    def classify(self, membership: Membership) -> Membership:
        """Computes the triangles' nodes on the next level."""
        count, boxes, device = self.triangles.count, self.triangles.boxes, self.device
        chunks = -(-count // CHUNK)
        counts = wp.empty(chunks, dtype=int, device=device)
        refined = Membership()
        refined.node = wp.empty(count, dtype=int, device=device)
        self.run(members_phase.count_shared, chunks, count, boxes, self.live, membership, refined, counts)
        sizes = counts.numpy()
        places = wp.array(np.cumsum(sizes) - sizes, dtype=int, device=device)
        refined.shared = wp.empty(max(1, int(sizes.sum())), dtype=int, device=device)
        self.run(members_phase.refine_members, chunks, count, boxes, self.live, membership, refined, places)
        return refined

    def make_tasks(self, events: Events, membership: Membership, spare: float) -> tuple[Reservation, EventLists, wp.array]:
        """Makes one task of each live node: its triangles, events and working memory. Also returns the roots of the tasks."""
        reservation = Reservation(self.levels[-1]["triangles"], 6, spare, self.width, self.device)
        lists = lists_for(reservation, self.triangles, self.config)
        frames = wp.empty(len(reservation.tasks), dtype=Frame, device=self.device)
        self.run(fill_phase.make_roots, len(reservation.tasks), self.live, frames, chunk=64)
        self.copy_to_tasks(events, membership, reservation.tasks, lists, frames)
        return reservation, lists, frames

    def copy_to_tasks(
        self, events: Events, membership: Membership, tasks: wp.array, lists: EventLists, frames: wp.array
    ) -> None:
        """Copies triangles and events to their tasks."""
        count, device = self.count, self.device
        chunks = -(-count // CHUNK)
        places = wp.empty((chunks, len(tasks)), dtype=int, device=device)
        local = Membership()
        local.node = wp.empty(count, dtype=int, device=device)
        local.shared = wp.empty(len(membership.shared), dtype=int, device=device)
        self.run(fill_phase.scan_task_triangles, len(tasks), tasks, self.members, places, chunk=64)
        self.run(fill_phase.fill_task_triangles, chunks, count, membership, tasks, places, local, lists)
        if self.parts:
            self.run(name_triangles, len(lists.triangle), self.parts.triangle, lists.triangle, chunk=CHUNK)
        chunks = cut_events(events, len(tasks))
        places = wp.empty((3, chunks, len(tasks)), dtype=int, device=device)
        self.run(fill_phase.count_task_events, 3 * chunks, events, membership, places)
        self.run(fill_phase.scan_task_events, len(tasks), tasks, places, frames, chunk=64)
        self.run(fill_phase.fill_task_events, 3 * chunks, events, membership, local, places, lists)
