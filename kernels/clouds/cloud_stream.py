"""The step of streams and interleaved walks that decides about a point near which the line of a ray passes."""

from functools import cache

import warp as wp

from wrt.kernels.answers.answer_kind import BestHit
from wrt.kernels.clouds.cloud_test import PointRay, meet_point
from wrt.kernels.layout.ray_batch import HitBatch
from wrt.kernels.layout.unchecked import load_int
from wrt.kernels.simd.boxes import RaySlabs
from wrt.kernels.traversal.stream.stream_candidates import put_best, record_if_better
from wrt.kernels.traversal.stream.stream_kernel import get_ray, stream_ray
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks


@cache
def make_point_step(config: TraversalConfig) -> wp.Function:
    """As `wrt.kernels.traversal.stream.stream_candidates.scalar_test_step`."""
    name, answer = config.triangle_test, config.answer
    StreamRay, get = stream_ray(name), get_ray(name)
    meet = meet_point(config.width, TRIANGLE_TESTS[name].record.components)
    any_hit, nearest, accept = answer.rules.ends_at_first, answer.nearest, answer.search.accept
    put = put_best(name, any_hit)

    @wp.func
    def test_point(
        triangles: TriangleBlocks,
        stream: wp.array(dtype=StreamRay),
        k: int,
        slot: int,
        hits: wp.ref[HitBatch],
        i: int,
    ):
        slabs = RaySlabs()
        state = PointRay()
        best = BestHit()
        t_min = get(stream, k, slabs, state, best)
        if wp.static(any_hit) and best.primitive >= 0:
            return  # the ray already has a hit
        u = float(0.0)
        v = float(0.0)
        t = meet(triangles.records, slot, state, slabs, t_min, u, v)
        primitive = load_int(triangles.primitive, slot)
        if wp.static(nearest):
            record_if_better(wp.vec3(t, u, v), primitive, t_min, best)
        elif t >= t_min and t <= best.t:
            best = accept(hits, i, best, t, primitive, u, v)
        put(stream, k, best)

    return test_point
