"""A triangle test without a tree, boxes or a rule for ties: for measuring tests, not for tracing.

`make_frusta`: packets of P rays with a common origin, W rays at a time against one triangle after the other (the test's
`packet_form`). `make_blocks`: one ray after the other against blocks of W triangles (`block_test`). Both test every triangle
and keep the closest hit with t > 0, so that the compiler can remove nothing. `make_pairs`: ray i against triangle i, by the
scalar form, or by the lanes of a form that has no other. `make_scalar`: every ray against every triangle by the scalar form.
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module, specialised_kernel
from wrt.kernels.simd.lanes import lanes, lowest_bit
from wrt.kernels.study.dammertz_keller import ScalarTest
from wrt.kernels.triangle.support.triangle_contract import TestForm, TriangleTest

exact_module(__name__)

_FRUSTA = """
    const float INF = WRT_INFINITY, *origin0 = (const float*)&origin;
    const float *origin_x = nullptr, *origin_y = nullptr, *origin_z = nullptr;
    WRT_STATE
    float slope_x[P], slope_y[P], t[P];
    int found[P], main_axis[P], main_axes = 0;
    const float ox = origin0[0], oy = origin0[1], oz = origin0[2];
    const float* d = (const float*)(directions.data + begin);
    WRT_FOR(P, k) {
        const float x = d[3 * k], y = d[3 * k + 1], z = d[3 * k + 2], ix = 1.0f / x, iy = 1.0f / y, iz = 1.0f / z;
        const float size_x = WRT_ABS(x), size_y = WRT_ABS(y), size_z = WRT_ABS(z);
        const bool main_x = (size_x >= size_y) & (size_x >= size_z), main_y = !(size_x >= size_y) & (size_y >= size_z);
        const float major = main_x ? x : main_y ? y : z;
        const float sx = (main_x ? y : main_y ? z : x) / major, sy = (main_x ? z : main_y ? x : y) / major;
        slope_x[k] = sx; slope_y[k] = sy; t[k] = INF; found[k] = -1;
        WRT_PREPARE
        main_axis[k] = main_x ? 0 : main_y ? 1 : 2;
        main_axes |= 1 << main_axis[k];
    }
    for (int id = 0; id < triangles; ++id) {
        const float* corner = &records.data[(size_t)(id / W) * (RECORD * W) + id % W];
        WRT_UNROLLED for (int pass = 0; pass < PASSES; ++pass) {
            if (PASSES > 1 && !(main_axes >> pass & 1)) continue;
            WRT_TRIANGLE
            for (int f = 0; f < P; f += W) {
                WRT_INSIDE
                WRT_FOR_LANES(i) {
                    const int k = f + i;
                    float at, hit_u, hit_v;
                    WRT_HIT
                    const bool hit = (inside[i] != 0) & (at > 0.0f) & (at < t[k]);
                    t[k] = hit ? at : t[k];
                    found[k] = hit ? id : found[k];
                }
            }
        }
    }
    for (int k = 0; k < P; ++k) { out_t.data[begin + k] = t[k]; out_id.data[begin + k] = found[k]; }
