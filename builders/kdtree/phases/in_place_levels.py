"""The kernels of a level of the in-place build: all live nodes at once (Choi et al. 2010; `wrt.builders.core.levels`).

**Data.** Data does not move: events stay in their sorted order, and each triangle has a list of its nodes (`membership`).

**Phases.** A level takes four phases. Each is parallel over chunks of events or triangles, from the root on:

    search      FindBestPlane: every chunk counts, per live node, the triangles that begin and end in it; a scan over the
                chunks gives each chunk the counts before it; every chunk then evaluates its planes; the best of all chunks
                is the node's split
    stop, emit  NewGen: a node with a split gets two children, the others are finished
    partition   ClassifyTriangles: every triangle replaces its nodes by their children (`membership`)

Chunks begin where the position changes, so no plane is shared between chunks. The best plane among chunks is selected in the
order of the axes and positions.

**What we changed.** Most chunks are not searched, and the others only for nodes that may have their best plane there. The
counts before and behind a chunk bound the cost of all its planes from below. They also give the cost of a node's first plane in
each chunk. A chunk whose bound exceeds the least of these costs cannot contain a node's best plane (`may_contain_best`). A few
percent of the chunks remain (notebooks/records/2026-11-21-kdtree-builders.md).

References: choi-2010; rahikainen-2013 (algorithm 4.2.2).
"""

import warp as wp

from wrt.builders.core.levels import LiveNode, decided
from wrt.builders.cost import AxisFrame, SplitCost, axis_frame, no_split, plane_cost
from wrt.builders.kdtree.events.event_sort import Events, event_position, event_value
from wrt.builders.kdtree.events.sweep_planes import Sweep, close_planar, start_sweep, sweep_event
from wrt.builders.kdtree.phases.membership import Membership, member, member_count
from wrt.builders.tree import StopLimits
from wrt.kernels.layout.unchecked import load_int
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.simd.boxes import INFINITY

SLACK = 1.0 + 1e-5
"""Factor by which the bound of a chunk must exceed a known cost before the chunk is skipped: far more than rounding."""


@wp.func
def chunk_begin(events: Events, axis: int, chunk: int):
    """First event of a chunk: the nominal one, or the next one at which the position changes."""
    begin = wp.min(chunk * events.chunk, events.count[axis])
    while (
        begin > 0
        and begin < events.count[axis]
        and event_position(events, axis, begin) == event_position(events, axis, begin - 1)
    ):
        begin += 1
    return begin


@native.func_native(
    "events.h",
    "auto* of_node = counts.data + ((size_t)axis * counts.shape[1] + chunk) * counts.shape[2];\n"
    "const int* row = events.value.data + (size_t)axis * events.value.shape[1];\n"
    "wrt::count_events(row, begin, end, membership.node.data, membership.shared.data, of_node, counts.shape[2]);",
)
def count_range(
    events: Events,
    axis: int,
    chunk: int,
    begin: int,
    end: int,
    membership: Membership,
    counts: wp.array3d(dtype=wp.vec3i),
):
    """Counts, per live node, the triangles that begin and those that end among the events begin .. end - 1 of a chunk, and
    finds the node's first event there."""


@exact_kernel
def count_events(first: int, events: Events, membership: Membership, counts: wp.array3d(dtype=wp.vec3i)):
    """Item: axis * chunks + chunk.

    counts: (3, chunks, nodes) output: triangles that begin in the chunk, triangles that end, and the first event or -1."""
    item = first + wp.tid()
    axis = item / counts.shape[1]
    chunk = item % counts.shape[1]
    count_range(events, axis, chunk, chunk_begin(events, axis, chunk), chunk_begin(events, axis, chunk + 1), membership, counts)


