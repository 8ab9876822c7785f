"""Bounds of a packet whose rays end at one point, such as shadow rays to a point light, as seen from that point.

**Problem.** Interval bounds combine every origin with every direction. Shadow rays start on a surface and converge at the
light, but their bounds widen towards it.

**Idea.** An any-hit query may visit leaves in any order, so a node can be culled as if the rays began at their ends and ran
back: the interval of the new origins is almost a point, and the bounds widen towards the surface, as the rays do. Nodes near
the light come first. Only the bounds are reversed; triangles are tested with the rays as they are.

**Exactness.** A hit at t is a point origin + t direction within the slack of its triangle's box. The same point is end -
(t_max - t) direction, where the end origin + t_max direction is rounded, and the direction may be 1 / (1 / direction). The
slack of the reversed bounds is twice that of the packet, plus that of the ends, plus `ENDS_ERROR` of the largest coordinate.
So no hit is culled.

    u, X                          2^-24; the largest coordinate of origins and ends, so |t_max d| <= 2 X
    1 / (1 / d)                   two roundings: 4 u X
    t_max d                       one: 2 u X
    o + t_max d                   one: 1 u X
    sum                           7 u X

`ENDS_ERROR` is 16 u: more than half of it is slack. Searched by `ends` of tests/bounds.

A packet keeps its bounds if its ends and their slack are not small against the spread of its origins, as with rays that have no
common end or end nowhere, or if its directions have both signs along some axis. Parallel rays that end nowhere seem to meet far
away, where rounding leaves nothing of their origins; the slack of such an end is larger than any scene. The origins' own
interval (`origin_low`, `origin_high`) remains, for `packet_splitting`.

Figures: notebooks/records/2026-11-23-short-rows.md, 2026-11-28-whole-jobs-quiet.md (parallel rays).
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout

CLOSER = 4.0
"""How many times as far apart as the ends, with their slack, the origins must be."""

ENDS_ERROR = 2.0**-20
"""Greatest error of an end, as a fraction of the largest coordinate of origins and ends: 16 roundings of half a unit in the
last place, of which a computed end has seven."""


@cache
def reverse_bounds(layout: PacketLayout) -> wp.Function:
    """`wp.func(low, high, bounds)`: reverses the bounds if that makes them tighter; low, high: bounds of the scene.

    The bounds of the ends are needed (`ends` of `load_packet` and `activate_part`).
    """

    @native.func_native(
        "packet_bounds.h",
        f"""static_assert(wrt::CLOSER == {CLOSER!r}f && wrt::ENDS_ERROR == {ENDS_ERROR!r}f);
        wrt::reverse_bounds(low, high, bounds);""",
    )
    def reverse_bounds_native(low: wp.vec3, high: wp.vec3, bounds: wp.ref[PacketBounds]): ...

    return reverse_bounds_native
