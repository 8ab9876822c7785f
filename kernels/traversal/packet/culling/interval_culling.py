"""Culling by interval arithmetic: one slab test for all rays of a packet (Boulos, Wald and Shirley 2006).

The near plane along an axis is entered at (plane - origin) * inverse. Over intervals of origins and of inverses with one sign,
the least value occurs at the end of the origins that is closest to the plane, and at one of the two ends of the inverses. The
same holds for the far plane. If the product is 0 * inf, the undefined value must not give a bound. The comparisons are written
so that the NaN, which only the farther end of the inverses can produce first, is passed on and then ignored.

**Both signs along an axis.** The slab gives no bound in this case. But a box in front of all origins is reached only by rays
with positive direction, no sooner than by the fastest of them, with the least 1 / direction. The same holds for a box behind
all origins and rays with negative direction. Packets along the two lines of a picture where a component changes its sign need
this bound; without it they visit a large part of all nodes (notebooks/records/2026-11-21-packets.md).

References:
    S. Boulos, I. Wald, P. Shirley: Geometric and arithmetic culling methods for entire ray packets. Technical report
        UUCS-06-010, University of Utah, 2006.
    V. Rahikainen: On real-time ray tracing. MSc thesis, University of Tampere, 2013 (section 3.3).
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.box_lanes import NO_CHILD_CONSTANT
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout
from wrt.kernels.triangle.support.record_blocks import vertex_box

exact_module(__name__)

_ENDS = """
    const float in_x = bounds.origin_in.c[0], in_y = bounds.origin_in.c[1], in_z = bounds.origin_in.c[2];
    const float out_x = bounds.origin_out.c[0], out_y = bounds.origin_out.c[1], out_z = bounds.origin_out.c[2];
    const float large_x = bounds.inverse_large.c[0], large_y = bounds.inverse_large.c[1], large_z = bounds.inverse_large.c[2];
    const float small_x = bounds.inverse_small.c[0], small_y = bounds.inverse_small.c[1], small_z = bounds.inverse_small.c[2];
    const float t_min = bounds.t_min, t_max = bounds.t_max;
    const bool back_x = large_x < 0.0f, back_y = large_y < 0.0f, back_z = large_z < 0.0f;  // NaN, of both signs: false
"""

_INTERVAL = """
        float enter = t_min, leave = t_max, d, p, q;
        d = near_x - in_x; p = d * large_x; q = d * small_x; q = q < p ? q : p; enter = q > enter ? q : enter;
        d = near_y - in_y; p = d * large_y; q = d * small_y; q = q < p ? q : p; enter = q > enter ? q : enter;
        d = near_z - in_z; p = d * large_z; q = d * small_z; q = q < p ? q : p; enter = q > enter ? q : enter;
        d = far_x - out_x; p = d * large_x; q = d * small_x; q = q > p ? q : p; leave = q < leave ? q : leave;
        d = far_y - out_y; p = d * large_y; q = d * small_y; q = q > p ? q : p; leave = q < leave ? q : leave;
        d = far_z - out_z; p = d * large_z; q = d * small_z; q = q > p ? q : p; leave = q < leave ? q : leave;
"""

_MIXED = "".join(
    f"""
        d = {axis}0[i] - ahead_{axis}; q = d * forward_{axis}; enter = q > enter ? q : enter;
        d = {axis}1[i] - behind_{axis}; q = d * backward_{axis}; enter = q > enter ? q : enter;"""
    for axis in "xyz"
)


def _loop(more: str) -> str:
    return f"""
    WRT_FOR_LANES(i) {{
        const float near_x = x0[i], near_y = y0[i], near_z = z0[i];
        const float far_x = x1[i], far_y = y1[i], far_z = z1[i];{_INTERVAL}{more}
        int k = (__builtin_bit_cast(int, enter) & -W) | i;
        k = enter <= leave ? k : NO_CHILD;
        key[i] = k;
        least = k < least ? k : least;
    }}
    """


BOXES = f"""
    const float* box = &boxes.data[(size_t)node * (6 * W)];{_ENDS}
    const float *x0 = box + (back_x ? 3 * W : 0), *x1 = box + (back_x ? 0 : 3 * W);
    const float *y0 = box + (back_y ? 4 * W : W), *y1 = box + (back_y ? W : 4 * W);
    const float *z0 = box + (back_z ? 5 * W : 2 * W), *z1 = box + (back_z ? 2 * W : 5 * W);
    int* key = &keys.data[first];
    int least = NO_CHILD;
    if (bounds.mixed_axes == 0) {{{_loop("")}return least;}}
    // 0 along the other axes, where these bound nothing
    const float forward_x = bounds.forward_small.c[0], backward_x = bounds.backward_small.c[0];
    const float forward_y = bounds.forward_small.c[1], backward_y = bounds.backward_small.c[1];
    const float forward_z = bounds.forward_small.c[2], backward_z = bounds.backward_small.c[2];
    const float wide = bounds.slack;
    const float ahead_x = bounds.origin_high.c[0] + wide, behind_x = bounds.origin_low.c[0] - wide;
    const float ahead_y = bounds.origin_high.c[1] + wide, behind_y = bounds.origin_low.c[1] - wide;
    const float ahead_z = bounds.origin_high.c[2] + wide, behind_z = bounds.origin_low.c[2] - wide;
    {_loop(_MIXED)}
    return least;
"""
"""C++ of `cull_boxes`, also the fallback of other cullings."""

TRIANGLES = f"""
    const float* r = &records.data[(size_t)block * (RECORD * W)];{_ENDS}
    int kept[W];
    WRT_FOR_LANES(i) {{
        float low[3], high[3];{vertex_box("r", "i")}
        const float near_x = back_x ? high[0] : low[0], far_x = back_x ? low[0] : high[0];
        const float near_y = back_y ? high[1] : low[1], far_y = back_y ? low[1] : high[1];
        const float near_z = back_z ? high[2] : low[2], far_z = back_z ? low[2] : high[2];{_INTERVAL}
        // an unused lane holds NaN, which bounds nothing: it is told by its first vertex
        kept[i] = ((enter <= leave) & (r[i] == r[i])) ? -1 : 0;
    }}
    return wrt::bits<W>(kept);
"""
"""C++ of `cull_triangles`."""


@cache
def cull_boxes(layout: PacketLayout) -> wp.Function:
    """`Culling.boxes`: packet x W child boxes; keys as in `wrt.kernels.simd.box_lanes.ray_boxes`."""

    @native.func_native("lanes.h", f"{layout.constants}    constexpr int NO_CHILD = {NO_CHILD_CONSTANT};{BOXES}")
    def interval_boxes(
        boxes: wp.array(dtype=float),
        node: int,
        packet: wp.array(dtype=float),
        bounds: wp.ref[PacketBounds],
        keys: wp.array(dtype=int),
        first: int,
    ) -> int: ...

    return interval_boxes


@cache
def cull_triangles(layout: PacketLayout) -> wp.Function:
    """`Culling.triangles`: packet x the boxes of the W triangles of a block."""

    @native.func_native("lanes.h", f"{layout.constants}{TRIANGLES}")
    def interval_triangles(records: wp.array(dtype=float), block: int, bounds: wp.ref[PacketBounds]) -> wp.uint32: ...

    return interval_triangles