@exact_kernel
def sum_blocks(first: int, block_chunks: int, counts: wp.array3d(dtype=wp.vec3i), sums: wp.array3d(dtype=wp.vec2i)):
    """Item: axis * blocks + block. Adds the counts of the block's chunks. sums: (3, blocks, nodes) output."""
    item = first + wp.tid()
    axis = item / sums.shape[1]
    block = item % sums.shape[1]
    row = sums[axis, block]
    for index in range(row.shape[0]):
        row[index] = wp.vec2i(0, 0)
    for chunk in range(block * block_chunks, wp.min(counts.shape[1], (block + 1) * block_chunks)):
        of_chunk = counts[axis, chunk]
        for index in range(row.shape[0]):
            here = of_chunk[index]
            row[index] = row[index] + wp.vec2i(here[0], here[1])


@exact_kernel
def scan_blocks(first: int, sums: wp.array3d(dtype=wp.vec2i)):
    """Item: axis * nodes + a live node. Turns the sums of blocks into the counts before them."""
    item = first + wp.tid()
    axis = item / sums.shape[2]
    index = item % sums.shape[2]
    total = wp.vec2i(0, 0)
    for block in range(sums.shape[1]):
        here = sums[axis, block, index]
        sums[axis, block, index] = total
        total += here


@exact_kernel
def scan_chunks(
    first: int,
    cost: SplitCost,
    events: Events,
    nodes: wp.array(dtype=LiveNode),
    block_chunks: int,
    counts: wp.array3d(dtype=wp.vec3i),
    before: wp.array3d(dtype=wp.vec2i),
    block_cost: wp.array3d(dtype=float),
):
    """Item: axis * blocks + block. Turns the counts of the block's chunks into the counts before them.

    before: (3, blocks, nodes) counts before the block; overwritten. block_cost: (3, blocks, nodes) output, the least cost of
    each node's first planes in the block's chunks."""
    item = first + wp.tid()
    axis = item / before.shape[1]
    block = item % before.shape[1]
    total = before[axis, block]
    min_costs = block_cost[axis, block]
    for index in range(total.shape[0]):
        min_costs[index] = INFINITY
    for chunk in range(block * block_chunks, wp.min(counts.shape[1], (block + 1) * block_chunks)):
        of_chunk = counts[axis, chunk]
        for index in range(total.shape[0]):
            so_far = total[index]
            here = of_chunk[index]
            of_chunk[index] = wp.vec3i(so_far[0], so_far[1], here[2])
            total[index] = so_far + wp.vec2i(here[0], here[1])
            if here[2] >= 0:
                node = nodes[index]
                position = event_position(events, axis, here[2])
                frame = node.frame
                if position > frame.low[axis] and position < frame.high[axis]:
                    along = axis_frame(cost, axis, frame.low, frame.high, frame.triangles)
                    # what ends there still counts as on the right: the plane costs no more than this
                    known = plane_cost(cost, along, position, so_far[0], frame.triangles - so_far[1])
                    min_costs[index] = wp.min(min_costs[index], known)


@exact_kernel
def min_of_blocks(first: int, block_cost: wp.array3d(dtype=float), min_known_cost: wp.array(dtype=float)):
    """Item: a live node. min_known_cost: (nodes,) output, its least cost of all blocks and axes."""
    index = first + wp.tid()
    min_cost = float(INFINITY)
    for axis in range(3):
        for block in range(block_cost.shape[1]):
            min_cost = wp.min(min_cost, block_cost[axis, block, index])
    min_known_cost[index] = min_cost


@wp.func
def may_contain_best(
    cost: SplitCost,
    along: AxisFrame,
    begin: float,
    end: float,
    left: int,
    right: int,
    known: float,
):
    """Whether a plane of a chunk may be a node's best. left triangles begin before the chunk, right ones end behind it, and its
    positions are begin .. end. known: the least cost of the node's first planes in the chunks. The bound is the least cost of a
    split of the node without the slab between these positions."""
    low = wp.max(begin, along.low)
    high = wp.min(end, along.high)
    thin = along
    thin.high = along.high - (high - low)
    return low <= high and not (plane_cost(cost, thin, low, left, right) > known * SLACK)


