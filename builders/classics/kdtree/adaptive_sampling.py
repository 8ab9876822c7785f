"""Build of an approximate SAH kd-tree from adaptive samples of the cost (Hunt, Mark and Stoll 2006).

**Problem.** Evaluating the cost at every end of every box is expensive, and a few evenly spaced samples miss its steps.

**Idea.** Let C_L and C_R be the numbers of triangles to the left and to the right of a plane. C_L - C_R increases from -n to n,
and the cost changes most where it does. Sample evenly, then more where it increases most, and interpolate between samples.

**Steps** of a node (`sampling_method`); nodes of at most 36 triangles are searched exactly (`exact_planes`):

1. A first scan takes 8 evenly spaced samples per axis (`bin_range`).
2. `place_samples`: of 8 levels evenly spaced from -n to n, each adds one sample to the segment in which it is crossed, and the
   samples of a segment divide it evenly.
3. `count_samples`: a second scan counts at all 16, on all axes or on the longest one (`KdTreeConfig.searched_axes`).
4. `search_axis`: between two samples C_L and C_R are interpolated linearly. The areas of both sides are linear too, so the cost
   is a quadratic, whose minimum is tried along with the samples.
5. One pass over the references classifies and partitions them.

**More scans.** Between two samples, C_L is at least that of the first, and C_R at least that of the second, so the cost is at
least that of a split with these counts and without the slab in between. Intervals in which it exceeds the least known cost are
eliminated, and 16 samples are taken in the others, again and again (`resample`, `KdTreeConfig.resamplings`; Rahikainen 2013,
section 4.2, after Popov et al. 2006, who propose it and did not need it).

**Data.** One list of references per node (`wrt.builders.core.reference_lists`).

**Complexity.** O(N) per level: two scans, the second of which compares with 16 planes at a time.

**What we changed.** The samples divide the box of a node's triangles, not the node's own box, so its faces, which cut off empty
space, are candidate planes too. The quadratic ignores that leaves are counted in blocks; the cost of its minimum does not.

References: popov-2006; hunt-2006; rahikainen-2013 (section 4.2).
"""

from functools import cache

import warp as wp

from wrt.builders.classics.kdtree.early_cutting import early
from wrt.builders.classics.kdtree.medians import longest_axis
from wrt.builders.core.reference_lists import ReferenceLists
from wrt.builders.core.subtrees import Frame, Method
from wrt.builders.cost import AxisFrame, Split, SplitCost, axis_frame, cheaper_split, no_split, plane_cost
from wrt.builders.kdtree.kdtree_config import MAX_RESAMPLINGS, KdTreeConfig
from wrt.builders.kdtree.scan.exact_planes import search_exactly, values_for
from wrt.builders.kdtree.scan.kdtree_bins import bin_count, bin_range, make_binning
from wrt.builders.kdtree.scan.scanning import build_scanning, scan_method, uniform_scan
from wrt.builders.tree import KdTree
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.kernels.runtime import native
from wrt.kernels.simd.boxes import INFINITY

EXACT = wp.constant(36)
"""Triangles of a node up to which every plane is tried."""

UNIFORM = wp.constant(8)
"""Samples along an axis in the first scan; the second adds as many."""

SAMPLES = wp.constant(16)
"""Samples along an axis; the second scan compares a box with all of them at once."""

INTERVALS = wp.constant((MAX_RESAMPLINGS + 1) * 16)
"""Room for the intervals of an axis: 17 after the second scan, and 16 more after every other one if none is eliminated."""


@wp.func
def place_samples(lists: ReferenceLists, number: int, frame: Frame, axis: int):
    """Writes the ascending positions of an axis' 16 samples, after the first scan."""
    low = frame.inner_low[axis]
    width = (frame.inner_high[axis] - low) / float(UNIFORM + 1)
    level_gap = 2.0 * float(frame.triangles) / float(UNIFORM)
    left = int(0)
    right = int(frame.triangles)
    to = int(0)
    crossed = int(0)
    for segment in range(UNIFORM + 1):
        left += bin_count(lists.counter, number, axis * (UNIFORM + 1) + segment)
        right -= bin_count(lists.counter, number, (3 + axis) * (UNIFORM + 1) + UNIFORM - segment)
        begin = low + width * float(segment)
        below = int(crossed)  # levels are -n + (i + 1/2) gap, i = 0 .. 7
        while crossed < UNIFORM and (
            segment == UNIFORM or float(left - right) >= (float(crossed) + 0.5) * level_gap - float(frame.triangles)
        ):
            crossed += 1
        extra = crossed - below
        for i in range(extra):
            lists.value[number, to] = begin + width * (float(i + 1) / float(extra + 1))
            to += 1
        if segment < UNIFORM:
            lists.value[number, to] = low + width * float(segment + 1)
            to += 1


