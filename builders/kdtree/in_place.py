"""In-place parallel build of an SAH kd-tree (Choi et al. 2010; survey, section 4.2.2).

**Problem.** A build that goes depth first has one node, then two, then four to share among the cores, and it copies every
list at every level while it does.

**Algorithm.** The events of all triangles are sorted once per axis (`events`). The top levels are built breadth first,
parallel over the geometry, in place: nodes are written to triangles, not triangles to nodes (`levels`). As soon as there
are enough live nodes, each becomes a task that builds its subtree depth first (`subtrees`); the parts are then put together
in depth-first order (`assembly`). Exact SAH everywhere: every plane at which a triangle's box starts or ends is tried.

**Complexity.** O(N log N): the sort, then O(N) a level.

**What we changed.** The paper keeps breadth-first order while a level has fewer nodes than cores; here until it has several
times as many, so that tasks can be shared out evenly. Sweeps start from the counts of the chunks before them, as in the
same paper's nested algorithm, instead of from a shared counter. The split that a node gets does not depend on the phase in
which it is built: the tree is the same for any number of threads, chunks and tasks. Only tasks clip triangles
(`clipped_events`); where that is asked for, the size of the mesh alone decides at which level they begin.

References:
    B. Choi, R. Komuravelli, V. Lu, H. Sung, R. L. Bocchino, S. V. Adve, J. C. Hart: Parallel SAH k-D tree construction.
        High Performance Graphics 2010.
    V. Rahikainen: On real-time ray tracing. MSc thesis, University of Tampere, 2013 (the survey).
"""

import numpy as np
import warp as wp

from wrt.builders.cost import AxisFrame, SplitCost
from wrt.builders.kdtree.events.clipped_events import arrays_of, events_method, lists_for
from wrt.builders.kdtree.events.event_lists import EventLists
from wrt.builders.kdtree.events.event_sort import CHUNK, EVENT_CHUNK, Events, emit_events, sorted_events
from wrt.builders.kdtree.events.sweep_planes import Sweep
from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.kdtree.phases import in_place_levels as level_phase
from wrt.builders.kdtree.phases import task_fill as fill_phase
from wrt.builders.kdtree.phases.assembly import assemble, copy_subtrees
from wrt.builders.kdtree.phases.in_place_levels import LiveNode, Membership
from wrt.builders.kdtree.phases.kdtree_subtrees import Frame, Reservation, build_subtrees, make_build_subtrees
from wrt.builders.tree import KdTree, Phases, StopLimits
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.kernels.layout.struct_arrays import array_of_structs
from wrt.kernels.runtime.launch import get_num_threads, launch, load, specialise

TASKS_PER_THREAD = 2
"""Live nodes per thread at which the build goes over to subtrees, with many threads: every level that they split together costs
each of them a pass over memory (notebooks/records/2026-11-22-scaling.md)."""

LEAST_TASKS = 8
"""Live nodes for few threads, up to twice as many a thread: enough to share them out evenly."""

CLIPPED_TRIANGLES = 1 << 12
"""Triangles of the mesh per live node at which a build that clips does so, for any number of threads: only tasks clip."""

MAX_LEVELS = 12
"""Levels after which the build goes over to subtrees in any case."""

SPARE_ROOM = 1.5
"""Room that a task has for its work, as a multiple of its own lists; doubled whenever that was too little."""

LAUNCHED = 8
"""Chunks of items per thread: enough to balance the load, as claiming one costs next to nothing."""

TRIANGLES = 1 << 11
"""Triangles whose classification is worth a chunk of its own."""

EVENTS_PER_NODE = 256
"""Events of a chunk for each live node: a chunk keeps some hundred bytes for each of them."""

CHUNKS_PER_THREAD = 4
"""Chunks of all axes together that a thread has at least, if there are enough events."""

KERNELS = (emit_events, level_phase.search_planes, fill_phase.fill_task_events, copy_subtrees)
"""One kernel of each module: compiling them is no phase of the build."""


