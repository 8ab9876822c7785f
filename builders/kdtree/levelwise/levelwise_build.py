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

import numpy as np
import warp as wp

from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.kdtree.levelwise.cell_nodes import (
    INNER,
    LEFT,
    LISTED,
    NO_PLANE,
    RIGHT,
    SEARCHED_EACH,
    BuiltNodes,
    CellNode,
    Level,
    make_children,
    search_planes,
)
from wrt.builders.kdtree.levelwise.event_moves import EVENTS_EACH, Below, move_events
from wrt.builders.kdtree.levelwise.level_memory import LevelMemory
from wrt.builders.kdtree.levelwise.numbering import number, sum_sizes
from wrt.builders.kdtree.levelwise.paired_events import emit_pairs, sorted_pairs
from wrt.builders.tree import KdTree, Phases
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.kernels.runtime.launch import load
from wrt.kernels.runtime.workspace import give_back, take

KERNELS = (emit_pairs, search_planes, move_events, sum_sizes)
"""One kernel of each module."""

MAX_KEPT = 1 << 18
"""Triangles up to which a build's memory is kept for the next one: some 400 bytes each."""

LEAST_SHARE = 4
"""Triangles of the mesh for each element that an array has at least."""

EXPECTED = 1.25
"""Triangles of the next level for each of a level, for which there is room before their number is known. If they are more,
events are moved again."""

MAX_EVENTS = (1 << 31) - 1
"""Of a level: kernels number them by 32 bits."""

MAX_TRIANGLES = MAX_EVENTS // 12
"""Of a mesh: a sort has room for twice the events."""


def build(triangles: TriangleBoxes, config: KdTreeConfig) -> KdTree:
    """Builds the tree on the device that holds the boxes. The config does not clip.

    Raises:
        ValueError: a mesh has more than `MAX_TRIANGLES`, or a level more references to triangles than kernels number.
    """
    device, count = triangles.boxes.low.device, triangles.count
    check_count(count)
    load(KERNELS, device)
    phase = Phases(device)
    kind = build, device.alias, device.stream.cuda_stream if device.is_cuda else None  # others' kernels may use it still
    work = take(kind) or LevelMemory(device, min(count, MAX_KEPT) // LEAST_SHARE)
    with phase("sort"):
        sorted_pairs(triangles, work)
        triangles.check()  # waits for the corners while the device sorts
    with phase("levels"):
        built, made = split_levels(triangles, config, work)
    with phase("assemble"):
        built.size = work.room("size", made, wp.int64)
        built.size.zero_()
        nodes, primitive = number(built, made, config.cost.width)
    phase.stats.reserve(triangles.boxes.low, triangles.boxes.high, *work.arrays.values(), nodes, primitive)
    if count <= MAX_KEPT:
        give_back(kind, work)
    return KdTree(nodes, primitive, wp.vec3(*triangles.low), wp.vec3(*triangles.high), config.cost.width, phase.stats)


def check_count(count: int) -> None:
    """Refuses more triangles than kernels number, before anything is made for them; errors as `build`."""
    if count > MAX_TRIANGLES:
        raise ValueError(
            f"a mesh of {count:,} triangles, and a kd-tree built on CUDA takes {MAX_TRIANGLES:,} at most; take "
            "wrt.KdTree(builder='nested'), which is built on the CPU, or cut the mesh into several"
        )


def split_levels(triangles: TriangleBoxes, config: KdTreeConfig, work: LevelMemory) -> tuple[BuiltNodes, int]:
    """Splits level after level; returns all nodes, and how many they are."""
    device, grid, totals, (cost, limits) = work.device, work.grid, work.totals, config.rules(triangles)
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
        grid.run(search_planes, -(-6 * level.triangles // SEARCHED_EACH), [cost, level.triangles, events, nodes, keys])
        grow(built, work, level)
        children = work.room(f"nodes{there}", 2 * level.nodes, CellNode)
        child_keys = work.room(f"keys{there}", 2 * level.nodes, wp.int64)
        expected = min(int(EXPECTED * level.triangles), MAX_EVENTS // 6)
        threads = -(-6 * level.triangles // EVENTS_EACH)
        inputs = [
            cost,
            limits,
            level,
            events,
            keys,
            nodes,
            grid.tiles(level.nodes),
            children,
            child_keys,
            built,
            totals.found,
            totals.told,
        ]
        grid.run(make_children, level.nodes, inputs)
        totals.mark()
        to.event, to.listed = work.room(f"events{there}", 6 * expected, wp.vec4i), built.listed
        while True:
            inputs = [level.triangles, triangles.boxes, events, nodes, totals.found, grid.tiles(threads), to]
            grid.run(move_events, threads, inputs)
            found = totals.read()
            below = found[LEFT] + found[RIGHT]
            if 6 * below <= to.event.size:
                break
            if 6 * below > MAX_EVENTS:
                raise ValueError(
                    f"a level of the tree has {below:,} references to triangles, and kernels number {MAX_EVENTS // 6:,}; take "
                    "wrt.KdTree(builder='nested'), which is built on the CPU"
                )
            to.event = work.room(f"events{there}", 6 * below, wp.vec4i)
        level.first, level.listed, level.depth = level.first + level.nodes, level.listed + found[LISTED], level.depth + 1
        level.nodes, level.triangles, nodes, keys = 2 * found[INNER], below, children, child_keys
    return built, level.first


def grow(built: BuiltNodes, work: LevelMemory, level: Level) -> None:
    """Makes room for the nodes and the listed triangles of a level, and for the nodes of the next one."""
    made, listed = level.first + level.nodes, level.listed + level.triangles
    for name, wanted, dtype, keep in (
        ("node", made, wp.vec2i, level.first),
        ("parent", made + 2 * level.nodes, int, made),
        ("listed", listed, int, level.listed),
    ):
        array = work.room(name, wanted, dtype, keep)
        if getattr(built, name) is not array:
            setattr(built, name, array)