@native.func_native(
    "scan.h",
    "const float* position = lists.value.data + (size_t)number * lists.value.shape[1];\n"
    "int* to = lists.counter.data + (size_t)number * lists.counter.shape[1] + at;\n"
    f"wrt::count_samples<{int(SAMPLES)}>(lists.reference.data + (size_t)first * 8, count, axis, position, to);",
)
def count_samples(lists: ReferenceLists, number: int, first: int, count: int, axis: int, at: int):
    """The second scan: for every sample, counts the triangles to its left; the counts to the right follow all of these."""


@wp.struct
class Sample:
    """A position and the numbers of triangles on both sides of it."""

    position: float
    left: float
    right: float


@wp.func
def lowest_between(along: AxisFrame, a: Sample, b: Sample):
    """Parameter, from 0 at a to 1 at b, at which the quadratic between two samples is lowest."""
    grown = (b.position - a.position) * along.perimeter
    area_left = along.face + (a.position - along.low) * along.perimeter
    area_right = along.face + (along.high - a.position) * along.perimeter
    more_left = b.left - a.left
    more_right = b.right - a.right
    curvature = grown * (more_left - more_right)
    slope = area_left * more_left + grown * a.left + area_right * more_right - grown * a.right
    return wp.where(curvature > 0.0, wp.clamp(-0.5 * slope / curvature, 0.0, 1.0), wp.where(slope < 0.0, 1.0, 0.0))


@wp.func
def try_segment(cost: SplitCost, along: AxisFrame, a: Sample, b: Sample, best: Split):
    """The better of `best` and the lowest point between two samples."""
    at = lowest_between(along, a, b)
    position = a.position + (b.position - a.position) * at
    left = int(wp.ceil(a.left + (b.left - a.left) * at))
    right = int(wp.ceil(a.right + (b.right - a.right) * at))
    return cheaper_split(cost, along, position, left, right, False, best)


@wp.func
def right_of_sample(lists: ReferenceLists, number: int, frame: Frame, at: int, i: int):
    """Triangles to the right of a counted sample; those in its plane are on the right."""
    left = bin_count(lists.counter, number, at + i)
    return wp.max(bin_count(lists.counter, number, at + SAMPLES + i), frame.triangles - left)


@wp.func
def search_axis(cost: SplitCost, lists: ReferenceLists, number: int, frame: Frame, axis: int, at: int, best: Split):
    """The best of `best` and the planes of one axis whose samples have been placed and counted."""
    along = axis_frame(cost, axis, frame.low, frame.high, frame.triangles)
    total = float(frame.triangles)
    best = cheaper_split(cost, along, frame.inner_low[axis], 0, frame.triangles, False, best)
    a = Sample(frame.inner_low[axis], 0.0, total)
    for i in range(SAMPLES):
        left = bin_count(lists.counter, number, at + i)
        right = right_of_sample(lists, number, frame, at, i)
        b = Sample(lists.value[number, i], float(left), float(right))
        best = try_segment(cost, along, a, b, best)
        best = cheaper_split(cost, along, b.position, left, right, False, best)
        a = b
    best = try_segment(cost, along, a, Sample(frame.inner_high[axis], total, 0.0), best)
    return cheaper_split(cost, along, frame.inner_high[axis], frame.triangles, 0, True, best)


@wp.func
def min_cost_between(cost: SplitCost, along: AxisFrame, low: float, high: float, left: int, right: int):
    """A lower bound of the cost of planes between two samples: the cost of a split without the slab in between.

    left: triangles on the left of the lower sample. right: those on the right of the upper one."""
    thin = along
    thin.high = along.high - (high - low)
    return plane_cost(cost, thin, low, left, right)


