"""Two-plane frustum culling for rays without a shared origin (Overbeck, Ramamoorthi and Mark 2008).

**Problem.** If rays start at different points, separate intervals of origins and slopes lose the correlation between them.
Shadow rays start anywhere on a surface and converge at the light, but a frustum of extreme origins and extreme slopes widens
towards the light.

**Idea.** Two planes normal to the packet's main axis bound all rays: a near one behind all origins, a far one behind the scene.
Each ray crosses both, and two rectangles bound the points. The volume between corresponding sides of the rectangles is a
frustum around all rays: at every depth a ray is a weighted mean of its own two points, and therefore between the means of the
extremes.

**Steps.**

1. The near plane is behind all origins along the main axis, the far one behind the scene.
2. Each of the P rays is intersected with both: two rectangles, and lines through their corresponding sides.
3. Boxes are culled by the lines as in `inverse_frustum`, triangles whose vertices are beyond one line by `side_planes`.

**Data.** The lines of `PacketBounds`, as in `inverse_frustum`: side is the near rectangle, rise is the difference of the two
rectangles divided by the depth. The set-up intersects P rays with two planes, once per packet; the other cullings do not have
this cost.

**Differences from the paper.** Boxes are culled as in `inverse_frustum`; triangles are culled if their three vertices lie
outside the same side (`side_planes`). If the scene ends soon after the origins, the far plane is moved to at least half of the
reach, so that extending a side backward magnifies its rounding at most five times. If all rays share an origin, the near
rectangle is that point. A packet without a main axis is culled by `interval_culling`.

References: overbeck-2008; rahikainen-2013 (section 3.3).
"""

from functools import cache

import warp as wp

from wrt.kernels.traversal.packet.culling.culling_hooks import bounds_set_by
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout


@cache
def start(layout: PacketLayout) -> wp.Function:
    """Sets up the frustum between the rearmost origin and the end of the scene."""
    return bounds_set_by("packet_frusta.h", f"wrt::set_two_plane_frustum(low, high, {layout.packet}, bounds);")
