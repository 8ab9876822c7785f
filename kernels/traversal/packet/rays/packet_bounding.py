"""Bounds of the active rays of a packet, computed from its components: on loading, and again for each part
(`packet_splitting`).

Inactive rays are replaced by the first active one, so that the loops need no masks.
"""

import re

from wrt.kernels.traversal.packet.rays.lane_intervals import INTERVALS, PACKET_INTERVALS, packet_ends
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout
from wrt.kernels.triangle import TRIANGLE_TESTS


def bounding_head(layout: PacketLayout, slopes: bool) -> str:
    """C++ for the head of a function that ends in `bound_packet`, after `PacketLayout.head`; slopes: whether slopes are bounded
    too."""
    passes = TRIANGLE_TESTS[layout.triangle_test].packet_form.passes
    constants = f"    constexpr int PASSES = {passes};\n    constexpr bool SLOPES = {str(slopes).lower()};\n"
    return constants + INTERVALS + PACKET_INTERVALS


_BOUND = """
    int one = 0;
    while (one < P && !(t[one] >= -0.0f)) ++one;  // an active ray's t is not negative
    bounds.active = 0;
    if (one == P) return;
    WRT_ENDS(ix); WRT_ENDS(iy); WRT_ENDS(iz); WRT_ENDS(sx); WRT_ENDS(sy);
    WRT_ENDS(ox); WRT_ENDS(oy); WRT_ENDS(oz); WRT_ENDS(wide);
    WRT_ENDS(ex); WRT_ENDS(ey); WRT_ENDS(ez);
    int active = 0;
    WRT_FOR_LANES(i) {
        WRT_BOUND(ix, inverse_x[k]) WRT_BOUND(iy, inverse_y[k]) WRT_BOUND(iz, inverse_z[k])
        if (SLOPES) { WRT_BOUND(sx, slope_x[k]) WRT_BOUND(sy, slope_y[k]) }
        if (!SHARED) {
            WRT_BOUND(ox, origin_x[k]) WRT_BOUND(oy, origin_y[k]) WRT_BOUND(oz, origin_z[k])
        }
        WRT_WIDE
        WRT_RAY_ENDS
        WRT_UNROLLED for (int f = 0; f < P; f += W) active += t[f + i] >= -0.0f ? 1 : 0;
    }
    WRT_ALL_ENDS
    bounds.active = active;
    if (ranged) {
        WRT_ENDS(start); WRT_ENDS(end);
        WRT_FOR_LANES(i) { WRT_BOUND(start, t_min[k]) WRT_BOUND(end, t[k]) }
        WRT_RANGE_ENDS
        bounds.t_min = start_least; bounds.t_max = end_most;
    } else {
        bounds.t_min = t_min[one]; bounds.t_max = t[one];
    }
    WRT_ORIGIN_ENDS
    WRT_SET_RAY_ENDS
    WRT_MAIN_AXES
    WRT_SLACK
    bounds.slack = slack0;
    if (SLOPES) {
        const int main = main_axes == 1 ? 0 : main_axes == 2 ? 1 : 2;
        const int next = main == 2 ? 0 : main + 1, other = next == 2 ? 0 : next + 1;
        const float plane = SHARED ? lows[main] : 0.5f * (lows[main] + highs[main]);
        WRT_SLOPE_ENDS
        bounds.plane = plane;
        if (SHARED) {
            bounds.through_low = bounds.through_high = wp::vec2(lows[next], lows[other]);
        } else {
            const float* along = main == 0 ? origin_x : main == 1 ? origin_y : origin_z;
            const float* across_x = main == 0 ? origin_y : main == 1 ? origin_z : origin_x;
            const float* across_y = main == 0 ? origin_z : main == 1 ? origin_x : origin_y;
            WRT_ENDS(cx); WRT_ENDS(cy);
            WRT_FOR_LANES(i) {
                WRT_BOUND(cx, across_x[k] - slope_x[k] * (along[k] - plane))
                WRT_BOUND(cy, across_y[k] - slope_y[k] * (along[k] - plane))
            }
            WRT_CROSSING_ENDS
            bounds.through_low = wp::vec2(cx_least - slack0, cy_least - slack0);
            bounds.through_high = wp::vec2(cx_most + slack0, cy_most + slack0);
        }
    }
    WRT_AXES
"""

