"""In-place parallel build of an SAH kd-tree (Choi et al. 2010) for a GPU: breadth first down to the leaves.

**Problem.** The in-place build (`wrt.builders.kdtree.in_place`) is made for tens of threads: each of them passes some thousand
events for all nodes of a level, and later builds a subtree alone. A GPU has 100,000 threads. A subtree by one of them takes
longer than all the rest, and passing a few events for all nodes is work of events times nodes.

**Algorithm.** That of the paper, level by level, but to the last level, and with the data in the order of the nodes: an event
knows its node and how many triangles of it begin before, so it is one thread's, and a level is three launches whatever its
nodes are.

**Data.** Two events of each triangle on each axis (`paired_events`), 16 bytes each, in one array of a level by axis, node and
position. The paper finds the nodes of an event by its triangle; here the events of a node lie together, and no list of a
triangle's nodes is needed.

**Phases.**

    sort        `sorted_pairs`
    levels      FindBestPlane: `search_planes`. NewGen: `make_children`. ClassifyTriangles and Fill: `move_events`
    assemble    `number`

The host reads four numbers of each level, which say how large the next one is, while the device moves its events.

**Complexity.** O(N log N) work: the sort, and O(1) for each event of a level.

**What we changed.** Events move, in order, because sums over the events of a node then are sums over neighbours. There are no
tasks. Counts, sums and minima do not depend on the order of threads, and costs are those of the same functions, so the tree is
that of the in-place build, node for node.

**Limits.** Triangles are not clipped. Two levels are in memory at a time, 96 bytes for each reference to a triangle in each.
What bounds a build of 200,000 triangles is half the host, which issues three launches a level, and half the passes over events
(notebooks/records/2026-11-28-gpu-graphs.md).

References: choi-2010; rahikainen-2013 (section 4.2, algorithm 4.2.2); merrill-garland-2016.
"""

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
    Level,
    make_children,
    search_planes,
)
from wrt.builders.kdtree.levelwise.event_moves import EVENTS_EACH, Below, move_events
from wrt.builders.kdtree.levelwise.grid_sums import Grid
from wrt.builders.kdtree.levelwise.numbering import number, sum_sizes
from wrt.builders.kdtree.levelwise.paired_events import emit_pairs, sorted_pairs
from wrt.builders.tree import KdTree, Phases
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.kernels.runtime.launch import load
from wrt.kernels.runtime.workspace import give_back, read_ints, take

KERNELS = (emit_pairs, search_planes, move_events, sum_sizes)
"""One kernel of each module."""

GROWTH = 1.5
"""How much larger than asked for an array is made that will be asked for again."""

LEAST_SHARE = 4
"""Triangles of the mesh for each element that an array has at least."""

MAX_EVENTS = (1 << 31) - 1
"""Of a level: kernels number them by 32 bits."""


