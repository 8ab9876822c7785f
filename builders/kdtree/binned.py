"""Parallel build of an approximate SAH kd-tree by min-max binning (Shevtsov, Soupikov and Kapustin 2007).

**Problem.** Sorting all events, and keeping them sorted through every split, takes most of the time of an exact build.

**Algorithm.** Count the begins and ends of boxes in 32 bins per axis, and try only the planes between bins (`kdtree_bins`). In
large nodes only every log10(n)-th triangle is counted. Nodes of at most 32 triangles are searched exactly (`exact_planes`).
Large nodes are split level by level, by all threads together (`reference_levels`). The others are tasks in a pool that all
threads share, each of which builds a subtree depth first (`wrt.builders.core.subtrees`).

**Data.** One list of references per node (`wrt.builders.core.reference_lists`).

**Phases** of a large node: those of `ReferenceLevels`; of the others: `method`. Search: by bins or exactly. Classify and
partition: one pass over the references.

**Complexity.** O(N) per level, with sequential memory access only.

**What we changed.** The paper first divides the scene into regions of equal triangle counts, one per thread, with 512 bins per
thread (initial clustering). This balances the load and costs tracing speed (it traces at 70 % of the exact tree's speed). Here
the top is split by cost, in parallel over its triangles. `KdTreeConfig.median_levels` has the first levels split at medians
instead; their number, not that of threads, decides on the tree, and bins are counted anew at every level. The bins divide
the box of a node's triangles, not the node's own box, so its faces are candidate planes too, and empty space is cut off
exactly. Triangles are moved as whole references, not as indices. Sampling starts only in nodes large enough for reliable
counts. The tree is the same for any number of threads, chunks and tasks.

References: shevtsov-2007-kdtree; rahikainen-2013 (section 4.2).
"""

from functools import cache

import warp as wp

from wrt.builders.core.reference_lists import ReferenceLists
from wrt.builders.core.subtrees import Frame, Method
from wrt.builders.cost import SplitCost
from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.kdtree.scan.exact_planes import exact_search, values_for
from wrt.builders.kdtree.scan.kdtree_bins import bin_plane_search, bin_range, make_binning
from wrt.builders.kdtree.scan.reference_chunks import sample_step
from wrt.builders.kdtree.scan.reference_levels import LevelRules
from wrt.builders.kdtree.scan.scanning import Scan, build_scanning, scan_method
from wrt.builders.tree import KdTree
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.kernels.runtime.launch import get_num_threads

BINS = 32
"""Bins per axis, and triangles of a node up to which every plane is tried."""

SAMPLED = 10_000
"""Triangles of a node from which on only a sample of them is counted."""

TASKS_PER_THREAD = 2
"""Tasks per thread that define a large node: one with more than the average share of triangles is split by all threads."""

MIN_LARGE = 1 << 15
"""Triangles below which a single thread builds a node: the host's fixed cost per level exceeds the gain of splitting it
together (notebooks/records/2026-11-22-binned-kdtree-tasks.md)."""


@cache
def searching(ends_rays: bool) -> wp.Function:
    """The search of `Method`; ends_rays: whether the cost is that of rays that end (`wrt.builders.cost.split_comparison`)."""
    exactly, best_plane = exact_search(ends_rays), bin_plane_search(ends_rays)

    @wp.func
    def search(cost: SplitCost, lists: ReferenceLists, number: int, frame: Frame):
        """The best plane of a node."""
        if frame.triangles <= lists.rules.bins:
            return exactly(cost, lists, number, frame)
        step = sample_step(frame.triangles, lists.rules.sampled)
        bin_range(
            lists.reference, frame.first[0], frame.triangles, step, make_binning(frame, lists.rules.bins), lists.counter, number
        )
        return best_plane(cost, frame, lists.counter, number, lists.rules.bins, step)

    return search


def binned_method(config: KdTreeConfig) -> Method:
    """What is done with a node."""
    return scan_method(config, searching(config.cost.occluder > 0.0))


def build(triangles: TriangleBoxes, config: KdTreeConfig) -> KdTree:
    """Builds the tree on the device that holds the boxes."""
    threads = get_num_threads()
    large = max(MIN_LARGE, triangles.count // (TASKS_PER_THREAD * threads)) if threads > 1 else triangles.count
    rules = LevelRules(large, BINS, SAMPLED, config.median_levels)
    return build_scanning(triangles, config, Scan(binned_method(config), rules, values_for(BINS), by_bins=True))
