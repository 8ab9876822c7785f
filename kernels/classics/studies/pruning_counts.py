"""Counts the comparisons that pruning makes: the measure by which Pichler 2018 compares orders.

The count covers the pairs of a ray and a triangle that any tree with one triangle per leaf has to test: the ray meets the
triangle's own box no later than at its closest hit.
"""

from functools import cache

import warp as wp

from wrt.kernels.classics.triangle.ferko.record_part import join, place
from wrt.kernels.classics.triangle.ferko.similarity import SIMILARITY, in_plane
from wrt.kernels.classics.triangle.ferko.variant import Variant, point_test, pruning_test
from wrt.kernels.layout.ray_batch import RayBatch, load_ray
from wrt.kernels.runtime.options import specialised_kernel
from wrt.kernels.simd.boxes import clamp_to_box, ray_slabs, reach
from wrt.kernels.traversal.brute_force import AllTriangles
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks, corners_high, corners_low, load_corners, load_own
from wrt.kernels.triangle.support.vectors import prepare


@wp.struct
class Pruned:
    """Counts for the tests of one ray."""

    tests: int
    """Triangles tested."""
    points: int
    """Tests in which no bound rejected the ray."""
    comparisons: int
    """Comparisons made in those tests."""
    kept: int
    """Hits."""


@cache
def make_kernel(variant: Variant, width: int) -> wp.Kernel:
    """Counts the work of one variant. `closest` holds each ray's closest t, inf for a miss."""
    record, at = join(variant.parts), place(variant.parts, SIMILARITY)
    load, load_vertices = load_own(record.own), load_corners(record.components)
    find_point, make_comparisons = point_test(variant), pruning_test(variant)

    def count_comparisons(
        first: int,
        tree: AllTriangles,
        triangles: TriangleBlocks,
        rays: RayBatch,
        closest: wp.array(dtype=float),
        counts: wp.array(dtype=Pruned),
    ):
        i = first + wp.tid()
        ray = load_ray(rays, i)
        count = Pruned()
        if ray.valid:
            slabs = ray_slabs(ray.origin, ray.direction, reach(ray.origin, tree.low, tree.high))
            state = prepare(ray.origin, ray.direction)
            for slot in range(tree.count):
                corners = load_vertices(triangles.records, slot, wp.static(width))
                entry = clamp_to_box(slabs, corners_low(corners), corners_high(corners), ray.t_min)
                if entry >= ray.t_min and entry <= wp.min(closest[i], ray.t_max):
                    count.tests += 1
                    own = load(triangles.records, slot, wp.static(width))
                    found = find_point(state, own)
                    if found[0] == found[0]:
                        q = in_plane(wp.vec3(found[1], found[2], found[3]), own, wp.static(at))
                        made = make_comparisons(q, own)
                        count.points += 1
                        count.comparisons += wp.abs(made)
                        count.kept += wp.where(made > 0, 1, 0)
        counts[i] = count

    return specialised_kernel(count_comparisons)
