"""A build that scans references: all threads split the top levels together, then each task of a pool builds one subtree.

This is the common part of the builders that search by scanning. `reference_levels` splits large nodes, `subtrees` builds the
others with the builder's own search, and `assembly` combines the parts. A builder without parallel levels makes the whole tree
one task, and runs on one thread.
"""

from dataclasses import dataclass

import numpy as np
import warp as wp

from wrt.builders.kdtree.kdtree_config import ROUND_ROBIN, KdTreeConfig
from wrt.builders.kdtree.phases.assembly import assemble, copy_subtrees
from wrt.builders.kdtree.phases.kdtree_subtrees import Frame, Method, Reservation, Task, build_subtrees, make_build_subtrees
from wrt.builders.kdtree.scan.kdtree_bins import counters_for
from wrt.builders.kdtree.scan.reference_levels import LevelRules, TopLevels, bin_chunks, split_top
from wrt.builders.kdtree.scan.reference_lists import ReferenceLists
from wrt.builders.kdtree.scan.split_clipping import PAD
from wrt.builders.tree import KdTree, Phases
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.builders.triangle_references import copy_references
from wrt.kernels.runtime.launch import launch, load, specialise

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

SPARE_ROOM = 1.5
"""Working memory of a task relative to its own lists; doubled whenever it is too small."""


@wp.kernel
def copy_lists(
    first: int,
    references: wp.array(dtype=float),
    source: wp.array(dtype=int),
    tasks: wp.array(dtype=Task),
    frames: wp.array(dtype=Frame),
    lists: ReferenceLists,
):
    """Item: a task. Copies its references to its own range."""
    number = first + wp.tid()
    copy_references(references, source[number], frames[number].triangles, lists.reference, tasks[number].lists_first)


@dataclass(frozen=True)
class Scan:
    """The builder-specific part of a scanning build.

    Attributes:
        method: how subtrees are built.
        levels: how the top is split.
        values: floats that a search in a node of the largest task writes.
        counters: counters that it needs in addition to those of the bins.
    """

    method: Method
    levels: LevelRules
    values: int
    counters: int = 0


def one_task(method: Method, triangles: int, values: int, bins: int = 1, counters: int = 0) -> Scan:
    """A build on one thread: the whole tree is one task."""
    return Scan(method, LevelRules(large=triangles, bins=bins, sampled=0), values, counters)


def build_scanning(triangles: TriangleBoxes, config: KdTreeConfig, scan: Scan) -> KdTree:
    """Builds the tree on the device that holds the boxes."""
    phase = Phases(triangles.boxes.low.device)
    load((bin_chunks, copy_lists, copy_subtrees, specialise(make_build_subtrees, scan.method)), phase.device)
    with phase("top levels"):
        top = split_top(triangles, config, scan.levels)
    spare = SPARE_ROOM
    while True:
        with phase("subtrees"):
            room, lists, results = build_tasks(top, triangles, config, scan, spare)
        if not results.numpy()["overflow"].any():
            break
        spare *= 2.0
    with phase("assemble"):
        nodes, primitive = assemble(top.levels[:-1], room, results, config.cost.width)
    work = [top.references, lists.reference, lists.counter, lists.value, room.parts.nodes, room.parts.primitive]
    phase.stats.reserve(triangles.boxes.low, triangles.boxes.high, *work, nodes, primitive)
    return KdTree(nodes, primitive, wp.vec3(*triangles.low), wp.vec3(*triangles.high), config.cost.width, phase.stats)


def build_tasks(
    top: TopLevels, triangles: TriangleBoxes, config: KdTreeConfig, scan: Scan, spare: float
) -> tuple[Reservation, ReferenceLists, wp.array]:
    """Builds the subtrees below the top levels; returns the tasks' memory, their lists, and the result of each task."""
    device, roots = top.references.device, top.levels[-1]["frame"].copy()
    count = len(roots)
    room = Reservation(roots["triangles"], 1, spare, config.cost.width, device)
    lists = ReferenceLists()
    lists.rules.bins = scan.levels.bins
    lists.rules.sampled = scan.levels.sampled
    lists.rules.round_robin = config.axis == ROUND_ROBIN
    lists.reference = wp.empty(8 * room.entries, dtype=float, device=device)
    lists.counter = wp.empty((count, counters_for(scan.levels.bins) + scan.counters), dtype=int, device=device)
    lists.value = wp.empty((count, scan.values), dtype=float, device=device)
    if config.split_clipping:
        lists.vertices, lists.faces = triangles.vertices, triangles.faces
        lists.pad = PAD * triangles.size
    source = wp.array(np.ascontiguousarray(roots["first"][:, 0]), dtype=int, device=device)
    roots["first"][:, 0] = room.rooms["lists_first"]
    roots["top"] = room.rooms["lists_first"] + roots["triangles"]
    frames = wp.array(roots, dtype=Frame, device=device)
    launch(copy_lists, count, [top.references, source, room.tasks, frames, lists], device=device, chunk=1)
    results = build_subtrees(scan.method, triangles, config, room, frames, lists)
    return room, lists, results
