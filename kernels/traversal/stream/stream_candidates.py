"""Candidates of a stream: pairs of a ray and a triangle that its line meets, and the evaluation of which of them are hits.

**Problem.** A candidate is a ray and a triangle somewhere in memory. Its evaluation is about a hundred instructions, a load of
the triangle's id that misses the caches, and up to three unpredictable branches (is the hit in the ray's range, does the ray
have a better hit, are there more candidates). One at a time, this is a large part of the time of incoherent rays, most of it
latency.

**Idea.** Candidates are independent until the last step, so 16 of them, of any rays and triangles, are evaluated at a time, one
per lane. Rays are loaded by vector loads and a transposition (`kernels/native/lanes.h`), triangles word by word, which is
faster than gathers. Candidates within the range of their rays are then merged one after the other, so that a ray with several
of them keeps the best. Figures: notebooks/records/2026-11-22-stream-candidates.md.

A triangle test supplies its code for these lanes in `TestForm.native`. For other tests, for queries for all hits, and
with back-face culling, candidates are evaluated one after the other by the scalar test (`triangle_step`), with the same bits.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.ray_batch import HitBatch
from wrt.kernels.layout.unchecked import load_int
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.boxes import RaySlabs
from wrt.kernels.traversal.crossings import record_crossing
from wrt.kernels.traversal.leaf import BOX_INTERVAL, Candidate, triangle_step
from wrt.kernels.traversal.stream.stream_kernel import get_ray, ray_number, ray_words, stream_ray
from wrt.kernels.traversal.stream.stream_lists import LISTS, Pairs, load_candidate
from wrt.kernels.traversal.traversal_config import ANY, TraversalConfig
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks, vertex_box

exact_module(__name__)

_EVALUATE = """
        CANDIDATE_LANES
        WRT_FOR_LANES(i) {
            float low[3], high[3];
            VERTEX_BOX
            const float ix = words[0][i], iy = words[1][i], iz = words[2][i];
            const float in_x = words[3][i], in_y = words[4][i], in_z = words[5][i];
            const float out_x = words[6][i], out_y = words[7][i], out_z = words[8][i];
            const bool back_x = ix < 0.0f, back_y = iy < 0.0f, back_z = iz < 0.0f;
            float at = t[i];
            const bool hit = at == at;  // a candidate may be none; the box makes a number of a NaN
            BOX_INTERVAL
            t[i] = at;
            near[i] = (hit & (enter <= leave) & (at >= words[9][i]) & (at <= words[10][i]) & (first + i < count)) ? -1 : 0;
        }
        for (unsigned mask = wrt::bits<L>(near); mask; mask &= mask - 1u) {
            const int i = wrt::lowest_bit(mask);
            auto& best = rays.data[owner[first + i]].best;
            TAKE
        }
"""

_TEST = """
    // the last vector is filled up: the lists have room for so many beyond the greatest number
    WRT_UNROLLED for (int i = 0; i < L; ++i) {
        pairs.candidates.c[count + i] = pairs.candidates.c[0]; pairs.candidate_rays.c[count + i] = pairs.candidate_rays.c[0];
    }
    const int* owner = pairs.candidate_rays.c;
    for (int first = 0; first < count; first += L) {
        alignas(64) float words[WORDS][L], corner[9][L];
        float t[L], u[L], v[L];
        int primitive[L], near[L];
        const float* from[L];
        WRT_SCALAR for (int i = 0; i < L; ++i) {
            const unsigned slot = (unsigned)pairs.candidates.c[first + i];
            if (!ANY) primitive[i] = primitives.data[slot];
            from[i] = (const float*)(rays.data + (unsigned)owner[first + i]);
            const float* r = &records.data[(size_t)(slot / WIDTH) * (COMPONENTS * WIDTH) + slot % WIDTH];
            WRT_UNROLLED for (int c = 0; c < 9; ++c) corner[c][i] = r[c * WIDTH];
        }
        wrt::read_records(from, 0, words[0]);
        wrt::read_records(from, WORDS - 16, words[WORDS - 16]);
        EVALUATE
    }
"""

_TAKE_ANY = """
            best.primitive = 0;  // any
            best.t = -WRT_INFINITY;
"""

_TAKE_CLOSEST = """
            if ((t[i] < best.t) | ((t[i] == best.t) & ((best.primitive < 0) | (primitive[i] < best.primitive)))) {
                best.t = t[i];
                best.primitive = primitive[i];
                best.u = u[i];
                best.v = v[i];
            }
