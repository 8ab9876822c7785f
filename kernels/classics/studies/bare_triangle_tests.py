"""A triangle test without a tree, boxes or a rule for ties: for measuring tests, not for tracing.

`make_frusta`: packets of P rays with a common origin, W rays at a time against one triangle after the other (the test's
`packet_form`). `make_blocks`: one ray after the other against blocks of W triangles (`block_test`). Both test every triangle
and keep the closest hit with t > 0, so that the compiler can remove nothing. `make_pairs`: ray i against triangle i, by the
scalar form, or by the lanes of a form that has no other. `make_scalar`: every ray against every triangle by the scalar form.
"""

from functools import cache

import warp as wp

from wrt.kernels.classics.studies.dammertz_keller import ScalarTest
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import specialised_kernel
from wrt.kernels.simd.lanes import lanes, lowest_bit
from wrt.kernels.triangle.support.triangle_contract import TestForm, TriangleTest


@cache
def make_frusta(test: TestForm, rays: int, width: int) -> wp.Kernel:
    """Closest hits of frusta of `rays` rays. `rays` is a multiple of `width`, the block width. One item is a frustum."""
    form, sizes = test.packet_form, f"{width}, {test.packet_form.passes}, {test.record.components}"
    state = " ".join(f"float {name}_of[{rays}]; float* const {name} = {name}_of;" for name in form.state)
    code = f"""
        constexpr int W = {width}; constexpr bool SHARED = true;
        {state} wrt::BareFrustum<{rays}> own;
        const float *const slope_x = own.slope_x, *const slope_y = own.slope_y, *const t = own.t, *const origin0 = origin.c;
        const float *const origin_x = nullptr, *const origin_y = nullptr, *const origin_z = nullptr;
        const int* const main_axis = own.main_axis;
        own.start(origin0, (const float*)(directions.data + begin), {form.preparation});
        own.trace<{sizes}>(records.data, triangles, {form.triangles});
        for (int k = 0; k < {rays}; ++k) {{ out_t.data[begin + k] = own.t[k]; out_id.data[begin + k] = own.found[k]; }}
    """

    @native.func_native(f"bare_frusta.h {form.headers}", code)
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


@wp.struct
class Nearest:
    """The closest hit of a ray."""

    t: float
    triangle: int
    """-1 if it hits none."""


def single_rays(trace: wp.Function) -> wp.Kernel:
    """Closest hits of single rays. One item is a ray. trace: `wp.func(records, triangles, origin, direction) -> Nearest`."""

    def rays(
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
        nearest = trace(records, triangles, origins[i * origin_stride], directions[i])
        out_t[i] = nearest.t
        out_id[i] = nearest.triangle

    return specialised_kernel(rays)


@cache
def make_blocks(test: TestForm, width: int, in_range: wp.Function | None = None) -> wp.Kernel:
    """Single rays against blocks of `width` triangles. Arguments as in `make_frusta`.

    in_range: checks t in all lanes at once (`wrt.kernels.classics.studies.distance_checks.in_range`); None: where a test hits,
    one by one.
    """
    prepare, block_test, at_once = test.prepare, test.block_test(width), in_range is not None
    Lanes = lanes(width)

    @wp.func
    def by_blocks(records: wp.array(dtype=float), triangles: int, origin: wp.vec3, direction: wp.vec3):
        state = prepare(origin, direction)
        nearest = Nearest(wp.inf, -1)
        for block in range((triangles + wp.static(width - 1)) / wp.static(width)):
            t = Lanes()
            u = Lanes()
            v = Lanes()
            mask = block_test(records, block, state, t, u, v)
            if wp.static(at_once):
                mask = in_range(t, mask, nearest.t)
            while mask != wp.uint32(0):
                lane = lowest_bit(mask)
                mask = mask & (mask - wp.uint32(1))
                if (wp.static(at_once) or t[lane] > 0.0) and t[lane] < nearest.t:
                    nearest.t = t[lane]
                    nearest.triangle = block * wp.static(width) + lane
        return nearest

    return single_rays(by_blocks)


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
    """Single rays against triangles one by one. Arguments as in `make_frusta`."""
    prepare, scalar = test.prepare, scalar_of(test)

    @wp.func
    def one_by_one(records: wp.array(dtype=float), triangles: int, origin: wp.vec3, direction: wp.vec3):
        state = prepare(origin, direction)
        nearest = Nearest(wp.inf, -1)
        for slot in range(triangles):
            hit = scalar(records, slot, state)
            if hit[0] > 0.0 and hit[0] < nearest.t:
                nearest.t = hit[0]
                nearest.triangle = slot
        return nearest

    return single_rays(one_by_one)
