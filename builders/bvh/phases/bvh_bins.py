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

References:
    I. Wald: On fast construction of SAH-based bounding volume hierarchies. IEEE Symposium on Interactive Ray Tracing 2007.
    M. Vinkler, J. Bittner, V. Havran: Extended Morton codes for high performance bounding volume hierarchy construction.
        High Performance Graphics 2017.
"""

import warp as wp

from wrt.builders.bvh.bvh_config import MAX_BINS, BuildRules
from wrt.builders.cost import LEAF_COST, SplitCost
from wrt.kernels.layout.unchecked import load_float
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.boxes import INFINITY

exact_module(__name__)

SLOT_BINS = 4 * MAX_BINS
"""Bins of a slot, at axis * bins + bin; packed densely if fewer bins are in use."""

SIZE_RANGE = wp.constant(8.0)
"""Least binary logarithm of the ratio of the largest and the smallest box's area for size to be an axis. The parts of scanned
meshes differ less, and are spared the bins (notebooks/records/2026-11-24-large-triangles.md)."""

FEW = wp.constant(64)
FEW_BINS = wp.constant(8)
"""A node of at most FEW triangles gets FEW_BINS bins, because clearing and sweeping more would cost more than they improve."""

_HEAD = f"""
    constexpr int W = 8;
    constexpr int SLOT_BINS = {SLOT_BINS};
    constexpr int PIECE = 1 << 23;
    constexpr int ONE_GRID = 64;  // triangles up to which a second grid takes longer to clear than it saves
    (void)W; (void)SLOT_BINS; (void)PIECE; (void)ONE_GRID;
"""


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


@native.func_native(
    "lanes.h",
    _HEAD
    + """
    const float* __restrict__ from = references.data + (size_t)begin * 8;
    float grown[W];
    WRT_FOR_LANES(j) grown[j] = INFINITY;
    for (int i = 0; i < count; ++i, from += 8) {
        float centroid[W];
        for (int j = 0; j < 4; ++j) { centroid[j] = from[j] - from[4 + j]; centroid[4 + j] = from[4 + j] - from[j]; }
        WRT_FOR_LANES(j) grown[j] = centroid[j] < grown[j] ? centroid[j] : grown[j];
    }
    WRT_FOR_LANES(j) domain.data[(size_t)at * 8 + j] = grown[j];
""",
)
def centroid_domain(references: wp.array(dtype=float), begin: int, count: int, domain: wp.array(dtype=float), at: int):
    """Writes the box of the doubled centroids of a range."""
    ...


@native.func_native(
    "lanes.h",
    _HEAD
    + """
    const float* __restrict__ from = references.data + (size_t)begin * 8;
    float grown[W];
    WRT_FOR_LANES(j) grown[j] = INFINITY;
    for (int i = 0; i < count; ++i, from += 8) {
        WRT_FOR_LANES(j) grown[j] = from[j] < grown[j] ? from[j] : grown[j];
    }
    WRT_FOR_LANES(j) boxes.data[(size_t)node * 8 + j] = grown[j];
""",
)
def range_box(references: wp.array(dtype=float), begin: int, count: int, boxes: wp.array(dtype=float), node: int):
    """Writes the box of a range of triangles."""
    ...


@native.func_native(
    "lanes.h",
    _HEAD
    + """
    const int bins = binning.bins;
    float* __restrict__ grid = scratch.box.data + (size_t)slot * (SLOT_BINS * 8);
    int* __restrict__ counts = scratch.count.data + (size_t)slot * SLOT_BINS;
    const int all = binning.axes * bins;
    const float empty[W] = {INFINITY, INFINITY, INFINITY, INFINITY, INFINITY, INFINITY, INFINITY, 0.0f};
    for (int i = 0; i < all; ++i) memcpy(grid + i * 8, empty, sizeof(empty));
    for (int i = 0; i < all; ++i) counts[i] = 0;
    float low[4], scale[4];
    for (int j = 0; j < 4; ++j) { low[j] = binning.low.c[j]; scale[j] = binning.scale.c[j]; }
    const float last = (float)(bins - 1);
    float one_more[W];
    WRT_FOR_LANES(j) one_more[j] = -0.0f;
    one_more[7] = -1.0f;
    const auto add = [&](auto axes, float* into, const float* from) {
        float reference[W];
        memcpy(reference, from, sizeof(reference));
        int bin[4];
        WRT_FOR(4, j) {
            float t = ((from[j] - from[4 + j]) - low[j]) * scale[j];
            t = t > 0.0f ? t : 0.0f;
            t = t < last ? t : last;
            bin[j] = (int)t;
        }
        for (int axis = 0; axis < axes.count; ++axis) {
            float* box = into + (axis * bins + bin[axis]) * 8;
            float grown[W];
            memcpy(grown, box, sizeof(grown));
            WRT_FOR_LANES(j) grown[j] = (reference[j] < grown[j] ? reference[j] : grown[j]) + one_more[j];
            memcpy(box, grown, sizeof(grown));
        }
    };
    const auto add_all = [&](auto axes) {
        const float* __restrict__ from = references.data + (size_t)begin * 8;
        if (count <= ONE_GRID) {
            for (int i = 0; i < count; ++i, from += 8) add(axes, grid, from);
            WRT_SCALAR
            for (int i = 0; i < all; ++i) counts[i] -= (int)grid[i * 8 + 7];
            return;
        }
        float other[SLOT_BINS * 8];
        for (int done = 0; done < count; done += PIECE) {
            const int piece = count - done < PIECE ? count - done : PIECE;
            for (int i = 0; i < all; ++i) { memcpy(other + i * 8, empty, sizeof(empty)); grid[i * 8 + 7] = 0.0f; }
            for (int i = 0; i < piece - 1; i += 2, from += 16) { add(axes, grid, from); add(axes, other, from + 8); }
            if (piece & 1) { add(axes, grid, from); from += 8; }
            for (int i = 0; i < all; ++i) {
                float* box = grid + i * 8;
                const float* more = other + i * 8;
                counts[i] -= (int)box[7] + (int)more[7];
                WRT_FOR_LANES(j) box[j] = more[j] < box[j] ? more[j] : box[j];
            }
        }
    };
    struct Three { enum { count = 3 }; };  // known to the compiler, which unrolls the loop over axes
    struct Four { enum { count = 4 }; };
    if (binning.axes == 4) add_all(Four{});
    else add_all(Three{});