"""


def evaluates_in_lanes(config: TraversalConfig) -> bool:
    """Whether candidates are evaluated 16 at a time."""
    return bool(TRIANGLE_TESTS[config.triangle_test].native) and not config.crossing and not config.cull_backfaces


def evaluation(config: TraversalConfig) -> str:
    """C++ that evaluates a vector of candidates and merges their hits, where `evaluates_in_lanes`.

    It reads words[c][i] of their rays, corner[c][i] and, for closest hits, primitive[i] of their triangles. Lane i is candidate
    first + i of `count`, of ray owner[first + i].
    """
    code = _EVALUATE.replace(
        "CANDIDATE_LANES", f"{TRIANGLE_TESTS[config.triangle_test].native}::test<L>(words, corner, t, u, v);"
    )
    code = code.replace("VERTEX_BOX", vertex_box("corner[0]", "i")).replace("BOX_INTERVAL", BOX_INTERVAL)
    return code.replace("TAKE", _TAKE_ANY if config.query == ANY else _TAKE_CLOSEST)


def lane_constants(config: TraversalConfig) -> str:
    """C++ of what `evaluation` needs: constants, and how lists and transpositions work."""
    return f"""{LISTS}
    constexpr int W = L, WIDTH = {config.width}, WORDS = {ray_words(config.triangle_test)};
    constexpr int COMPONENTS = {TRIANGLE_TESTS[config.triangle_test].record.components};
    constexpr bool ANY = {int(config.query == ANY)};
    """


@cache
def test_in_lanes(config: TraversalConfig) -> wp.Function:
    """`func(records, primitives, rays, pairs, count)`: evaluates the first `count` candidates and merges their hits."""
    StreamRay, code = stream_ray(config.triangle_test), _TEST.replace("EVALUATE", evaluation(config))

    @native.func_native("triangle.h", lane_constants(config) + code)
    def test_in_lanes_native(
        records: wp.array(dtype=float),
        primitives: wp.array(dtype=int),
        rays: wp.array(dtype=StreamRay),
        pairs: wp.ref[Pairs],
        count: int,
    ): ...

    return test_in_lanes_native


@wp.func_native("""
    const float t = hit.c[0];
    const bool ahead = (t < best.t) | ((t == best.t) & ((best.primitive < 0) | (primitive < best.primitive)));
    const unsigned taken = 0u - (unsigned)((t >= t_min) & ahead);
    auto pick = [&](float old, float other) {
        const unsigned kept = wp::cast<unsigned>(old) & ~taken;
        return wp::cast<float>(kept | (wp::cast<unsigned>(other) & taken));
    };
    best.primitive = (int)(((unsigned)best.primitive & ~taken) | ((unsigned)primitive & taken));
    best.t = pick(best.t, t);
    best.u = pick(best.u, hit.c[1]);
    best.v = pick(best.v, hit.c[2]);
""")
def record_if_better(hit: wp.vec3, primitive: int, t_min: float, best: wp.ref[Candidate]):
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
    any_hit, crossing, record = config.query == ANY, config.crossing, record_crossing(config)

    @native.func_native(
        "lanes.h",
        f"""
        rays.data[k].best = best;
        if ({int(any_hit)} && best.primitive >= 0) rays.data[k].best.t = __builtin_bit_cast(float, 0xff800000u);  // -inf
    """,
    )
    def put_best(rays: wp.array(dtype=StreamRay), k: int, best: Candidate): ...

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
        best = Candidate()
        t_min = get(stream, k, slabs, state, best)
        if wp.static(any_hit) and best.primitive >= 0:
            return  # the ray already has a hit
        hit = candidate(triangles.records, slot, state, slabs)
        primitive = load_int(triangles.primitive, slot)
        if wp.static(crossing):
            if hit[0] >= t_min and hit[0] <= best.t:
                best = record(hits, i, best, hit[0], primitive, hit[1], hit[2])
        else:
            record_if_better(hit, primitive, t_min, best)
        put_best(stream, k, best)

    return test_one


@cache
def candidate_tester(config: TraversalConfig) -> wp.Function:
    """`wp.func(triangles, stream, pairs, count, hits, begin)`: evaluates the first `count` candidates.

    hits, begin: as in `wrt.kernels.traversal.stream.stream_pairs.pair_tester`.
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
            hits: wp.ref[HitBatch],
            begin: int,
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
        hits: wp.ref[HitBatch],
        begin: int,
    ):
        p = int(0)
        while p < count:
            slot = int(0)
            k = load_candidate(pairs, p, slot)
            test_one(triangles, stream, k, slot, hits, begin + number_of(stream, k))
            p += 1

    return test_each
