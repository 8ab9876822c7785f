"""In-place parallel build of an SAH kd-tree (Choi et al. 2010) for a GPU: breadth first down to the leaves.

**Problem.** The in-place build (`wrt.builders.kdtree.in_place`) is made for tens of threads: each of them passes some thousand
events for all nodes of a level, and later builds a subtree alone. A GPU has 100,000 threads. A subtree by a thread alone takes
longer than the rest, and passing a few events for all nodes is work of events times nodes.

**Algorithm.** That of the paper, level by level, but to the last level, and with the data in the order of the nodes: an event
knows its node and how many triangles of it have begun, a thread takes a few events, and a level is a fixed number of launches
whatever its nodes are.

**Data.** Two events of each triangle on each axis (`paired_events`), 16 bytes each, on every level in one array by axis, node
and position. So events are not found by their triangles' nodes, as in the paper, but next to each other; and no list of a
triangle's nodes is needed.

**Phases.**

    sort        `sorted_pairs`
    levels      FindBestPlane: `search_planes`. NewGen: `decide`, a scan over nodes, `make_children`. ClassifyTriangles:
                `count_sides`. Fill: a scan over items, `move_events`
    assemble    `number`

The host reads four numbers of each level: they say how large the next one is.

**Complexity.** O(N log N) work: the sort, and O(1) for each event of a level. A level is O(log N) steps, by its scans.

**What we changed.** Events move, in order, because sums over the events of a node then are sums over neighbours. There are no
tasks. Counts, sums and minima do not depend on the order of threads, and costs are those of the same functions, so the tree is
that of the in-place build, node for node.

**Limits.** Triangles are not clipped. Two levels are in memory at a time, 192 bytes for each triangle of each.

References: choi-2010; zagha-blelloch-1991.
"""

from functools import partial
from typing import Any

import numpy as np
import warp as wp

from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.kdtree.levelwise.cell_nodes import (
    INNER,
    LEFT,
    LISTED,
    NO_PLANE,
    RIGHT,
    SUMS,
    BuiltNodes,
    CellNode,
    decide,
    make_children,
    search_planes,
)
from wrt.builders.kdtree.levelwise.event_moves import PARTS, count_sides, move_events
from wrt.builders.kdtree.levelwise.numbering import number, sum_sizes
from wrt.builders.kdtree.levelwise.paired_events import ITEM_CHUNK, emit_pairs, items_of, sorted_pairs
from wrt.builders.tree import KdTree, Phases
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.kernels.runtime.launch import launch, load

KERNELS = (emit_pairs, search_planes, move_events, sum_sizes)
"""One kernel of each module."""

NODE_CHUNK = 256
"""On the CPU, nodes that are worth a chunk of their own."""

GROWTH = 1.5
"""How much larger than asked for an array is made that will be asked for again."""


def build(triangles: TriangleBoxes, config: KdTreeConfig) -> KdTree:
    """Builds the tree on the device that holds the boxes. The config does not clip."""
    device = triangles.boxes.low.device
    load(KERNELS, device)
    phase = Phases(device)
    work = Room(device)
    events = work.room("events0", 6 * triangles.count, wp.vec4i)
    with phase("sort"):
        sorted_pairs(triangles, events)
    with phase("levels"):
        built, count = split_levels(triangles, config, work)
    with phase("assemble"):
        nodes, primitive = number(built, count, config.cost.width)
    phase.stats.reserve(triangles.boxes.low, triangles.boxes.high, *work.arrays.values(), nodes, primitive)
    return KdTree(nodes, primitive, wp.vec3(*triangles.low), wp.vec3(*triangles.high), config.cost.width, phase.stats)


class Room:
    """Arrays by name, made anew where they are too small.

    Args:
        device: where they are.
    """

    def __init__(self, device: wp.Device) -> None:
        self.device = device
        self.arrays: dict[str, wp.array] = {}

    def room(self, name: str, count: int, dtype: Any, keep: int = 0) -> wp.array:
        """An array of at least `count` elements, of which the first `keep` are those that it had."""
        known = self.arrays.get(name)
        if known is None or known.size < count:
            made = self.arrays[name] = wp.empty(int(GROWTH * count) + 64, dtype=dtype, device=self.device)
            if known is not None and keep:
                wp.copy(made, known, count=keep)
        return self.arrays[name]


def split_levels(triangles: TriangleBoxes, config: KdTreeConfig, work: Room) -> tuple[BuiltNodes, int]:
    """Splits level after level; returns all nodes, and how many they are."""
    device, (cost, limits) = work.device, config.rules(triangles)
    run = partial(launch, device=device)
    count, total, depth, first, listed = 1, triangles.count, 0, 0, 0
    root = np.zeros(1, dtype=CellNode.numpy_dtype())
    root["low"], root["high"], root["triangles"] = triangles.low, triangles.high, total
    nodes = wp.array(root, dtype=CellNode, device=device)
    keys = wp.full(1, int(NO_PLANE), dtype=wp.int64, device=device)
    totals = wp.empty(SUMS, dtype=int, device=device)
    built = BuiltNodes()
    grow(built, work, (0, 0), (1 + total, total))
    built.parent[:1].fill_(-1)
    while count:
        events = work.arrays[f"events{depth & 1}"]
        run(search_planes, items_of(6 * total), [cost, total, events, nodes, keys], chunk=ITEM_CHUNK)
        sums = work.room("sums", SUMS * count + 1, int)[: SUMS * count + 1]
        run(decide, count, [cost, limits, depth, total, events, nodes, keys, sums, count], chunk=NODE_CHUNK)
        wp.utils.array_scan(sums, sums, inclusive=False)
        grow(built, work, (first + count, listed), (first + 3 * count, listed + total))
        children = work.room(f"nodes{depth & 1}", 2 * count, CellNode)
        keys = work.room("keys", 2 * count, wp.int64)
        inputs = [count, sums, wp.vec3i(first, first + count, listed), nodes, children, keys, built, totals]
        run(make_children, count, inputs, chunk=NODE_CHUNK)
        items = items_of(6 * total)
        sides = work.room("sides", items, int)
        counts = work.room("counts", PARTS * items, int)[: PARTS * items]
        run(count_sides, items, [items, total, triangles.boxes, events, nodes, sides, counts], chunk=ITEM_CHUNK)
        wp.utils.array_scan(counts, counts, inclusive=False)
        found = totals.numpy()
        moved = work.room(f"events{1 - (depth & 1)}", 6 * int(found[LEFT] + found[RIGHT]), wp.vec4i)
        inputs = [items, total, events, nodes, totals, sides, counts, moved, built.listed]
        run(move_events, items, inputs, chunk=ITEM_CHUNK)
        first, listed, depth = first + count, listed + int(found[LISTED]), depth + 1
        count, total, nodes = 2 * int(found[INNER]), int(found[LEFT] + found[RIGHT]), children
    return built, first


def grow(built: BuiltNodes, work: Room, used: tuple[int, int], wanted: tuple[int, int]) -> None:
    """Makes room for so many nodes and listed triangles; used: those that there are."""
    had = 0 if built.size is None else built.size.size
    built.node = work.room("node", wanted[0], wp.vec2i, used[0])
    built.parent = work.room("parent", wanted[0], int, used[0])
    built.size = work.room("size", wanted[0], wp.int64)
    built.listed = work.room("listed", wanted[1], int, used[1])
    if built.size.size > had:
        built.size.zero_()