def build(triangles: TriangleBoxes, config: KdTreeConfig) -> KdTree:
    """Builds the tree on the device that holds the boxes."""
    if config.split_clipping:  # which levels clip is not to depend on the threads
        return build_in_place(triangles, config, triangles.count // CLIPPED_TRIANGLES)
    tasks = TASKS_PER_THREAD * get_num_threads()
    return build_in_place(triangles, config, max(tasks, min(2 * tasks, LEAST_TASKS)))


def build_in_place(triangles: TriangleBoxes, config: KdTreeConfig, least_tasks: int) -> KdTree:
    """Builds the tree; levels are split together until there are so many tasks."""
    builder = InPlaceBuilder(triangles, config)
    load((*KERNELS, specialise(make_build_subtrees, builder.method)), builder.device)
    with builder.phase("sort"):
        events = sorted_events(triangles)
    with builder.phase("top levels"):
        membership = builder.build_levels(events, least_tasks)
    spare = SPARE_ROOM
    while True:
        with builder.phase("fill"):
            room, lists, frames = builder.fill(events, membership, spare)
        with builder.phase("subtrees"):
            results = build_subtrees(builder.method, triangles, config, room, frames, lists)
        if not results.numpy()["overflow"].any():
            break
        spare *= 2.0
    with builder.phase("assemble"):
        nodes, primitive = assemble(builder.levels[:-1], room, results, config.cost.width)
    boxes = [triangles.boxes.low, triangles.boxes.high, events.position, events.value, membership.first, membership.node]
    work = [*arrays_of(lists), room.parts.nodes, room.parts.primitive]
    builder.phase.stats.reserve(*boxes, *work, nodes, primitive)
    return KdTree(nodes, primitive, wp.vec3(*triangles.low), wp.vec3(*triangles.high), config.cost.width, builder.phase.stats)


def cut_events(events: Events, nodes: int) -> int:
    """Sets the size of chunks that suits so many live nodes; returns the number of chunks of an axis."""
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
        self.method = events_method(config)
        self.phase = Phases(self.device)
        self.levels: list[np.ndarray] = []
        """Live nodes of each level so far."""
        root = LiveNode()
        root.low = wp.vec3(*triangles.low)
        root.high = wp.vec3(*triangles.high)
        root.triangles = triangles.count
        self.live = array_of_structs([root], LiveNode, self.device)

    def run(self, kernel: wp.Kernel, count: int, *inputs: object, chunk: int = 1) -> None:
        """Launches a kernel on the build's device."""
        launch(kernel, count, inputs, device=self.device, chunk=chunk, chunks_per_thread=LAUNCHED)

    def build_levels(self, events: Events, least_tasks: int) -> Membership:
        """Builds level after level until there are enough live nodes; returns which of them each triangle lies in."""
        count = self.triangles.count
        membership = Membership()
        membership.first = wp.array(np.arange(count + 1, dtype=np.int32), dtype=int, device=self.device)
        membership.node = wp.zeros(count, dtype=int, device=self.device)
        open_nodes = 1
        while 0 < open_nodes < least_tasks and len(self.levels) < MAX_LEVELS:
            self.split_level(events, membership)
            children = wp.empty(2 * len(self.live), dtype=LiveNode, device=self.device)
            counts = wp.empty(2, dtype=int, device=self.device)
            self.run(level_phase.new_generation, 1, self.live, children, counts)
            total, open_nodes = map(int, counts.numpy())  # the one round trip of a level
            membership = self.reclassify(membership)
            self.levels.append(self.live.numpy())
            self.live = children[:total]
        self.levels.append(self.live.numpy())
        self.count_members(membership)
        return membership

    def count_members(self, membership: Membership) -> None:
        """Has the last level's nodes hold as many triangles as there are in them: what is copied to them must find room, and of
        NaN the counts of a sweep may have another opinion."""
        last = self.levels[-1]
        last["triangles"] = np.bincount(membership.node.numpy(), minlength=len(last))
        self.live = wp.array(last, dtype=LiveNode, device=self.device)

    def split_level(self, events: Events, membership: Membership) -> None:
        """Finds the split of every live node."""
        nodes = len(self.live)
        chunks = cut_events(events, nodes)
        counts = wp.empty((3, chunks, nodes), dtype=wp.vec2i, device=self.device)
        reached = wp.empty((3, nodes), dtype=float, device=self.device)
        frames = wp.empty((3, chunks, nodes), dtype=AxisFrame, device=self.device)
        sweeps = wp.empty((3, chunks, nodes), dtype=Sweep, device=self.device)
        self.run(level_phase.count_events, 3 * chunks, events, membership, counts)
        self.run(level_phase.scan_chunks, 3 * nodes, self.cost, events, self.live, counts, reached, chunk=16)
        work = [membership, self.live, counts, reached, frames, sweeps]
        self.run(level_phase.search_planes, 3 * chunks, self.cost, events, *work)
        self.run(level_phase.decide, nodes, self.cost, self.limits, sweeps, self.live, chunk=16)

    def reclassify(self, membership: Membership) -> Membership:
        """The triangles' nodes on the next level."""
        count = self.triangles.count
        counts = wp.zeros(count + 1, dtype=int, device=self.device)
        boxes = self.triangles.boxes
        self.run(level_phase.count_members, count, boxes, self.live, membership, counts, chunk=TRIANGLES)
        new = Membership()
        new.first = wp.empty(count + 1, dtype=int, device=self.device)
        wp.utils.array_scan(counts, new.first, inclusive=False)
        new.node = wp.empty(int(new.first[-1:].numpy()[0]), dtype=int, device=self.device)
        self.run(level_phase.fill_members, count, boxes, self.live, membership, new, chunk=TRIANGLES)
        return new

    def fill(self, events: Events, membership: Membership, spare: float) -> tuple[Reservation, EventLists, wp.array]:
        """Makes one task of each live node: its triangles, its events, and room to work in; and the roots of the tasks."""
        room = Reservation(self.levels[-1]["triangles"], 6, spare, self.width, self.device)
        lists = lists_for(room, self.triangles, self.config)
        frames = wp.empty(len(room.tasks), dtype=Frame, device=self.device)
        self.run(fill_phase.make_roots, len(room.tasks), self.live, frames, chunk=64)
        self.copy_to_tasks(events, membership, room.tasks, lists, frames)
        return room, lists, frames

    def copy_to_tasks(
        self, events: Events, membership: Membership, tasks: wp.array, lists: EventLists, frames: wp.array
    ) -> None:
        """Copies triangles and events to their tasks."""
        count, device = self.triangles.count, self.device
        chunks = -(-count // CHUNK)
        places = wp.empty((chunks, len(tasks)), dtype=int, device=device)
        local = wp.empty(len(membership.node), dtype=int, device=device)
        self.run(fill_phase.count_task_triangles, chunks, count, membership, places)
        self.run(fill_phase.scan_task_triangles, len(tasks), tasks, places, chunk=64)
        self.run(fill_phase.fill_task_triangles, chunks, count, membership, tasks, places, local, lists)
        chunks = cut_events(events, len(tasks))
        places = wp.empty((3, chunks, len(tasks)), dtype=int, device=device)
        self.run(fill_phase.count_task_events, 3 * chunks, events, membership, places)
        self.run(fill_phase.scan_task_events, len(tasks), tasks, places, frames, chunk=64)
        self.run(fill_phase.fill_task_events, 3 * chunks, events, membership, local, places, lists)
