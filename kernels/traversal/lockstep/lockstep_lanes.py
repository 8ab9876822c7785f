"""Simultaneous walks through a kd-tree: the lane loops of `wrt.kernels.traversal.lockstep.lockstep_kernel`.

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
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.boxes import RaySlabs
from wrt.kernels.simd.lanes import lanes

exact_module(__name__)

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


_START = """
    walks.inverse_x.c[lane] = slabs.inverse.c[0];
    walks.inverse_y.c[lane] = slabs.inverse.c[1];
    walks.inverse_z.c[lane] = slabs.inverse.c[2];
    walks.in_x.c[lane] = slabs.origin_in.c[0];
    walks.in_y.c[lane] = slabs.origin_in.c[1];
    walks.in_z.c[lane] = slabs.origin_in.c[2];
    walks.out_x.c[lane] = slabs.origin_out.c[0];
    walks.out_y.c[lane] = slabs.origin_out.c[1];
    walks.out_z.c[lane] = slabs.origin_out.c[2];
    walks.node.c[lane] = 0;
    walks.entry.c[lane] = interval.c[0];
    walks.leave.c[lane] = interval.c[1];
    walks.best.c[lane] = t_max;
    walks.top.c[lane] = -1;
    walks.nodes.c[lane] = 0;
"""


@cache
def lane_start(count: int) -> wp.Function:
    """`func(walks, lane, slabs, interval, t_max)`: places a ray at the root; `interval` is its interval in the scene's box."""
    Walks = walks(count)

    @native.func_native("lanes.h", _START)
    def start_lane(walks: wp.ref[Walks], lane: int, slabs: RaySlabs, interval: wp.vec2, t_max: float): ...

    return start_lane


_ADVANCE = """
    const unsigned long long* pairs = (const unsigned long long*)nodes.data;
    alignas(64) float inverse_x[W], inverse_y[W], inverse_z[W], in_x[W], in_y[W], in_z[W], out_x[W], out_y[W], out_z[W];
    alignas(64) float entry[W], leave[W];
    alignas(64) int node[W], top[W], word0[W], word1[W], inner[W], steps[W];
    WRT_FOR_LANES(i) {
        inverse_x[i] = walks.inverse_x.c[i]; inverse_y[i] = walks.inverse_y.c[i]; inverse_z[i] = walks.inverse_z.c[i];
    }
    WRT_FOR_LANES(i) { in_x[i] = walks.in_x.c[i]; in_y[i] = walks.in_y.c[i]; in_z[i] = walks.in_z.c[i]; }
    WRT_FOR_LANES(i) { out_x[i] = walks.out_x.c[i]; out_y[i] = walks.out_y.c[i]; out_z[i] = walks.out_z.c[i]; }
    WRT_FOR_LANES(i) {
        entry[i] = walks.entry.c[i]; leave[i] = walks.leave.c[i];
        node[i] = walks.node.c[i]; top[i] = walks.top.c[i]; steps[i] = 0;
    }
    for (;;) {
        for (int i = 0; i < W; ++i) {
            unsigned long long pair = pairs[node[i]];
            word0[i] = (int)pair; word1[i] = (int)(pair >> 32);
        }
        int walking = 0;
        WRT_FOR_LANES(i) {
            inner[i] = (word1[i] & 3) != 3 ? -1 : 0;
            walking -= inner[i];
        }
        if (walking < least || row == ROWS) break;
        int* line = &log.data[row * (4 * W)];
        WRT_FOR_LANES(i) {
            int axis = word1[i] & 3, left = node[i] + 1, right = word1[i] >> 2;
            float position = wp::cast<float>(word0[i]), first = entry[i], last = leave[i];
            float inverse_0 = inverse_x[i], inverse_1 = inverse_y[i], inverse_2 = inverse_z[i];
            float in_0 = in_x[i], in_1 = in_y[i], in_2 = in_z[i];
            float out_0 = out_x[i], out_1 = out_y[i], out_2 = out_z[i];
            float inverse = axis == 0 ? inverse_0 : (axis == 1 ? inverse_1 : inverse_2);
            float origin_in = axis == 0 ? in_0 : (axis == 1 ? in_1 : in_2);
            float origin_out = axis == 0 ? out_0 : (axis == 1 ? out_1 : out_2);
            float before = (position - origin_out) * inverse, behind = (position - origin_in) * inverse;
            before = before < last ? before : last;
            behind = behind > first ? behind : first;
            int swap = (left ^ right) & (wp::cast<int>(inverse) >> 31);
            int near = left ^ swap, far = right ^ swap;
            bool step = inner[i] != 0, visit_near = first <= before;
            bool push = step & visit_near & (behind <= last), go_near = step & visit_near, go_far = step & !visit_near;
            line[i] = far;
            line[W + i] = wp::cast<int>(behind);
            line[2 * W + i] = wp::cast<int>(last);
            line[3 * W + i] = top[i];
            top[i] = push ? row : top[i];
            node[i] = step ? (visit_near ? near : far) : node[i];
            entry[i] = go_far ? behind : first;
            leave[i] = go_near ? before : last;
            if (COUNTING) steps[i] -= inner[i];
        }
        ++row;
    }
    unsigned at_leaf = 0;
    WRT_FOR_LANES(i) {
        walks.entry.c[i] = entry[i]; walks.leave.c[i] = leave[i]; walks.node.c[i] = node[i]; walks.top.c[i] = top[i];
        walks.word0.c[i] = word0[i]; walks.word1.c[i] = word1[i];
        if (COUNTING) walks.nodes.c[i] += steps[i];
        at_leaf |= inner[i] ? 0u : 1u << i;
    }
    return at_leaf;
"""


