"""Bounds of a run of rays of any length, without loading them into a packet: for tiles, which are tested only as a whole.

A packet takes the interval of 1 / direction over its rays (`wrt.kernels.traversal.packet.rays.packet_load`). A tile takes the
intervals of directions and origins and derives the rest from their ends. Quotients, products and differences round
monotonically, so the ends still bound the values that each ray computes. This costs a minimum and a maximum per component and
ray, and no division.
"""

import warp as wp

from wrt.kernels.layout.ray_batch import DIRECTION_LANES, RayBatch
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.boxes import SLACK
from wrt.kernels.traversal.packet.rays.lane_intervals import INTERVALS
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds

exact_module(__name__)

_HEAD = f"    constexpr int RUN = 64;\n    constexpr float SLACK = {SLACK!r}f;\n{DIRECTION_LANES}"

_GATHER = """
    const float INF = WRT_INFINITY;
    const double center[3] = {rays.center.c[0], rays.center.c[1], rays.center.c[2]};
    WRT_INTERVAL(dx); WRT_INTERVAL(dy); WRT_INTERVAL(dz); WRT_INTERVAL(ox); WRT_INTERVAL(oy); WRT_INTERVAL(oz);
    WRT_INTERVAL(start); WRT_INTERVAL(end);
    int active = 0;
    float o[3][RUN], d[3][RUN], t0[RUN], t1[RUN];
    const float* origins = (const float*)rays.origins.data;
    const float* directions = (const float*)rays.directions.data;
    if (!rays.origin_stride) for (int a = 0; a < 3; ++a) {
        const float value = (float)((double)origins[a] - center[a]);
        WRT_FOR(RUN, k) o[a][k] = value;
    }
    if (!rays.t_min_stride) { WRT_FOR(RUN, k) t0[k] = rays.t_min.data[0]; }
    if (!rays.t_max_stride) { WRT_FOR(RUN, k) t1[k] = rays.t_max.data[0]; }
    const int last = first + count < rays.count ? first + count : rays.count;
    for (int begin = first; begin < last; begin += RUN) {
        const int here = last - begin < RUN ? last - begin : RUN;
        if (rays.origin_stride) {
            const float* from = origins + 3 * (size_t)begin;
            for (int a = 0; a < 3; ++a) WRT_FOR(here, k) o[a][k] = (float)((double)from[3 * k + a] - center[a]);
        }
        const float* to = directions + 3 * (size_t)begin * rays.direction_stride;
        if (rays.direction_stride) {
            WRT_FOR(here, k) { d[0][k] = to[3 * k]; d[1][k] = to[3 * k + 1]; d[2][k] = to[3 * k + 2]; }
        } else {
            WRT_FOR(here, k) { d[0][k] = to[0]; d[1][k] = to[1]; d[2][k] = to[2]; }
        }
        if (rays.t_min_stride) { WRT_FOR(here, k) t0[k] = rays.t_min.data[begin + k]; }
        if (rays.t_max_stride) { WRT_FOR(here, k) t1[k] = rays.t_max.data[begin + k]; }
        WRT_FOR(here, k) {
            float x = d[0][k], y = d[1][k], z = d[2][k];
            wrt_direction(x, y, z);
            t1[k] = t1[k] > FARTHEST ? FARTHEST : t1[k];
            const float px = o[0][k], py = o[1][k], pz = o[2][k];
            const float size_x = WRT_ABS(x), size_y = WRT_ABS(y), size_z = WRT_ABS(z);
            float size = size_x > size_y ? size_x : size_y; size = size > size_z ? size : size_z;
            const bool valid = (x - x == 0.0f) & (y - y == 0.0f) & (z - z == 0.0f) & (px - px == 0.0f) & (py - py == 0.0f)
                & (pz - pz == 0.0f) & (size >= SHORTEST) & (t0[k] >= 0.0f) & (t0[k] <= t1[k]);
            active += valid ? 1 : 0;
            WRT_WIDEN(dx, x, valid) WRT_WIDEN(dy, y, valid) WRT_WIDEN(dz, z, valid)
            WRT_WIDEN(ox, px, valid) WRT_WIDEN(oy, py, valid) WRT_WIDEN(oz, pz, valid)
            WRT_WIDEN(start, t0[k], valid) WRT_WIDEN(end, t1[k], valid)
        }
    }
    bounds.active = active;
    if (!active) return;
"""

