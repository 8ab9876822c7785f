"""Bounds of a packet whose rays end at one point, such as shadow rays to a point light, as seen from that point.

**Problem.** Interval bounds combine every origin with every direction. Shadow rays start on a surface and converge at the
light, but their bounds widen towards it.

**Idea.** An any-hit query may visit leaves in any order, so a node can be culled as if the rays began at their ends and ran
back: the interval of the new origins is almost a point, and the bounds widen towards the surface, as the rays do. Nodes near
the light come first. Only the bounds are reversed; triangles are tested with the rays as they are.

**Exactness.** A hit at t is a point origin + t direction within the slack of its triangle's box. The same point is end -
(t_max - t) direction, where the end origin + t_max direction is rounded, and the direction may be 1 / (1 / direction). The
slack of the reversed bounds is twice that of the packet, plus that of the ends, plus `ENDS_ERROR` of the largest coordinate, a
multiple of those roundings. So no hit is culled.

A packet keeps its bounds if its ends are not close together against its origins, as with rays that have no common end or end
nowhere, or if its directions have both signs along some axis. The origins' own interval (`origin_low`, `origin_high`) remains,
for `packet_splitting`.

Figures: notebooks/records/2026-11-23-short-rows.md.
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.boxes import SLACK
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout

exact_module(__name__)

CLOSER = 4.0
"""How many times as far apart as the ends the origins must be."""

ENDS_ERROR = 2.0**-20
"""Greatest error of an end, as a fraction of the largest coordinate of origins and ends: 16 roundings of half a unit in the
last place, of which a computed end has five."""

_REVERSE = """
    if (bounds.mixed_axes) return;
    float ends = 0.0f, origins = 0.0f, reach = 0.0f, size = 0.0f;
    auto widen = [](float value, float& most) { most = WRT_ABS(value) > most ? WRT_ABS(value) : most; };
    WRT_UNROLLED for (int a = 0; a < 3; ++a) {
        const float least = bounds.end_low.c[a], most = bounds.end_high.c[a];
        ends += most - least;
        origins += bounds.origin_high.c[a] - bounds.origin_low.c[a];
        widen(low.c[a] - most, reach); widen(high.c[a] - least, reach);
        widen(least, size); widen(most, size);
        widen(bounds.origin_low.c[a], size); widen(bounds.origin_high.c[a], size);
    }
    const float wide = 2.0f * bounds.slack + SLACK * reach + ENDS_ERROR * size;
    if (!(CLOSER * ends < origins) || !(wide < INF)) return;  // NaN, of ends at infinity, too
    WRT_UNROLLED for (int a = 0; a < 3; ++a) {
        const bool backward = !bounds.backward.c[a];
        bounds.backward.c[a] = backward ? 1 : 0;
        bounds.inverse_large.c[a] = -bounds.inverse_large.c[a];
        bounds.inverse_small.c[a] = -bounds.inverse_small.c[a];
        bounds.origin_in.c[a] = backward ? bounds.end_low.c[a] - wide : bounds.end_high.c[a] + wide;
        bounds.origin_out.c[a] = backward ? bounds.end_high.c[a] + wide : bounds.end_low.c[a] - wide;
    }
    bounds.slack = wide;
    bounds.t_max = (bounds.t_max - bounds.t_min) * (1.0f + ENDS_ERROR);
    bounds.t_min = 0.0f;
"""


@cache
def reverse_bounds(layout: PacketLayout) -> wp.Function:
    """`wp.func(low, high, bounds)`: reverses the bounds if that makes them tighter; low, high: bounds of the scene.

    The bounds of the ends are needed (`ends` of `load_packet` and `activate_part`).
    """
    constants = f"    constexpr float CLOSER = {CLOSER!r}f, SLACK = {SLACK!r}f, ENDS_ERROR = {ENDS_ERROR!r}f;\n"

    @native.func_native("lanes.h", layout.constants + constants + _REVERSE)
    def reverse_bounds_native(low: wp.vec3, high: wp.vec3, bounds: wp.ref[PacketBounds]): ...

    return reverse_bounds_native