@cache
def advance(count: int, counting: bool) -> wp.Function:
    """`func(nodes, walks, log, row, least) -> uint32`: steps until fewer than `least` lanes are at inner nodes, or the log is
    full.

    Returns the mask of the lanes at leaves; `row` is the next free row of the log.
    """
    Walks = walks(count)

    @native.func_native(
        "lanes.h", f"    constexpr int W = {count}, ROWS = {ROWS}; constexpr bool COUNTING = {int(counting)};{_ADVANCE}"
    )
    def advance_lanes(
        nodes: wp.array(dtype=wp.vec2i), walks: wp.ref[Walks], log: wp.array(dtype=int), row: wp.ref[int], least: int
    ) -> wp.uint32: ...

    return advance_lanes


_SKIP_BLOCKS = """
    unsigned mask = 0;
    WRT_FOR_LANES(i) {
        walks.word0.c[i] += blocks;
        walks.word1.c[i] -= 4 * TRIANGLES * blocks;
        mask |= walks.word1.c[i] > 3 ? 1u << i : 0u;
    }
    return mask;
"""


@cache
def skip_blocks(count: int, width: int) -> wp.Function:
    """`func(walks, blocks) -> uint32`: removes `blocks` blocks from the front of every leaf; returns the mask of leaves with
    triangles left.

    Results for lanes at inner nodes are undefined.
    """
    Walks = walks(count)

    @native.func_native("lanes.h", f"    constexpr int W = {count}, TRIANGLES = {width};{_SKIP_BLOCKS}")
    def skip_leaf_blocks(walks: wp.ref[Walks], blocks: int) -> wp.uint32: ...

    return skip_leaf_blocks


