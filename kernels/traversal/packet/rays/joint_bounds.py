"""Bounds of several packets together, taken from the batch without loading a packet.

**Problem.** Where a packet meets nothing, mostly its neighbours do not either: the background of a view, surfaces that a light
reaches. Loading and bounding each of them costs more than the test of the root that all of them fail.

**Idea.** Bound the rays of some packets together, and test the root once. The extremes of origins and directions are found
where these lie in memory (`wrt.kernels.simd.triples`). The rest is derived from the ends of the intervals of origins,
directions and ends of rays; differences and quotients round monotonically, so they bound what each ray computes.

**Exactness.** Invalid rays may widen the intervals, NaN does not. A direction's negligible components count as 0
(`wrt.kernels.layout.ray_batch.usable_direction`); an end that may be negligible is moved to 0. Ends of rays are computed from
origins that are not relative to the scene's centre, so they are widened by `ENDS_ERROR` of the coordinates.

This is the tile of Reshetov et al. (2005), without a search below the root.

References:
    A. Reshetov, A. Soupikov, J. Hurley: Multi-level ray tracing algorithm. SIGGRAPH 2005.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.ray_batch import DIRECTION_LANES, HitBatch, RayBatch
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.boxes import SLACK
from wrt.kernels.simd.lane_vectors import vector_words
from wrt.kernels.simd.triples import triple_extremes
from wrt.kernels.traversal.packet.rays.packet_bounding import SLACK_OF_ENDS, axes_code
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout
from wrt.kernels.traversal.packet.rays.packet_load import REACH
from wrt.kernels.traversal.packet.rays.ray_numbers import ROWS
from wrt.kernels.traversal.packet.rays.reversed_bounds import ENDS_ERROR

exact_module(__name__)

EXTREMES = """
    const double center[3] = {rays.center.c[0], rays.center.c[1], rays.center.c[2]};
    const float *origins = (const float*)rays.origins.data, *directions = (const float*)rays.directions.data;
    float origin_of_all[3 * W], direction_of_all[3 * W];
    if (!rays.origin_stride) for (int i = 0; i < 3 * W; ++i) origin_of_all[i] = origins[i % 3];
    if (!rays.direction_stride) for (int i = 0; i < 3 * W; ++i) direction_of_all[i] = directions[i % 3];
    const float last = rays.t_max.data[0] > FARTHEST ? FARTHEST : rays.t_max.data[0];
    vf start = (vf)INF, end = (vf)(-INF), odd = (vf)0.0f;
    vf least[3][3], most[3][3];  // of origins, directions and ends
    WRT_UNROLLED for (int r = 0; r < 3; ++r) WRT_UNROLLED for (int a = 0; a < 3; ++a) { least[r][a] = start; most[r][a] = end; }
    for (int y = 0; y < rows; ++y) for (int x = 0; x < length; x += W) {
        const size_t at = begin + (size_t)y * apart + x;
        const float* o = rays.origin_stride ? origins + 3 * at : origin_of_all;
        const float* d = rays.direction_stride ? directions + 3 * at : direction_of_all;
        WRT_UNROLLED for (int a = 0; a < 3; ++a) {
            const vf direction = load(d + a * W);
            wrt_widen(direction, least[1][a], most[1][a]);
            if (ODD) odd += direction * 0.0f;
            if (SHARED) continue;
            const vf origin = load(o + a * W);
            wrt_widen(origin, least[0][a], most[0][a]);
            if (ODD) odd += origin * 0.0f;
            if (ENDS) wrt_widen(origin + direction * last, least[2][a], most[2][a]);
        }
        if (rays.t_min_stride) { const vf t = load(rays.t_min.data + at); start = t < start ? t : start; }
        if (rays.t_max_stride) { const vf t = load(rays.t_max.data + at); end = t > end ? t : end; }
    }
    float low_of[3][3], high_of[3][3], lows[3], highs[3];
    WRT_UNROLLED for (int a = 0; a < 3; ++a) low_of[0][a] = high_of[0][a] = origins[a];
    if (!SHARED) wrt_ends(least[0], most[0], low_of[0], high_of[0]);
    wrt_ends(least[1], most[1], low_of[1], high_of[1]);
    if (ENDS) wrt_ends(least[2], most[2], low_of[2], high_of[2]);
    WRT_UNROLLED for (int a = 0; a < 3; ++a) {
        lows[a] = (float)((double)low_of[0][a] - center[a]); highs[a] = (float)((double)high_of[0][a] - center[a]);
    }
