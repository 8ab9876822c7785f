"""Light buffer on CPUs: 128 rays at a time, their tests 16 pairs of a ray and a triangle at a time.

**Problem.** A ray needs few triangles, often one or two: one ray against W triangles leaves lanes idle, and one ray after the
other waits for a cell, then an entry, then a triangle, each in another cache line.

**Idea.** The rays of an item go through each step together. Their cells are found in lanes, and each step prefetches what the
next one reads. In every round each remaining ray contributes its next triangle; the pairs, of any rays and triangles, are
tested 16 to a vector, as in a stream (`wrt.kernels.traversal.stream.stream_candidates`). A triangle here is one cache line of
vertices.

The arithmetic is that of `light_buffer_query`, to the bit. The triangle test must supply its code for such lanes
(`TestForm.native`); others use that kernel.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.light_cells import CELL_WORDS, DEPTH_SLACK, LightCells
from wrt.kernels.layout.ray_batch import RayBatch
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_kernel, specialised_kernel
from wrt.kernels.traversal.shadows.light_buffer_query import Skipped
from wrt.kernels.traversal.shadows.light_rays import LIT, OCCLUDED, UNDECIDED
from wrt.kernels.triangle import TRIANGLE_TESTS

RUN = 128
"""Rays of an item: their numbers fit the first-level cache."""

RECORD_FLOATS = 16
"""Floats of a triangle in `make_pack_lines`: a cache line."""


@cache
def make_answer(triangle_test: str) -> wp.Function:
    """`wp.func(cells, records, batch, target, skipped, items, answers, undecided)`: the rays of an item."""
    sizes = f"{TRIANGLE_TESTS[triangle_test].native}, {RUN}, {RECORD_FLOATS}"
    arguments = "cells, records.data, batch, target, skipped.triangles.data, skipped.stride, items[0], items[1], answers.data"

    @native.func_native(
        "light_buffer.h",
        f"""
        static_assert(wrt::LIT == {LIT} && wrt::OCCLUDED == {OCCLUDED} && wrt::UNDECIDED == {UNDECIDED});
        static_assert(wrt::CELL_WORDS == {CELL_WORDS} && wrt::DEPTH_SLACK == {DEPTH_SLACK!r}f);
        wrt::LightRays<{sizes}> rays;
        if (rays.answer({arguments})) undecided.data[0] = 1;""",
    )
    def answer_native(
        cells: LightCells,
        records: wp.array(dtype=float),
        batch: RayBatch,
        target: wp.vec3d,
        skipped: Skipped,
        items: wp.vec2i,
        answers: wp.array(dtype=wp.uint8),
        undecided: wp.array(dtype=int),
    ): ...

    return answer_native


@cache
def make_lane_kernel(triangle_test: str) -> wp.Kernel:
    """The kernel for a triangle test with a `native` form; arguments as in `light_buffer_query.make_light_buffer_kernel`."""
    answer = make_answer(triangle_test)

    def light_buffer_lanes(
        first: int,
        cells: LightCells,
        records: wp.array(dtype=float),
        rays: RayBatch,
        target: wp.vec3d,
        skipped: Skipped,
        answers: wp.array(dtype=wp.uint8),
        undecided: wp.array(dtype=int),
    ):
        """Item: a run of rays; records are those of `pack_lines`."""
        begin = (first + wp.tid()) * wp.static(RUN)
        count = wp.min(wp.static(RUN), rays.count - begin)
        answer(cells, records, rays, target, skipped, wp.vec2i(begin, count), answers, undecided)

    return specialised_kernel(light_buffer_lanes)


@exact_kernel
def pack_lines(
    first: int,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    records: wp.array(dtype=float),
):
    """Writes the vertices of a triangle to a cache line. Item: a triangle."""
    i = first + wp.tid()
    face = faces[i]
    at = i * wp.static(RECORD_FLOATS)
    for corner in range(3):
        vertex = vertices[face[corner]]
        for axis in range(3):
            records[at + 3 * corner + axis] = vertex[axis]