def build(triangles: TriangleBoxes, config: KdTreeConfig) -> KdTree:
    """Builds the tree on the device that holds the boxes. The config does not clip."""
    device, count = triangles.boxes.low.device, triangles.count
    load(KERNELS, device)
    phase = Phases(device)
    work, grid = Room(device, count // LEAST_SHARE), Grid(device)
    with phase("sort"):
        sorted_pairs(triangles, grid, work.room("events0", 6 * count, wp.vec4i))
        triangles.check()  # waits for the corners while the device sorts
    with phase("levels"):
        built, made = split_levels(triangles, config, work, grid)
    with phase("assemble"):
        built.size = work.zeros("size", made, wp.int64)
        nodes, primitive = number(built, made, config.cost.width)
    phase.stats.reserve(triangles.boxes.low, triangles.boxes.high, *work.arrays.values(), nodes, primitive)
    return KdTree(nodes, primitive, wp.vec3(*triangles.low), wp.vec3(*triangles.high), config.cost.width, phase.stats)


class Room:
    """Arrays by name, made anew where they are too small.

    Args:
        device: where they are.
        least: elements of the smallest array.
    """

    def __init__(self, device: wp.Device, least: int) -> None:
        self.device, self.least = device, least
        self.arrays: dict[str, wp.array] = {}

    def room(self, name: str, count: int, dtype: Any, keep: int = 0) -> wp.array:
        """An array of at least `count` elements, of which the first `keep` are those that it had."""
        known = self.arrays.get(name)
        if known is not None and known.size >= count:
            return known
        made = self.arrays[name] = wp.empty(max(int(GROWTH * count), self.least), dtype=dtype, device=self.device)
        if known is not None and keep:
            wp.copy(made, known, count=keep)
        return made

    def zeros(self, name: str, count: int, dtype: Any) -> wp.array:
        """As `room`; a new array is of zeros."""
        known = self.arrays.get(name)
        made = self.room(name, count, dtype)
        if made is not known:
            made.zero_()
        return made


class Totals:
    """What a level's nodes sum up to, on the device, and read by the host while the device goes on."""

    def __init__(self, device: wp.Device) -> None:
        self.found = wp.empty(SUMS, dtype=int, device=device)
        self._read = wp.empty(SUMS, dtype=int, device="cpu", pinned=True) if device.is_cuda else self.found
        self._is_read = wp.Event(device) if device.is_cuda else None
        self._device = device

    def begin(self) -> None:
        """Begins to read them."""
        if self._is_read is not None:
            wp.copy(self._read, self.found)
            self._device.stream.record_event(self._is_read)

    def end(self) -> list[int]:
        """Waits for them."""
        if self._is_read is not None:
            wp.synchronize_event(self._is_read)
        return read_ints(self._read, SUMS)


def split_levels(triangles: TriangleBoxes, config: KdTreeConfig, work: Room, grid: Grid) -> tuple[BuiltNodes, int]:
    """Splits level after level; returns all nodes, and how many they are."""
    device, (cost, limits) = work.device, config.rules(triangles)
    kind = split_levels, device.alias
    totals = take(kind) or Totals(device)
    level = Level()
    level.nodes, level.triangles, level.depth, level.first, level.listed = 1, triangles.count, 0, 0, 0
    root = np.zeros(1, dtype=CellNode.numpy_dtype())
    root["low"], root["high"], root["triangles"] = triangles.low, triangles.high, triangles.count
    nodes = wp.array(root, dtype=CellNode, device=device)
    keys = wp.full(1, int(NO_PLANE), dtype=wp.int64, device=device)
    built = BuiltNodes()
    grow(built, work, level)
    built.parent[:1].fill_(-1)
    to = Below()
    while level.nodes:
        here, there = level.depth & 1, 1 - (level.depth & 1)
        events = work.arrays[f"events{here}"]
        grid.run(search_planes, 6 * level.triangles, [cost, level.triangles, events, nodes, keys])
        grow(built, work, level)
        children = work.room(f"nodes{there}", 2 * level.nodes, CellNode)
        child_keys = work.room(f"keys{there}", 2 * level.nodes, wp.int64)
        threads = -(-6 * level.triangles // EVENTS_EACH)
        inputs = [cost, limits, level, events, keys, nodes, grid.tiles(level.nodes), children, child_keys, built, totals.found]
        grid.run(make_children, level.nodes, inputs)
        totals.begin()
        to.event, to.listed = work.room(f"events{there}", 6 * level.triangles, wp.vec4i), built.listed
        while True:
            inputs = [level.triangles, triangles.boxes, events, nodes, totals.found, grid.tiles(threads), to]
            grid.run(move_events, threads, inputs)
            found = totals.end()
            below = found[LEFT] + found[RIGHT]
            if 6 * below <= to.event.size:
                break
            if 6 * below > MAX_EVENTS:
                raise ValueError(
                    f"a level of the tree has {below:,} references to triangles; kernels number {MAX_EVENTS // 6:,}"
                )
            to.event = work.room(f"events{there}", 6 * below, wp.vec4i)
        level.first, level.listed, level.depth = level.first + level.nodes, level.listed + found[LISTED], level.depth + 1
        level.nodes, level.triangles, nodes, keys = 2 * found[INNER], below, children, child_keys
    give_back(kind, totals)
    return built, level.first


def grow(built: BuiltNodes, work: Room, level: Level) -> None:
    """Makes room for the nodes and the listed triangles of a level, and for the nodes of the next one."""
    made, listed = level.first + level.nodes, level.listed + level.triangles
    for name, wanted, dtype, keep in (
        ("node", made, wp.vec2i, level.first),
        ("parent", made + 2 * level.nodes, int, made),
        ("listed", listed, int, level.listed),
    ):
        known = work.arrays.get(name)
        if known is None or known.size < wanted:
            setattr(built, name, work.room(name, wanted, dtype, keep))
