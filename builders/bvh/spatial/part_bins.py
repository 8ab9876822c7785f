"""Innermost loops of spatial splits: bin the parts of triangles, and divide a range at a plane.

**Bins.** The box of a node is cut into slabs of equal width along an axis. A triangle adds to each slab that its box meets the
box of its part there (`wrt.builders.core.clip`, with the same pads), is counted as entering at the first of
them, and as leaving at the last. The boxes on both sides of a plane between slabs are unions of those of slabs; the triangles
on the left of it are those that entered before, those on the right are those that leave after (Stich et al. 2009).

**Determinism.** `slab_of` maps a coordinate to a slab. Bins and division evaluate the same expression, so no side gets more
triangles than were counted. It may get fewer: a triangle may have no part in the overlap of its box and a side.

References: stich-2009.
"""

import warp as wp

from wrt.builders.bvh.phases.bvh_bins import SLOT_BINS, Scratch
from wrt.builders.core.clip import ClippedMesh
from wrt.kernels.runtime import native

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
    ...


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
    ...
