"""Light buffer: a shadow ray towards a point light is tested only against the triangles that are seen in its direction.

**Problem.** A shadow ray walks a tree, although all rays towards a light end at the same point.

**Idea.** The directions around the light are divided into cells (`wrt.kernels.layout.light_cells`). All triangles that a ray of
a cell can hit are in its list, by depth, so the search needs no tree: it ends at the first hit, or at the first triangle behind
the ray's point. A cell may be covered by one triangle; then rays that start behind that are occluded without a test.

**The same answers as `occluded`.** The list is conservative, proved in `wrt.builders.lights.light_raster`; the triangle test,
the consistency rule and the range are those of every traversal. Rays that the lists do not decide (from points far outside the
scene; beyond the light; those that end short of a triangle that covers their cell) are marked and left to a traversal.

References: see `wrt.kernels.layout.light_cells`.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.light_cells import CELL_WORDS, LightCells
from wrt.kernels.layout.ray_batch import RayBatch
from wrt.kernels.runtime.options import specialised_kernel
from wrt.kernels.simd.boxes import ray_slabs, reach
from wrt.kernels.traversal.leaf import triangle_step
from wrt.kernels.traversal.shadows.light_rays import LIT, OCCLUDED, UNDECIDED, find_cell, light_ray
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle import TRIANGLE_TESTS


@wp.func
def depth_of(entry: wp.uint64):
    """Least depth of a hit on the triangle of an entry."""
    return wp.cast(wp.uint32(entry >> wp.uint64(32)), wp.float32)


@wp.func
def triangle_in(entry: wp.uint64):
    """Number of the triangle of an entry."""
    return int(wp.uint32(entry))


@wp.struct
class Skipped:
    """The triangle that each ray ignores."""

    triangles: wp.array(dtype=int)
    """(N,) or (1,), -1 for none."""
    stride: int
    """1, or 0 if all rays ignore the same one."""


@cache
def make_light_buffer_kernel(config: TraversalConfig) -> wp.Kernel:
    """The kernel that tests the triangles of a list one by one, for any triangle test and device.

    records: the triangles in the order of their numbers.
    """
    test, candidate = TRIANGLE_TESTS[config.triangle_test], triangle_step(config)
    prepare = test.prepare

    def light_buffer(
        first: int,
        cells: LightCells,
        records: wp.array(dtype=float),
        rays: RayBatch,
        target: wp.vec3d,
        skipped: Skipped,
        answers: wp.array(dtype=wp.uint8),
        undecided: wp.array(dtype=int),
    ):
        """Item: a ray. Sets undecided[0] to 1 if any answer is `UNDECIDED`."""
        i = first + wp.tid()
        ray = light_ray(rays, i, target)
        answer = int(wp.static(LIT))
        if ray.valid:
            distance = reach(ray.origin, cells.low, cells.high)
            query = find_cell(cells, ray, distance)
            at = query.cell * wp.static(CELL_WORDS)
            far = wp.cast(cells.cells[at + 2], wp.float32)
            nearest = wp.cast(cells.cells[at + 3], wp.float32)
            if far <= query.max_depth and not (query.min_depth <= nearest):
                query.decided = False
            skip = skipped.triangles[i * skipped.stride]
            if not query.decided:
                answer = wp.static(UNDECIDED)
            elif far <= query.sure and skip < 0:
                answer = wp.static(OCCLUDED)
            else:
                slabs = ray_slabs(ray.origin, ray.direction, distance)
                state = prepare(ray.origin, ray.direction)
                place = cells.cells[at]
                end = place + cells.cells[at + 1]
                while place < end:
                    entry = cells.entries[place]
                    place += 1
                    if depth_of(entry) > query.max_depth:
                        break
                    triangle = triangle_in(entry)
                    if triangle == skip:
                        continue
                    hit = candidate(records, triangle, state, slabs)
                    if hit[0] >= ray.t_min and hit[0] <= ray.t_max:
                        answer = wp.static(OCCLUDED)
                        break
                # the list ends at the triangle that covers the cell, which this ray ignores
                if skip >= 0 and answer == wp.static(LIT) and far <= query.max_depth:
                    answer = wp.static(UNDECIDED)
        answers[i] = wp.uint8(answer)
        if answer == wp.static(UNDECIDED):
            undecided[0] = 1

    return specialised_kernel(light_buffer)
