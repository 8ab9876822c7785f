"""Back-face culling for whole packets: triangles that turn their back to all of their rays.

A ray comes from the front if the product of its direction and the triangle's normal is negative
(`wrt.kernels.traversal.leaf.comes_from_front`). Over an interval of directions, the least product along each axis is at one of
the ends, and the sum of the three is not greater than the sum of any ray: rounding is monotone. Where it is not negative, no
ray comes from the front. The other triangles are tested, and each hit by itself.

References:
    C. Benthin, I. Wald: Efficient ray traced soft shadows using multi-frusta tracing. High Performance Graphics 2009.
    V. Rahikainen: On real-time ray tracing. MSc thesis, University of Tampere, 2013 (section 2.3).
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.traversal.leaf import FRONT
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout

exact_module(__name__)

_FRONTS = """
    const float* r = &records.data[(size_t)block * (RECORD * W)];
    double end[3][2];  // of the directions, derived as those of the rays are
    for (int a = 0; a < 3; ++a) {
        const float large = bounds.inverse_large.c[a], small = bounds.inverse_small.c[a];
        const bool mixed = large != large;
        end[a][0] = (double)(1.0f / (mixed ? bounds.forward_small.c[a] : large));
        end[a][1] = (double)(1.0f / (mixed ? bounds.backward_small.c[a] : small));
    }
    int faces[W];
    WRT_FOR_LANES(i) {
        double normal[3], least[3];
        wrt_normal(r + i, W, normal);
        for (int a = 0; a < 3; ++a) {
            const double p = normal[a] * end[a][0], q = normal[a] * end[a][1];
            least[a] = p < q ? p : q;
        }
        faces[i] = (least[0] + least[1]) + least[2] < 0.0 ? -1 : 0;
    }
    return wrt::bits<W>(faces);
"""


@cache
def keep_front_faces(layout: PacketLayout) -> wp.Function:
    """`wp.func(records, block, bounds) -> mask` of the triangles of a block whose front some ray may see."""

    @native.func_native("lanes.h", f"{layout.constants}{FRONT}{_FRONTS}")
    def keep_front_faces_native(records: wp.array(dtype=float), block: int, bounds: wp.ref[PacketBounds]) -> wp.uint32: ...

    return keep_front_faces_native
