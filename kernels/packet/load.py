"""From rays in memory to a packet and its bounds, with the arithmetic of `load_ray`, `ray_slabs` and the test's `prepare`."""

from functools import cache

import warp as wp

from wrt.kernels.boxes import SLACK
from wrt.kernels.packet.bounds import PacketBounds
from wrt.kernels.packet.intervals import INTERVALS
from wrt.kernels.packet.layout import PacketLayout
from wrt.kernels.packet.numbers import NUMBERS
from wrt.kernels.rays import TINY, RayBatch
from wrt.kernels.triangle import TRIANGLE_TESTS

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

_LOAD = """
    const bool consecutive = here == P && !picture;
    const double center_x = rays.center.c[0], center_y = rays.center.c[1], center_z = rays.center.c[2];
    float dx[P], dy[P], dz[P];
    if (consecutive && rays.direction_stride) {
        const float* d = (const float*)(rays.directions.data + first);
        WRT_FOR(P, k) { dx[k] = d[3 * k]; dy[k] = d[3 * k + 1]; dz[k] = d[3 * k + 2]; }
    } else for (int k = 0; k < P; ++k) {
        const wp::vec3 d = rays.directions.data[number[k] * rays.direction_stride];
        dx[k] = d.c[0]; dy[k] = d.c[1]; dz[k] = d.c[2];
    }
    float ox0 = 0.0f, oy0 = 0.0f, oz0 = 0.0f, slack0 = 0.0f;
    auto reach = [&](float x, float y, float z) {
        float far = WRT_ABS(low.c[0] - x), f;
        f = WRT_ABS(high.c[0] - x); far = f > far ? f : far;
        f = WRT_ABS(low.c[1] - y); far = f > far ? f : far;
        f = WRT_ABS(high.c[1] - y); far = f > far ? f : far;
        f = WRT_ABS(low.c[2] - z); far = f > far ? f : far;
        f = WRT_ABS(high.c[2] - z); far = f > far ? f : far;
        return far;
    };
    if (SHARED) {
        const wp::vec3 o = rays.origins.data[0];
        ox0 = (float)((double)o.c[0] - center_x);
        oy0 = (float)((double)o.c[1] - center_y);
        oz0 = (float)((double)o.c[2] - center_z);
        slack0 = SLACK * reach(ox0, oy0, oz0);
    } else if (consecutive && rays.origin_stride) {
        const float* o = (const float*)(rays.origins.data + first);
        WRT_FOR(P, k) {
            origin_x[k] = (float)((double)o[3 * k] - center_x);
            origin_y[k] = (float)((double)o[3 * k + 1] - center_y);
            origin_z[k] = (float)((double)o[3 * k + 2] - center_z);
        }
    } else for (int k = 0; k < P; ++k) {
        const wp::vec3 o = rays.origins.data[number[k] * rays.origin_stride];
        origin_x[k] = (float)((double)o.c[0] - center_x);
        origin_y[k] = (float)((double)o.c[1] - center_y);
        origin_z[k] = (float)((double)o.c[2] - center_z);
    }
    if (!rays.t_min_stride) { const float value = rays.t_min.data[0]; WRT_FOR(P, k) t_min[k] = value; }
    else if (consecutive) { WRT_FOR(P, k) t_min[k] = rays.t_min.data[first + k]; }
    else for (int k = 0; k < P; ++k) t_min[k] = rays.t_min.data[number[k]];
    if (!rays.t_max_stride) { const float value = rays.t_max.data[0]; WRT_FOR(P, k) t[k] = value; }
    else if (consecutive) { WRT_FOR(P, k) t[k] = rays.t_max.data[first + k]; }
    else for (int k = 0; k < P; ++k) t[k] = rays.t_max.data[number[k]];

    WRT_INTERVAL(ix); WRT_INTERVAL(iy); WRT_INTERVAL(iz);
    WRT_INTERVAL(sx); WRT_INTERVAL(sy); WRT_INTERVAL(start); WRT_INTERVAL(end);
    int active = 0, main_axes = 0;
    WRT_FOR(P, k) {
        const float x = dx[k], y = dy[k], z = dz[k];
        const float ox = SHARED ? ox0 : origin_x[k], oy = SHARED ? oy0 : origin_y[k], oz = SHARED ? oz0 : origin_z[k];
        const float size_x = WRT_ABS(x), size_y = WRT_ABS(y), size_z = WRT_ABS(z);
        float size = size_x > size_y ? size_x : size_y; size = size > size_z ? size : size_z;
        const bool valid = (k < here) & (x - x == 0.0f) & (y - y == 0.0f) & (z - z == 0.0f)
            & (ox - ox == 0.0f) & (oy - oy == 0.0f) & (oz - oz == 0.0f)
            & (size >= TINY) & (t_min[k] >= 0.0f) & (t_min[k] <= t[k]);
        const float ix = 1.0f / x, iy = 1.0f / y, iz = 1.0f / z;
        inverse_x[k] = ix; inverse_y[k] = iy; inverse_z[k] = iz;
        if (!SHARED) slack[k] = SLACK * reach(ox, oy, oz);
        const float end = valid ? t[k] : -INF;
        t[k] = end;
        ((int*)primitive)[k] = -1;
        u[k] = 0.0f; v[k] = 0.0f;
        const bool xy = size_x >= size_y, xz = size_x >= size_z, yz = size_y >= size_z;
        const bool main_x = xy & xz, main_y = !xy & yz;  // ties as in the scalar form of the watertight test
        const float major = main_x ? x : main_y ? y : z;
        const float sx = (main_x ? y : main_y ? z : x) / major, sy = (main_x ? z : main_y ? x : y) / major;
        slope_x[k] = sx; slope_y[k] = sy;
        WRT_PREPARE
        active += valid ? 1 : 0;
        main_axes |= valid ? (main_x ? 1 : main_y ? 2 : 4) : 0;
        WRT_WIDEN(ix, ix, valid) WRT_WIDEN(iy, iy, valid) WRT_WIDEN(iz, iz, valid)
        WRT_WIDEN(sx, sx, valid) WRT_WIDEN(sy, sy, valid)
        WRT_WIDEN(start, t_min[k], valid) WRT_WIDEN(end, end, valid)
    }
    float lows[3] = {ox0, oy0, oz0}, highs[3] = {ox0, oy0, oz0};
    if (!SHARED) {
        WRT_INTERVAL(ox); WRT_INTERVAL(oy); WRT_INTERVAL(oz); WRT_INTERVAL(wide);
        WRT_FOR(P, k) {
            const bool valid = t[k] >= -0.0f;
            WRT_WIDEN(ox, origin_x[k], valid) WRT_WIDEN(oy, origin_y[k], valid) WRT_WIDEN(oz, origin_z[k], valid)
            WRT_WIDEN(wide, slack[k], valid)
        }
        lows[0] = wrt_value(ox_low); lows[1] = wrt_value(oy_low); lows[2] = wrt_value(oz_low);
        highs[0] = wrt_value(ox_high); highs[1] = wrt_value(oy_high); highs[2] = wrt_value(oz_high);
        slack0 = wrt_value(wide_high);
    }
    bounds.active = active;
    bounds.main_axes = main_axes;
    bounds.passes = PASSES == 1 ? 1 : main_axes;
    bounds.t_min = wrt_value(start_low); bounds.t_max = wrt_value(end_high);
    bounds.slack = slack0;
    bounds.slope_low = wp::vec2(wrt_value(sx_low), wrt_value(sy_low));
    bounds.slope_high = wp::vec2(wrt_value(sx_high), wrt_value(sy_high));
    const int main = main_axes == 1 ? 0 : main_axes == 2 ? 1 : 2;
    const int next = main == 2 ? 0 : main + 1, other = next == 2 ? 0 : next + 1;
    bounds.plane = SHARED ? lows[main] : 0.5f * (lows[main] + highs[main]);
    if (SHARED) {
        bounds.through_low = bounds.through_high = wp::vec2(lows[next], lows[other]);
    } else {
        const float plane = bounds.plane;
        const float* along = main == 0 ? origin_x : main == 1 ? origin_y : origin_z;
        const float* across_x = main == 0 ? origin_y : main == 1 ? origin_z : origin_x;
        const float* across_y = main == 0 ? origin_z : main == 1 ? origin_x : origin_y;
        float through_x[P], through_y[P];
        WRT_FOR(P, k) { through_x[k] = across_x[k] - slope_x[k] * (along[k] - plane); }
        WRT_FOR(P, k) { through_y[k] = across_y[k] - slope_y[k] * (along[k] - plane); }
        WRT_INTERVAL(cx); WRT_INTERVAL(cy);
        WRT_FOR(P, k) {
            const bool valid = t[k] >= -0.0f;
            WRT_WIDEN(cx, through_x[k], valid) WRT_WIDEN(cy, through_y[k], valid)
        }
        bounds.through_low = wp::vec2(wrt_value(cx_low) - slack0, wrt_value(cy_low) - slack0);
        bounds.through_high = wp::vec2(wrt_value(cx_high) + slack0, wrt_value(cy_high) + slack0);
    }
    const float inverse_low[3] = {wrt_value(ix_low), wrt_value(iy_low), wrt_value(iz_low)};
    const float inverse_high[3] = {wrt_value(ix_high), wrt_value(iy_high), wrt_value(iz_high)};
    bounds.mixed_axes = 0;
    for (int a = 0; a < 3; ++a) {
        const bool backward = inverse_high[a] < 0.0f, mixed = (inverse_low[a] < 0.0f) & !backward;
        const float none = WRT_NAN;
        bounds.mixed_axes += mixed ? 1 : 0;
        bounds.backward.c[a] = backward ? 1 : 0;
        bounds.inverse_large.c[a] = mixed ? none : backward ? inverse_low[a] : inverse_high[a];
        bounds.inverse_small.c[a] = mixed ? none : backward ? inverse_high[a] : inverse_low[a];
        bounds.origin_in.c[a] = backward ? lows[a] - slack0 : highs[a] + slack0;
        bounds.origin_out.c[a] = backward ? highs[a] + slack0 : lows[a] - slack0;
        bounds.origin_low.c[a] = lows[a]; bounds.origin_high.c[a] = highs[a];
        if (mixed) {
            const float* inverse = a == 0 ? inverse_x : a == 1 ? inverse_y : inverse_z;
            WRT_INTERVAL(forward); WRT_INTERVAL(backward);
            WRT_FOR(P, k) {
                const bool valid = t[k] >= -0.0f, ahead = valid & !(inverse[k] < 0.0f), behind = valid & !ahead;
                WRT_WIDEN(forward, inverse[k], ahead) WRT_WIDEN(backward, inverse[k], behind)
            }
            bounds.forward_small.c[a] = wrt_value(forward_low); bounds.backward_small.c[a] = wrt_value(backward_high);
        }
    }
"""


@cache
def load_packet(layout: PacketLayout) -> wp.Function:
    """`wp.func(rays, first, low, high, packet, bounds)`: P rays of a batch (`numbers`); low, high: the scene.

    Rays that are bad or beyond the end of the batch are not active: no hit improves on their t of -inf.
    """
    form = TRIANGLE_TESTS[layout.triangle_test].packet_form
    constants = f"    constexpr float SLACK = {SLACK!r}f, TINY = {TINY!r}f;\n    constexpr int PASSES = {form.passes};\n"

    @wp.func_native(layout.head + constants + NUMBERS + INTERVALS + _LOAD.replace("WRT_PREPARE", form.prepare))
    def load_packet_native(
        rays: RayBatch,
        first: int,
        low: wp.vec3,
        high: wp.vec3,
        packet: wp.array(dtype=float),
        bounds: wp.ref[PacketBounds],
    ): ...

    return load_packet_native
