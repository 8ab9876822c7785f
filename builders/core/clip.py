"""Split clipping: a triangle that straddles a plane enters each side with the box of its part there ("perfect splits").

**Problem.** The box of a slanted triangle extends far beyond it. Split repeatedly by their boxes, triangles end up in cells
that they do not meet, and the candidate planes are those of boxes, not of the remaining parts of the triangles.

**Algorithm.** When partition finds a straddler, the triangle is clipped to both cells, plane after plane (Sutherland and
Hodgman 1974), in float64. On each side the reference gets the box of the remaining polygon, or is dropped if there is none
(Soupikov et al. 2008; Rahikainen 2013, sections 4.1 and 4.2). The search does not change: it sees smaller boxes. This file is
for lists that are scanned. `clipped_events` divides sorted events with the same clip, into the same tree.

**No hit is lost.** Cells, and the resulting boxes, are enlarged by `PAD` of the scene: a triangle is in every leaf that comes
as close to it.

    u, R, E                       2^-24; the ray's reach; the scene's largest extent
    16 u R + 14 u D               distance of a hit from its triangle (`wrt.kernels.triangle.watertight.woop_areas`)
    D <= 2 E                      twice the triangle's extent
    16 u R                        by which traversals widen cells (`wrt.kernels.simd.boxes`)
    4 u R                         of this, what the arithmetic of a plane uses
    pad = 1024 u E                less a rounding of the cell's faces, 1 u E
    12 u R + 1023 u E             distance that is covered
    16 u R + 28 u E               distance to be covered
    R <= 248 E                    is enough: 4 u R <= 995 u E

So no hit is lost for rays that start up to 200 times the scene's size away. Beyond that, one is lost only if the roundings of
another 4 u R all reach their worst case in the same direction. Searched by `clip` and `hits` of tests/bounds. The interval of
that leaf contains the hit's t: the leaf is visited before a later hit ends the search, and counts find an owner of the crossing
(`wrt.kernels.traversal.crossings`), which does not depend on the pad. Triangle tests that are not `accurate` may lose hits
beside needles.

Levels that several threads split together clip to the same boxes.

**Tests without clipping.** If boxes are not to shrink (`KdTreeConfig.cell_tests`), the same clip only tells which cells a
triangle meets: intersection tests in inner nodes, of which Rahikainen 2013 (4.1) reports that clipping is better.

**Limits.** The build takes 2 to 3 times as long (notebooks/records/2026-11-21-split-clipping.md). The choice of planes is
greedy: smaller boxes make single splits cheaper, and usually, but not always, the tree.

References: sutherland-hodgman-1974; wald-havran-2006; soupikov-2008; rahikainen-2013.
"""

from typing import Any

import warp as wp

from wrt.builders.core.reference_lists import ReferenceLists, Sides, partition_by, set_list
from wrt.builders.core.subtrees import Frame
from wrt.builders.cost import Split
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.kernels.runtime import native

PAD = 2.0**-14
"""Enlargement of cells and boxes, relative to the scene's largest extent: 1024 units of 2^-24, see the module's docstring."""


@wp.struct
class ClippedMesh:
    """The triangles to clip."""

    vertices: wp.array(dtype=wp.vec3)
    faces: wp.array(dtype=wp.vec3i)
    pad: float
    """Enlargement of cells and boxes, in scene units."""
    shrinks: bool
    """Whether clipped triangles get the boxes of their parts."""
    clips: bool
    """Whether anything is clipped; if not, nothing else is set."""


def give_mesh(lists: Any, triangles: TriangleBoxes, size: float, shrinks: bool) -> None:
    """Sets the members of a struct that are those of `ClippedMesh`; size: the scene's largest extent."""
    lists.vertices, lists.faces = triangles.vertices, triangles.faces
    lists.pad, lists.shrinks = PAD * size, shrinks


def clipped_mesh(triangles: TriangleBoxes, size: float, shrinks: bool = True) -> ClippedMesh:
    """The triangles to clip; arguments as in `give_mesh`."""
    mesh = ClippedMesh()
    mesh.clips = True
    give_mesh(mesh, triangles, size, shrinks)
    return mesh


@native.func_native(
    "clip.h",
    "float* range = lists.reference.data + (size_t)begin * 8;\n"
    "const auto cell = wrt::cell_of(frame.low, frame.high, lists.pad);\n"
    "return wrt::clip_range(lists, cell, range, count, axis, beyond_high, inner_low, inner_high);",
)
def clip_range(
    lists: ReferenceLists,
    frame: wp.ref[Frame],
    begin: int,
    count: int,
    axis: int,
    beyond_high: bool,
    inner_low: wp.ref[wp.vec3],
    inner_high: wp.ref[wp.vec3],
) -> int:
    """Clips the references of a range that extend beyond one end of a node's cell along an axis, and drops those without
    a remaining part.

    Returns the number of remaining references. inner_low, inner_high: their box."""


@wp.func
def clip_list(lists: ReferenceLists, frame: wp.ref[Frame], count: int, axis: int, beyond_high: bool):
    """Clips the straddlers in a child's list, which has not been set yet, to its cell."""
    low = wp.vec3()
    high = wp.vec3()
    begin = frame.first[0]
    kept = clip_range(lists, frame, begin, count, axis, beyond_high, low, high)
    set_list(frame, begin, kept, low, high)


@wp.func
def clip_lists(lists: ReferenceLists, split: Split, sides: Sides, left: wp.ref[Frame], right: wp.ref[Frame]):
    """Gives the children what was moved, and clips the straddlers among it."""
    clip_list(lists, left, sides.left, split.axis, True)
    clip_list(lists, right, sides.right, split.axis, False)


partition_clipping = partition_by(clip_lists)
"""`reference_lists.partition`, with clipping of the straddlers."""