_POP = """
    alignas(64) int top[W], node[W], waiting[W];
    alignas(64) float entry[W], leave[W], best[W];
    const int* fields = log.data;
    WRT_FOR_LANES(i) {
        waiting[i] = (at_leaf >> i & 1u) ? -1 : 0;
        top[i] = walks.top.c[i]; node[i] = walks.node.c[i]; best[i] = walks.best.c[i];
        entry[i] = walks.entry.c[i]; leave[i] = walks.leave.c[i];
    }
    unsigned dropped = 0;
    WRT_FOR_LANES(i) {
        int row = top[i], at = (row > 0 ? row : 0) * (4 * W) + i;
        int node_i = fields[at], below = fields[at + 3 * W];
        float entry_i = wp::cast<float>(fields[at + W]), leave_i = wp::cast<float>(fields[at + 2 * W]);
        leave_i = leave_i < best[i] ? leave_i : best[i];
        int there = waiting[i] & ~(row >> 31), take = there & (entry_i <= best[i] ? -1 : 0);
        float old_entry = entry[i], old_leave = leave[i];
        int old_node = node[i];
        node[i] = take ? node_i : old_node;
        entry[i] = take ? entry_i : old_entry;
        leave[i] = take ? leave_i : old_leave;
        top[i] = there ? below : row;
        waiting[i] &= ~take;
        dropped |= (there & ~take) ? 1u << i : 0u;
    }
    for (int i = 0; dropped; ++i, dropped >>= 1) {
        if (!(dropped & 1u)) continue;
        int row = top[i];
        while (row >= 0 && waiting[i]) {
            int at = row * (4 * W) + i;
            float entry_i = wp::cast<float>(fields[at + W]), leave_i = wp::cast<float>(fields[at + 2 * W]);
            if (entry_i <= best[i]) {
                node[i] = fields[at]; entry[i] = entry_i; leave[i] = leave_i < best[i] ? leave_i : best[i]; waiting[i] = 0;
            }
            row = fields[at + 3 * W];
        }
        top[i] = row;
    }
    unsigned done = 0;
    WRT_FOR_LANES(i) {
        walks.top.c[i] = top[i]; walks.node.c[i] = node[i]; walks.entry.c[i] = entry[i]; walks.leave.c[i] = leave[i];
        done |= waiting[i] ? 1u << i : 0u;
    }
    return done;
"""


@cache
def pop(count: int) -> wp.Function:
    """`func(walks, log, at_leaf) -> uint32`: moves the lanes of the mask to the next cell in their log.

    Returns the mask of the lanes that have none. A cell whose entry lies beyond the best hit is dropped, and the interval of a
    visited cell is clipped to the best hit. Most lanes find their cell at the first attempt, in vectors; lanes that drop a cell
    continue one by one.
    """
    Walks = walks(count)

    @native.func_native("lanes.h", f"    constexpr int W = {count};{_POP}")
    def pop_lanes(walks: wp.ref[Walks], log: wp.array(dtype=int), at_leaf: wp.uint32) -> wp.uint32: ...

    return pop_lanes


_COMPACT = """
    int used = 0;
    for (int i = 0; i < W; ++i) {
        int rows[DEPTH], size = 0;
        for (int row = walks.top.c[i]; row >= 0; row = log.data[(row * 4 + 3) * W + i]) rows[size++] = row;
        for (int k = 0; k < size; ++k) {
            const int* from = &log.data[rows[size - 1 - k] * (4 * W) + i];
            int* to = &log.data[k * (4 * W) + i];
            to[0] = from[0]; to[W] = from[W]; to[2 * W] = from[2 * W]; to[3 * W] = k - 1;
        }
        walks.top.c[i] = size - 1;
        used = size > used ? size : used;
    }
    return used;
"""


@cache
def compact(count: int) -> wp.Function:
    """`func(walks, log) -> int`: moves the linked rows to the start of the log; returns the first free row.

    Rows are moved oldest first: the k-th oldest is in row k or later, so no row is overwritten before it is moved.
    """
    Walks = walks(count)

    @native.func_native("lanes.h", f"    constexpr int W = {count}, DEPTH = {MAX_TREE_DEPTH};{_COMPACT}")
    def compact_log(walks: wp.ref[Walks], log: wp.array(dtype=int)) -> int: ...

    return compact_log
