"""The fill phase (Choi et al. 2010): copies each live node's triangles and events to its task (count, scan, fill), in sorted
order.

References: choi-2010.
"""

import warp as wp

from wrt.builders.core.subtrees import Task
from wrt.builders.kdtree.events.event_lists import EventLists
from wrt.builders.kdtree.events.event_sort import Events, event_position, event_value
from wrt.builders.kdtree.phases.membership import Membership, member, member_count
from wrt.kernels.layout.unchecked import load_int, store_int, store_pair
from wrt.kernels.runtime.options import exact_kernel


@exact_kernel
def count_task_triangles(first: int, size: int, triangles: int, membership: Membership, counts: wp.array2d(dtype=int)):
    """Item: a chunk of triangles. Counts its triangles per task. counts: (chunks, live nodes)."""
    chunk = first + wp.tid()
    row = counts[chunk]
    for task in range(counts.shape[1]):
        row[task] = 0
    for triangle in range(chunk * size, wp.min(triangles, (chunk + 1) * size)):
        own = load_int(membership.node, triangle)
        for m in range(member_count(membership, own)):
            row[member(membership, own, m)] += 1


@exact_kernel
def scan_columns(first: int, counts: wp.array2d(dtype=int), totals: wp.array(dtype=int)):
    """Item: a column. Turns its counts into `totals` and the counts before them, and adds them up there."""
    column = first + wp.tid()
    total = totals[column]
    for row in range(counts.shape[0]):
        here = counts[row, column]
        counts[row, column] = total
        total += here
    totals[column] = total


@exact_kernel
def fill_task_triangles(
    first: int,
    size: int,
    triangles: int,
    membership: Membership,
    tasks: wp.array(dtype=Task),
    before: wp.array2d(dtype=int),
    local: Membership,
    lists: EventLists,
):
    """Item: a chunk of triangles. Copies their ids.

    before: (chunks, tasks) triangles of each task in the chunks before; overwritten.
    local: the triangles' indices within their tasks, at the same places where `membership` holds the tasks. The counts at the
    head of each list in `Membership.shared` have no counterpart.
    """
    chunk = first + wp.tid()
    row = before[chunk]
    for triangle in range(chunk * size, wp.min(triangles, (chunk + 1) * size)):
        own = load_int(membership.node, triangle)
        for m in range(member_count(membership, own)):
            task = member(membership, own, m)
            index = row[task]
            row[task] = index + 1
            lists.triangle[tasks[task].triangles_first + index] = triangle
            if own >= 0:
                store_int(local.node, triangle, index)
            else:
                store_int(local.shared, ~own + 1 + m, index)


@wp.func
def local_index(local: Membership, own: int, triangle: int, number: int):
    """What `fill_task_triangles` wrote of a triangle in one of its tasks; own: its node in `membership`."""
    if own >= 0:
        return load_int(local.node, triangle)
    return load_int(local.shared, ~own + 1 + number)


@exact_kernel
def count_task_events(first: int, events: Events, membership: Membership, counts: wp.array3d(dtype=int)):
    """Item: axis * chunks + chunk. Counts its events per task. counts: (3, chunks, tasks)."""
    item = first + wp.tid()
    axis = item / counts.shape[1]
    chunk = item % counts.shape[1]
    row = counts[axis, chunk]
    for task in range(counts.shape[2]):
        row[task] = 0
    for i in range(chunk * events.chunk, wp.min(events.count[axis], (chunk + 1) * events.chunk)):
        own = load_int(membership.node, event_value(events, axis, i) >> 2)
        for m in range(member_count(membership, own)):
            row[member(membership, own, m)] += 1


@exact_kernel
def fill_task_events(
    first: int,
    events: Events,
    membership: Membership,
    local: Membership,
    places: wp.array3d(dtype=int),
    lists: EventLists,
):
    """Item: axis * chunks + chunk. Copies events to the tasks of their triangles."""
    item = first + wp.tid()
    axis = item / places.shape[1]
    chunk = item % places.shape[1]
    row = places[axis, chunk]
    for i in range(chunk * events.chunk, wp.min(events.count[axis], (chunk + 1) * events.chunk)):
        position = event_position(events, axis, i)
        value = event_value(events, axis, i)
        triangle = value >> 2
        own = load_int(membership.node, triangle)
        for m in range(member_count(membership, own)):
            task = member(membership, own, m)
            place = row[task]
            row[task] = place + 1
            index = local_index(local, own, triangle, m)
            store_pair(lists.event, place, wp.vec2i(wp.cast(position, wp.int32), (index << 2) | (value & 3)))
