"""Innermost loops of the binned build: bin a range of triangles, find its best plane, partition the range.

**Data.** A triangle is a reference of 8 floats (`wrt.builders.triangle_references`). Its doubled centroid is low + high. A bin
is 8 floats too: adding a box to it is one minimum over 8 lanes (Wald 2007, section 3).

**Size as an axis.** Where the triangles of a node differ much in size, their size is a fourth axis: a split by size separates a
floor from what stands on it, which no plane in space does. Vinkler et al. (2017) sort by size for the same reason. The fourth
component of a doubled centroid is id - size, with an id that is too small a number to change it. So all axes are treated alike.

**Determinism.** `Binning` maps a centroid to a bin. Binning and partition evaluate the same expression, so the triangles
counted on the left of a plane are those moved to the left. Minima and counts do not depend on the order, so a range binned in
chunks gives the same result as in one pass.

Every function works on the scratch memory of one slot, which belongs to a subtree's task or to a chunk of the top levels.

References: wald-2007-sah; vinkler-2017.
"""

import warp as wp

from wrt.builders.bvh.bvh_config import MAX_BINS, BuildRules
from wrt.builders.cost import SplitCost
from wrt.kernels.layout.unchecked import load_float
from wrt.kernels.runtime import native
from wrt.kernels.simd.boxes import INFINITY

SLOT_BINS = 4 * MAX_BINS
"""Bins of a slot, at axis * bins + bin; packed densely if fewer bins are in use."""

SIZE_RANGE = wp.constant(8.0)
"""Least binary logarithm of the ratio of the largest and the smallest box's area for size to be an axis. The parts of scanned
meshes differ less, and do not need these bins (notebooks/records/2026-11-24-large-triangles.md)."""

FEW = wp.constant(64)
FEW_BINS = wp.constant(8)
"""A node of at most FEW triangles gets FEW_BINS bins, because clearing and sweeping more would cost more than they improve."""


@wp.struct
class Scratch:
    """Scratch memory of all slots."""

    box: wp.array(dtype=float)
    """(slots * SLOT_BINS * 8,) box of each bin."""
    count: wp.array(dtype=int)
    """(slots * SLOT_BINS,) triangles in each bin."""
    left: wp.array(dtype=int)
    """(slots * SLOT_BINS,) triangles before this bin."""


def make_scratch(slots: int, device: wp.Device) -> Scratch:
    """Scratch memory for a number of slots."""
    scratch = Scratch()
    scratch.box = wp.empty(slots * SLOT_BINS * 8, dtype=float, device=device)
    for name in ("count", "left"):
        setattr(scratch, name, wp.empty(slots * SLOT_BINS, dtype=int, device=device))
    return scratch


@wp.struct
class Binning:
    """The bin of a doubled centroid c: (c - low) * scale, clamped to [0, bins - 1]."""

    low: wp.vec4
    scale: wp.vec4
    bins: int
    axes: int
    """3, or 4 if size is an axis."""


@wp.struct
class Plane:
    """The best plane found."""

    cost: float
    """See `split_cost`; INFINITY if no plane has triangles on both sides."""
    axis: int
    bin: int
    """First bin on the right."""
    left: int
    """Triangles on the left."""


@wp.func
def no_plane():
    """A plane that costs more than any other."""
    plane = Plane()
    plane.cost = INFINITY
    return plane


@wp.func
def bins_for(rules: BuildRules, count: int):
    """Number of bins of a node with `count` triangles."""
    return wp.where(count > FEW, rules.bins, wp.min(rules.bins, FEW_BINS))


@wp.func
def make_binning(domain: wp.array(dtype=float), at: int, bins: int):
    """The bins of a node. domain: 8 floats per node, (low, -high) of the doubled centroids."""
    binning = Binning()
    binning.bins = bins
    for axis in range(4):
        low = load_float(domain, at * 8 + axis)
        extent = -load_float(domain, at * 8 + 4 + axis) - low
        binning.low[axis] = low
        binning.scale[axis] = wp.where(extent > 0.0, float(bins) / extent, 0.0)
    sizes = -load_float(domain, at * 8 + 7) - load_float(domain, at * 8 + 3)
    binning.axes = wp.where(sizes > SIZE_RANGE, 4, 3)
    return binning


