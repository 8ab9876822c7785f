"""Candidates of a stream: pairs of a ray and a triangle that its line meets, and the evaluation of which of them are hits.

**Problem.** A candidate is a ray and a triangle somewhere in memory. Its evaluation is about a hundred instructions, a load of
the triangle's id that misses the caches, and up to three unpredictable branches (is the hit in the ray's range, does the ray
have a better hit, are there more candidates). One at a time, this is a large part of the time of incoherent rays, most of it
latency.

**Idea.** Candidates are independent until the last step, so 16 of them, of any rays and triangles, are evaluated at a time, one
per lane (`kernels/native/stream_candidates.h`). Rays are loaded by vector loads and a transposition, triangles word by word,
which is faster than gathers. Candidates within the range of their rays are then merged one after the other, so that a ray with
several of them keeps the best. Figures: notebooks/records/2026-11-22-stream-candidates.md.

A triangle test supplies its code for these lanes in `TestForm.native`. For other tests, for queries for all hits, and
with back-face culling, candidates are evaluated one after the other by the scalar test (`triangle_step`), with the same bits.
"""

from functools import cache

import warp as wp

from wrt.kernels.answers.best_hit import BestHit
from wrt.kernels.layout.ray_batch import HitBatch
from wrt.kernels.layout.unchecked import load_int
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.boxes import RaySlabs
from wrt.kernels.traversal.leaf import triangle_step
from wrt.kernels.traversal.stream.stream_kernel import LIST_LANES, get_ray, ray_number, stream_ray
from wrt.kernels.traversal.stream.stream_lists import Pairs, StreamHits, load_candidate
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks

exact_module(__name__)


def evaluates_in_lanes(config: TraversalConfig) -> bool:
    """Whether candidates are evaluated 16 at a time."""
    return bool(TRIANGLE_TESTS[config.triangle_test].native) and config.answer.nearest and not config.cull_backfaces


def lane_form(config: TraversalConfig) -> str:
    """C++ template arguments of what evaluates candidates, where `evaluates_in_lanes`."""
    test = TRIANGLE_TESTS[config.triangle_test]
    return f"{test.native}, {config.width}, {test.record.components}, {int(config.answer.ends_at_first)}, {LIST_LANES}"


@cache
def test_in_lanes(config: TraversalConfig) -> wp.Function:
    """`func(records, primitives, rays, pairs, count)`: evaluates the first `count` candidates and merges their hits."""
    StreamRay = stream_ray(config.triangle_test)
    call = f"wrt::test_candidates<{lane_form(config)}>(records.data, primitives.data, rays.data, pairs, count)"

    @native.func_native("stream_candidates.h", f"{call};")
    def test_in_lanes_native(
        records: wp.array(dtype=float),
        primitives: wp.array(dtype=int),
        rays: wp.array(dtype=StreamRay),
        pairs: wp.ref[Pairs],
        count: int,
    ): ...

    return test_in_lanes_native


@native.func_native("stream_candidates.h", "wrt::record_if_better(hit.c, primitive, t_min, best);")
def record_if_better(hit: wp.vec3, primitive: int, t_min: float, best: wp.ref[BestHit]):
    """Replaces the best hit by the hit (t, u, v) if that `improves` it.

    It uses bit operations, because the compiler may turn a select into a branch, which is slower for incoherent rays
    (notebooks/records/2026-11-22-stream-candidates.md).
    """
    ...


@cache
def scalar_test_step(config: TraversalConfig) -> wp.Function:
    """`wp.func(triangles, stream, k, slot, hits, i)`: evaluates one candidate, of ray k of the stream and i of the batch."""
    StreamRay, RayState = stream_ray(config.triangle_test), TRIANGLE_TESTS[config.triangle_test].ray_state
    get, candidate = get_ray(config.triangle_test), triangle_step(config)
    any_hit, nearest, accept = config.answer.ends_at_first, config.answer.nearest, config.answer.accept

    @native.func_native(
        "lanes.h",
        f"""
        rays.data[k].best = best;
        if ({int(any_hit)} && best.primitive >= 0) rays.data[k].best.t = __builtin_bit_cast(float, 0xff800000u);  // -inf
    """,
    )
    def put_best(rays: wp.array(dtype=StreamRay), k: int, best: BestHit): ...

    @wp.func
    def test_one(
        triangles: TriangleBlocks,
        stream: wp.array(dtype=StreamRay),
        k: int,
        slot: int,
        hits: wp.ref[HitBatch],
        i: int,
    ):
        slabs = RaySlabs()
        state = RayState()
        best = BestHit()
        t_min = get(stream, k, slabs, state, best)
        if wp.static(any_hit) and best.primitive >= 0:
            return  # the ray already has a hit
        hit = candidate(triangles.records, slot, state, slabs)
        primitive = load_int(triangles.primitive, slot)
        if wp.static(nearest):
            record_if_better(hit, primitive, t_min, best)
        elif hit[0] >= t_min and hit[0] <= best.t:
            best = accept(hits, i, best, hit[0], primitive, hit[1], hit[2])
        put_best(stream, k, best)

    return test_one


@cache
def candidate_tester(config: TraversalConfig) -> wp.Function:
    """`wp.func(triangles, stream, pairs, count, found)`: evaluates the first `count` candidates.

    found: `StreamHits`.
    """
    StreamRay = stream_ray(config.triangle_test)
    if evaluates_in_lanes(config):
        in_lanes = test_in_lanes(config)

        @wp.func
        def test_all(
            triangles: TriangleBlocks,
            stream: wp.array(dtype=StreamRay),
            pairs: wp.ref[Pairs],
            count: int,
            found: wp.ref[StreamHits],
        ):
            in_lanes(triangles.records, triangles.primitive, stream, pairs, count)

        return test_all

    test_one, number_of = scalar_test_step(config), ray_number(config.triangle_test)

    @wp.func
    def test_each(
        triangles: TriangleBlocks,
        stream: wp.array(dtype=StreamRay),
        pairs: wp.ref[Pairs],
        count: int,
        found: wp.ref[StreamHits],
    ):
        p = int(0)
        while p < count:
            slot = int(0)
            k = load_candidate(pairs, p, slot)
            test_one(triangles, stream, k, slot, found.hits, found.begin + number_of(stream, k))
            p += 1

    return test_each
