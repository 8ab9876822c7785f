"""Events in pairs: each triangle has exactly two on each axis, one at which it begins and one at which it ends.

A box that is flat along an axis has both at one position. With such pairs the events of a node are twice its triangles on every
axis, so the place of a node's events follows from the triangles of the nodes before it, and the number of triangles that end
before an event from its place and the number of those that begin. Otherwise events are those of `event_sort`, in the same
order: by position, then END, PLANAR_BEGIN, PLANAR_END, START, then triangle.

The events of a level lie in one array: axis by axis, node by node, sorted.

References: wald-havran-2006.
"""

import warp as wp

from wrt.builders.kdtree.levelwise.grid_sums import Tiles, sums_before
from wrt.builders.kdtree.levelwise.level_memory import LevelMemory
from wrt.builders.triangle_boxes import Boxes, TriangleBoxes
from wrt.kernels.runtime import native
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import exact_kernel

END = wp.constant(0)
PLANAR_BEGIN = wp.constant(1)
PLANAR_END = wp.constant(2)
START = wp.constant(3)
"""Kinds of events; a triangle begins at those that are odd."""

CHUNK = 2048
"""On the CPU, triangles that are worth a chunk of their own."""


@wp.struct
class Event:
    """An event, as it is used; four words in memory."""

    position: float
    triangle: int
    kind: int
    node: int
    """Its node on the level."""
    axis: int
    begun: int
    """Triangles of its node that begin before it."""


@wp.func
def event_at(events: wp.array(dtype=wp.vec4i), i: int):
    """Event i of a level."""
    words = load_words(events, i)
    event = Event()
    event.position = wp.cast(words[0], wp.float32)
    event.triangle = words[1] >> 2
    event.kind = words[1] & 3
    event.node = words[2] >> 2
    event.axis = words[2] & 3
    event.begun = words[3]
    return event


@native.func_native("event_moves.h", "return wrt::load_four(events.data + i);")
def load_words(events: wp.array(dtype=wp.vec4i), i: int) -> wp.vec4i:
    """events[i], by one access to memory."""


@native.func_native("event_moves.h", "wrt::store_four(events.data + i, words);")
def store_words(events: wp.array(dtype=wp.vec4i), i: int, words: wp.vec4i):
    """events[i] = words, by one access to memory."""


@exact_kernel
def find_planar(first: int, triangles: int, boxes: Boxes, planar: wp.array(dtype=int)):
    """Item: a triangle. planar: (3 triangles + 1,) 1 where it is flat, axis by axis, and a 0."""
    i = first + wp.tid()
    for axis in range(3):
        planar[axis * triangles + i] = wp.where(boxes.low[axis, i] < boxes.high[axis, i], 0, 1)
    if i == 0:
        planar[3 * triangles] = 0


@exact_kernel
def emit_pairs(
    first: int,
    triangles: int,
    boxes: Boxes,
    planar: wp.array(dtype=int),
    position: wp.array(dtype=float),
    value: wp.array(dtype=int),
):
    """Item: a triangle. Writes its events where a stable sort by position needs them: kind by kind, by triangle.

    planar: sums of what `find_planar` wrote, before each place. position, value: (12 triangles,) output, a row of 4 for
    each axis, of which the sort needs a half; triangle << 2 | kind."""
    i = first + wp.tid()
    for axis in range(3):
        row = 4 * triangles * axis
        before = planar[axis * triangles + i] - planar[axis * triangles]
        flat = planar[(axis + 1) * triangles] - planar[axis * triangles]
        low = boxes.low[axis, i]
        high = boxes.high[axis, i]
        begin = triangles + flat + i - before
        end = i - before
        begin_kind = START
        end_kind = END
        if not (low < high):
            high = low
            begin = triangles - flat + before
            end = triangles + before
            begin_kind = PLANAR_BEGIN
            end_kind = PLANAR_END
        position[row + begin] = low
        value[row + begin] = (i << 2) | begin_kind
        position[row + end] = high
        value[row + end] = (i << 2) | end_kind


@exact_kernel
def make_first_level(
    first: int,
    triangles: int,
    position: wp.array(dtype=float),
    value: wp.array(dtype=int),
    tiles: Tiles,
    events: wp.array(dtype=wp.vec4i),
):
    """Item: an event, in one chunk. Writes it to the first level, whose only node has all of them."""
    i = first + wp.tid()
    axis = i / (2 * triangles)
    row = 4 * triangles * axis
    at = i - 2 * triangles * axis
    own = int(0)
    if axis < 3:
        own = value[row + at]
    before = sums_before(tiles, wp.vec4i(own & 1, 0, 0, 0))
    if axis < 3:
        words = wp.vec4i(wp.cast(position[row + at], wp.int32), own, axis, before[0] - axis * triangles)
        store_words(events, i, words)


def sorted_pairs(triangles: TriangleBoxes, work: LevelMemory) -> None:
    """Writes the events of the first level, "events0"."""
    boxes, count, device = triangles.boxes, triangles.count, work.device
    planar = work.room("planar", 3 * count + 1, int)
    launch(find_planar, count, [count, boxes, planar], device=device, chunk=CHUNK)
    wp.utils.array_scan(planar, planar, inclusive=False)
    position, value = (work.room(name, 12 * count, dtype) for name, dtype in (("position", float), ("value", int)))
    launch(emit_pairs, count, [count, boxes, planar, position, value], device=device, chunk=CHUNK)
    for axis in range(3):
        rows = slice(4 * count * axis, 4 * count * (axis + 1))
        wp.utils.radix_sort_pairs(position[rows], value[rows], 2 * count)
    inputs = [count, position, value, work.grid.tiles(6 * count), work.room("events0", 6 * count, wp.vec4i)]
    work.grid.run(make_first_level, 6 * count, inputs)
