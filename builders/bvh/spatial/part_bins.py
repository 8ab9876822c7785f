"""Innermost loops of spatial splits: bin the parts of triangles, and divide a range at a plane.

**Bins.** The box of a node is cut into slabs of equal width along an axis. A triangle adds to each slab that its box meets the
box of its part there (`wrt.builders.core.clip`, with the same pads), is counted as entering at the first of
them, and as leaving at the last. The boxes on both sides of a plane between slabs are unions of those of slabs; the triangles
on the left of it are those that entered before, those on the right are those that leave after (Stich et al. 2009).

**Determinism.** `slab_of` maps a coordinate to a slab. Bins and division evaluate the same expression, so no side gets more
triangles than were counted. It may get fewer: a triangle may have no part in the overlap of its box and a side.

References:
    M. Stich, H. Friedrich, A. Dietrich: Spatial splits in bounding volume hierarchies. High Performance Graphics 2009.
"""

import warp as wp

from wrt.builders.bvh.phases.bvh_bins import SLOT_BINS, Scratch
from wrt.builders.core.clip import CLIP, ClippedMesh
from wrt.builders.triangle_references import ID_OFFSET
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module

exact_module(__name__)

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


_HEAD = (
    """
    constexpr int W = 8;
    const auto& lists = mesh;
    const float pad = mesh.pad;
    const int axis = slabs.axis;
    wp::vec3 low, high;
"""
    + CLIP
    + f"""
    const auto slab_of = [&](float x) {{
        float t = (x - slabs.low) * slabs.scale;
        t = t > 0.0f ? t : 0.0f;
        t = t < (float)(slabs.count - 1) ? t : (float)(slabs.count - 1);
        return (int)t;
    }};
    const auto part_between = [&](float* box, float from, float to) {{
        for (int j = 0; j < 3; ++j) {{ low.c[j] = box[j]; high.c[j] = -box[4 + j]; }}
        low.c[axis] = from > low.c[axis] ? from : low.c[axis];
        high.c[axis] = to < high.c[axis] ? to : high.c[axis];
        int bits;
        memcpy(&bits, box + 3, 4);
        return clip(box, bits - {ID_OFFSET});
    }};
"""
)
"""slab_of: see `Slabs`. part_between: shrinks the box of a reference to its part between two planes; false if it has none."""


@native.func_native(
    "lanes.h",
    _HEAD
    + f"""
    const size_t first = (size_t)slot * {SLOT_BINS} + axis * slabs.count;
    float* grid = scratch.box.data + first * 8;
    int* enter = scratch.count.data + first;
    int* leave = leaving.data + first;
    const float empty[W] = {{INFINITY, INFINITY, INFINITY, INFINITY, INFINITY, INFINITY, INFINITY, INFINITY}};
    for (int b = 0; b < slabs.count; ++b) {{ memcpy(grid + b * 8, empty, sizeof(empty)); enter[b] = 0; leave[b] = 0; }}
    const float width = 1.0f / slabs.scale;
    const float* from = references.data + (size_t)begin * 8;
    for (int i = 0; i < count; ++i, from += 8) {{
        const int b0 = slab_of(from[axis]), b1 = slab_of(-from[4 + axis]);
        ++enter[b0];
        ++leave[b1];
        for (int b = b0; b <= b1; ++b) {{
            float part[W];
            memcpy(part, from, sizeof(part));
            if (b0 < b1) {{
                const float at = b == b0 ? -INFINITY : slabs.low + (float)b * width;
                const float end = b == b1 ? INFINITY : slabs.low + (float)(b + 1) * width;
                if (!part_between(part, at, end)) continue;
            }}
            float* box = grid + b * 8;
            WRT_FOR_LANES(j) box[j] = part[j] < box[j] ? part[j] : box[j];
        }}
    }}
""",
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
    "lanes.h",
    _HEAD
    + """
    const float at = slabs.low + (float)plane / slabs.scale;
    const float* from = references.data + (size_t)begin * 8;
    float* left = references.data + (size_t)to_left * 8;
    float* right = references.data + (size_t)to_right * 8;
    int lefts = 0, rights = 0;
    for (int i = 0; i < count; ++i, from += 8) {
        const bool on_left = slab_of(from[axis]) < plane, on_right = slab_of(-from[4 + axis]) >= plane;
        if (!(on_left && on_right)) {
            memcpy((on_left ? left + (size_t)lefts * 8 : right + (size_t)rights * 8), from, 8 * sizeof(float));
            lefts += on_left;
            rights += !on_left;
            continue;
        }
        float a[W], b[W];
        memcpy(a, from, sizeof(a));
        memcpy(b, from, sizeof(b));
        const bool second = part_between(b, at, INFINITY), first = part_between(a, -INFINITY, at);
        if (first) memcpy(left + (size_t)lefts++ * 8, a, sizeof(a));
        if (second) memcpy(right + (size_t)rights++ * 8, b, sizeof(b));
    }
    return wp::vec2i(lefts, rights);
""",
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
