"""The rays of a packet in a cell of a kd-tree: one interval of t per ray, in lanes; a plane splits those of all rays at a time.

The intervals are two more components of the packet, in a separate array: `entry` of the P rays, then `leave`. A ray that is not
in the cell has an empty interval. The formulas per ray are those of `wrt.kernels.traversal.single.single_kdtree`.
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout

exact_module(__name__)

_ENTER = """
    float *entry = cells.data, *leave = cells.data + P;
    const float slack0 = bounds.slack;
    const float from_x = bounds.origin_low.c[0], from_y = bounds.origin_low.c[1], from_z = bounds.origin_low.c[2];
    int inside = 0;
    WRT_FOR(P, k) {
        const float ix = inverse_x[k], iy = inverse_y[k], iz = inverse_z[k], wide = SHARED ? slack0 : slack[k];
        const float ox = SHARED ? from_x : origin_x[k], oy = SHARED ? from_y : origin_y[k], oz = SHARED ? from_z : origin_z[k];
        const bool back_x = ix < 0.0f, back_y = iy < 0.0f, back_z = iz < 0.0f;
        const float step_x = back_x ? -wide : wide, step_y = back_y ? -wide : wide, step_z = back_z ? -wide : wide;
        float enter = t_min[k], exit = t[k], s;
        s = ((back_x ? high.c[0] : low.c[0]) - (ox + step_x)) * ix; enter = s > enter ? s : enter;
        s = ((back_y ? high.c[1] : low.c[1]) - (oy + step_y)) * iy; enter = s > enter ? s : enter;
        s = ((back_z ? high.c[2] : low.c[2]) - (oz + step_z)) * iz; enter = s > enter ? s : enter;
        s = ((back_x ? low.c[0] : high.c[0]) - (ox - step_x)) * ix; exit = s < exit ? s : exit;
        s = ((back_y ? low.c[1] : high.c[1]) - (oy - step_y)) * iy; exit = s < exit ? s : exit;
        s = ((back_z ? low.c[2] : high.c[2]) - (oz - step_z)) * iz; exit = s < exit ? s : exit;
        entry[k] = enter; leave[k] = exit;
        inside += enter <= exit ? 1 : 0;
    }
    return inside;
"""

_SPLIT = """
    float *entry = cells.data, *leave = cells.data + P;
    const float from0 = bounds.origin_low.c[axis], slack0 = bounds.slack;
    // a loop is vectorised only if its pointers are known: once for each axis
    auto split = [=](const float* inverse, const float* from) {
        float before[P], behind[P];
        int left = 0, right = 0, leftwards = 0;
        WRT_FOR(P, k) {
            const float i = inverse[k], o = SHARED ? from0 : from[k], wide = SHARED ? slack0 : slack[k];
            const bool back = i < 0.0f, inside = entry[k] <= leave[k];
            const float step = back ? -wide : wide;
            float out = (position - (o - step)) * i, in = (position - (o + step)) * i;
            out = out < leave[k] ? out : leave[k];
            in = in > entry[k] ? in : entry[k];
            before[k] = out; behind[k] = in;
            const bool near = inside & (entry[k] <= out), far = inside & (in <= leave[k]);
            left += (back ? far : near) ? 1 : 0;
            right += (back ? near : far) ? 1 : 0;
            leftwards += (near & far) ? (back ? -1 : 1) : 0;
        }
        const bool both = (left > 0) & (right > 0), go_right = both ? leftwards < 0 : right > 0;
        WRT_FOR(P, k) {
            const bool far = (inverse[k] < 0.0f) != go_right;
            const float e = entry[k], l = leave[k], b = before[k], c = behind[k];
            entry[k] = far ? c : e;
            leave[k] = far ? l : b;
        }
        return (go_right ? 1 : 0) | (both ? 2 : 0);
    };
    if (axis == 0) return split(inverse_x, origin_x);
    if (axis == 1) return split(inverse_y, origin_y);
    return split(inverse_z, origin_z);
"""


@cache
def enter_cell(layout: PacketLayout) -> wp.Function:
    """`wp.func(packet, bounds, low, high, cells) -> int`: computes the intervals in a box; returns the number of rays inside.

    The intervals are clipped to the rays' ranges and best hits.
    """

    @native.func_native("lanes.h", layout.head + _ENTER)
    def enter_cell_native(
        packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds], low: wp.vec3, high: wp.vec3, cells: wp.array(dtype=float)
    ) -> int: ...

    return enter_cell_native


@cache
def split_cell(layout: PacketLayout) -> wp.Function:
    """`wp.func(packet, bounds, axis, position, cells) -> bits`: moves to a child.

    Bit 0: the child is the right one. Bit 1: both must be visited; the move is then to the child that is near for the majority
    of the rays that visit both.
    """

    @native.func_native("lanes.h", layout.head + _SPLIT)
    def split_cell_native(
        packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds], axis: int, position: float, cells: wp.array(dtype=float)
    ) -> int: ...

    return split_cell_native
