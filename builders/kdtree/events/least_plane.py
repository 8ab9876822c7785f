"""The least cost of all planes of a sweep, 16 events at a time, and the block of events in which it occurs.

**Problem.** An exact sweep evaluates the cost at every event, with counts that each event changes. Done one after the other,
this is half the time of an exact build.

**Algorithm.** The counts at 16 events are prefix sums over their types; the 16 costs are then lanes of one vector. Each lane
keeps the least cost so far and the block of 16 in which it occurred. The plane itself is found by a sweep that starts at the
first such block (`sweep_planes`), so that ties, and the counts of the plane, are decided in one place. Both costs have the same
bits, because both come from one function.

**Limits.** The axis must have no planar triangles, which are tried on both sides.
"""

import warp as wp

from wrt.builders.cost import AxisFrame, SplitCost
from wrt.kernels.runtime import native


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
    "events.h",
    "wrt::find_least_plane(cost, frame, events.data + begin, count, left_before, right_before, found);\nfound.event += begin;",
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