_AXES = """
    bounds.finished = WRT_FINISHED;
    const float none = WRT_NAN;
    int mixed_axes = 0;
    bounds.forward_small = wp::vec3(); bounds.backward_small = wp::vec3();
    WRT_EACH_AXIS
    bounds.mixed_axes = mixed_axes;
"""

_SIDES = """
        mixed_axes += mixed ? 1 : 0;
        bounds.backward.c[a] = backward ? 1 : 0;
        bounds.origin_in.c[a] = backward ? lows[a] - slack0 : highs[a] + slack0;
        bounds.origin_out.c[a] = backward ? highs[a] + slack0 : lows[a] - slack0;
        bounds.origin_low.c[a] = lows[a]; bounds.origin_high.c[a] = highs[a];
"""

_INVERSE_AXES = f"""
    const float inverse_low[3] = {{ix_least, iy_least, iz_least}}, inverse_high[3] = {{ix_most, iy_most, iz_most}};
    WRT_UNROLLED for (int a = 0; a < 3; ++a) {{
        const float least = inverse_low[a], most = inverse_high[a];
        const bool backward = most < 0.0f, mixed = (least < 0.0f) & !backward;
        bounds.inverse_large.c[a] = mixed ? none : backward ? least : most;
        bounds.inverse_small.c[a] = mixed ? none : backward ? most : least;{_SIDES}
    }}
    if (mixed_axes) for (int a = 0; a < 3; ++a) {{
        if (!((inverse_low[a] < 0.0f) & !(inverse_high[a] < 0.0f))) continue;
        const float* inverse = a == 0 ? inverse_x : a == 1 ? inverse_y : inverse_z;
        WRT_INTERVAL(forward); WRT_INTERVAL(behind);
        WRT_FOR(P, k) {{
            const bool valid = t[k] >= -0.0f, ahead = valid & !(inverse[k] < 0.0f), back = valid & !ahead;
            WRT_WIDEN(forward, inverse[k], ahead) WRT_WIDEN(behind, inverse[k], back)
        }}
        bounds.forward_small.c[a] = wrt_value(forward_low); bounds.backward_small.c[a] = wrt_value(behind_high);
    }}
"""

_DIRECTION_AXES = f"""
    // a direction of -0 counts as +0, whose reciprocal bounds the same boxes; division is monotone on either side of 0
    const float least_of[3] = {{ix_least + 0.0f, iy_least + 0.0f, iz_least + 0.0f}};
    const float most_of[3] = {{ix_most + 0.0f, iy_most + 0.0f, iz_most + 0.0f}};
    WRT_UNROLLED for (int a = 0; a < 3; ++a) {{
        const float of_least = 1.0f / least_of[a], of_most = 1.0f / most_of[a];
        const bool backward = most_of[a] < 0.0f, mixed = (least_of[a] < 0.0f) & !backward;
        bounds.inverse_large.c[a] = mixed ? none : backward ? of_most : of_least;
        bounds.inverse_small.c[a] = mixed ? none : backward ? of_least : of_most;
        bounds.forward_small.c[a] = mixed ? of_most : 0.0f; bounds.backward_small.c[a] = mixed ? of_least : 0.0f;{_SIDES}
    }}
"""

_ORIGIN_ENDS = """
    lows[0] = ox_least; lows[1] = oy_least; lows[2] = oz_least;
    highs[0] = ox_most; highs[1] = oy_most; highs[2] = oz_most;
"""

_MAIN_AXES = """
    const int* axis = (const int*)main_axis;
    int main_axes = 0;
    WRT_FOR(P, k) { main_axes |= t[k] >= -0.0f ? 1 << axis[k] : 0; }
    bounds.main_axes = main_axes;
    bounds.passes = PASSES == 1 ? 1 : main_axes;
"""