@wp.func
def resample(cost: SplitCost, lists: ReferenceLists, number: int, frame: Frame, axis: int, at: int, best: Split):
    """The better of `best` and the planes of further scans along an axis whose samples have been placed and counted."""
    along = axis_frame(cost, axis, frame.low, frame.high, frame.triangles)
    low = wp.zeros(shape=(INTERVALS,), dtype=float)
    high = wp.zeros(shape=(INTERVALS,), dtype=float)
    left = wp.zeros(shape=(INTERVALS,), dtype=int)
    right = wp.zeros(shape=(INTERVALS,), dtype=int)
    count = int(SAMPLES + 1)
    low[0] = frame.inner_low[axis]
    left[0] = 0
    for i in range(SAMPLES):
        high[i] = lists.value[number, i]
        right[i] = right_of_sample(lists, number, frame, at, i)
        low[i + 1] = lists.value[number, i]
        left[i + 1] = bin_count(lists.counter, number, at + i)
    high[SAMPLES] = frame.inner_high[axis]
    right[SAMPLES] = 0
    for _scan in range(1, lists.rules.resamplings):
        kept = int(0)
        for i in range(count):
            bound = min_cost_between(cost, along, low[i], high[i], left[i], right[i])
            if low[i] < high[i] and (bound < best.cost or cost.occluder > 0.0):
                low[kept] = low[i]
                high[kept] = high[i]
                left[kept] = left[i]
                right[kept] = right[i]
                kept += 1
        if kept == 0:
            break
        for j in range(SAMPLES):  # sample j is in interval j * kept / 16, in equal steps with the others there
            i = j * kept / SAMPLES
            begin = (i * SAMPLES + kept - 1) / kept
            end = ((i + 1) * SAMPLES + kept - 1) / kept
            lists.value[number, j] = low[i] + (high[i] - low[i]) * (float(j - begin + 1) / float(end - begin + 1))
        count_samples(lists, number, frame.first[0], frame.triangles, axis, at)
        count = kept
        for j in range(SAMPLES):
            i = j * kept / SAMPLES
            position = lists.value[number, j]
            on_left = bin_count(lists.counter, number, at + j)
            on_right = right_of_sample(lists, number, frame, at, j)
            best = cheaper_split(cost, along, position, on_left, on_right, False, best)
            # the sample divides the rest of its interval: the part before it is added, the part behind it remains
            low[count] = low[i]
            left[count] = left[i]
            high[count] = position
            right[count] = on_right
            low[i] = position
            left[i] = on_left
            count += 1
    return best


@cache
def searching(again: bool) -> wp.Function:
    """The search of `Method`; again: whether there are further scans."""

    @wp.func
    def sample_axis(cost: SplitCost, lists: ReferenceLists, number: int, frame: Frame, axis: int, best: Split):
        at = 6 * lists.rules.bins  # the second scan's counts lie behind those of the first
        place_samples(lists, number, frame, axis)
        count_samples(lists, number, frame.first[0], frame.triangles, axis, at)
        best = search_axis(cost, lists, number, frame, axis, at, best)
        if wp.static(again):
            best = resample(cost, lists, number, frame, axis, at, best)
        return best

    @wp.func
    def search(cost: SplitCost, lists: ReferenceLists, number: int, frame: Frame):
        """The best plane of a node."""
        if frame.triangles <= EXACT:
            return search_exactly(cost, lists, number, frame)
        bins = lists.rules.bins
        bin_range(lists.reference, frame.first[0], frame.triangles, 1, make_binning(frame, bins), lists.counter, number)
        best = no_split()
        longest = longest_axis(frame)
        if frame.triangles >= lists.rules.longest_from:
            best = sample_axis(cost, lists, number, frame, longest, best)
        if best.cost == INFINITY:
            for axis in range(3):
                best = sample_axis(cost, lists, number, frame, axis, best)
        return best

    return search


def sampling_method(config: KdTreeConfig) -> Method:
    """What is done with a node."""
    return scan_method(config, early(config, searching(config.resamplings > 1)))


def build(triangles: TriangleBoxes, config: KdTreeConfig) -> KdTree:
    """Builds the tree on the device that holds the boxes."""
    values = values_for(int(EXACT))
    return build_scanning(
        triangles,
        config,
        uniform_scan(sampling_method(config), triangles, config, values, bins=int(UNIFORM) + 1, counters=2 * int(SAMPLES)),
    )