"""


@cache
def make_frusta(test: TestForm, rays: int, width: int) -> wp.Kernel:
    """Closest hits of frusta of `rays` rays. `rays` is a multiple of `width`, the block width. One item is a frustum."""
    form = test.packet_form
    constants = f"    constexpr int W = {width}, P = {rays}, RECORD = {test.record.components}, PASSES = {form.passes};\n"
    state = "".join(f"float {name}[P]; " for name in form.state)
    pieces = {"WRT_STATE": state, "WRT_PREPARE": form.prepare, "WRT_TRIANGLE": form.triangle}
    body = _FRUSTA
    for name, piece in (pieces | {"WRT_INSIDE": form.inside, "WRT_HIT": form.hit}).items():
        body = body.replace(name, piece)

    @native.func_native(f"lanes.h {form.headers}", constants + "    constexpr bool SHARED = true;\n" + body)
    def trace_frustum(
        records: wp.array(dtype=float),
        triangles: int,
        origin: wp.vec3,
        directions: wp.array(dtype=wp.vec3),
        begin: int,
        out_t: wp.array(dtype=float),
        out_id: wp.array(dtype=int),
    ): ...

    def frusta(
        first: int,
        records: wp.array(dtype=float),
        triangles: int,
        origins: wp.array(dtype=wp.vec3),
        origin_stride: int,
        directions: wp.array(dtype=wp.vec3),
        out_t: wp.array(dtype=float),
        out_id: wp.array(dtype=int),
    ):
        begin = (first + wp.tid()) * wp.static(rays)
        trace_frustum(records, triangles, origins[begin * origin_stride], directions, begin, out_t, out_id)

    return specialised_kernel(frusta)


@cache
def make_blocks(test: TestForm, width: int, in_range: wp.Function | None = None) -> wp.Kernel:
    """Closest hits of single rays against blocks of `width` triangles. One item is a ray. Arguments as in `make_frusta`.

    in_range: checks t in all lanes at once (`wrt.kernels.study.distance_checks.in_range`); None: where a test hits, one by one.
    """
    prepare, block_test, at_once = test.prepare, test.block_test(width), in_range is not None
    Lanes = lanes(width)

    def blocks(
        first: int,
        records: wp.array(dtype=float),
        triangles: int,
        origins: wp.array(dtype=wp.vec3),
        origin_stride: int,
        directions: wp.array(dtype=wp.vec3),
        out_t: wp.array(dtype=float),
        out_id: wp.array(dtype=int),
    ):
        i = first + wp.tid()
        state = prepare(origins[i * origin_stride], directions[i])
        best = float(wp.inf)
        found = int(-1)
        for block in range((triangles + wp.static(width - 1)) / wp.static(width)):
            t = Lanes()
            u = Lanes()
            v = Lanes()
            mask = block_test(records, block, state, t, u, v)
            if wp.static(at_once):
                mask = in_range(t, mask, best)
            while mask != wp.uint32(0):
                lane = lowest_bit(mask)
                mask = mask & (mask - wp.uint32(1))
                if (wp.static(at_once) or t[lane] > 0.0) and t[lane] < best:
                    best = t[lane]
                    found = block * wp.static(width) + lane
        out_t[i] = best
        out_id[i] = found

    return specialised_kernel(blocks)


def scalar_of(test: TestForm | ScalarTest) -> wp.Function:
    """`wp.func(records, slot, ray) -> vec3 (t, u, v)` for blocks of one triangle; t is NaN for a miss."""
    State = test.ray_state
    if isinstance(test, TriangleTest | ScalarTest):
        intersect, load = test.intersect, test.record.load

        @wp.func
        def by_intersect(records: wp.array(dtype=float), slot: int, ray: State):
            return intersect(ray, load(records, slot, 1))

        return by_intersect
    block_test, Lane = test.block_test(1), lanes(1)

    @wp.func
    def by_lanes(records: wp.array(dtype=float), slot: int, ray: State):
        t = Lane()
        u = Lane()
        v = Lane()
        if (block_test(records, slot, ray, t, u, v) & wp.uint32(1)) == wp.uint32(0):
            return wp.vec3(wp.nan, 0.0, 0.0)
        return wp.vec3(t[0], u[0], v[0])

    return by_lanes


@cache
def make_pairs(test: TestForm | ScalarTest) -> wp.Kernel:
    """Item i tests ray i against triangle i of blocks of width 1. `out` is (t, u, v); t is NaN for a miss."""
    prepare, scalar = test.prepare, scalar_of(test)

    def pairs(
        first: int,
        records: wp.array(dtype=float),
        origins: wp.array(dtype=wp.vec3),
        origin_stride: int,
        directions: wp.array(dtype=wp.vec3),
        out: wp.array(dtype=wp.vec3),
    ):
        i = first + wp.tid()
        out[i] = scalar(records, i, prepare(origins[i * origin_stride], directions[i]))

    return specialised_kernel(pairs)


@cache
def make_scalar(test: TestForm | ScalarTest) -> wp.Kernel:
    """Closest hits of single rays, triangles one by one. One item is a ray. Arguments as in `make_frusta`."""
    prepare, scalar = test.prepare, scalar_of(test)

    def one_by_one(
        first: int,
        records: wp.array(dtype=float),
        triangles: int,
        origins: wp.array(dtype=wp.vec3),
        origin_stride: int,
        directions: wp.array(dtype=wp.vec3),
        out_t: wp.array(dtype=float),
        out_id: wp.array(dtype=int),
    ):
        i = first + wp.tid()
        state = prepare(origins[i * origin_stride], directions[i])
        best = float(wp.inf)
        found = int(-1)
        for slot in range(triangles):
            hit = scalar(records, slot, state)
            if hit[0] > 0.0 and hit[0] < best:
                best = hit[0]
                found = slot
        out_t[i] = best
        out_id[i] = found

    return specialised_kernel(one_by_one)