_SLOPE_ENDS = """
        bounds.slope_low = wp::vec2(sx_least, sy_least);
        bounds.slope_high = wp::vec2(sx_most, sy_most);
"""


_RAY_ENDS = """
        WRT_BOUND(ex, origin_x[k] + t[k] * (WRT_DIRECTION(inverse_x[k])))
        WRT_BOUND(ey, origin_y[k] + t[k] * (WRT_DIRECTION(inverse_y[k])))
        WRT_BOUND(ez, origin_z[k] + t[k] * (WRT_DIRECTION(inverse_z[k])))
"""

_SET_RAY_ENDS = """
    bounds.end_low = wp::vec3(ex_least, ey_least, ez_least);
    bounds.end_high = wp::vec3(ex_most, ey_most, ez_most);
"""

SLACK_OF_ENDS = """
    const float of_lows = reach(lows[0], lows[1], lows[2]), of_highs = reach(highs[0], highs[1], highs[2]);
    const float slack0 = SLACK * (of_lows > of_highs ? of_lows : of_highs);
"""
"""C++ of `slack0`, the greatest slack of rays that start between `lows[3]` and `highs[3]` (`packet_load.REACH`)."""


def axes_code(later: bool) -> str:
    """C++ that sets the fields of `bounds` that depend on the axis, from `lows`, `highs`, `slack0` and the intervals ix_least,
    ix_most and so on of 1 / direction. later: these are the intervals of the directions."""
    code = _AXES.replace("WRT_FINISHED", "0" if later else "1")
    return code.replace("WRT_EACH_AXIS", _DIRECTION_AXES if later else _INVERSE_AXES)


def bound_packet(layout: PacketLayout, slopes: bool, later: bool = False, ends: bool = False, loading: bool = True) -> str:
    """C++ after `PacketLayout.head` and `bounding_head`: sets `bounds`. An active ray has t >= 0; if there is no active ray,
    only `active` is set.

    The code needs `lows[3]` and `highs[3]` (the shared origin, otherwise any numbers) and `ranged`: whether rays may have a
    t_min or t of their own.

    later: what only tests need is still to be computed (`packet_load.finish_packet`); the components of 1 / direction hold
    directions. ends: bounds the ends of rays with origins of their own, too. loading: the code has `reach` and SLACK
    (`packet_load`); otherwise the slack is that of the rays or, if the origin is shared, a variable `slack0`.
    """
    own_slack = not loading and not layout.shared_origin
    names = ["ix", "iy", "iz", *(["sx", "sy"] if slopes else []), *([] if layout.shared_origin else ["ox", "oy", "oz"])]
    pieces = {"WRT_RAY_ENDS": "", "WRT_SET_RAY_ENDS": "", "WRT_WIDE": "WRT_BOUND(wide, slack[k])" if own_slack else ""}
    if own_slack:
        names.append("wide")
    if ends:
        names += ["ex", "ey", "ez"]
        pieces["WRT_RAY_ENDS"] = re.sub(r"WRT_DIRECTION\((.*?)\)", r"\1" if later else r"1.0f / \1", _RAY_ENDS)
        pieces["WRT_SET_RAY_ENDS"] = _SET_RAY_ENDS
    pieces |= {"WRT_ALL_ENDS": packet_ends(names, layout.width), "WRT_RANGE_ENDS": packet_ends(["start", "end"], layout.width)}
    pieces["WRT_ORIGIN_ENDS"] = "" if layout.shared_origin else _ORIGIN_ENDS
    pieces["WRT_MAIN_AXES"] = "const int main_axes = 0;" if later else _MAIN_AXES
    pieces["WRT_SLACK"] = SLACK_OF_ENDS if loading else "const float slack0 = wide_most;" if own_slack else ""
    pieces["WRT_SLOPE_ENDS"] = _SLOPE_ENDS if slopes else ""
    pieces["WRT_CROSSING_ENDS"] = packet_ends(["cx", "cy"], layout.width)
    pieces["WRT_AXES"] = axes_code(later)
    code = _BOUND
    for name, piece in pieces.items():
        code = code.replace(name, piece)
    return code
