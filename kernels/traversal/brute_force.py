"""Brute force: every ray against every triangle, the reference for every tree and traversal; O(rays x triangles)."""

from functools import cache

import warp as wp

from wrt.kernels.answers.answer_kind import BestHit, improves, start
from wrt.kernels.layout.ray_batch import HitBatch, RayBatch, load_ray
from wrt.kernels.runtime.options import specialised_kernel
from wrt.kernels.simd.boxes import ray_slabs, reach
from wrt.kernels.traversal.leaf import CounterRows, triangle_step
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks


@wp.struct
class AllTriangles:
    """All triangles, in blocks in the order of their ids."""

    count: int
    low: wp.vec3
    """`low` and `high` bound the scene."""
    high: wp.vec3


@cache
def make_brute_force_kernel(config: TraversalConfig) -> wp.Kernel:
    """The kernel for one specialisation.

    It uses the scalar form of the triangle test, so comparisons also check the lane form.
    """
    test = TRIANGLE_TESTS[config.triangle_test]
    prepare, candidate, store = test.prepare, triangle_step(config), config.answer.stored.store
    nearest, accept = config.answer.nearest, config.answer.search.accept
    counting, any_hit = config.counters, config.answer.rules.ends_at_first

    def brute_force(
        first: int,
        tree: AllTriangles,
        triangles: TriangleBlocks,
        rays: RayBatch,
        hits: HitBatch,
        counters: CounterRows,
    ):
        i = first + wp.tid()
        ray = load_ray(rays, i)
        best = start(ray.t_max)
        tested = int(0)
        if ray.valid:
            slabs = ray_slabs(ray.origin, ray.direction, reach(ray.origin, tree.low, tree.high))
            state = prepare(ray.origin, ray.direction)
            while tested < tree.count:
                hit = candidate(triangles.records, tested, state, slabs)
                if wp.static(not nearest):
                    if hit[0] >= ray.t_min and hit[0] <= ray.t_max:
                        best = accept(hits, i, best, hit[0], triangles.primitive[tested], hit[1], hit[2])
                elif improves(hit[0], triangles.primitive[tested], ray.t_min, best):
                    best = BestHit(hit[0], triangles.primitive[tested], hit[1], hit[2])
                    if wp.static(any_hit):
                        break
                tested += 1
        store(hits, i, best)
        if wp.static(counting):
            counters.rows[i].triangles = tested

    return specialised_kernel(brute_force)