"""
"""C++ after `ROWS` and `triple_extremes`: the intervals low_of[r], high_of[r] of the origins (r = 0), the directions (1) and,
if ENDS, the ends of the rays (2), all in the caller's coordinates; `lows` and `highs`, of the origins relative to the centre;
lanes of the least t_min (`start`) and the greatest t_max (`end`) of rays with ranges of their own; `last`, the others' t_max.
If ODD, a lane of `odd` is not 0 if a number of a ray is NaN or infinite."""

_JOIN = """
    float t_min = INF, t_max = -INF;
    if (rays.t_min_stride) { WRT_SCALAR for (int i = 0; i < W; ++i) t_min = start[i] < t_min ? start[i] : t_min; }
    if (rays.t_max_stride) { WRT_SCALAR for (int i = 0; i < W; ++i) t_max = end[i] > t_max ? end[i] : t_max; }
    bounds.t_min = rays.t_min_stride ? t_min : rays.t_min.data[0];
    bounds.t_max = rays.t_max_stride ? (t_max > FARTHEST ? FARTHEST : t_max) : last;
    bounds.active = packets * P;

    float size = 0.0f, from_zero = 0.0f;
    auto grow = [](float value, float& most) { most = WRT_ABS(value) > most ? WRT_ABS(value) : most; };
    WRT_UNROLLED for (int a = 0; a < 3; ++a) {
        grow(low_of[1][a], size); grow(high_of[1][a], size);
        if (ENDS) WRT_UNROLLED for (int r = 0; r < 3; r += 2) { grow(low_of[r][a], from_zero); grow(high_of[r][a], from_zero); }
    }
    const float negligible = (size > LEAST_SIZE ? size : LEAST_SIZE) * NEGLIGIBLE, error = ENDS_ERROR * from_zero;
    const bool one_range = !rays.t_max_stride;  // what `last` is for
    WRT_UNROLLED for (int a = 0; a < 3; ++a) {
        float& least_direction = low_of[1][a]; float& most_direction = high_of[1][a];
        if ((least_direction > 0.0f) & (least_direction < negligible)) least_direction = 0.0f;
        if ((most_direction < 0.0f) & (-most_direction < negligible)) most_direction = 0.0f;
        if (!ENDS) continue;
        bounds.end_low.c[a] = one_range ? (float)((double)low_of[2][a] - center[a]) - error : -INF;
        bounds.end_high.c[a] = one_range ? (float)((double)high_of[2][a] - center[a]) + error : INF;
    }
    const float ix_least = low_of[1][0], iy_least = low_of[1][1], iz_least = low_of[1][2];
    const float ix_most = high_of[1][0], iy_most = high_of[1][1], iz_most = high_of[1][2];
