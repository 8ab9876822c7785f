"""Parallel build of an approximate SAH kd-tree by min-max binning (Shevtsov, Soupikov, Kapustin 2007; survey, section 4.2).

**Problem.** Sorting all events, and keeping them sorted through every split, is most of the time of an exact build.

**Algorithm.** Count in 32 bins an axis where boxes begin and end, and try only the planes between bins (`bins`); of large nodes
only every log10(n)-th triangle is counted. Nodes of at most 32 triangles are searched exactly (`exact_planes`). Large nodes are
split level by level, by all threads together (`reference_levels`); the others are tasks in a pool that all threads share,
each of which builds a subtree depth first (`subtrees`).

**Complexity.** O(N) a level, with sequential access to memory only.

**What we changed.** The paper cuts the scene into regions of equal triangle counts first, one a thread, which balances the load
and costs tracing speed (it traces at 70 % of the exact tree's speed); here the top is split by cost, in parallel over its
triangles. The bins divide the box of a node's triangles instead of the node's own, so its faces are planes too, and empty space
is cut off where it ends. Triangles are moved as whole references, not as indices. Sampling begins where a node is so large
that its counts stay good. The tree is the same for any number of threads, chunks and tasks.

References:
    M. Shevtsov, A. Soupikov, A. Kapustin: Highly parallel fast KD-tree construction for interactive ray tracing of dynamic
        scenes. Computer Graphics Forum 26(3), 2007.
    V. Rahikainen: On real-time ray tracing. MSc thesis, University of Tampere, 2013 (the survey).
"""

import warp as wp

from wrt.builders.cost import SplitCost
from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.kdtree.phases.kdtree_subtrees import Frame, Method
from wrt.builders.kdtree.scan.exact_planes import search_exactly, values_for
from wrt.builders.kdtree.scan.kdtree_bins import best_bin_plane, bin_range, place
from wrt.builders.kdtree.scan.reference_levels import LevelRules, sample_step
from wrt.builders.kdtree.scan.reference_lists import ReferenceLists, scanning
from wrt.builders.kdtree.scan.scanning import Scan, build_scanning
from wrt.builders.tree import KdTree
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.kernels.runtime.launch import get_num_threads

BINS = 32
"""Bins an axis, and triangles of a node up to which every plane is tried."""

SAMPLED = 10_000
"""Triangles of a node from which on only some of them are counted."""

TASKS_PER_THREAD = 2
"""A node of more than its share of triangles, if there were so many tasks a thread, is split by all threads together."""

LEAST_LARGE = 1 << 15
"""Triangles below which a node is not worth more than one thread: a level costs the host some 1.5 ms, and the whole subtree of
such a node takes a thread 6. (Processor time of the bunny, 69,630 triangles, on two threads: 16.6 ms with this bound, 20.4 with
half of it, 14.3 as a single task.)"""

CLIPPED_LARGE = 1 << 14
"""The same where triangles are clipped, which only tasks do: for any number of threads."""


@wp.func
def search(cost: SplitCost, lists: ReferenceLists, number: int, frame: Frame):
    """The best plane of a node."""
    if frame.triangles <= lists.rules.bins:
        return search_exactly(cost, lists, number, frame)
    step = sample_step(frame.triangles, lists.rules.sampled)
    bin_range(lists.reference, frame.first[0], frame.triangles, step, place(frame, lists.rules.bins), lists.counter, number)
    return best_bin_plane(cost, frame, lists.counter, number, lists.rules.bins, step)


def method(config: KdTreeConfig) -> Method:
    """How subtrees are built."""
    return scanning(search, config.split_clipping)


def build(triangles: TriangleBoxes, config: KdTreeConfig) -> KdTree:
    """Builds the tree on the device that holds the boxes."""
    threads = get_num_threads()
    large = max(LEAST_LARGE, triangles.count // (TASKS_PER_THREAD * threads)) if threads > 1 else triangles.count
    if config.split_clipping:  # which levels clip is not to depend on the threads
        large = CLIPPED_LARGE
    return build_scanning(triangles, config, Scan(method(config), LevelRules(large, BINS, SAMPLED), values_for(BINS)))
