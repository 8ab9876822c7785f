"""Local search: the best plane between the spatial and the object median (MacDonald and Booth 1990).

**Problem.** A median ignores the cost, and a search of all planes evaluates many that cannot be best.

**Idea.** If no triangle straddled the planes, the one of least cost would lie between the spatial and the object median.
Beyond either median, moving the plane towards it shrinks the child that has more than its share.

**Steps** of a node (`between_medians_method`):

1. The axis, as in `medians`; the spatial median, and the object median by a selection.
2. `search_axis`: 16 planes, evenly spaced from one median to the other, are counted in one scan (`adaptive_sampling`), and the
   cheapest is taken.
3. `try_box_faces`: the faces of the box of the triangles, along every axis. One pass classifies and partitions the references.

**Data.** One list of references per node (`wrt.builders.core.reference_lists`).

**Complexity.** O(N) per level: a selection for the object median, and a scan.

**What we changed.** The faces of the box of a node's triangles are tried too, along every axis, because no plane between the
medians cuts off empty space.

**Limits.** Trees cost about as much as exact ones, but random rays are somewhat slower
(notebooks/records/2026-11-21-kdtree-builders.md).

References: macdonald-booth-1990; rahikainen-2013 (section 4.1).
"""

import warp as wp

from wrt.builders.classics.kdtree.adaptive_sampling import SAMPLES, count_samples
from wrt.builders.classics.kdtree.early_cutting import early
from wrt.builders.classics.kdtree.medians import along_first_axis, median_position
from wrt.builders.core.reference_lists import ReferenceLists
from wrt.builders.core.subtrees import Frame, Method
from wrt.builders.cost import Split, SplitCost, axis_frame, cheaper_by_area, no_split
from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.kdtree.scan.kdtree_bins import bin_count
from wrt.builders.kdtree.scan.scanning import build_scanning, scan_method, uniform_scan
from wrt.builders.tree import KdTree
from wrt.builders.triangle_boxes import TriangleBoxes


@wp.func
def search_axis(cost: SplitCost, lists: ReferenceLists, number: int, frame: Frame, axis: int):
    """The best plane between the medians of one axis."""
    along = axis_frame(cost, axis, frame.low, frame.high, frame.triangles)
    spatial = 0.5 * (frame.low[axis] + frame.high[axis])
    step = (median_position(lists, number, frame, axis) - spatial) / float(SAMPLES - 1)
    for i in range(SAMPLES):
        lists.value[number, i] = spatial + step * float(i)
    count_samples(lists, number, frame.first[0], frame.triangles, axis, 0)
    best = no_split()
    for i in range(SAMPLES):
        left = bin_count(lists.counter, number, i)
        right = wp.max(bin_count(lists.counter, number, SAMPLES + i), frame.triangles - left)  # planar ones go to the right
        best = cheaper_by_area(cost, along, lists.value[number, i], left, right, False, best)
    return best


@wp.func
def try_box_faces(cost: SplitCost, frame: Frame, best: Split):
    """The better of `best` and the planes at the faces of the triangles' box."""
    for axis in range(3):
        along = axis_frame(cost, axis, frame.low, frame.high, frame.triangles)
        best = cheaper_by_area(cost, along, frame.inner_low[axis], 0, frame.triangles, False, best)
        best = cheaper_by_area(cost, along, frame.inner_high[axis], frame.triangles, 0, True, best)
    return best


search_first_axis = along_first_axis(search_axis)


@wp.func
def search(cost: SplitCost, lists: ReferenceLists, number: int, frame: Frame):
    """The best plane of a node."""
    return try_box_faces(cost, frame, search_first_axis(cost, lists, number, frame))


def between_medians_method(config: KdTreeConfig) -> Method:
    """What is done with a node."""
    return scan_method(config, early(config, search))


def build(triangles: TriangleBoxes, config: KdTreeConfig) -> KdTree:
    """Builds the tree on the device that holds the boxes."""
    return build_scanning(
        triangles,
        config,
        uniform_scan(between_medians_method(config), triangles, config, values=None, counters=2 * int(SAMPLES)),
    )
