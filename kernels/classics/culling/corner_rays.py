"""Corner-ray culling: four rays bound the packet (Dmitriev, Havran and Seidel 2004).

**Problem.** A large packet reaches many triangles that none of its rays hit, and rejecting each takes P / W vector tests.

**Idea.** Four rays, real or virtual, span a convex shaft around all the others. At a leaf a triangle is tested against these
four. If all of them pass the same edge on its outer side, so do all rays in between, and the triangle is culled before any ray
is tested.

**Steps**, for the W triangles of a block at a time:

1. The corner rays are the four pairs of extreme slopes (s, t) of the packet.
2. For each edge (p, q), the signed area of the edge as seen by each of the four.
3. A triangle is culled if neither all three areas can be >= 0 nor all three <= 0, for any ray between the four.

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

References: dmitriev-2004; reshetov-2005; rahikainen-2013 (section 3.3).
"""

from functools import cache

import warp as wp

from wrt.kernels.traversal.packet.culling.culling_hooks import triangles_culled_by
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout, cpp

MARGIN = 4.0
"""Error bound of an area, in slacks times the distance of its vertices from the ray."""


@cache
def cull_triangles(layout: PacketLayout) -> wp.Function:
    """Four corner rays x the edges of the W triangles of a block."""
    call = f"wrt::corner_mask<{layout.width}, {cpp(layout.shared_origin)}>({layout.block}, bounds)"
    return triangles_culled_by("packet_culling.h", f"static_assert(wrt::CORNER_MARGIN == {MARGIN!r}f);\nreturn {call};")