"""


@cache
def join_packets(layout: PacketLayout, ends: bool) -> wp.Function:
    """`wp.func(rays, first, limit, low, high, bounds) -> int`: bounds the rays of the packets from ray `first` on, at most
    `limit` of them.

    Returns the number of packets: all of them that are whole and lie side by side in the batch; 0 if these are less than two,
    or on CUDA. low, high: bounds of the scene. ends: whether the ends of rays are bounded, too. The packet counts as not
    finished (`PacketBounds.finished`).
    """
    constants = f"""
    constexpr bool ENDS = {str(ends and not layout.shared_origin).lower()}, ODD = false;
    constexpr float SLACK = {SLACK!r}f, ENDS_ERROR = {ENDS_ERROR!r}f;
{DIRECTION_LANES}"""
    body = (
        vector_words(layout.width)
        + triple_extremes(layout.width)
        + EXTREMES
        + _JOIN
        + SLACK_OF_ENDS
        + "    bounds.slack = slack0;\n"
        + axes_code(later=True)
    )
    body = f"{ROWS}    if (packets < 2) return 0;\n{REACH}{body}    return packets;\n"
    body = f"#if defined(__clang__) && !defined(__CUDA_ARCH__)\n{body}#else\n    return 0;\n#endif\n"

    @native.func_native("lanes.h", layout.constants + constants + body)
    def join_packets_native(
        rays: RayBatch, first: int, limit: int, low: wp.vec3, high: wp.vec3, bounds: wp.ref[PacketBounds]
    ) -> int: ...

    return join_packets_native


_FETCH_AHEAD = """
#if !defined(__CUDA_ARCH__)
    auto fetch_to_write = [](const void* data, size_t bytes) {
        for (size_t b = 0; b < bytes; b += 64) __builtin_prefetch((const char*)data + b, 1);
    };
    for (int y = 0; y < rows; ++y) {
        const size_t at = begin + (size_t)y * apart + length;
        fetch_to_write(hits.t.data + at, 4 * (size_t)length);
        fetch_to_write(hits.primitive.data + at, 4 * (size_t)length);
        fetch_to_write(hits.uv.data + at, 8 * (size_t)length);
    }
#endif
"""


@cache
def fetch_ahead(layout: PacketLayout) -> wp.Function:
    """`wp.func(rays, first, limit, hits)`: fetches into the caches where the closest hits of the packets after these will be
    written: without traversals in between, stores would wait for memory."""

    @native.func_native("lanes.h", layout.constants + ROWS + _FETCH_AHEAD)
    def fetch_ahead_native(rays: RayBatch, first: int, limit: int, hits: HitBatch): ...

    return fetch_ahead_native


_STORE = """
    for (int y = 0; y < rows; ++y) {
        const size_t at = begin + (size_t)y * apart;
        if (ANY_HIT) { WRT_FOR(length, x) hits.occluded.data[at + x] = OCCLUDED; continue; }
        float* t = hits.t.data + at; float* uv = (float*)(hits.uv.data + at);
        int* primitive = hits.primitive.data + at;
        WRT_STREAM
        WRT_FOR(length, x) t[x] = INF;
        WRT_FOR(length, x) primitive[x] = -1;
        WRT_FOR(2 * length, x) uv[x] = 0.0f;
    }
"""

_STREAM = """
#if defined(__x86_64__) && defined(__clang__) && !defined(__CUDA_ARCH__)
        if ((((size_t)t | (size_t)primitive | (size_t)uv) & (4 * W - 1)) == 0) {
            typedef float wrt_misses __attribute__((ext_vector_type(W)));
            typedef int wrt_no_ids __attribute__((ext_vector_type(W)));
            for (int x = 0; x < length; x += W) __builtin_nontemporal_store((wrt_misses)INF, (wrt_misses*)(t + x));
            for (int x = 0; x < length; x += W) __builtin_nontemporal_store((wrt_no_ids)(-1), (wrt_no_ids*)(primitive + x));
            for (int x = 0; x < 2 * length; x += W) __builtin_nontemporal_store((wrt_misses)0.0f, (wrt_misses*)(uv + x));
            continue;
        }
#endif
"""


@cache
def store_together(layout: PacketLayout, any_hit: bool, non_temporal: bool, occluded: bool = False) -> wp.Function:
    """`wp.func(rays, first, limit, hits)`: no ray of the packets has a hit that `join_packets` joins with this limit; or, of an
    any-hit query, all of them, if `occluded`.

    non_temporal: as of `wrt.kernels.traversal.packet.rays.packet_store.store_packet`.
    """
    constant = f"    constexpr bool ANY_HIT = {str(any_hit).lower()}, OCCLUDED = {str(occluded).lower()};\n"
    body = _STORE.replace("WRT_STREAM", _STREAM if non_temporal else "")

    @native.func_native("lanes.h", layout.constants + constant + ROWS + body)
    def store_together_native(rays: RayBatch, first: int, limit: int, hits: HitBatch): ...

    return store_together_native
