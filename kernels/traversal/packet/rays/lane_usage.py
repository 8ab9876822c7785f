"""Lane utilisation: the number of ray-triangle lanes tested, and the number that held a useful test."""

from functools import cache

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout
from wrt.kernels.traversal.packet.rays.ray_box_slabs import SHARED_ORIGIN, SLABS
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.record_blocks import vertex_box

exact_module(__name__)

_ACTIVE = f"""
    int active = 0;
    for (; mask; mask &= mask - 1u) {{
        const float* corner = &records.data[(size_t)block * (RECORD * W)] + wrt::lowest_bit(mask);
        float low[3], high[3];{vertex_box("corner", "0")}
        for (int k = 0; k < P; ++k) {{
            float enter = t_min[k], leave = t[k];
{SLABS}
            active += ((enter <= leave) & (t[k] > -INF)) ? 1 : 0;
        }}
    }}
    return active;
"""

_LANES = """
    return P * (PASSES == 1 ? 1 : (bounds.passes & 1) + (bounds.passes >> 1 & 1) + (bounds.passes >> 2 & 1));
"""


@cache
def active_lanes(layout: PacketLayout) -> wp.Function:
    """`wp.func(records, block, mask, packet, bounds) -> int`: pairs of a triangle in `mask` and a ray that meets its box."""

    @native.func_native("lanes.h", layout.head + SHARED_ORIGIN + _ACTIVE)
    def count_active_lanes(
        records: wp.array(dtype=float),
        block: int,
        mask: wp.uint32,
        packet: wp.array(dtype=float),
        bounds: wp.ref[PacketBounds],
    ) -> int: ...

    return count_active_lanes


@cache
def lanes_tested(layout: PacketLayout) -> wp.Function:
    """`wp.func(bounds) -> int`: number of lanes that `test_block` processes per triangle, over all passes."""
    passes = TRIANGLE_TESTS[layout.triangle_test].packet_form.passes

    @native.func_native("lanes.h", f"{layout.constants}    constexpr int PASSES = {passes};{_LANES}")
    def count_lanes(bounds: wp.ref[PacketBounds]) -> int: ...

    return count_lanes
