"""One node of a build with spatial splits: its best division, among triangles or between slabs, and the division itself.

`split` searches as `projected_binned` does; if the boxes of both sides overlap, it also searches between slabs. Phases: search,
divide. `spatial_build` has the story and the bounds.

**Bins.** The box of a node is cut into slabs of equal width along an axis. A triangle adds to each slab that its box meets the
box of its part there (`wrt.builders.core.clip`, with the same pads), is counted as entering at the first of them, and as
leaving at the last. The boxes on both sides of a plane between slabs are unions of those of slabs; the triangles on the left of
it are those that entered before, those on the right are those that leave after (Stich et al. 2009).

**Determinism.** `slab_of` maps a coordinate to a slab. Bins and division evaluate the same expression, so no side gets more
triangles than were counted. It may get fewer: a triangle may have no part in the overlap of its box and a side.

References: stich-2009.
"""

import warp as wp

from wrt.builders.bvh.bvh_config import BuildRules
from wrt.builders.bvh.known_rays_config import KnownRays
from wrt.builders.bvh.phases.binary_tree import BinaryTree, Frame, half_area, halvings, middle, must_split_at_median, split_cost
from wrt.builders.bvh.phases.bvh_bins import (
    SLOT_BINS,
    Scratch,
    bin_range,
    bins_for,
    centroid_domain,
    make_binning,
    make_scratch,
    no_plane,
    partition_range,
    range_box,
    write_child_boxes,
)
from wrt.builders.bvh.projected_binned import (
    BOX_FLOATS,
    SIDES,
    add_projected,
    cheapest_by_projection,
    high_of,
    low_of,
    mixture_at,
    sweep_axis,
)
from wrt.builders.core.clip import ClippedMesh
from wrt.builders.cost import leaf_cost
from wrt.builders.influence.projected_cost import box_weight
from wrt.kernels.layout.struct_arrays import with_known_layout
from wrt.kernels.layout.unchecked import load_int
from wrt.kernels.runtime import native
from wrt.kernels.simd.boxes import INFINITY

MIN_PADS = 2.0
"""Least width of a slab, in pads: in thinner ones, every part would reach into the neighbours."""


@wp.struct
class Slabs:
    """The slabs of a node along an axis. The slab of a coordinate x: (x - low) * scale, clamped to [0, count - 1]."""

    axis: int
    low: float
    scale: float
    """0 if the node is too thin to be split: everything is in slab 0."""
    count: int


@wp.func
def make_slabs(axis: int, low: float, high: float, count: int, pad: float):
    """The slabs of a node that reaches from low to high."""
    slabs = Slabs()
    slabs.axis = axis
    slabs.low = low
    slabs.count = count
    slabs.scale = 0.0
    if high - low > MIN_PADS * pad * float(count):
        slabs.scale = float(count) / (high - low)
    return slabs


@native.func_native(
    "clip.h",
    f"const size_t first = (size_t)slot * {SLOT_BINS} + slabs.axis * slabs.count;\n"
    "int *enter = scratch.count.data + first, *leave = leaving.data + first;\n"
    "const float* from = references.data + (size_t)begin * 8;\n"
    "wrt::bin_parts(mesh, from, count, slabs, scratch.box.data + first * 8, enter, leave);",
)
def bin_parts(
    mesh: ClippedMesh,
    references: wp.array(dtype=float),
    begin: int,
    count: int,
    slabs: Slabs,
    scratch: Scratch,
    leaving: wp.array(dtype=int),
    slot: int,
):
    """Bins the parts of a range of triangles along an axis: boxes and numbers of entering triangles in `scratch`, numbers of
    leaving ones in `leaving`, in the same layout."""


@native.func_native(
    "clip.h",
    "float *from = references.data + (size_t)begin * 8, *left = references.data + (size_t)to_left * 8;\n"
    "float* right = references.data + (size_t)to_right * 8;\n"
    "return wrt::divide_parts<wp::vec2i>(mesh, from, count, slabs, plane, left, right);",
)
def divide_parts(
    mesh: ClippedMesh,
    references: wp.array(dtype=float),
    begin: int,
    count: int,
    slabs: Slabs,
    plane: int,
    to_left: int,
    to_right: int,
) -> wp.vec2i:
    """Moves a range to the sides of the plane before slab `plane`, in order, and straddlers to both, with the boxes of their
    parts. Returns the numbers of both sides."""


