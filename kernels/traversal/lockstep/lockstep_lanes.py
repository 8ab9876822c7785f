"""Simultaneous walks through a kd-tree: the lane loops of `wrt.kernels.traversal.lockstep.lockstep_kernel`
(`kernels/native/lockstep.h`).

Each of L lanes walks its own ray. Node, interval and ray are vectors over the lanes, so a step through inner nodes is a few
vector instructions, whatever nodes, axes and directions the lanes have. The formulas are those of `step_selecting` of
`wrt.kernels.traversal.single.single_kdtree`.

**The log.** A stack per lane, indexed by the lane's own size, would need a scatter for every vector that is written. Here all
lanes write to the same row, whether they have an entry to push or not, and the next step writes to the next row: plain stores.
The valid rows of a lane form a linked list, from the lane's `top` through the field `below`. When all rows are used, the linked
ones are moved to the front. No lane links more rows than the tree's depth, so at least half of the rows become free.

    log[((row * 4 + field) * L) + lane]    fields: far node, its entry, its leave (bits of float32), row below or -1
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.kdtree_nodes import MAX_TREE_DEPTH
from wrt.kernels.runtime import native
from wrt.kernels.simd.boxes import RaySlabs
from wrt.kernels.simd.lanes import lanes

ROWS = 2 * MAX_TREE_DEPTH
"""Number of rows of the log."""

FIELDS = 4
"""Fields per lane in a row."""


@cache
def walks(count: int) -> type:
    """The struct of `count` walks; a vector over the lanes for each number."""
    Floats = lanes(count)
    Ints = wp.types.vector(length=count, dtype=wp.int32)

    class Walks:
        inverse_x: Floats
        inverse_y: Floats
        inverse_z: Floats
        in_x: Floats
        in_y: Floats
        in_z: Floats
        out_x: Floats
        out_y: Floats
        out_z: Floats
        node: Ints
        entry: Floats
        leave: Floats
        best: Floats
        top: Ints
        word0: Ints
        word1: Ints
        nodes: Ints

    Walks.__doc__ = """The `RaySlabs` of the rays by component, and the state of the walks:

    node, entry, leave: current node, and the interval of t in which the ray may be inside it.
    best: t of the best hit so far; before the first hit t_max.
    top: row of the log with the next cell, -1 if there is none.
    word0, word1: words of the node; see `wrt.kernels.layout.kdtree_nodes`.
    nodes: number of inner nodes visited, if work is counted.
    """
    return wp.struct(Walks)


@cache
def lane_start(count: int) -> wp.Function:
    """`func(walks, lane, slabs, interval, t_max)`: places a ray at the root; `interval` is its interval in the scene's box."""
    Walks = walks(count)

    @native.func_native("lockstep.h", "wrt::start_walk(walks, lane, slabs, interval.c, t_max);")
    def start_lane(walks: wp.ref[Walks], lane: int, slabs: RaySlabs, interval: wp.vec2, t_max: float): ...

    return start_lane


@cache
def advance(count: int, counting: bool) -> wp.Function:
    """`func(nodes, walks, log, row, least) -> uint32`: steps until fewer than `least` lanes are at inner nodes, or the log is
    full.

    Returns the mask of the lanes at leaves; `row` is the next free row of the log.
    """
    Walks = walks(count)

    form = f"{count}, {ROWS}, {int(counting)}"

    @native.func_native("lockstep.h", f"return wrt::advance_walks<{form}>(nodes.data, walks, log.data, row, least);")
    def advance_lanes(
        nodes: wp.array(dtype=wp.vec2i), walks: wp.ref[Walks], log: wp.array(dtype=int), row: wp.ref[int], least: int
    ) -> wp.uint32: ...

    return advance_lanes


@cache
def skip_blocks(count: int, width: int) -> wp.Function:
    """`func(walks, blocks) -> uint32`: removes `blocks` blocks from the front of every leaf; returns the mask of leaves with
    triangles left.

    Results for lanes at inner nodes are undefined.
    """
    Walks = walks(count)

    @native.func_native("lockstep.h", f"return wrt::skip_leaf_blocks<{count}, {width}>(walks, blocks);")
    def skip_leaf_blocks(walks: wp.ref[Walks], blocks: int) -> wp.uint32: ...

    return skip_leaf_blocks


@cache
def pop(count: int) -> wp.Function:
    """`func(walks, log, at_leaf) -> uint32`: moves the lanes of the mask to the next cell in their log.

    Returns the mask of the lanes that have none. A cell whose entry lies beyond the best hit is dropped, and the interval of a
    visited cell is clipped to the best hit. Most lanes find their cell at the first attempt, in vectors; lanes that drop a cell
    continue one by one.
    """
    Walks = walks(count)

    @native.func_native("lockstep.h", f"return wrt::pop_walks<{count}>(walks, log.data, at_leaf);")
    def pop_lanes(walks: wp.ref[Walks], log: wp.array(dtype=int), at_leaf: wp.uint32) -> wp.uint32: ...

    return pop_lanes


@cache
def compact(count: int) -> wp.Function:
    """`func(walks, log) -> int`: moves the linked rows to the start of the log; returns the first free row.

    Rows are moved oldest first: the k-th oldest is in row k or later, so no row is overwritten before it is moved.
    """
    Walks = walks(count)

    @native.func_native("lockstep.h", f"return wrt::compact_log<{count}, {MAX_TREE_DEPTH}>(walks, log.data);")
    def compact_log(walks: wp.ref[Walks], log: wp.array(dtype=int)) -> int: ...

    return compact_log
