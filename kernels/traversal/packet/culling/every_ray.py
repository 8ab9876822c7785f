"""No culling: every ray of the packet against every box and every triangle on the packet's path (Wald et al. 2001).

This is the baseline for the other cullings. A child is visited if any ray meets its box, in the order of the earliest entry of
any ray. The rays share only the decisions, the loads and the lanes.

The box test cannot stop at the first ray that meets the box. If the nearest child of a level lies beyond all best hits, the
rest of the level is dropped, and this needs the least entry of all rays.

References:
    I. Wald, P. Slusallek, C. Benthin, M. Wagner: Interactive rendering with coherent ray tracing. Eurographics 2001.
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.box_lanes import NO_CHILD_CONSTANT
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout
from wrt.kernels.traversal.packet.rays.ray_box_slabs import SHARED_ORIGIN, SLABS

exact_module(__name__)

_BOXES = f"""
    const float* box = &boxes.data[(size_t)node * (6 * W)];
    int* key = &keys.data[first];
    int least = NO_CHILD;
    for (int c = 0; c < W; ++c) {{
        const float low[3] = {{box[c], box[W + c], box[2 * W + c]}};
        const float high[3] = {{box[3 * W + c], box[4 * W + c], box[5 * W + c]}};
        int entry = NO_CHILD;
        if (low[0] <= high[0]) {{  // an unused lane has no box
            WRT_FOR(P, k) {{
                float enter = t_min[k], leave = t[k];
{SLABS}
                // adding 0 turns -0 into +0; the t_min of a ray that is not active may be anything, of either sign
                const int met = ((enter <= leave) & (t[k] > -INF)) ? __builtin_bit_cast(int, enter + 0.0f) : NO_CHILD;
                entry = met < entry ? met : entry;
            }}
        }}
        entry = entry == NO_CHILD ? NO_CHILD : (entry & -W) | c;
        key[c] = entry;
        least = entry < least ? entry : least;
    }}
    return least;
"""

_TRIANGLES = """
    const float* r = &records.data[(size_t)block * (RECORD * W)];
    int kept[W];
    WRT_FOR_LANES(i) { kept[i] = r[i] == r[i] ? -1 : 0; }
    return wrt::bits<W>(kept);
"""


@cache
def cull_boxes(layout: PacketLayout) -> wp.Function:
    """`Culling.boxes`: P rays x W child boxes; keys as in `wrt.kernels.simd.box_lanes.ray_boxes`, from the least entry of all
    rays."""

    @native.func_native("lanes.h", f"{layout.head}    constexpr int NO_CHILD = {NO_CHILD_CONSTANT};{SHARED_ORIGIN}{_BOXES}")
    def every_ray_boxes(
        boxes: wp.array(dtype=float),
        node: int,
        packet: wp.array(dtype=float),
        bounds: wp.ref[PacketBounds],
        keys: wp.array(dtype=int),
        first: int,
    ) -> int: ...

    return every_ray_boxes


@cache
def cull_triangles(layout: PacketLayout) -> wp.Function:
    """`Culling.triangles`: keeps all triangles of a block; unused lanes hold NaN and are dropped."""

    @native.func_native("lanes.h", f"{layout.constants}{_TRIANGLES}")
    def every_triangle(records: wp.array(dtype=float), block: int, bounds: wp.ref[PacketBounds]) -> wp.uint32: ...

    return every_triangle
