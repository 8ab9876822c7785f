"""Conservative rasterisation of triangles onto the cube of directions around a point light, in float64.

**What must be listed.** A shadow ray starts at o and has the direction d = fl(light - o). A triangle test finds a hit at t in
[0, 1]. The list of the cell that contains -d must have the triangle.

**Proof.** The ray ends at o + d = light + e, where e comes from rounding o and d: |e| <= 2^-23 (|o| + |d|), all norms here are
the largest component. So o + t d = light + e + (1 - t)(-d): seen from light + e, the hit lies *exactly* in the direction -d. A
hit of an accurate test is at most 16 u R + 14 u D away from the triangle (`wrt.kernels.triangle.watertight.woop_areas`), less
than 2^-19 reach, as the reach that `slack_of` allows for is four times the scene's extent. Hence there is a point p of the
triangle and an error h with

    (1 - t)(-d) = p - light + h,  |h| <= slack,

where slack is at least |e| plus that (`slack_of`). Let c be -d scaled to depth 1 and s = (1 - t)|d| the depth of the hit:
s c = p - light + h. The following tests accept a cell if any c in it satisfies this for any p and h; the cell is widened by
`CELL_SLACK`, more than the rounding of u and v (three operations on numbers up to 2). Errors of float64 are ten thousand times
smaller than slack.

* **Rectangle.** The projections of the vertices, each anywhere in a box of radius slack, bound u and v; if the triangle reaches
  behind the light, the projection of its box in front of depth rho does, where rho is a lower bound of s: the distance of the
  triangle from the light minus slack.
* **Edges.** For vertices A, B, C around the light, n = A x B has the sign of the volume (A, B, C) on C. n . s c = n . p + n . h
  >= -|n|_1 slack, so n . c >= -|n|_1 slack / rho.
* **Plane.** With the normal N towards which the volume V = N . A is positive, s N . c lies in V -+ |N|_1 slack. This bounds s
  too: the least depth in the cell.

For tests that are not accurate, all that is known is that a hit lies in the widened box of its triangle (the consistency rule
of `wrt.kernels.simd.boxes`). Their triangles are listed wherever the box is seen.

**Back faces.** If shadow rays hit only fronts, a triangle that turns its front to the light is left out: its volume V is below
-2 |N|_1 slack with N from its winding, so N . s c = V + N . h is negative, N . d positive, and no ray comes from its front.

**Covered cells.** Behind a triangle that covers a cell, every ray of the cell is occluded. A watertight test finds the hit for
certain if the line passes inside the triangle by more than its rounding: the signs of its areas are those of the sheared
vertices, which are the vertices, each moved by at most slack. An edge's volume c . (A + a) x (B + b) with |a|, |b| <= slack
differs from c . A x B by at most 2 slack (|A|_1 + |B|_1 + 2 slack), as no component of c is above 1. If c . n is larger at all
four corners of the cell, for all edges, there is a hit. Its depth lies in the interval of the plane, V -+ |N|_1 slack over N .
c. The cell keeps the least far end of such intervals.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.light_cells import CELL_SLACK, DEPTH_SLACK
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import specialised_kernel

COVER, COUNT, FILL = "cover", "count", "fill"
"""The three rasterisations of a build: the depths behind which cells are covered; the lengths of the lists; the lists."""

INFINITY_BITS = 0x7F800000
"""Bits of the float32 infinity."""


@cache
def rasterise(stage: str, by_box: bool, covering: bool, backs_only: bool) -> wp.Function:
    """`wp.func(a, b, c, triangle, resolution, slack, words, entries)`: one stage of the build for one triangle.

    a, b, c: vertices relative to the light. words: of the cells; `FILL` advances `begin` of a cell by the entries that it
    writes.

    Args:
        stage: `COVER`, `COUNT` or `FILL`.
        by_box: whether the box of the triangle is rasterised in its place, for tests that are not accurate.
        covering: whether triangles may cover cells, for watertight tests.
        backs_only: whether triangles that turn their front to the light are left out.
    """
    flags = ", ".join(str(int(flag)) for flag in (by_box, covering, backs_only))
    arguments = f"wrt::RasterStage::{stage.upper()}, {flags}"

    @native.func_native(
        "light_raster.h",
        f"static_assert(wrt::CELL_SLACK == {CELL_SLACK!r} && wrt::DEPTH_SLACK == {DEPTH_SLACK!r});\n"
        f"static_assert(wrt::INFINITY_BITS == {INFINITY_BITS});\n"
        f"wrt::rasterise<{arguments}>(a, b, c, triangle, resolution, slack, words.data, (unsigned long long*)entries.data);",
    )
    def rasterise_native(
        a: wp.vec3d,
        b: wp.vec3d,
        c: wp.vec3d,
        triangle: int,
        resolution: int,
        slack: wp.float64,
        words: wp.array(dtype=int),
        entries: wp.array(dtype=wp.uint64),
    ): ...

    return rasterise_native


@cache
def make_rasteriser(stage: str, by_box: bool, covering: bool, backs_only: bool) -> wp.Kernel:
    """The kernel of one stage. Triangles with a NaN or an infinity, which no ray hits, are left out.

    Arguments as in `rasterise`.
    """
    draw = rasterise(stage, by_box, covering, backs_only)

    def rasterise_triangles(
        first: int,
        vertices: wp.array(dtype=wp.vec3),
        faces: wp.array(dtype=wp.vec3i),
        light: wp.vec3d,
        resolution: int,
        slack: wp.float64,
        words: wp.array(dtype=int),
        entries: wp.array(dtype=wp.uint64),
    ):
        """Item: a triangle."""
        triangle = first + wp.tid()
        face = faces[triangle]
        a = wp.vec3d(vertices[face[0]]) - light
        b = wp.vec3d(vertices[face[1]]) - light
        c = wp.vec3d(vertices[face[2]]) - light
        total = a + b + c
        rest = total - total
        if rest[0] == wp.float64(0.0) and rest[1] == wp.float64(0.0) and rest[2] == wp.float64(0.0):
            draw(a, b, c, triangle, resolution, slack, words, entries)

    return specialised_kernel(rasterise_triangles)
