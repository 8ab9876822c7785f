"""Clipping of the straddlers of a chunk of references (`reference_levels`)."""

import warp as wp

from wrt.builders.core.clip import ClippedMesh
from wrt.builders.core.levels import Chunk, LiveNode
from wrt.builders.core.reference_lists import Sides
from wrt.kernels.runtime import native


@native.func_native(
    "clip.h",
    "const auto& split = node.split;\n"
    "auto left_high = node.frame.high, right_low = node.frame.low;\n"
    "left_high[split.axis] = right_low[split.axis] = split.position;\n"
    "const auto left_cell = wrt::cell_of(node.frame.low, left_high, mesh.pad);\n"
    "const auto right_cell = wrt::cell_of(right_low, node.frame.high, mesh.pad);\n"
    "const float* from = references.data + (size_t)chunk.begin * 8;\n"
    "float *left = target.data + (size_t)chunk.to_left * 8, *right = target.data + (size_t)chunk.to_right * 8;\n"
    "const wrt::SideTargets targets = {moving, left, right, {}};\n"
    "wrt::clip_sides(mesh, left_cell, right_cell, from, chunk.end - chunk.begin, split, targets, sides);",
)
def clip_chunk(
    mesh: ClippedMesh,
    references: wp.array(dtype=float),
    node: LiveNode,
    chunk: Chunk,
    moving: bool,
    target: wp.array(dtype=float),
    sides: wp.ref[Sides],
):
    """Clips a chunk's straddlers to the cells of the children of its node, which is split, counts the references of both sides,
    and computes their boxes. Writes them to the target if they are `moving`."""
    ...
