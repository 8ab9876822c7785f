"""Events to the children of their nodes, in one pass (ClassifyTriangles and Fill of Choi et al. 2010, of a level at once).

An event looks at the box of its triangle and at its node's plane, and goes to one child or to both. Nodes, and the children of
a node, are in order, and so are the events of each; therefore events keep their order, and four sums over all events before one
say where it goes: events that go to left and to right children, and triangles that begin with them. An event of a leaf ends
there; where the triangle begins on the first axis, it is listed.

References: choi-2010.
"""

import warp as wp

from wrt.builders.kdtree.levelwise.cell_nodes import CellNode
from wrt.builders.kdtree.levelwise.grid_sums import Tiles
from wrt.builders.triangle_boxes import Boxes
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_kernel

EVENTS_EACH = 8
"""Events of a thread (event_moves.h)."""


@wp.struct
class Below:
    """Where events go."""

    event: wp.array(dtype=wp.vec4i)
    """Those of the next level."""
    listed: wp.array(dtype=int)
    """Triangles of leaves."""


@native.func_native(
    "event_moves.h",
    f"static_assert(wrt::EVENTS_EACH == {EVENTS_EACH});\n"
    "wrt::move_events(thread, 6 * total, boxes.low.data, boxes.high.data, boxes.low.shape[1], events.data, nodes.data,\n"
    "    totals.data, (wrt::Tile*)tiles.word.data, tiles.turn, to.event.data, to.event.shape[0], to.listed.data);",
)
def move_own(
    thread: int,
    total: int,
    boxes: Boxes,
    events: wp.array(dtype=wp.vec4i),
    nodes: wp.array(dtype=CellNode),
    totals: wp.array(dtype=int),
    tiles: Tiles,
    to: Below,
):
    """Moves the events of a thread."""


@exact_kernel
def move_events(
    first: int,
    total: int,
    boxes: Boxes,
    events: wp.array(dtype=wp.vec4i),
    nodes: wp.array(dtype=CellNode),
    totals: wp.array(dtype=int),
    tiles: Tiles,
    to: Below,
):
    """Item: `EVENTS_EACH` events, in one chunk. Writes them to the next level, as far as there is room, and the triangles of
    leaves. totals: of `make_children`."""
    move_own(first + wp.tid(), total, boxes, events, nodes, totals, tiles, to)
