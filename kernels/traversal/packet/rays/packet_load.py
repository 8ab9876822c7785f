"""Loads rays into a packet and computes its bounds, with the arithmetic of `load_ray`, `ray_slabs` and the test's `prepare`.

Many packets meet no leaf: of views those of the background, of shadow rays those whose light nothing hides. Divisions, slopes
and what else only tests need are left until the first leaf (`finish_packet`). Bounds take the ends of the directions, as
division is monotone.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.ray_batch import DIRECTION_LANES, RayBatch
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.boxes import SLACK
from wrt.kernels.traversal.packet.rays.packet_bounding import bound_packet, bounding_head
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout
from wrt.kernels.traversal.packet.rays.ray_numbers import FETCH, NUMBERS
from wrt.kernels.triangle import TRIANGLE_TESTS

exact_module(__name__)

_CENTRE = """
    const double center_x = rays.center.c[0], center_y = rays.center.c[1], center_z = rays.center.c[2];
    float from_x[P], from_y[P], from_z[P], least[P], most[P];
    float ox0 = 0.0f, oy0 = 0.0f, oz0 = 0.0f;
    if (SHARED) {
        const float* o = (const float*)rays.origins.data;
        ox0 = (float)((double)o[0] - center_x); oy0 = (float)((double)o[1] - center_y); oz0 = (float)((double)o[2] - center_z);
    } else fetch(rays.origin_stride, [&](int k, int n) {
        const float* o = (const float*)rays.origins.data + 3 * (size_t)n;
        from_x[k] = o[0]; from_y[k] = o[1]; from_z[k] = o[2];
    });
    if (!SHARED && rays.origin_stride) fetch_next(rays.origins.data);
    fetch(rays.t_min_stride, [&](int k, int n) { least[k] = rays.t_min.data[n]; });
    fetch(rays.t_max_stride, [&](int k, int n) { most[k] = rays.t_max.data[n]; });
    const bool ranged = rays.t_min_stride || rays.t_max_stride;
    if (!SHARED) WRT_FOR(P, k) {
        from_x[k] = (float)((double)from_x[k] - center_x);
        from_y[k] = (float)((double)from_y[k] - center_y);
        from_z[k] = (float)((double)from_z[k] - center_z);
    }
"""

REACH = """
    auto reach = [&](float x, float y, float z) {
        float far = WRT_ABS(low.c[0] - x), f;
        f = WRT_ABS(high.c[0] - x); far = f > far ? f : far;
        f = WRT_ABS(low.c[1] - y); far = f > far ? f : far;
        f = WRT_ABS(high.c[1] - y); far = f > far ? f : far;
        f = WRT_ABS(low.c[2] - z); far = f > far ? f : far;
        f = WRT_ABS(high.c[2] - z); far = f > far ? f : far;
        return far;
    };
"""
"""C++ of `reach(x, y, z)`: how far the box from `low` to `high` extends from a point along an axis."""

_SIZE = """
    auto wrt_size = [](float x) { return __builtin_bit_cast(int, x) & 0x7fffffff; };
"""
"""C++ of `wrt_size(x)`: the size of a float as an integer in the order of the floats, NaN and infinity beyond all numbers."""

_FILL = """
    float lows[3] = {ox0, oy0, oz0}, highs[3] = {ox0, oy0, oz0};
    WRT_FOR(P, k) {
        float x = to_x[k], y = to_y[k], z = to_z[k];
        wrt_direction(x, y, z);
        const float farthest = most[k] > FARTHEST ? FARTHEST : most[k];
        const float ox = SHARED ? ox0 : from_x[k], oy = SHARED ? oy0 : from_y[k], oz = SHARED ? oz0 : from_z[k];
        const int size_x = wrt_size(x), size_y = wrt_size(y), size_z = wrt_size(z);
        int size = size_x > size_y ? size_x : size_y; size = size > size_z ? size : size_z;
        const bool valid = (size >= wrt_size(SHORTEST)) & (size < wrt_size(INF))
            & (ox - ox == 0.0f) & (oy - oy == 0.0f) & (oz - oz == 0.0f)
            & (least[k] >= 0.0f) & (least[k] <= farthest);
        if (!SHARED) { origin_x[k] = ox; origin_y[k] = oy; origin_z[k] = oz; }
        t_min[k] = least[k];
        t[k] = valid ? farthest : -INF;
        WRT_REST
    }
