"""Clipping of the straddlers of a chunk of references (`reference_levels`)."""

import warp as wp

from wrt.builders.core.clip import ClippedMesh
from wrt.builders.core.levels import Chunk, LiveNode
from wrt.builders.core.reference_lists import Sides
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module

exact_module(__name__)


@native.func_native(
    "clip.h",
    "const float* from = references.data + (size_t)begin * 8;\n"
    "float *left = target.data + (size_t)to_left * 8, *right = target.data + (size_t)to_right * 8;\n"
    "const auto left_cell = wrt::cell_of(cell_low, left_high, lists.pad);\n"
    "const auto right_cell = wrt::cell_of(right_low, cell_high, lists.pad);\n"
    "const wrt::SideTargets targets = {moving, left, right, {}};\n"
    "wrt::clip_sides(lists, left_cell, right_cell, from, count, axis, position, planar_left, targets, sides);",
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