@wp.func
def sweep_chunk(
    cost: SplitCost,
    events: Events,
    axis: int,
    begin: int,
    end: int,
    membership: Membership,
    along: wp.array(dtype=AxisFrame),
    sweeps: wp.array(dtype=Sweep),
):
    """Evaluates the planes of the events begin .. end - 1 for each node that contains their triangles, except nodes whose frame
    is empty."""
    for i in range(begin, end):
        position = event_position(events, axis, i)
        value = event_value(events, axis, i)
        own = load_int(membership.node, value >> 2)
        for m in range(member_count(membership, own)):
            node = member(membership, own, m)
            if along[node].low <= along[node].high:
                sweep_event(cost, along[node], value & 3, position, sweeps[node])
    for node in range(sweeps.shape[0]):
        if along[node].low <= along[node].high:
            close_planar(cost, along[node], sweeps[node])


@exact_kernel
def search_planes(
    first: int,
    cost: SplitCost,
    events: Events,
    membership: Membership,
    nodes: wp.array(dtype=LiveNode),
    before: wp.array3d(dtype=wp.vec3i),
    min_known_cost: wp.array(dtype=float),
    frames: wp.array3d(dtype=AxisFrame),
    sweeps: wp.array3d(dtype=Sweep),
):
    """Item: axis * chunks + chunk.

    sweeps: (3, chunks, nodes) output, each node's best plane in the chunk, or none if the chunk cannot contain its best.
    frames: scratch of the same shape."""
    item = first + wp.tid()
    axis = item / before.shape[1]
    chunk = item % before.shape[1]
    row = sweeps[axis, chunk]
    along = frames[axis, chunk]
    begin = chunk_begin(events, axis, chunk)
    end = chunk_begin(events, axis, chunk + 1)
    any_candidate = bool(False)
    for index in range(before.shape[2]):
        node = nodes[index]
        triangles = node.frame.triangles
        counts = before[axis, chunk, index]
        ended = triangles
        if chunk + 1 < before.shape[1]:
            ended = before[axis, chunk + 1, index][1]
        row[index] = start_sweep(counts[0], triangles - counts[1])
        along[index] = axis_frame(cost, axis, node.frame.low, node.frame.high, triangles)
        is_candidate = bool(False)
        if not node.finished and begin < end:
            at = event_position(events, axis, begin)
            to = event_position(events, axis, end - 1)
            is_candidate = may_contain_best(cost, along[index], at, to, counts[0], triangles - ended, min_known_cost[index])
        if is_candidate:
            any_candidate = True
        else:
            along[index].low = INFINITY
            along[index].high = -INFINITY
    if any_candidate:
        sweep_chunk(cost, events, axis, begin, end, membership, along, row)


@exact_kernel
def keep_best(first: int, together: int, sweeps: wp.array3d(dtype=Sweep)):
    """Writes the best plane of a node in `together` chunks to the first of them.

    Item: (axis * blocks + block) * nodes + node."""
    item = first + wp.tid()
    index = item % sweeps.shape[2]
    blocks = (sweeps.shape[1] + together - 1) / together
    block = (item / sweeps.shape[2]) % blocks
    axis = item / sweeps.shape[2] / blocks
    begin = block * together
    best = sweeps[axis, begin, index].best
    for chunk in range(begin + 1, wp.min(begin + together, sweeps.shape[1])):
        candidate = sweeps[axis, chunk, index].best
        if candidate.cost < best.cost:
            best = candidate
    sweeps[axis, begin, index].best = best


@exact_kernel
def decide(
    first: int,
    together: int,
    cost: SplitCost,
    limits: StopLimits,
    sweeps: wp.array3d(dtype=Sweep),
    nodes: wp.array(dtype=LiveNode),
):
    """Item: a live node. Selects the best plane of all axes and chunks, in this order, and stops or splits.

    together: chunks whose best plane the first of them has."""
    index = first + wp.tid()
    node = nodes[index]
    if not node.finished:
        best = no_split()
        for axis in range(3):
            for block in range((sweeps.shape[1] + together - 1) / together):
                candidate = sweeps[axis, block * together, index].best
                if candidate.cost < best.cost:
                    best = candidate
        nodes[index] = decided(cost, limits, node, best)
