"""A build that scans references: all threads split the top levels together, then each task of a pool builds one subtree.

This is the common part of the builders that search by scanning. `reference_levels` splits large nodes, `core.subtrees` builds
the others by the phases that the builder's file lists, and `assembly` combines the parts. A search that is not divided into
chunks runs on one thread per large node; then all threads divide the node's list (`uniform_scan`). So only the search of the
root keeps the other threads waiting.
"""

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
from wrt.builders.kdtree.scan.kdtree_bins import counters_for
from wrt.builders.kdtree.scan.reference_chunks import bin_chunks, make_decide
from wrt.builders.kdtree.scan.reference_levels import LevelRules, ReferenceLevels
from wrt.builders.tree import KdTree, Phases, stop
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.builders.triangle_references import copy_references
from wrt.kernels.runtime.launch import get_num_threads, launch, load, specialise
from wrt.kernels.runtime.options import exact_kernel

MIN_VALUES = 16
"""Floats that a search may write down in any node."""

TASKS_PER_THREAD = 2
"""A node of more than its share of triangles, with this many tasks a thread, is split before there are tasks."""

MIN_LARGE = 1 << 13
"""Triangles below which a node is not worth more than one thread."""


@exact_kernel
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
    """What is done with a node whose references are scanned; search: as in `Method`. `wrt.builders.core.subtrees` calls these
    phases."""
    return Method(
        memory=ReferenceLists,
        search=search,
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
        by_bins: whether large nodes are searched by the bins of their chunks; if not, by the search of `method` too.
    """

    method: Method
    levels: LevelRules
    values: int | None
    counters: int = 0
    by_bins: bool = False


def uniform_scan(
    method: Method, triangles: TriangleBoxes, config: KdTreeConfig, values: int | None, bins: int = 1, counters: int = 0
) -> Scan:
    """A build that searches nodes of all sizes in the same way; method, values, counters: as in `Scan`."""
    threads, large = get_num_threads(), triangles.count
    if threads > 1:
        large = max(MIN_LARGE, large // (TASKS_PER_THREAD * threads))
    return Scan(method, LevelRules(large, bins, sampled=0), values, counters)


def build_scanning(triangles: TriangleBoxes, config: KdTreeConfig, scan: Scan) -> KdTree:
    """Builds the tree on the device that holds the boxes."""
    phase = Phases(triangles.boxes.low.device)
    load((bin_chunks, copy_lists, copy_subtrees, specialise(make_build_subtrees, scan.method)), phase.device)
    with phase("top levels"):
        levels = ReferenceLevels(triangles, config, scan.levels) if scan.by_bins else SearchedLevels(triangles, config, scan)
        levels.split()
    tasks = partial(make_tasks, levels.references, levels.nodes["frame"], triangles, config, scan)
    reservation, lists, results = build_tasks(scan.method, config.rules(triangles), tasks, phase=phase)
    work = [levels.references, lists.reference, lists.counter, lists.value]
    return assemble(triangles, config, phase, levels.levels, (reservation, results), work)


class SearchedLevels(ReferenceLevels):
    """The top levels of a build whose nodes of all sizes are searched in the same way, by one thread each."""

    def __init__(self, triangles: TriangleBoxes, config: KdTreeConfig, scan: Scan) -> None:
        super().__init__(triangles, config, scan.levels)
        self.config, self.scan = config, scan

    def search(self) -> None:
        """Nothing but chunks: `stop` searches."""
        self.cut()

    def stop(self) -> None:
        """Every node is searched, and becomes a leaf, or is split."""
        kernel = specialise(partial(make_decide, ReferenceLists), self.scan.method.search)
        lists = search_lists(self.references, self.nodes["frame"]["triangles"], self.config, self.scan)
        launch(kernel, len(self.nodes), [self.cost, self.limits, lists, self.live], device=self.device, chunk=1)


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
    references: wp.array, roots: np.ndarray, triangles: TriangleBoxes, config: KdTreeConfig, scan: Scan, spare: float
) -> tuple[Reservation, ReferenceLists, wp.array]:
    """Makes one task of each node of the last level, given as structured `Frame`s, whose lists are in `references`: its memory,
    its references, and the roots of the tasks."""
    device, roots = references.device, roots.copy()
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
    launch(copy_lists, count, [references, source, reservation.tasks, frames, lists], device=device, chunk=1)
    return reservation, lists, frames