""",
)
def bin_range(references: wp.array(dtype=float), begin: int, count: int, binning: Binning, scratch: Scratch, slot: int):
    """Bins a range of triangles along all axes.

    The last lane of a bin counts down by one per triangle, in the same instruction that adds -0 to the other lanes; a separate
    counter would need another load and store. The lane is moved to `count` before float32 can no longer represent it
    exactly. Neighbours in a mesh often fall into the same bins, and each would wait for the last one's store. So every other
    triangle goes to a second grid, which is merged with the first."""
    ...


@native.func_native(
    "lanes.h",
    _HEAD
    + """
    float* to = scratch.box.data + (size_t)slot * (SLOT_BINS * 8);
    int* count = scratch.count.data + (size_t)slot * SLOT_BINS;
    for (int i = 0; i < axes * bins * 8; ++i) to[i] = INFINITY;
    for (int i = 0; i < axes * bins; ++i) count[i] = 0;
    for (int other = first; other < end; ++other) {
        const float* from = scratch.box.data + (size_t)other * (SLOT_BINS * 8);
        for (int i = 0; i < axes * bins * 8; ++i) to[i] = from[i] < to[i] ? from[i] : to[i];
        for (int i = 0; i < axes * bins; ++i) count[i] += scratch.count.data[(size_t)other * SLOT_BINS + i];
    }
""",
)
def merge_bins(scratch: Scratch, slot: int, first: int, end: int, bins: int, axes: int):
    """Replaces the bins of a slot by the union of those of the slots first .. end - 1."""
    ...


@native.func_native(
    "lanes.h",
    _HEAD
    + LEAF_COST
    + f"""
    constexpr int MOST = {MAX_BINS};
    static_assert(MOST % W == 0, "lanes of the last vector are cleared");
    const float* grid = scratch.box.data + (size_t)slot * (SLOT_BINS * 8);
    const int* counts = scratch.count.data + (size_t)slot * SLOT_BINS;
    const int padded = (bins + W - 1) / W * W;
    float least[W];
    int where[W];
    WRT_FOR_LANES(j) {{ least[j] = INFINITY; where[j] = 0; }}
    for (int axis = 0; axis < axes; ++axis, grid += bins * 8, counts += bins) {{
        float left_area[MOST], right_area[MOST], low_side[W], high_side[W];
        int left[MOST];
        WRT_FOR_LANES(j) {{ low_side[j] = INFINITY; high_side[j] = INFINITY; }}
        left[0] = 0;
        for (int b = bins; b < padded; ++b) left[b] = 0;
        for (int b = 1; b < bins; ++b) {{
            const float* __restrict__ box = grid + (b - 1) * 8;
            WRT_FOR_LANES(j) low_side[j] = box[j] < low_side[j] ? box[j] : low_side[j];
            const float x = -(low_side[0] + low_side[4]), y = -(low_side[1] + low_side[5]), z = -(low_side[2] + low_side[6]);
            left_area[b] = x * y + y * z + z * x;
            left[b] = left[b - 1] + counts[b - 1];
            const float* __restrict__ other = grid + (bins - b) * 8;
            WRT_FOR_LANES(j) high_side[j] = other[j] < high_side[j] ? other[j] : high_side[j];
            const float u = -(high_side[0] + high_side[4]), v = -(high_side[1] + high_side[5]);
            const float w = -(high_side[2] + high_side[6]);
            right_area[bins - b] = u * v + v * w + w * u;
        }}
        for (int first = 0; first < padded; first += W) WRT_FOR_LANES(j) {{
            const int b = first + j, before = left[b];
            const float found = left_area[b] * leaf_cost(before) + right_area[b] * leaf_cost(count - before);
            const bool better = before > 0 && before < count && found < least[j];
            least[j] = better ? found : least[j];
            where[j] = better ? axis * MOST + b : where[j];
        }}
    }}
    int lane = 0;
    for (int j = 1; j < W; ++j)
        if (least[j] < least[lane] || (least[j] == least[lane] && where[j] < where[lane])) lane = j;
    plane.cost = least[lane];
    plane.axis = where[lane] / MOST;
    plane.bin = where[lane] % MOST;
    plane.left = 0;
    for (int b = 0; b < plane.bin; ++b) plane.left += (counts - axes * bins)[plane.axis * bins + b];
