"""The planes of a sweep, one event at a time, or the least cost among them, 16 events at a time.

**One event at a time.** Equivalent to the groups of events in `sorting_sweep`, without look-ahead.

At a position with e ends, p planar triangles and s starts, the relevant counts are those after all ends and before all starts.
Events come in the order end, planar, start. A plane evaluated after only some of the ends has more triangles on its right than
the true one, so it cannot be cheaper; among equal costs at one position the last end counts. A plane evaluated after some of
the starts has more triangles on its left; among equal costs the first start counts. So every event may evaluate the plane at
its position with the current counts, without a branch on what follows, and the minimum is that of the groups.

Planar triangles are the exception, because putting some of them on each side is not a split. They are all tried on the right
when the first of them comes, and all on the left when the last has been passed.

**16 events at a time** (`find_best_plane`). An exact sweep evaluates the cost at every event, with counts that each event
changes. Done one after the other, this is half the time of an exact build. But the counts at 16 events are prefix sums over
their types; the 16 costs are then lanes of one vector. Each lane keeps the least cost so far and the block of 16 in which it
occurred. The plane itself is found by a sweep that starts at the first such block, one event at a time, so that ties, and the
counts of the plane, are decided in one place. Both costs have the same bits, because both come from one function. The axis must
have no planar triangles, which are tried on both sides.
"""

import warp as wp

from wrt.builders.cost import AxisFrame, Split, SplitCost, no_split, plane_cost
from wrt.builders.kdtree.events.event_sort import END, PLANAR, START
from wrt.kernels.runtime import native


@wp.struct
class Sweep:
    """State of a sweep in one node along one axis."""

    left: int
    """Triangles that have begun."""
    right: int
    """Triangles that have not ended."""
    planar: int
    """Planar triangles at `position` that have been passed; they still count as on the right."""
    position: float
    best: Split


@wp.func
def start_sweep(left: int, right: int):
    """A sweep that starts with these counts, and no plane yet."""
    sweep = Sweep()
    sweep.left = left
    sweep.right = right
    sweep.best = no_split()
    return sweep


@wp.func
def try_plane(cost: SplitCost, along: AxisFrame, kind: int, position: float, sweep: wp.ref[Sweep]):
    """Keeps the plane with the current counts if it costs less than the best; after another end at the same position, also if
    it costs the same."""
    candidate = plane_cost(cost, along, position, sweep.left, sweep.right)
    same_plane = sweep.best.axis == along.axis and sweep.best.position == position
    better = candidate < sweep.best.cost or (kind == END and candidate == sweep.best.cost and same_plane)
    if better and position > along.low and position < along.high:
        sweep.best.cost = candidate
        sweep.best.axis = along.axis
        sweep.best.position = position
        sweep.best.planar_left = kind == START
        sweep.best.left = sweep.left
        sweep.best.right = sweep.right


@wp.func
def close_planar(cost: SplitCost, along: AxisFrame, sweep: wp.ref[Sweep]):
    """Passes the pending planar triangles, if there are any, and tries them on the left."""
    if sweep.planar > 0:
        sweep.left += sweep.planar
        sweep.right -= sweep.planar
        sweep.planar = 0
        try_plane(cost, along, START, sweep.position, sweep)


@wp.func
def sweep_event(cost: SplitCost, along: AxisFrame, kind: int, position: float, sweep: wp.ref[Sweep]):
    """Tries the plane at an event and passes the event."""
    if kind != PLANAR or position != sweep.position:
        close_planar(cost, along, sweep)
    sweep.right -= wp.where(kind == END, 1, 0)
    if kind != PLANAR or sweep.planar == 0:
        try_plane(cost, along, kind, position, sweep)
    sweep.left += wp.where(kind == START, 1, 0)
    if kind == PLANAR:
        sweep.planar += 1
        sweep.position = position


@wp.struct
class BestPlane:
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
    "wrt::find_best_plane(cost, frame, events.data + begin, count, left_before, right_before, found);\nfound.event += begin;",
)
def find_best_plane(
    cost: SplitCost,
    frame: AxisFrame,
    events: wp.array(dtype=wp.vec2i),
    begin: int,
    count: int,
    left_before: int,
    right_before: int,
    found: wp.ref[BestPlane],
):
    """Searches the events begin .. begin + count - 1, none of which is of a planar triangle.

    left_before: triangles that have begun before them. right_before: triangles that have not ended before them."""