MIN_OVERLAP = wp.constant(1e-5)
"""Least hit probability of the overlap of two children for which a spatial split is tried, that of Stich et al. (2009)."""


@with_known_layout
@wp.struct
class Branch:
    """A node that is being built."""

    frame: Frame
    room: int
    """References and pairs that it owns, from `frame.first` on."""


@wp.struct
class PartMemory:
    """The triangles, their references, and scratch memory of all slots."""

    mesh: ClippedMesh
    references: wp.array(dtype=float)
    """Two buffers of references."""
    capacity: int
    """References in a buffer."""
    bins: Scratch
    leaving: wp.array(dtype=int)
    """(slots * SLOT_BINS,) triangles that leave in each slab."""
    domain: wp.array(dtype=float)
    """(3 * slots * 8,) centroid boxes; only the first of a slot is read."""


@wp.struct
class PartPlane:
    """The best plane of a spatial split."""

    slabs: Slabs
    cost: float
    """INFINITY if there is none."""
    plane: int
    """First slab on its right."""
    left: int
    """Most triangles on its left."""
    right: int


def make_part_memory(mesh: ClippedMesh, references: wp.array, capacity: int, slots: int) -> PartMemory:
    """Memory for a number of slots."""
    device = references.device
    memory = PartMemory()
    memory.mesh, memory.references, memory.capacity = mesh, references, capacity
    memory.bins = make_scratch(slots, device)
    memory.leaving = wp.empty(slots * SLOT_BINS, dtype=int, device=device)
    memory.domain = wp.empty(3 * 8 * slots, dtype=float, device=device)
    return memory


# -- search --------------------------------------------------------------------------------------------------------------


@wp.func
def overlap_is_met(rays: KnownRays, tree: BinaryTree, pair: int, depth: int):
    """Whether enough rays meet the overlap of the boxes of a pair."""
    low = wp.max(low_of(tree, 2 * pair), low_of(tree, 2 * pair + 1))
    high = wp.min(high_of(tree, 2 * pair), high_of(tree, 2 * pair + 1))
    met = bool(False)
    if low[0] <= high[0] and low[1] <= high[1] and low[2] <= high[2]:
        met = box_weight(mixture_at(rays, depth), low, high) > MIN_OVERLAP
    return met


@wp.func
def cheapest_part_plane(
    rules: BuildRules,
    rays: KnownRays,
    memory: PartMemory,
    branch: Branch,
    slot: int,
    tree: BinaryTree,
):
    """The plane of least cost between slabs, on the axes that `cheapest_by_projection` tried in this node."""
    frame = branch.frame
    best = PartPlane()
    best.cost = INFINITY
    boxes = wp.zeros(shape=(BOX_FLOATS,), dtype=float)
    weights = wp.zeros(shape=(SIDES,), dtype=float)
    mixture = mixture_at(rays, frame.depth)
    low = low_of(tree, frame.node)
    high = high_of(tree, frame.node)
    bins = bins_for(rules, frame.count)
    tried = int(rays.tried[frame.node])
    for axis in range(3):
        slabs = make_slabs(axis, low[axis], high[axis], bins, memory.mesh.pad)
        if (tried >> axis) & 1 != 0 and slabs.scale > 0.0:
            begin = frame.buffer + frame.first
            bin_parts(memory.mesh, memory.references, begin, frame.count, slabs, memory.bins, memory.leaving, slot)
            sweep_axis(memory.bins, slot, axis, bins, mixture.others, boxes, weights)
            add_projected(mixture, 2 * bins, boxes, weights)
            first = slot * SLOT_BINS + axis * bins
            right = int(frame.count)
            for b in range(1, bins):
                left = load_int(memory.bins.left, first + b)
                right -= load_int(memory.leaving, first + b - 1)
                if left < frame.count and right < frame.count and left + right <= branch.room:
                    cost = split_cost(weights[b], leaf_cost(rules.cost, left), weights[bins + b], leaf_cost(rules.cost, right))
                    if cost < best.cost:
                        best.cost = cost
                        best.slabs = slabs
                        best.plane = b
                        best.left = left
                        best.right = right
    return best


