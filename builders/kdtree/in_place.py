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

**Phases.** Sort: `sorted_events`. Top levels: those of `InPlaceLevels`; no triangle is moved. Fill: `make_tasks` copies events
and triangles to the tasks. Subtrees: the phases of `event_method`. Assembly: `assemble`.

**Complexity.** O(N log N): the sort, then O(N) per level.

**What we changed.** The paper builds breadth first while a level has fewer nodes than cores; here until it has several times as
many, so that tasks balance. Sweeps start from the counts of the preceding chunks, as in the same paper's nested algorithm,
instead of from a shared counter. The split of a node does not depend on the phase in which it is built, so the tree is the same
for any number of threads, chunks and tasks, also if triangles are clipped, in the levels (`clipped_levels`) and in the tasks
(`clipped_events`).

On CUDA the same tree is built by levels alone (`wrt.builders.kdtree.levelwise.levelwise_build`); only builds that clip have
levels and tasks there too, each of which is one thread's.

References: choi-2010; rahikainen-2013 (section 4.2, algorithm 4.2.2).
"""

from typing import NamedTuple

import numpy as np
import warp as wp

from wrt.builders.core.levels import Levels, LiveNode, children_of, of_children, root_level, starts_of
from wrt.builders.core.subtrees import (
    Frame,
    Method,
    Reservation,
    build_tasks,
    make_build_subtrees,
)
from wrt.builders.cost import AxisFrame
from wrt.builders.kdtree.events.clipped_events import arrays_of, lists_for
from wrt.builders.kdtree.events.event_lists import EventLists
from wrt.builders.kdtree.events.event_method import event_method
from wrt.builders.kdtree.events.event_sort import Events, emit_events, item_sizes, sorted_events
from wrt.builders.kdtree.events.sweep_planes import Sweep
from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.kdtree.levelwise import levelwise_build
from wrt.builders.kdtree.phases import in_place_levels as level_phase
from wrt.builders.kdtree.phases import task_fill as fill_phase
from wrt.builders.kdtree.phases.assembly import assemble, copy_subtrees
from wrt.builders.kdtree.phases.clipped_levels import ClippedReferences, merge_events, name_triangles
from wrt.builders.kdtree.phases.membership import Membership, count_shared, refine_members
from wrt.builders.tree import KdTree, Phases
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.kernels.runtime.launch import get_num_threads, load, specialise

MIN_TASKS = 8
"""Least number of live nodes at which the build switches to subtrees, with two to eight threads; with more, one per thread.
Small, because every level that the threads split together costs each of them a pass over memory
(notebooks/records/2026-11-22-scaling.md)."""

LARGEST_SHARE = 1.2
"""Greatest size of a live node at which the build switches to subtrees, in triangles of the mesh per thread: one large subtree
would keep its thread busy after all others have finished (notebooks/records/2026-11-22-scaling.md)."""

MAX_LEVELS = 12
"""Levels after which the build switches to subtrees whatever the number of live nodes."""

ITEM_CHUNKS_PER_THREAD = 8
"""Chunks of items per thread: enough to balance the load, because claiming a chunk costs almost nothing."""

EVENTS_PER_NODE = 256
"""Events of a chunk per live node; a chunk stores a few hundred bytes for each live node."""

CHUNKS_PER_THREAD = 4
"""Least number of chunks per thread, over all axes, if there are enough events."""

CUDA_THREADS = 1 << 14
"""Threads of a CUDA device that work at a time, at least."""

CUDA_TASKS = 1024
"""Least number of live nodes at which the build switches to subtrees on CUDA, where each is one thread's."""

NAMED = 4096
"""Triangles of clipped references that are named at a time."""

BEST_TOGETHER = 64
"""Chunks on CUDA among which one thread selects a node's best plane."""

KERNELS = (emit_events, level_phase.search_planes, count_shared, fill_phase.fill_task_events, copy_subtrees)
"""One kernel of each module, compiled before the phases of the build are timed."""


class TaskTarget(NamedTuple):
    """When the build switches from levels to subtrees.

    Attributes:
        tasks: least number of live nodes.
        triangles: greatest number of triangles of a live node.
    """

    tasks: int
    triangles: int


def build(triangles: TriangleBoxes, config: KdTreeConfig) -> KdTree:
    """Builds the tree on the device that holds the boxes; on CUDA by levels alone, unless triangles are clipped."""
    if triangles.boxes.low.device.is_cuda and is_by_levels(config):
        return levelwise_build.build(triangles, config)
    return build_in_place(triangles, config, event_method(config), task_target(triangles.count, triangles.boxes.low.device))


def is_by_levels(config: KdTreeConfig) -> bool:
    """Whether CUDA builds the tree by levels alone (`wrt.builders.kdtree.levelwise`)."""
    return not config.tests_nodes


def task_target(count: int, device: wp.Device) -> TaskTarget:
    """Tasks that balance the load of the threads."""
    threads = get_num_threads()
    if device.is_cuda:
        return TaskTarget(CUDA_TASKS, count)
    return TaskTarget(max(threads, min(4 * threads, MIN_TASKS)), int(LARGEST_SHARE * count / threads))


