"""Streaming build of an SAH kd-tree: sampled breadth first, then exact (Popov, Guenther, Seidel and Slusallek 2006).

**Problem.** The lists of large nodes do not fit into the caches, and a sorting build reads them in an order that depends on the
plane.

**Algorithm.** While nodes are large, level after level: boxes stream through memory once; 1024 samples per axis count their
begins and ends, and the cost is evaluated at the samples. Triangles are copied to their children's part of a second buffer
(`reference_levels`). A node of at most 8192 triangles is a task: its events are sorted, and its subtree is built depth first
with all planes (`event_lists`), in memory that stays in the cache.

**Data.** References (`wrt.builders.triangle_references`) above, sorted events (`event_lists`) in the tasks.

**Steps.**

1. Top levels (`ReferenceLevels`): bins, the best sample of each node, and its references moved to its children's.
2. Sort (`list_task_events`): the events of a task are written, ends first, then planar events, then starts, each by triangle. A
   stable radix sort by position keeps that order among equal positions. So the lists equal the corresponding part of the events
   of the whole mesh.
3. Subtrees, by the phases of `event_method`; `assemble` combines the parts.

**Complexity.** O(N log N), of which the sequential top takes O(N) per level.

**What we changed.** The next level is sampled in a separate pass, because the samples divide the box of a node's triangles,
which is known only after the copy. The paper samples the node's box while it copies. Clipping is an option, in the levels too.
The paper assigns whole subtrees to threads; here the levels above them are parallel too. The tree is the same for any number of
threads.

References: popov-2006; rahikainen-2013 (algorithm 4.2.1).
"""

from functools import partial

import numpy as np
import warp as wp

from wrt.builders.core.subtrees import Frame, Reservation, Task, build_tasks, make_build_subtrees
from wrt.builders.kdtree.events.clipped_events import arrays_of, lists_for
from wrt.builders.kdtree.events.event_lists import EventLists
from wrt.builders.kdtree.events.event_method import event_method
from wrt.builders.kdtree.events.event_sort import SAME_KINDS
from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.kdtree.phases.assembly import assemble, copy_subtrees
from wrt.builders.kdtree.scan.reference_chunks import bin_chunks
from wrt.builders.kdtree.scan.reference_levels import LevelRules, ReferenceLevels
from wrt.builders.tree import KdTree, Phases
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.builders.triangle_references import write_order
from wrt.kernels.runtime import native
from wrt.kernels.runtime.launch import launch, load, specialise
from wrt.kernels.runtime.options import exact_kernel

SAMPLES = 1024
"""Bins per axis, with a sample between any two."""

EXACT = 8192
"""Triangles of a node up to which every plane is tried."""


@native.func_native(
    "events.h",
    f"{SAME_KINDS}return wrt::write_events(references.data + (size_t)first * 8, count, axis, lists.event.data + begin);",
)
def write_events(references: wp.array(dtype=float), first: int, count: int, axis: int, lists: EventLists, begin: int) -> int:
    """Writes the events of a range of references along one axis, unsorted; returns their number."""


@native.func_native("events.h", "wrt::sort_pairs(lists.event.data + begin, count);")
def sort_events(lists: EventLists, begin: int, count: int):
    """Sorts a range of events by position, stably. An equal amount of memory behind it is scratch."""


@exact_kernel
def list_task_events(
    first: int,
    references: wp.array(dtype=float),
    source: wp.array(dtype=int),
    tasks: wp.array(dtype=Task),
    frames: wp.array(dtype=Frame),
    lists: EventLists,
):
    """Item: a task. Lists its triangles and their events. Its range must have room for a third more than these."""
    number = first + wp.tid()
    task = tasks[number]
    frame = frames[number]
    write_order(references, source[number], frame.triangles, lists.triangle, task.triangles_first)
    frame.top = task.lists_first
    for axis in range(3):
        count = write_events(references, source[number], frame.triangles, axis, lists, frame.top)
        sort_events(lists, frame.top, count)
        frame.first[axis] = frame.top
        frame.count[axis] = count
        frame.top += count
    frames[number] = frame


def build(triangles: TriangleBoxes, config: KdTreeConfig) -> KdTree:
    """Builds the tree on the device that holds the boxes."""
    phase, method = Phases(triangles.boxes.low.device), event_method(config, by_id=False)
    load((bin_chunks, list_task_events, copy_subtrees, specialise(make_build_subtrees, method)), phase.device)
    with phase("top levels"):
        levels = ReferenceLevels(triangles, config, LevelRules(EXACT, SAMPLES, sampled=0))
        levels.split()
    tasks = partial(list_events, levels, triangles, config)
    reservation, lists, results = build_tasks(method, config.rules(triangles), tasks, phase=phase, name="sort")
    work = [levels.references, *arrays_of(lists)]
    return assemble(triangles, config, phase, levels.levels, (reservation, results), work)


def list_events(
    levels: ReferenceLevels, triangles: TriangleBoxes, config: KdTreeConfig, spare: float
) -> tuple[Reservation, EventLists, wp.array]:
    """Makes one task of each node of the last level: its memory, its sorted events, and the roots of the tasks."""
    device, roots = levels.references.device, levels.nodes["frame"]
    reservation = Reservation(roots["triangles"], 6, spare, config.cost.width, device)
    lists = lists_for(reservation, triangles, config)
    source = wp.array(np.ascontiguousarray(roots["first"][:, 0]), dtype=int, device=device)
    frames = wp.array(roots, dtype=Frame, device=device)
    launch(list_task_events, len(roots), [levels.references, source, reservation.tasks, frames, lists], device=device, chunk=1)
    return reservation, lists, frames
