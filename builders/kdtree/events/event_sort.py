"""Events of a sweep: the starts and ends of the triangles' boxes along each axis, sorted once for the whole build.

A box that is flat along an axis has one planar event there, any other box a start and an end. A start always precedes its end,
because extents that are not greater than 0, including NaN, count as flat wherever events are made. Events are sorted by
position. At equal positions ends come first, then planar events, then starts, and among these the smaller triangle id (Wald and
Havran 2006). A part of a sorted list is sorted: nodes need no sort, unless they clip (`clipped_events`).
"""

from typing import NamedTuple

import numpy as np
import warp as wp

from wrt.builders.radix_sort import sort_rows
from wrt.builders.triangle_boxes import Boxes, TriangleBoxes
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import exact_kernel

END = wp.constant(0)
PLANAR = wp.constant(1)
START = wp.constant(2)

SAME_KINDS = f"static_assert(wrt::END == {int(END)} && wrt::PLANAR == {int(PLANAR)} && wrt::START == {int(START)});\n"
"""C++ that compiles if native code has the same constants."""


class ItemSizes(NamedTuple):
    """Sizes of items of kernels; no result depends on them.

    Attributes:
        triangles: per chunk of the count before a scan.
        events: least number per item.
        counts: per block of the scan over chunks.
    """

    triangles: int
    events: int
    counts: int


SIZES = {False: ItemSizes(4096, 2048, 4096), True: ItemSizes(256, 256, 512)}
"""On the CPU, and on CUDA, where an item is a thread: with fewer items most of the device would wait
(notebooks/records/2026-11-27-gpu-builds.md)."""


def item_sizes(device: wp.Device) -> ItemSizes:
    """Those for a device."""
    return SIZES[device.is_cuda]


@wp.struct
class Events:
    """The sorted events of the three axes."""

    position: wp.array2d(dtype=float)
    """(3, capacity); only the first `count[axis]` of a row are in use."""
    value: wp.array2d(dtype=int)
    """(3, capacity): triangle << 2 | type."""
    count: wp.vec3i
    chunk: int
    """Events per item of a kernel; no result depends on it."""


@wp.func_native("return events.position.data[(size_t)axis * events.position.shape[1] + i];")
def event_position(events: Events, axis: int, i: int) -> float:
    """events.position[axis, i], without index checks: see `wrt.kernels.layout.unchecked`."""


@wp.func_native("return events.value.data[(size_t)axis * events.value.shape[1] + i];")
def event_value(events: Events, axis: int, i: int) -> int:
    """events.value[axis, i], without index checks."""


@exact_kernel
def count_planar(first: int, size: int, boxes: Boxes, triangles: int, counts: wp.array2d(dtype=int)):
    """Item: a chunk of triangles. Counts its planar events. counts: (3, chunks)."""
    chunk = first + wp.tid()
    for axis in range(3):
        planar = int(0)
        for i in range(chunk * size, wp.min(triangles, (chunk + 1) * size)):
            planar += wp.where(boxes.low[axis, i] < boxes.high[axis, i], 0, 1)
        counts[axis, chunk] = planar


@exact_kernel
def emit_events(
    first: int, size: int, boxes: Boxes, triangles: int, planar_before: wp.array2d(dtype=int), total: wp.vec3i, events: Events
):
    """Item: a chunk of triangles. Writes all ends, then all planar events, then all starts, each by triangle id."""
    chunk = first + wp.tid()
    for axis in range(3):
        begin = chunk * size
        planar = planar_before[axis, chunk]
        spread = begin - planar
        solid = triangles - total[axis]
        for i in range(begin, wp.min(triangles, (chunk + 1) * size)):
            low = boxes.low[axis, i]
            high = boxes.high[axis, i]
            if not (low < high):
                events.position[axis, solid + planar] = low
                events.value[axis, solid + planar] = (i << 2) | PLANAR
                planar += 1
            else:
                events.position[axis, spread] = high
                events.value[axis, spread] = (i << 2) | END
                events.position[axis, triangles + spread] = low
                events.value[axis, triangles + spread] = (i << 2) | START
                spread += 1


def sorted_events(triangles: TriangleBoxes) -> Events:
    """All events of the mesh, sorted."""
    boxes, count = triangles.boxes, triangles.count
    device = boxes.low.device
    sizes = item_sizes(device)
    chunks, size = -(-count // sizes.triangles), sizes.triangles
    counts = wp.empty((3, chunks), dtype=int, device=device)
    launch(count_planar, chunks, [size, boxes, count, counts], device=device, chunk=1)
    planar = counts.numpy()
    total = planar.sum(axis=1)
    before = wp.array(np.cumsum(planar, axis=1) - planar, dtype=int, device=device)
    events = Events()
    events.chunk = sizes.events
    events.position = wp.empty((3, 4 * count), dtype=float, device=device)
    events.value = wp.empty((3, 4 * count), dtype=int, device=device)
    events.count = wp.vec3i(*(int(2 * count - n) for n in total))
    launch(emit_events, chunks, [size, boxes, count, before, wp.vec3i(*map(int, total)), events], device=device, chunk=1)
    sort_rows(events.position, events.value, events.count)
    return events
