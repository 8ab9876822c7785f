"""Corner-ray culling: four rays bound the packet (Dmitriev, Havran and Seidel 2004).

**Problem.** A large packet reaches many triangles that none of its rays hit, and rejecting each takes P / W vector tests.

**Idea.** Four rays, real or virtual, span a convex shaft around all the others. At a leaf a triangle is tested against these
four. If all of them pass the same edge on its outer side, so do all rays in between, and the triangle is culled before any ray
is tested.

**Validity.** The paper also traverses the tree with the four rays alone. Reshetov et al. (2005) note that this is wrong: a box
may lie within the shaft without touching any of its corners. Boxes are therefore culled by `interval_culling` here. The four
rays bound the others only if all rays start at one point and have the same main axis. As a function of the two slopes (s, t),
the signed area of an edge (p, q) seen from a shared origin is that of (p_x - s p_z, p_y - t p_z) and (q_x - s q_z, q_y - t
q_z), in which the product s t cancels. The area is therefore linear, and is greatest and least at the corners of the rectangle
of slopes. With separate origins it is not linear. Batches without a shared origin, and packets with different main axes, are
culled by the boxes of the triangles, as in `interval_culling`.

**Differences from the paper.** The corner rays are virtual: the four pairs of extreme slopes. Both sides of a triangle are
tested: it is culled if neither all three areas can be >= 0 nor all three <= 0, which includes the paper's single edge.

**Why the hits do not change.** Sheared vertices are computed as in the watertight test, with errors of at most 5 u reach (u =
2^-24). A test that is `accurate` finds no hit farther than the slack, 16 u reach, from the triangle. An area that decides a hit
therefore differs from the area of the exact vertices by at most 2 slack (|p| + |q|) plus second-order terms, where |p| is the
sum of the absolute coordinates, greatest at a corner. The areas computed here have a rounding error of 13 / 16 slack (|p| +
|q|). They must be beyond 4 slack (|p| + |q| + 4 slack), and beyond the least normal number.

References:
    K. Dmitriev, V. Havran, H.-P. Seidel: Faster ray tracing with SIMD shaft culling. Research report MPI-I-2004-4-006,
        Max-Planck-Institut fuer Informatik, 2004.
    A. Reshetov, A. Soupikov, J. Hurley: Multi-level ray tracing algorithm. SIGGRAPH 2005.
    V. Rahikainen: On real-time ray tracing. MSc thesis, University of Tampere, 2013 (section 3.3).
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.ray_batch import TINY
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.traversal.packet.culling import interval_culling as interval
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout

exact_module(__name__)

MARGIN = 4.0
"""Error bound of an area, in slacks times the distance of its vertices from the ray."""

_TRIANGLES = f"""
    const unsigned met = [&]() -> unsigned {{{interval.TRIANGLES}}}();
    if (!SHARED || (bounds.main_axes & (bounds.main_axes - 1)) || !met) return met;
    const int z = bounds.main_axes == 1 ? 0 : bounds.main_axes == 2 ? 1 : 2, x = z == 2 ? 0 : z + 1, y = x == 2 ? 0 : x + 1;
    const float* r = &records.data[(size_t)block * (RECORD * W)];
    const float ox = bounds.origin_low.c[x], oy = bounds.origin_low.c[y], oz = bounds.origin_low.c[z];
    const float s0 = bounds.slope_low.c[0], s1 = bounds.slope_high.c[0];
    const float t0 = bounds.slope_low.c[1], t1 = bounds.slope_high.c[1];
    const float wide = {MARGIN!r}f * bounds.slack;
    int kept[W];
    WRT_FOR_LANES(i) {{
        float px[3], qx[3], py[3], qy[3], size[3];  // sheared by the least and by the greatest slope
        for (int k = 0; k < 3; ++k) {{
            const float vx = r[(3 * k + x) * W + i] - ox, vy = r[(3 * k + y) * W + i] - oy, vz = r[(3 * k + z) * W + i] - oz;
            px[k] = vx - s0 * vz; qx[k] = vx - s1 * vz;
            py[k] = vy - t0 * vz; qy[k] = vy - t1 * vz;
            const float ax = WRT_ABS(px[k]), bx = WRT_ABS(qx[k]);
            const float ay = WRT_ABS(py[k]), by = WRT_ABS(qy[k]);
            size[k] = (ax > bx ? ax : bx) + (ay > by ? ay : by);
        }}
        bool front = true, back = true;  // whether some ray may see all areas >= 0, or all <= 0
        for (int k = 0; k < 3; ++k) {{
            const int l = k == 2 ? 0 : k + 1;
            const float a = px[k] * py[l] - py[k] * px[l], b = px[k] * qy[l] - qy[k] * px[l];
            const float c = qx[k] * py[l] - py[k] * qx[l], d = qx[k] * qy[l] - qy[k] * qx[l];
            const float margin = wide * (size[k] + size[l] + 4.0f * bounds.slack) + {TINY!r}f;
            // NaN, where products overflow, keeps the triangle
            front = front & !((a < -margin) & (b < -margin) & (c < -margin) & (d < -margin));
            back = back & !((a > margin) & (b > margin) & (c > margin) & (d > margin));
        }}
        kept[i] = (front | back) ? -1 : 0;
    }}
    return wrt::bits<W>(kept) & met;
"""


@cache
def cull_triangles(layout: PacketLayout) -> wp.Function:
    """`Culling.triangles`: four corner rays x the edges of the W triangles of a block."""

    @native.func_native("lanes.h", f"{layout.constants}{_TRIANGLES}")
    def corner_rays(records: wp.array(dtype=float), block: int, bounds: wp.ref[PacketBounds]) -> wp.uint32: ...

    return corner_rays