"""

_TESTED = """
        if (!SHARED) slack[k] = SLACK * reach(ox, oy, oz);
        ((int*)primitive)[k] = -1;
        u[k] = 0.0f; v[k] = 0.0f;
        const bool xy = size_x >= size_y, xz = size_x >= size_z, yz = size_y >= size_z;
        const bool main_x = xy & xz, main_y = !xy & yz;  // ties as in the scalar form of the watertight test
        const float major = main_x ? x : main_y ? y : z;
        const float sx = (main_x ? y : main_y ? z : x) / major, sy = (main_x ? z : main_y ? x : y) / major;
        const float ix = 1.0f / x, iy = 1.0f / y, iz = 1.0f / z;
        slope_x[k] = sx; slope_y[k] = sy;
        ((int*)main_axis)[k] = main_x ? 0 : main_y ? 1 : 2;
        inverse_x[k] = ix; inverse_y[k] = iy; inverse_z[k] = iz;
        WRT_PREPARE
"""

_DIRECTIONS = """
        inverse_x[k] = x; inverse_y[k] = y; inverse_z[k] = z;
"""

_FINISH = """
    if (bounds.finished) return;
    bounds.finished = 1;
    const float ox0 = bounds.origin_low.c[0], oy0 = bounds.origin_low.c[1], oz0 = bounds.origin_low.c[2];
    int main_axes = 0;
    WRT_FOR(P, k) {
        const float x = inverse_x[k], y = inverse_y[k], z = inverse_z[k];
        const float ox = SHARED ? ox0 : origin_x[k], oy = SHARED ? oy0 : origin_y[k], oz = SHARED ? oz0 : origin_z[k];
        const int size_x = wrt_size(x), size_y = wrt_size(y), size_z = wrt_size(z);
        WRT_REST
        main_axes |= t[k] >= -0.0f ? (main_x ? 1 : main_y ? 2 : 4) : 0;
    }
    bounds.main_axes = main_axes;
    bounds.passes = PASSES == 1 ? 1 : main_axes;
"""


def fill_head(layout: PacketLayout, slopes: bool) -> str:
    """C++ for the head of a function that contains `fill_packet` and ends in `bound_packet`, after `PacketLayout.head`."""
    return _constants() + bounding_head(layout, slopes)


def _constants() -> str:
    return f"    constexpr float SLACK = {SLACK!r}f;\n{DIRECTION_LANES}{REACH}{_SIZE}"


def tested(layout: PacketLayout) -> str:
    """C++ that computes what of ray k only tests need: 1 / direction, slopes, slack, no hit so far and the test's state."""
    return _TESTED.replace("WRT_PREPARE", TRIANGLE_TESTS[layout.triangle_test].packet_form.prepare)


def fill_packet(layout: PacketLayout, later: bool = False) -> str:
    """C++ that fills the components of a packet from arrays of P floats: directions to_x, to_y, to_z; t_min and t_max least,
    most; origins from_x, from_y, from_z, or ox0, oy0, oz0 if it is shared. low, high: bounds of the tree. later: what only
    tests need is left for `finish_packet`, and the components of 1 / direction hold the direction."""
    return _FILL.replace("WRT_REST", _DIRECTIONS if later else tested(layout))


@cache
def load_packet(layout: PacketLayout, slopes: bool = True, later: bool = False, ends: bool = False) -> wp.Function:
    """`wp.func(rays, first, low, high, packet, bounds)`: loads P rays of a batch (`ray_numbers`); low, high: bounds of the
    scene.

    slopes: whether slopes are bounded (`Culling.slopes`). later: leaves what only tests need to `finish_packet`; not with
    slopes. ends: bounds the ends of rays, too (`PacketBounds.end_low`). Invalid rays and places beyond the end of the batch are
    inactive: their t is -inf, which no hit improves.
    """
    head = layout.head + fill_head(layout, slopes) + NUMBERS

    @native.func_native(
        "lanes.h", head + FETCH + _CENTRE + fill_packet(layout, later) + bound_packet(layout, slopes, later, ends)
    )
    def load_packet_native(
        rays: RayBatch,
        first: int,
        low: wp.vec3,
        high: wp.vec3,
        packet: wp.array(dtype=float),
        bounds: wp.ref[PacketBounds],
    ): ...

    return load_packet_native


@cache
def finish_packet(layout: PacketLayout) -> wp.Function:
    """`wp.func(low, high, packet, bounds)`: computes what `load_packet` left for later, unless that is done; low, high: as
    there."""
    passes = f"    constexpr int PASSES = {TRIANGLE_TESTS[layout.triangle_test].packet_form.passes};\n"

    @native.func_native("lanes.h", layout.head + _constants() + passes + _FINISH.replace("WRT_REST", tested(layout)))
    def finish_packet_native(low: wp.vec3, high: wp.vec3, packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds]): ...

    return finish_packet_native
