"""Split clipping in the top levels of a build that scans references (`reference_levels`).

A chunk finds the sides of its references as without clipping. A straddler is then clipped to both children's cells, and enters
each with the box of its part there, or not at all (`split_clipping`). The counts say where chunks write, so the references are
clipped twice: once to be counted, once to be moved. Few of them straddle a plane. Tasks clip the same references to the same
boxes, so the tree does not depend on the level at which tasks begin.

References:
    S. Popov, J. Guenther, H.-P. Seidel, P. Slusallek: Experiences with streaming construction of SAH KD-trees.
        IEEE Symposium on Interactive Ray Tracing 2006.
"""

import warp as wp

from wrt.builders.kdtree.scan.reference_chunks import Chunk, LiveRange
from wrt.builders.kdtree.scan.reference_lists import Sides
from wrt.builders.kdtree.scan.split_clipping import PAD
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.builders.triangle_references import copy_references
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module

exact_module(__name__)


@wp.struct
class ClippedMesh:
    """The triangles to clip."""

    vertices: wp.array(dtype=wp.vec3)
    faces: wp.array(dtype=wp.vec3i)
    pad: float
    """Enlargement of cells and boxes, in scene units."""
    shrinks: bool
    """Whether clipped triangles get the boxes of their parts."""


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
    node: LiveRange,
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
        chunk.count,
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


@wp.kernel
def measure_clipped_chunks(
    first: int,
    mesh: ClippedMesh,
    references: wp.array(dtype=float),
    nodes: wp.array(dtype=LiveRange),
    chunks: wp.array(dtype=Chunk),
    measured: wp.array(dtype=Sides),
):
    """Item: a chunk. `measure_chunks` of `reference_chunks`, with clipping."""
    slot = first + wp.tid()
    chunk = chunks[slot]
    node = nodes[chunk.node]
    sides = Sides()
    if node.finished:
        sides.left = chunk.count
    else:
        clip_chunk(mesh, references, node, chunk, False, references, sides)
    measured[slot] = sides


@wp.kernel
def move_clipped_chunks(
    first: int,
    mesh: ClippedMesh,
    references: wp.array(dtype=float),
    nodes: wp.array(dtype=LiveRange),
    chunks: wp.array(dtype=Chunk),
    target: wp.array(dtype=float),
):
    """Item: a chunk. `move_chunks` of `reference_chunks`, with clipping."""
    chunk = chunks[first + wp.tid()]
    node = nodes[chunk.node]
    sides = Sides()
    if node.finished:
        copy_references(references, chunk.begin, chunk.count, target, chunk.to_left)
    else:
        clip_chunk(mesh, references, node, chunk, True, target, sides)


def clipped_mesh(triangles: TriangleBoxes, shrinks: bool) -> ClippedMesh:
    """The triangles to clip; shrinks: as of `ClippedMesh`."""
    mesh = ClippedMesh()
    mesh.vertices, mesh.faces = triangles.vertices, triangles.faces
    mesh.pad, mesh.shrinks = PAD * triangles.size, shrinks
    return mesh
