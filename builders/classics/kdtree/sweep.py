"""Serial sweep build of an SAH kd-tree in O(N log N) (Wald and Havran 2006).

**Problem.** Sorting the events of every node again costs a factor of log N.

**Idea.** Sort once. A list that is divided in order stays sorted.

**Steps** of a node (`event_method`), after the sort of all events by position, then end, planar, start:

1. Find the plane: sweep over the lists of the three axes with the counts N_L, N_P and N_R (`event_lists.search`).
2. Classify: the list of the split axis tells which triangles are on the left, on the right, or on both sides.
3. Divide the lists between the children, in order.
4. If triangles are clipped to cells, the new events of those that straddle the plane are sorted and merged in
   (`clipped_events`).

This is the in-place build with a single task and no levels above it, on one thread: the baseline for all other builds.

**Data.** One list of sorted events per axis and node (`event_lists`).

**Complexity.** O(N log N): the sort, then O(N) per level.

**What we changed.** The paper always clips. Here clipping is an option; without it the parts of a list stay sorted, and builds
are faster (notebooks/records/2026-11-21-split-clipping.md).

References: wald-havran-2006; rahikainen-2013 (algorithms 4.1.4 and 4.1.5).
"""

from wrt.builders.classics.kdtree.early_cutting import early
from wrt.builders.kdtree.events.event_lists import EventLists, search
from wrt.builders.kdtree.events.event_method import event_method
from wrt.builders.kdtree.in_place import TaskTarget, build_in_place
from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.tree import KdTree
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.kernels.runtime.launch import use_threads


def build(triangles: TriangleBoxes, config: KdTreeConfig) -> KdTree:
    """Builds the tree on the device that holds the boxes, on one thread."""
    method = event_method(config, early(config, search, EventLists))
    with use_threads(1):
        return build_in_place(triangles, config, method, TaskTarget(tasks=1, triangles=triangles.count))
