"""From rays in memory to a packet and its bounds, with the arithmetic of `load_ray`, `ray_slabs` and the test's `prepare`."""

from functools import cache

import warp as wp

from wrt.kernels.boxes import SLACK
from wrt.kernels.packet.bounding import BOUND
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
        t[k] = valid ? t[k] : -INF;
        ((int*)primitive)[k] = -1;
        u[k] = 0.0f; v[k] = 0.0f;
        const bool xy = size_x >= size_y, xz = size_x >= size_z, yz = size_y >= size_z;
        const bool main_x = xy & xz, main_y = !xy & yz;  // ties as in the scalar form of the watertight test
        const float major = main_x ? x : main_y ? y : z;
        const float sx = (main_x ? y : main_y ? z : x) / major, sy = (main_x ? z : main_y ? x : y) / major;
        slope_x[k] = sx; slope_y[k] = sy;
        ((int*)main_axis)[k] = main_x ? 0 : main_y ? 1 : 2;
        WRT_PREPARE
    }
    float lows[3] = {ox0, oy0, oz0}, highs[3] = {ox0, oy0, oz0};
"""


@cache
def load_packet(layout: PacketLayout) -> wp.Function:
    """`wp.func(rays, first, low, high, packet, bounds)`: P rays of a batch (`numbers`); low, high: the scene.

    Rays that are bad or beyond the end of the batch are not active: no hit improves on their t of -inf.
    """
    form = TRIANGLE_TESTS[layout.triangle_test].packet_form
    constants = f"    constexpr float SLACK = {SLACK!r}f, TINY = {TINY!r}f;\n    constexpr int PASSES = {form.passes};\n"

    @wp.func_native(layout.head + constants + NUMBERS + INTERVALS + _LOAD.replace("WRT_PREPARE", form.prepare) + BOUND)
    def load_packet_native(
        rays: RayBatch,
        first: int,
        low: wp.vec3,
        high: wp.vec3,
        packet: wp.array(dtype=float),
        bounds: wp.ref[PacketBounds],
    ): ...

    return load_packet_native