_BOUND = """
    const float lows[3] = {wrt_value(ox_low), wrt_value(oy_low), wrt_value(oz_low)};
    const float highs[3] = {wrt_value(ox_high), wrt_value(oy_high), wrt_value(oz_high)};
    const float least[3] = {wrt_value(dx_low), wrt_value(dy_low), wrt_value(dz_low)};
    const float most[3] = {wrt_value(dx_high), wrt_value(dy_high), wrt_value(dz_high)};
    float reach = 0.0f, wide[3], narrow[3];
    for (int a = 0; a < 3; ++a) {
        const float ends[4] = {low.c[a] - lows[a], low.c[a] - highs[a], high.c[a] - lows[a], high.c[a] - highs[a]};
        for (int e = 0; e < 4; ++e) reach = WRT_ABS(ends[e]) > reach ? WRT_ABS(ends[e]) : reach;
        const float p = WRT_ABS(least[a]), q = WRT_ABS(most[a]);
        wide[a] = p > q ? p : q;
        narrow[a] = (least[a] < 0.0f) != (most[a] < 0.0f) ? 0.0f : p < q ? p : q;
    }
    const float slack0 = SLACK * reach;
    bounds.slack = slack0;
    bounds.t_min = wrt_value(start_low); bounds.t_max = wrt_value(end_high);
    bounds.passes = 7;
    bounds.mixed_axes = 0;
    for (int a = 0; a < 3; ++a) {
        // the sign bit, not < 0: 1 / -0 is -inf
        const bool backward = __builtin_bit_cast(int, most[a]) < 0, mixed = (__builtin_bit_cast(int, least[a]) < 0) & !backward;
        const float p = 1.0f / least[a], q = 1.0f / most[a], none = WRT_NAN;
        bounds.mixed_axes += mixed ? 1 : 0;
        bounds.backward.c[a] = backward ? 1 : 0;
        bounds.inverse_large.c[a] = mixed ? none : backward ? q : p;
        bounds.inverse_small.c[a] = mixed ? none : backward ? p : q;
        bounds.forward_small.c[a] = mixed ? q : 0.0f; bounds.backward_small.c[a] = mixed ? p : 0.0f;
        bounds.origin_in.c[a] = backward ? lows[a] - slack0 : highs[a] + slack0;
        bounds.origin_out.c[a] = backward ? highs[a] + slack0 : lows[a] - slack0;
        bounds.origin_low.c[a] = lows[a]; bounds.origin_high.c[a] = highs[a];
    }
    bounds.main_axes = 7;
    for (int z = 0; z < 3; ++z) {
        const int x = z == 2 ? 0 : z + 1, y = x == 2 ? 0 : x + 1;
        if (!((narrow[z] > wide[x]) & (narrow[z] > wide[y]))) continue;
        bounds.main_axes = 1 << z;
        bounds.plane = 0.5f * (lows[z] + highs[z]);
        const float near = lows[z] - bounds.plane, far = highs[z] - bounds.plane;
        for (int side = 0; side < 2; ++side) {
            const int a = side ? y : x;
            const float slopes[4] = {least[a] / least[z], least[a] / most[z], most[a] / least[z], most[a] / most[z]};
            float s0 = slopes[0], s1 = slopes[0];
            for (int e = 1; e < 4; ++e) { s0 = slopes[e] < s0 ? slopes[e] : s0; s1 = slopes[e] > s1 ? slopes[e] : s1; }
            const float shifts[4] = {s0 * near, s0 * far, s1 * near, s1 * far};
            float m0 = shifts[0], m1 = shifts[0];
            for (int e = 1; e < 4; ++e) { m0 = shifts[e] < m0 ? shifts[e] : m0; m1 = shifts[e] > m1 ? shifts[e] : m1; }
            bounds.slope_low.c[side] = s0; bounds.slope_high.c[side] = s1;
            bounds.through_low.c[side] = (lows[a] - m1) - slack0; bounds.through_high.c[side] = (highs[a] - m0) + slack0;
        }
    }
"""


@native.func_native("lanes.h", _HEAD + INTERVALS + _GATHER + _BOUND)
def bound_rays(rays: RayBatch, first: int, count: int, low: wp.vec3, high: wp.vec3, bounds: wp.ref[PacketBounds]):
    """Bounds of the rays first .. first + count - 1 of a batch, clipped to its end; low, high: bounds of the scene.

    If no ray is active, only `bounds.active` is set.
    """
    ...