AT = "references.data + (size_t){} * 8"
RANGE = AT.format("begin")
GRID = f"scratch.box.data + (size_t)slot * {8 * SLOT_BINS}"
COUNTS = f"scratch.count.data + (size_t)slot * {SLOT_BINS}"
ALL = "scratch.box.data, scratch.count.data"
"""C++: a reference and the first of a range; the boxes and the counts of a slot's bins, and those of all slots."""


@native.func_native("bins.h", f"wrt::centroid_domain({RANGE}, count, domain.data + (size_t)at * 8);")
def centroid_domain(references: wp.array(dtype=float), begin: int, count: int, domain: wp.array(dtype=float), at: int):
    """Writes the box of the doubled centroids of a range."""


@native.func_native("bins.h", f"wrt::range_box({RANGE}, count, boxes.data + (size_t)node * 8);")
def range_box(references: wp.array(dtype=float), begin: int, count: int, boxes: wp.array(dtype=float), node: int):
    """Writes the box of a range of triangles."""


@native.func_native("bins.h", f"wrt::bin_range<{SLOT_BINS}>({RANGE}, count, binning, {GRID}, {COUNTS});")
def bin_range(references: wp.array(dtype=float), begin: int, count: int, binning: Binning, scratch: Scratch, slot: int):
    """Bins a range of triangles along all axes.

    The last lane of a bin counts down by one per triangle, in the same instruction that adds -0 to the other lanes; a separate
    counter would need another load and store. The lane is moved to `count` before float32 can no longer represent it
    exactly."""


@native.func_native("bins.h", f"wrt::merge_bins<{SLOT_BINS}>({ALL}, slot, first, end, axes * bins);")
def merge_bins(scratch: Scratch, slot: int, first: int, end: int, bins: int, axes: int):
    """Replaces the bins of a slot by the union of those of the slots first .. end - 1."""


@native.func_native("bins.h", f"wrt::find_best_plane<{MAX_BINS}>(cost, {GRID}, {COUNTS}, bins, axes, count, plane);")
def find_best_plane(cost: SplitCost, scratch: Scratch, slot: int, bins: int, axes: int, count: int, plane: wp.ref[Plane]):
    """Sweeps the bins of a slot from both ends, and finds the plane of least cost."""


@wp.func
def best_plane(cost: SplitCost, scratch: Scratch, slot: int, bins: int, axes: int, count: int):
    """The plane of least cost; ties go to the smaller axis, then to the smaller bin."""
    plane = no_plane()
    find_best_plane(cost, scratch, slot, bins, axes, count, plane)
    return plane


@native.func_native("bins.h", f"wrt::write_child_boxes({GRID} + axis * bins * 8, bins, plane, boxes.data + (size_t)pair * 16);")
def write_child_boxes(scratch: Scratch, slot: int, bins: int, axis: int, plane: int, boxes: wp.array(dtype=float), pair: int):
    """Writes the boxes of the bins on both sides of a plane."""


@native.func_native(
    "bins.h",
    f"float *left = {AT.format('to[0]')}, *right = {AT.format('to[1]')};\n"
    "float *left_box = domain.data + (size_t)at[0] * 8, *right_box = domain.data + (size_t)at[1] * 8;\n"
    f"wrt::partition_range({RANGE}, count, binning, plane.axis, plane.bin, left, right, left_box, right_box);",
)
def partition_range(
    references: wp.array(dtype=float),
    begin: int,
    count: int,
    binning: Binning,
    plane: Plane,
    to: wp.vec2i,
    domain: wp.array(dtype=float),
    at: wp.vec2i,
):
    """Moves a range to the two sides of a plane, in order, and writes the boxes of their doubled centroids to `domain`.

    to: where the references of the left and of the right side go. at: where their boxes go."""
