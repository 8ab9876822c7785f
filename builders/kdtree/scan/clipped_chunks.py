"""Clipping of the straddlers of a chunk of references (`reference_levels`)."""

import warp as wp

from wrt.builders.core.clip import CLIP, ClippedMesh
from wrt.builders.core.levels import Chunk, LiveNode
from wrt.builders.core.reference_lists import CLASSIFY, GROW, HEAD, SIDES_END, SIDES_START, Sides
from wrt.builders.triangle_references import ID_OFFSET
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module

exact_module(__name__)


@native.func_native(
    "lanes.h",
    HEAD
    + SIDES_START
    + """
    const auto part_in = [&](const auto& low, const auto& high, float* box) {
        const float pad = lists.pad;
"""
    + CLIP
    + f"""
        int bits;
        memcpy(&bits, box + 3, 4);
        return clip(box, bits - {ID_OFFSET});
    }};
    float unwanted[W];
    const auto write = [&](const float* box, int left, int right) {{
        if (moving) {{
            memcpy(left ? target.data + (size_t)(to_left + sides.left) * 8 : unwanted, box, sizeof(unwanted));
            memcpy(right ? target.data + (size_t)(to_right + sides.right) * 8 : unwanted, box, sizeof(unwanted));
        }}
        sides.left += left;
        sides.right += right;
    }};
    sides.left = 0;
    sides.right = 0;
    for (int i = 0; i < count; ++i, from += 8) {{
"""
    + CLASSIFY
    + """
        float reference[W];
        if (left & right) {
            memcpy(reference, from, sizeof(reference));
            if (part_in(cell_low, left_high, reference)) {
                const int left = 1, right = 0;
"""
    + GROW
    + """
                write(reference, left, right);
            }
            memcpy(reference, from, sizeof(reference));
            if (part_in(right_low, cell_high, reference)) {
                const int left = 0, right = 1;
"""
    + GROW
    + """
                write(reference, left, right);
            }
            continue;
        }
        memcpy(reference, from, sizeof(reference));
"""
    + GROW
    + """
        write(reference, left, right);
    }
"""
    + SIDES_END,
)
def clip_range(
    lists: ClippedMesh,
    references: wp.array(dtype=float),
    begin: int,
    count: int,
    axis: int,
    position: float,
    planar_left: bool,
    cell_low: wp.vec3,
    left_high: wp.vec3,
    right_low: wp.vec3,
    cell_high: wp.vec3,
    moving: bool,
    target: wp.array(dtype=float),
    to_left: int,
    to_right: int,
    sides: wp.ref[Sides],
):
    """Clips the straddlers of a range to the cells (cell_low, left_high) and (right_low, cell_high), counts the references of
    both sides, and computes their boxes. Writes them to the target if they are `moving`."""
    ...


@wp.func
def clip_chunk(
    mesh: ClippedMesh,
    references: wp.array(dtype=float),
    node: LiveNode,
    chunk: Chunk,
    moving: bool,
    target: wp.array(dtype=float),
    sides: wp.ref[Sides],
):
    """`clip_range` of a chunk of a node that is split."""
    split = node.split
    left_high = node.frame.high
    right_low = node.frame.low
    left_high[split.axis] = split.position
    right_low[split.axis] = split.position
    clip_range(
        mesh,
        references,
        chunk.begin,
        chunk.end - chunk.begin,
        split.axis,
        split.position,
        split.planar_left,
        node.frame.low,
        left_high,
        right_low,
        node.frame.high,
        moving,
        target,
        chunk.to_left,
        chunk.to_right,
        sides,
    )