""",
)
def find_best_plane(cost: SplitCost, scratch: Scratch, slot: int, bins: int, axes: int, count: int, plane: wp.ref[Plane]):
    """Sweeps the bins of a slot from both ends, and finds the plane of least cost.

    Lane j keeps the best of the bins j, j + 8, ... of all axes. So the costs of eight planes are computed at once."""
    ...


@wp.func
def best_plane(cost: SplitCost, scratch: Scratch, slot: int, bins: int, axes: int, count: int):
    """The plane of least cost; ties go to the smaller axis, then to the smaller bin."""
    plane = no_plane()
    find_best_plane(cost, scratch, slot, bins, axes, count, plane)
    return plane


@native.func_native(
    "lanes.h",
    _HEAD
    + """
    const float* grid = scratch.box.data + ((size_t)slot * SLOT_BINS + axis * bins) * 8;
    for (int side = 0; side < 2; ++side) {
        float grown[W];
        WRT_FOR_LANES(j) grown[j] = INFINITY;
        for (int b = side ? plane : 0; b < (side ? bins : plane); ++b) {
            const float* __restrict__ box = grid + b * 8;
            WRT_FOR_LANES(j) grown[j] = box[j] < grown[j] ? box[j] : grown[j];
        }
        WRT_FOR_LANES(j) boxes.data[((size_t)pair * 2 + side) * 8 + j] = grown[j];
    }
""",
)
def write_child_boxes(scratch: Scratch, slot: int, bins: int, axis: int, plane: int, boxes: wp.array(dtype=float), pair: int):
    """Writes the boxes of the bins on both sides of a plane."""
    ...


@native.func_native(
    "lanes.h",
    _HEAD
    + """
    const float low = binning.low.c[axis], scale = binning.scale.c[axis], last = (float)(binning.bins - 1);
    const float* __restrict__ from = references.data + (size_t)begin * 8;
    float* left = references.data + (size_t)to_left * 8;
    float* right = references.data + (size_t)to_right * 8;
    const float floors[2] = {INFINITY, -INFINITY};
    float low_side[W], high_side[W];
    WRT_FOR_LANES(j) { low_side[j] = INFINITY; high_side[j] = INFINITY; }
    for (int i = 0; i < count; ++i, from += 8) {
        float t = ((from[axis] - from[4 + axis]) - low) * scale;
        t = t > 0.0f ? t : 0.0f;
        t = t < last ? t : last;
        const bool on_left = (int)t < plane;
        float reference[W], centroid[W];
        memcpy(reference, from, sizeof(reference));
        for (int j = 0; j < 4; ++j) {
            centroid[j] = from[j] - from[4 + j];
            centroid[4 + j] = from[4 + j] - from[j];
        }
        float* to = on_left ? left : right;
        memcpy(to, reference, sizeof(reference));
        left += on_left ? 8 : 0;
        right += on_left ? 0 : 8;
        const float floor = floors[on_left];  // lifts what is on the other side out of the minimum, without a branch
        WRT_FOR_LANES(j) {
            const float a = centroid[j] > floor ? centroid[j] : floor;
            const float b = centroid[j] > -floor ? centroid[j] : -floor;
            low_side[j] = a < low_side[j] ? a : low_side[j];
            high_side[j] = b < high_side[j] ? b : high_side[j];
        }
    }
    WRT_FOR_LANES(j) {
        domain.data[(size_t)left_at * 8 + j] = low_side[j];
        domain.data[(size_t)right_at * 8 + j] = high_side[j];
    }
""",
)
def partition_range(
    references: wp.array(dtype=float),
    begin: int,
    count: int,
    binning: Binning,
    axis: int,
    plane: int,
    to_left: int,
    to_right: int,
    domain: wp.array(dtype=float),
    left_at: int,
    right_at: int,
):
    """Moves a range to the two sides of a plane, in order, and writes the boxes of their doubled centroids to `domain`."""
    ...