def build_in_place(triangles: TriangleBoxes, config: KdTreeConfig, method: Method, target: TaskTarget) -> KdTree:
    """Builds the tree; levels are split together until the live nodes meet the target. method: what tasks do with a node."""
    device = triangles.boxes.low.device
    phase, clipping = Phases(device), (merge_events,) if config.tests_nodes else ()
    load((*KERNELS, *clipping, specialise(make_build_subtrees, method)), device)
    with phase("sort"):
        events = sorted_events(triangles)
    with phase("top levels"):
        levels = InPlaceLevels(triangles, config, target, events)
        levels.split()
        levels.count_members()
    reservation, lists, results = build_tasks(method, config.rules(triangles), levels.make_tasks, phase=phase, name="fill")
    work = [events.position, events.value, levels.membership.node, levels.membership.shared, *arrays_of(lists)]
    return assemble(triangles, config, phase, levels.levels, (reservation, results), work)


def workers(device: wp.Device) -> int:
    """Threads that work at a time."""
    return CUDA_THREADS if device.is_cuda else get_num_threads()


def cut_events(events: Events, nodes: int) -> int:
    """Sets the size of chunks for this number of live nodes; returns the number of chunks of an axis."""
    max_count = max(events.count)
    smallest = item_sizes(events.value.device).events
    longest = max(smallest, -(-3 * max_count // (CHUNKS_PER_THREAD * workers(events.value.device))))
    events.chunk = min(max(smallest, EVENTS_PER_NODE * nodes), longest)
    return max(1, -(-max_count // events.chunk))


class InPlaceLevels(Levels):
    """The top levels while they are split.

    Args:
        triangles: boxes of the mesh's triangles.
        config: cost model and stop rules, and whether triangles are clipped.
        target: when the levels end.
        events: sorted; replaced if triangles are clipped.
    """

    chunks_per_thread = ITEM_CHUNKS_PER_THREAD

    def __init__(self, triangles: TriangleBoxes, config: KdTreeConfig, target: TaskTarget, events: Events) -> None:
        super().__init__(triangles.boxes.low.device, root_level(triangles))
        self.triangles, (self.cost, self.limits) = triangles, config.rules(triangles)
        self.config, self.target, self.events = config, target, events
        self.parts = ClippedReferences(triangles, config.split_clipping) if config.tests_nodes else None
        """What is classified in place of triangles, if they are clipped."""
        self.membership = Membership()
        """The nodes that contain each triangle."""
        self.membership.node = wp.zeros(triangles.count, dtype=int, device=self.device)
        self.membership.shared = wp.empty(1, dtype=int, device=self.device)

    @property
    def count(self) -> int:
        """Triangles, or references to them."""
        return self.parts.count if self.parts else self.triangles.count

    def should_split(self) -> bool:
        """Until the nodes meet the target."""
        triangles, target = self.nodes["frame"]["triangles"][~self.nodes["finished"]], self.target
        met = len(triangles) >= target.tasks and triangles.max() <= target.triangles
        return len(triangles) > 0 and len(self.levels) < MAX_LEVELS and not met

    def count_members(self) -> None:
        """Sets the triangle counts of the nodes to the actual numbers, because what is copied to them must fit. The counts of a
        sweep may differ if there is NaN, or if triangles are clipped."""
        size = item_sizes(self.device).triangles
        chunks = -(-self.count // size)
        members = wp.empty((chunks, len(self.nodes)), dtype=int, device=self.device)
        self.run(fill_phase.count_task_triangles, chunks, size, self.count, self.membership, members)
        totals = wp.zeros(len(self.nodes), dtype=int, device=self.device)
        self.run(fill_phase.scan_columns, len(self.nodes), members, totals, chunk=16)
        self.members = members
        """(chunks, nodes) triangles of each node in the chunks of triangles before."""
        self.nodes["frame"]["triangles"] = totals.numpy()

    def search(self) -> None:
        """Finds the best plane of every live node, in each chunk of events."""
        self.live = wp.array(self.nodes, dtype=LiveNode, device=self.device)
        nodes, events = len(self.nodes), self.events
        chunks = cut_events(events, nodes)
        counts = wp.empty((3, chunks, nodes), dtype=wp.vec3i, device=self.device)
        frames = wp.empty((3, chunks, nodes), dtype=AxisFrame, device=self.device)
        self.sweeps = wp.empty((3, chunks, nodes), dtype=Sweep, device=self.device)
        self.run(level_phase.count_events, 3 * chunks, events, self.membership, counts)
        min_known_cost = self.scan(counts)
        work = [self.membership, self.live, counts, min_known_cost, frames, self.sweeps]
        self.run(level_phase.search_planes, 3 * chunks, self.cost, events, *work)

    def scan(self, counts: wp.array) -> wp.array:
        """Turns counts of chunks into the counts before them; returns each node's least cost of its first
        planes in the chunks."""
        chunks, nodes = counts.shape[1:]
        block_chunks = max(1, item_sizes(self.device).counts // nodes)
        blocks = -(-chunks // block_chunks)
        before = wp.zeros((3, blocks, nodes), dtype=wp.vec2i, device=self.device)
        if blocks > 1:
            self.run(level_phase.sum_blocks, 3 * blocks, block_chunks, counts, before)
            self.run(level_phase.scan_blocks, 3 * nodes, before, chunk=16)
        block_cost = wp.empty((3, blocks, nodes), dtype=float, device=self.device)
        work = [self.live, block_chunks, counts, before, block_cost]
        self.run(level_phase.scan_chunks, 3 * blocks, self.cost, self.events, *work)
        min_known_cost = wp.empty(nodes, dtype=float, device=self.device)
        self.run(level_phase.min_of_blocks, nodes, block_cost, min_known_cost, chunk=64)
        return min_known_cost

    def stop(self) -> None:
        """Takes the best plane of all chunks; a node becomes a leaf, or is split there."""
        together = BEST_TOGETHER if self.device.is_cuda else 1
        if together > 1:
            _, chunks, nodes = self.sweeps.shape
            self.run(level_phase.keep_best, 3 * -(-chunks // together) * nodes, together, self.sweeps)
        inputs = [together, self.cost, self.limits, self.sweeps, self.live]
        self.run(level_phase.decide, len(self.live), *inputs, chunk=16)

    def emit(self) -> None:
        """Lists the children, with the counts of the search."""
        self.nodes = nodes = self.live.numpy()
        self.children = children_of(nodes)
        triangles, split = nodes["frame"]["triangles"], nodes["split"]
        left = np.where(nodes["finished"], triangles, split["left"])
        self.children["frame"]["triangles"] = of_children(nodes, left, split["right"])
        self.live = wp.array(nodes, dtype=LiveNode, device=self.device)

    def partition(self) -> None:
        """Every triangle replaces its nodes by their children."""
        if self.parts:
            self.membership = self.parts.classify(self.events, self.membership, self.live)
        else:
            self.membership = self.refined()
        self.levels.append(self.nodes)
        self.nodes = self.children
        if self.parts:
            self.count_members()

    def refined(self) -> Membership:
        """The triangles' nodes on the next level."""
        count, boxes, device = self.triangles.count, self.triangles.boxes, self.device
        size = item_sizes(device).triangles
        chunks = -(-count // size)
        counts = wp.empty(chunks, dtype=int, device=device)
        refined = Membership()
        refined.node = wp.empty(count, dtype=int, device=device)
        inputs = [size, count, boxes, self.live, self.membership, refined]
        self.run(count_shared, chunks, *inputs, counts)
        sizes = counts.numpy()
        places = wp.array(starts_of(sizes), dtype=int, device=device)
        refined.shared = wp.empty(max(1, int(sizes.sum())), dtype=int, device=device)
        self.run(refine_members, chunks, *inputs, places)
        return refined

    def make_tasks(self, spare: float) -> tuple[Reservation, EventLists, wp.array]:
        """Makes one task of each live node: its triangles, events and working memory. Also returns the roots of the tasks."""
        roots = self.nodes["frame"].copy()
        reservation = Reservation(roots["triangles"], 6, spare, self.config.cost.width, self.device)
        lists = lists_for(reservation, self.triangles, self.config)
        local = self.fill_triangles(reservation, lists)
        self.fill_events(reservation, local, lists, roots)
        return reservation, lists, wp.array(roots, dtype=Frame, device=self.device)

    def fill_triangles(self, reservation: Reservation, lists: EventLists) -> Membership:
        """Copies triangles to their tasks; returns their indices there, at the same places as their tasks."""
        count, device, tasks = self.count, self.device, reservation.tasks
        local = Membership()
        local.node = wp.empty(count, dtype=int, device=device)
        local.shared = wp.empty(len(self.membership.shared), dtype=int, device=device)
        before = wp.clone(self.members)
        inputs = [item_sizes(device).triangles, count, self.membership, tasks, before, local, lists]
        self.run(fill_phase.fill_task_triangles, before.shape[0], *inputs)
        if self.parts:
            self.run(name_triangles, len(lists.triangle), self.parts.triangle, lists.triangle, chunk=NAMED)
        return local

    def fill_events(self, reservation: Reservation, local: Membership, lists: EventLists, roots: np.ndarray) -> None:
        """Copies events to their tasks, axis after axis, and stores the ranges of the lists in the roots."""
        events, tasks = self.events, len(roots)
        chunks = cut_events(events, tasks)
        counts = wp.empty((3, chunks, tasks), dtype=int, device=self.device)
        self.run(fill_phase.count_task_events, 3 * chunks, events, self.membership, counts)
        ends = wp.array(reservation.ranges["lists_first"], dtype=int, device=self.device)
        self.run(fill_phase.scan_columns, tasks, counts.reshape((3 * chunks, tasks)), ends, chunk=16)
        places = np.array([*(counts[axis, 0].numpy() for axis in range(3)), ends.numpy()])
        roots["first"], roots["count"], roots["top"] = places[:3].T, np.diff(places, axis=0).T, places[3]
        inputs = [events, self.membership, local, counts, lists]
        self.run(fill_phase.fill_task_events, 3 * chunks, *inputs)
