"""The least cost of all planes of a sweep, 16 events at a time, and the block of events in which it occurs.

**Problem.** An exact sweep evaluates the cost at every event, with counts that each event changes. Done one after the other,
this is half the time of an exact build.

**Algorithm.** The counts at 16 events are prefix sums over their types; the 16 costs are then lanes of one vector. Each lane
keeps the least cost so far and the block of 16 in which it occurred. The plane itself is found by a sweep that starts at the
first such block (`sweep_planes`), so that ties, and the counts of the plane, are decided in one place. Both costs have the same
bits, because both come from `PLANE_COST`.

**Limits.** The axis must have no planar triangles, which are tried on both sides.
"""

import warp as wp

from wrt.builders.cost import PLANE_COST, AxisFrame, SplitCost
from wrt.builders.kdtree.events.event_sort import END, START
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module

exact_module(__name__)


@wp.struct
class LeastPlane:
    """The least cost of a sweep along one axis and its position."""

    cost: float
    """inf if there is no plane."""
    event: int
    """First event of the first block that contains it."""
    left: int
    """Triangles that have begun before that event."""
    right: int
    """Triangles that have not ended before that event."""


@native.func_native(
    "lanes.h",
    PLANE_COST
    + f"""
    constexpr int W = 16;
    float least[W];
    int block[W], blocks_left[W], blocks_right[W];
    WRT_FOR_LANES(j) {{ least[j] = WRT_INFINITY; block[j] = 0; blocks_left[j] = 0; blocks_right[j] = 0; }}
    int left = left_before, right = right_before;
    for (int first = 0; first < count; first += W) {{
        const auto* from = events.data + begin + first;
        const int lanes = count - first < W ? count - first : W;
        int bits[W], lefts[W], rights[W];
        const int block_left = left, block_right = right;
        for (int j = 0; j < lanes; ++j) {{
            const int kind = from[j].c[1] & 3;
            bits[j] = from[j].c[0];
            right -= kind == {int(END)};
            lefts[j] = left;
            rights[j] = right;
            left += kind == {int(START)};
        }}
        for (int j = lanes; j < W; ++j) {{ bits[j] = 0x7f800000; lefts[j] = rights[j] = 1; }}  // at infinity: not inside
        float positions[W];
        memcpy(positions, bits, sizeof(bits));
        WRT_FOR_LANES(j) {{
            const float candidate = plane_cost(positions[j], lefts[j], rights[j]);
            const bool better = (candidate < least[j]) & (positions[j] > frame.low) & (positions[j] < frame.high);
            least[j] = better ? candidate : least[j];
            block[j] = better ? first : block[j];
            blocks_left[j] = better ? block_left : blocks_left[j];
            blocks_right[j] = better ? block_right : blocks_right[j];
        }}
    }}
    int best = 0;
    for (int j = 1; j < W; ++j)
        if (least[j] < least[best] || (least[j] == least[best] && block[j] < block[best])) best = j;
    found.cost = least[best];
    found.event = begin + block[best];
    found.left = blocks_left[best];
    found.right = blocks_right[best];
""",
)
def find_least_plane(
    cost: SplitCost,
    frame: AxisFrame,
    events: wp.array(dtype=wp.vec2i),
    begin: int,
    count: int,
    left_before: int,
    right_before: int,
    found: wp.ref[LeastPlane],
):
    """Searches the events begin .. begin + count - 1, none of which is of a planar triangle.

    left_before: triangles that have begun before them. right_before: triangles that have not ended before them."""
    ...
