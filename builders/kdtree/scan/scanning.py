"""A build that scans references: all threads split the top levels together, then each task of a pool builds one subtree.

This is the common part of the builders that search by scanning. `reference_levels` splits large nodes, `core.subtrees` builds
the others by the phases that the builder's file lists, and `assembly` combines the parts. A search that is not divided into
chunks runs on one thread per large node; then all threads divide the node's list (`uniform_scan`). So only the search of the
root keeps the other threads waiting.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import warp as wp

from wrt.builders.core.clip import give_mesh, partition_clipping
from wrt.builders.core.reference_lists import ReferenceLists, emit_leaf, partition
from wrt.builders.core.subtrees import (
    Frame,
    Method,
    Reservation,
    Task,
    build_tasks,
    emit_inner,
    in_partition,
    make_build_subtrees,
)
from wrt.builders.kdtree.kdtree_config import ROUND_ROBIN, KdTreeConfig
from wrt.builders.kdtree.phases.assembly import assemble, copy_subtrees
from wrt.builders.kdtree.phases.early_cutting import cutting_early
from wrt.builders.kdtree.scan.kdtree_bins import counters_for
from wrt.builders.kdtree.scan.reference_chunks import bin_chunks, make_decide
from wrt.builders.kdtree.scan.reference_levels import LevelRules, ReferenceLevels, TopLevels
from wrt.builders.tree import KdTree, Phases, stop
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.builders.triangle_references import copy_references
from wrt.kernels.runtime.launch import get_num_threads, launch, load, specialise
from wrt.kernels.runtime.options import exact_module

exact_module(__name__)

SPARE_MEMORY = 1.5
"""Working memory of a task relative to its own lists; doubled whenever it is too small."""


MIN_VALUES = 16
"""Floats that a search may write down in any node."""

TASKS_PER_THREAD = 2
"""A node of more than its share of triangles, if there were so many tasks a thread, is split before there are tasks."""

MIN_LARGE = 1 << 13
"""Triangles below which a node is not worth more than one thread."""


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


def scan_method(config: KdTreeConfig, search: wp.Function) -> Method:
    """What is done with a node whose references are scanned; search: as of `Method`. `wrt.builders.core.subtrees` calls these
    phases."""
    return Method(
        memory=ReferenceLists,
        search=cutting_early(search, ReferenceLists) if config.cuts_early else search,
        stop=stop,
        classify=in_partition,
        partition=partition_clipping if config.tests_nodes else partition,
        emit_inner=emit_inner,
        emit_leaf=emit_leaf,
    )


@dataclass(frozen=True)
class Scan:
    """The builder-specific part of a scanning build.

    Attributes:
        method: how subtrees are built.
        levels: how the top is split.
        values: floats that a search in a node writes; None for as many as the node has triangles, but at least MIN_VALUES.
        counters: counters that it needs in addition to those of the bins.
        split_level: calls the phases of a level; None if large nodes are searched by the search of `method` too.
    """

    method: Method
    levels: LevelRules
    values: int | None
    counters: int = 0
    split_level: Callable[[ReferenceLevels], None] | None = None


def uniform_scan(
    method: Method, triangles: TriangleBoxes, config: KdTreeConfig, values: int | None, bins: int = 1, counters: int = 0
) -> Scan:
    """A build that searches nodes of all sizes in the same way; method, values, counters: as of `Scan`."""
    threads, large = get_num_threads(), triangles.count
    if threads > 1:
        large = max(MIN_LARGE, large // (TASKS_PER_THREAD * threads))
    return Scan(method, LevelRules(large, bins, sampled=0), values, counters)


def build_scanning(triangles: TriangleBoxes, config: KdTreeConfig, scan: Scan) -> KdTree:
    """Builds the tree on the device that holds the boxes."""
    phase = Phases(triangles.boxes.low.device)
    load((bin_chunks, copy_lists, copy_subtrees, specialise(make_build_subtrees, scan.method)), phase.device)
    with phase("top levels"):
        top = split_top(triangles, config, scan)
    tasks = partial(make_tasks, top, triangles, config, scan)
    reservation, lists, results = build_tasks(scan.method, config.rules(triangles), tasks, SPARE_MEMORY, phase)
    work = [top.references, lists.reference, lists.counter, lists.value]
    return assemble(triangles, config, phase, top.levels[:-1], (reservation, results), work)


def split_top(triangles: TriangleBoxes, config: KdTreeConfig, scan: Scan) -> TopLevels:
    """Splits large nodes, level after level, until there are none."""
    levels = ReferenceLevels(triangles, config, scan.levels)
    while levels.any_large():
        if scan.split_level:
            scan.split_level(levels)
        else:
            split_level_by_search(levels, config, scan)
    return levels.finished()


def split_level_by_search(levels: ReferenceLevels, config: KdTreeConfig, scan: Scan) -> None:
    """Splits a level whose nodes are searched as in a task, each by one thread."""
    kernel = specialise(partial(make_decide, ReferenceLists), scan.method.search)
    lists = search_lists(levels.references, levels.nodes["frame"]["triangles"], config, scan)
    levels.search_and_stop(kernel, lists)
    levels.classify()
    levels.emit()
    levels.partition()


def search_lists(references: wp.array, sizes: np.ndarray, config: KdTreeConfig, scan: Scan) -> ReferenceLists:
    """Lists in `references`, and room to search for nodes of such sizes."""
    count, device = len(sizes), references.device
    values = max(MIN_VALUES, int(sizes.max())) if scan.values is None else scan.values
    lists = ReferenceLists()
    lists.rules.bins = scan.levels.bins
    lists.rules.sampled = scan.levels.sampled
    lists.rules.round_robin = config.axis == ROUND_ROBIN
    lists.rules.longest_from = config.longest_from
    lists.rules.resamplings = config.resamplings
    lists.reference = references
    lists.counter = wp.empty((count, counters_for(scan.levels.bins) + scan.counters), dtype=int, device=device)
    lists.value = wp.empty((count, values), dtype=float, device=device)
    return lists


def make_tasks(
    top: TopLevels, triangles: TriangleBoxes, config: KdTreeConfig, scan: Scan, spare: float
) -> tuple[Reservation, ReferenceLists, wp.array]:
    """Makes one task of each node of the last level: its memory, its references, and the roots of the tasks."""
    device, roots = top.references.device, top.levels[-1]["frame"].copy()
    count = len(roots)
    reservation = Reservation(roots["triangles"], 1, spare, config.cost.width, device)
    entries = wp.empty(8 * reservation.entries, dtype=float, device=device)
    lists = search_lists(entries, roots["triangles"], config, scan)
    if config.tests_nodes:
        give_mesh(lists, triangles, triangles.size, config.split_clipping)
    source = wp.array(np.ascontiguousarray(roots["first"][:, 0]), dtype=int, device=device)
    roots["first"][:, 0] = reservation.ranges["lists_first"]
    roots["top"] = reservation.ranges["lists_first"] + roots["triangles"]
    frames = wp.array(roots, dtype=Frame, device=device)
    launch(copy_lists, count, [top.references, source, reservation.tasks, frames, lists], device=device, chunk=1)
    return reservation, lists, frames
