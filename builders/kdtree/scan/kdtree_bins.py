"""Min-max binning: counts of the begins and ends of boxes per bin, and the best plane between bins (Shevtsov et al. 2007).

The box of a node's triangles, clamped to the node's own, is divided into bins of equal width along each axis. A box counts in
the bin in which it begins and in the one in which it ends. The sum of the begins from the left is the number of triangles to
the left of a plane, the sum of the ends from the right that to its right; straddlers are in both. The candidate planes are
those between bins, and the two faces of the box, which cut off empty space.

A reference has lanes for the lower ends and for the negated upper ones. Both are binned by the same expression, the upper ends
from the opposite face, so that an interval that ends at a plane counts on its left only. Counts are exact up to the rounding of
the plane's position. If only every `step`-th triangle is counted they are estimates, and the partition counts again.

References: shevtsov-2007-kdtree.
"""

from functools import cache

import warp as wp

from wrt.builders.core.subtrees import Frame
from wrt.builders.cost import SplitCost, axis_frame, no_split, split_comparison
from wrt.kernels.runtime import native


def counters_for(bins: int) -> int:
    """Counters of a node: 6 rows, for the begins of boxes along x, y, z, and for their ends, counted from the upper face."""
    return 6 * bins


@wp.struct
class Binning:
    """The bins of a node: a lane falls into bin (lane - origin) * scale, clamped to [0, bins - 1]."""

    low: wp.vec3
    """Origin of the lower ends."""
    high: wp.vec3
    """Minus the origin of the negated upper ends."""
    scale: wp.vec3
    bins: int


@wp.func
def make_binning(frame: Frame, bins: int):
    """The bins of a node. Along an axis without extent everything falls into the first bin."""
    binning = Binning()
    binning.low = frame.inner_low
    binning.high = frame.inner_high
    binning.bins = bins
    for axis in range(3):
        extent = frame.inner_high[axis] - frame.inner_low[axis]
        binning.scale[axis] = wp.where(extent > 0.0, float(bins) / extent, 0.0)
    return binning


@native.func_native(
    "scan.h",
    "const float* from = references.data + (size_t)begin * 8;\n"
    "wrt::count_ends(from, count, step, binning, counter.data + (size_t)slot * counter.shape[1]);",
)
def bin_range(
    references: wp.array(dtype=float),
    begin: int,
    count: int,
    step: int,
    binning: Binning,
    counter: wp.array2d(dtype=int),
    slot: int,
):
    """Counts every `step`-th reference of a range in the bins of a slot."""


@native.func_native("scan.h", "wrt::sum_counters(counter.data, counter.shape[1], slot, first, end, 6 * bins);")
def merge_bins(counter: wp.array2d(dtype=int), slot: int, first: int, end: int, bins: int):
    """Replaces the bins of a slot by the sums of those of the slots first .. end - 1."""


@wp.func_native("return counter.data[(size_t)slot * counter.shape[1] + i];")
def bin_count(counter: wp.array2d(dtype=int), slot: int, i: int) -> int:
    """counter[slot, i], without index checks: see `wrt.kernels.layout.unchecked`."""


@wp.func
def median_bin_plane(cost: SplitCost, frame: Frame, counter: wp.array2d(dtype=int), slot: int, bins: int, step: int):
    """The plane between bins, along the longest axis of the triangles' box, that divides the triangles most evenly. It costs
    nothing, so that it is taken. `no_split()` if none divides them."""
    split = no_split()
    size = frame.inner_high - frame.inner_low
    axis = wp.where(size[0] >= size[1] and size[0] >= size[2], 0, wp.where(size[1] >= size[2], 1, 2))
    triangles = frame.triangles
    min_uneven = int(triangles)
    left = int(0)
    right = (triangles + step - 1) / step
    for b in range(1, bins):
        left += bin_count(counter, slot, axis * bins + b - 1)
        right -= bin_count(counter, slot, (3 + axis) * bins + bins - b)
        uneven = wp.abs(left - right) * step
        position = frame.inner_low[axis] + size[axis] * (float(b) / float(bins))
        if uneven < min_uneven and position > frame.low[axis] and position < frame.high[axis]:
            min_uneven = uneven
            split.cost = 0.0
            split.axis = axis
            split.position = position
            split.left = wp.min(left * step, triangles)
            split.right = wp.max(wp.min(right * step, triangles), triangles - split.left)
    return split


@cache
def bin_plane_search(ends_rays: bool) -> wp.Function:
    """The search among bins; ends_rays: as in `wrt.builders.cost.split_comparison`."""
    compare = split_comparison(ends_rays)

    @wp.func
    def best_bin_plane(cost: SplitCost, frame: Frame, counter: wp.array2d(dtype=int), slot: int, bins: int, step: int):
        """The best of the planes between bins and the faces of the triangles' box. step: triangles per counted triangle."""
        best = no_split()
        triangles = frame.triangles
        for axis in range(3):
            along = axis_frame(cost, axis, frame.low, frame.high, frame.triangles)
            low = frame.inner_low[axis]
            high = frame.inner_high[axis]
            best = compare(cost, along, low, 0, triangles, False, best)
            if low < high:
                left = int(0)
                right = (triangles + step - 1) / step
                for b in range(1, bins):
                    left += bin_count(counter, slot, axis * bins + b - 1)
                    right -= bin_count(counter, slot, (3 + axis) * bins + bins - b)
                    position = low + (high - low) * (float(b) / float(bins))
                    on_left = wp.min(left * step, triangles)
                    # a triangle in the plane counts on neither side, so planar ones are put on the right
                    on_right = wp.max(wp.min(right * step, triangles), triangles - on_left)
                    best = compare(cost, along, position, on_left, on_right, False, best)
            best = compare(cost, along, high, triangles, 0, True, best)
        return best

    return best_bin_plane


best_bin_plane = bin_plane_search(True)
"""For either cost model."""