# -- divide --------------------------------------------------------------------------------------------------------------


@wp.func
def room_of_left(branch: Branch, left: int, right: int):
    """The left child's room: its references, and its share of what is left over."""
    spare = branch.room - left - right
    return left + int(wp.float64(spare) * wp.float64(left) / wp.float64(left + right))


@wp.func
def pair_at(branch: Branch, left_room: int):
    """The pair of children of a node, by the room of the left one."""
    return branch.frame.first + left_room


@wp.func
def split(
    rules: BuildRules,
    rays: KnownRays,
    memory: PartMemory,
    branch: Branch,
    slot: int,
    tree: BinaryTree,
    left: wp.ref[Branch],
    right: wp.ref[Branch],
):
    """Divides a node: searches, moves its references to the other buffer, and writes the boxes of its children."""
    frame = branch.frame
    begin = frame.buffer + frame.first
    plane = no_plane()
    parts = PartPlane()
    parts.cost = INFINITY
    centroid_domain(memory.references, begin, frame.count, memory.domain, 3 * slot)
    binning = make_binning(memory.domain, 3 * slot, bins_for(rules, frame.count))
    if half_area(tree.box, frame.node) > 0.0 and not must_split_at_median(frame.depth, frame.count):
        bin_range(memory.references, begin, frame.count, binning, memory.bins, slot)
        plane = cheapest_by_projection(rules, rays, binning, memory.bins, slot, tree, frame)
        if frame.count > rules.max_leaf and branch.room > frame.count and frame.depth + halvings(frame.count) < rays.max_depth:
            overlap = plane.cost == INFINITY
            if not overlap:
                pair = pair_at(branch, plane.left)
                write_child_boxes(memory.bins, slot, binning.bins, plane.axis, plane.bin, tree.box, pair)
                overlap = overlap_is_met(rays, tree, pair, frame.depth)
            if overlap:
                parts = cheapest_part_plane(rules, rays, memory, branch, slot, tree)
    left.room = room_of_left(branch, plane.left, frame.count - plane.left)
    counts = wp.vec2i(plane.left, frame.count - plane.left)
    to = memory.capacity - frame.buffer + frame.first
    buffer = memory.capacity - frame.buffer
    if parts.cost < plane.cost:
        left.room = room_of_left(branch, parts.left, parts.right)
        counts = divide_parts(memory.mesh, memory.references, begin, frame.count, parts.slabs, parts.plane, to, to + left.room)
    elif plane.cost < INFINITY:
        sides = wp.vec2i(to, to + left.room)
        boxes = wp.vec2i(3 * slot + 1, 3 * slot + 2)
        partition_range(memory.references, begin, frame.count, binning, plane, sides, memory.domain, boxes)
    else:  # stays where it is, so all of the spare room goes to the right
        half = middle(frame.count, rules.cost.width_bits)
        left.room = half
        counts = wp.vec2i(half, frame.count - half)
        buffer = frame.buffer
    pair = pair_at(branch, left.room)
    tree.pair[frame.node] = pair
    left.frame.node = 2 * pair
    left.frame.first = frame.first
    left.frame.count = counts[0]
    left.frame.buffer = buffer
    left.frame.depth = frame.depth + 1
    right.frame = left.frame
    right.frame.node = 2 * pair + 1
    right.frame.first = frame.first + left.room
    right.frame.count = counts[1]
    right.room = branch.room - left.room
    range_box(memory.references, buffer + left.frame.first, counts[0], tree.box, 2 * pair)
    range_box(memory.references, buffer + right.frame.first, counts[1], tree.box, 2 * pair + 1)
