// Simultaneous walks through a kd-tree, one in each of W lanes (wrt.kernels.traversal.lockstep.lockstep_kernel, which describes
// the struct of the walks and the log).
#pragma once
#include "lanes.h"

namespace wrt {
namespace {

/// Places the ray of a lane at the root; interval: its interval in the scene's box.
template <class Walks, class Slabs>
inline CUDA_CALLABLE void start_walk(Walks& walks, int lane, const Slabs& slabs, const float* interval, float t_max)
{
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
    walks.entry.c[lane] = interval[0];
    walks.leave.c[lane] = interval[1];
    walks.best.c[lane] = t_max;
    walks.top.c[lane] = -1;
    walks.nodes.c[lane] = 0;
}

/// A float of each lane by the axis of the lane, by selects.
inline CUDA_CALLABLE float by_axis(int axis, float x, float y, float z) { return axis == 0 ? x : (axis == 1 ? y : z); }

/// What a step does with its rays' intervals: the two halves of an interval at a plane, and the order of the children.
struct PlaneStep {
    float before, behind;
    int near, far;
};

/// left: the lower child; right: the upper one.
inline CUDA_CALLABLE PlaneStep step_at(
    float position, float inverse, float in, float out, float first, float last, int left, int right)
{
    float before = (position - out) * inverse, behind = (position - in) * inverse;
    before = before < last ? before : last;
    behind = behind > first ? behind : first;
    const int swap = (left ^ right) & (__builtin_bit_cast(int, inverse) >> 31);
    return {before, behind, left ^ swap, right ^ swap};
}

/// Steps until fewer than `min_walking` lanes are at inner nodes, or the ROWS of the log are full; returns the bits of the
/// lanes at leaves. row: the next free row of the log.
template <int W, int ROWS, bool COUNTING, class Node, class Walks>
inline CUDA_CALLABLE unsigned advance_walks(const Node* nodes, Walks& walks, int* log, int& row, int min_walking)
{
    const unsigned long long* pairs = (const unsigned long long*)nodes;
    alignas(64) float inverse_x[W], inverse_y[W], inverse_z[W], in_x[W], in_y[W], in_z[W], out_x[W], out_y[W], out_z[W];
    alignas(64) float entry[W], leave[W];
    alignas(64) int node[W], top[W], word0[W], word1[W], inner[W], steps[W];
    WRT_FOR_LANES (i) {
        inverse_x[i] = walks.inverse_x.c[i], inverse_y[i] = walks.inverse_y.c[i], inverse_z[i] = walks.inverse_z.c[i];
    }
    WRT_FOR_LANES (i) {
        in_x[i] = walks.in_x.c[i], in_y[i] = walks.in_y.c[i], in_z[i] = walks.in_z.c[i];
    }
    WRT_FOR_LANES (i) {
        out_x[i] = walks.out_x.c[i], out_y[i] = walks.out_y.c[i], out_z[i] = walks.out_z.c[i];
    }
    WRT_FOR_LANES (i) {
        entry[i] = walks.entry.c[i], leave[i] = walks.leave.c[i];
        node[i] = walks.node.c[i], top[i] = walks.top.c[i], steps[i] = 0;
    }
    for (;;) {
        for (int i = 0; i < W; ++i) {
            const unsigned long long pair = pairs[node[i]];
            word0[i] = (int)pair, word1[i] = (int)(pair >> 32);
        }
        int walking = 0;
        WRT_FOR_LANES (i) {
            inner[i] = (word1[i] & 3) != 3 ? -1 : 0;
            walking -= inner[i];
        }
        if (walking < min_walking || row == ROWS) break;
        int* line = log + row * (4 * W);
        WRT_FOR_LANES (i) {
            const int axis = word1[i] & 3;
            const float first = entry[i], last = leave[i];
            const float inverse = by_axis(axis, inverse_x[i], inverse_y[i], inverse_z[i]);
            const float in = by_axis(axis, in_x[i], in_y[i], in_z[i]), out = by_axis(axis, out_x[i], out_y[i], out_z[i]);
            const PlaneStep own
                = step_at(__builtin_bit_cast(float, word0[i]), inverse, in, out, first, last, node[i] + 1, word1[i] >> 2);
            const bool step = inner[i] != 0, visit_near = first <= own.before;
            const bool push = step & visit_near & (own.behind <= last);
            const bool go_near = step & visit_near, go_far = step & !visit_near;
            line[i] = own.far;
            line[W + i] = __builtin_bit_cast(int, own.behind);
            line[2 * W + i] = __builtin_bit_cast(int, last);
            line[3 * W + i] = top[i];
            top[i] = push ? row : top[i];
            node[i] = step ? (visit_near ? own.near : own.far) : node[i];
            entry[i] = go_far ? own.behind : first;
            leave[i] = go_near ? own.before : last;
            if (COUNTING) steps[i] -= inner[i];
        }
        ++row;
    }
    unsigned at_leaf = 0;
    WRT_FOR_LANES (i) {
        walks.entry.c[i] = entry[i], walks.leave.c[i] = leave[i], walks.node.c[i] = node[i], walks.top.c[i] = top[i];
        walks.word0.c[i] = word0[i], walks.word1.c[i] = word1[i];
        if (COUNTING) walks.nodes.c[i] += steps[i];
        at_leaf |= inner[i] ? 0u : 1u << i;
    }
    return at_leaf;
}

/// Removes `blocks` blocks of TRIANGLES from the front of every leaf; returns the bits of the leaves with triangles left.
template <int W, int TRIANGLES, class Walks> inline CUDA_CALLABLE unsigned skip_leaf_blocks(Walks& walks, int blocks)
{
    unsigned mask = 0;
    WRT_FOR_LANES (i) {
        walks.word0.c[i] += blocks;
        walks.word1.c[i] -= 4 * TRIANGLES * blocks;
        mask |= walks.word1.c[i] > 3 ? 1u << i : 0u;
    }
    return mask;
}

/// Moves the lanes of a mask to the next cell in their log, without cells behind their best hits; returns the bits of the lanes
/// that have none. Most find it at the first attempt, in vectors; lanes that drop a cell continue one by one.
template <int W, class Walks> inline CUDA_CALLABLE unsigned pop_walks(Walks& walks, const int* fields, unsigned at_leaf)
{
    alignas(64) int top[W], node[W], waiting[W];
    alignas(64) float entry[W], leave[W], best[W];
    WRT_FOR_LANES (i) {
        waiting[i] = (at_leaf >> i & 1u) ? -1 : 0;
        top[i] = walks.top.c[i], node[i] = walks.node.c[i], best[i] = walks.best.c[i];
        entry[i] = walks.entry.c[i], leave[i] = walks.leave.c[i];
    }
    unsigned dropped = 0;
    WRT_FOR_LANES (i) {
        const int row = top[i], at = (row > 0 ? row : 0) * (4 * W) + i;
        const int node_i = fields[at], below = fields[at + 3 * W];
        const float entry_i = __builtin_bit_cast(float, fields[at + W]);
        float leave_i = __builtin_bit_cast(float, fields[at + 2 * W]);
        leave_i = leave_i < best[i] ? leave_i : best[i];
        const int there = waiting[i] & ~(row >> 31), take = there & (entry_i <= best[i] ? -1 : 0);
        const float old_entry = entry[i], old_leave = leave[i];
        const int old_node = node[i];
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
            const int at = row * (4 * W) + i;
            const float entry_i = __builtin_bit_cast(float, fields[at + W]);
            const float leave_i = __builtin_bit_cast(float, fields[at + 2 * W]);
            if (entry_i <= best[i]) {
                node[i] = fields[at], entry[i] = entry_i, leave[i] = leave_i < best[i] ? leave_i : best[i];
                waiting[i] = 0;
            }
            row = fields[at + 3 * W];
        }
        top[i] = row;
    }
    unsigned done = 0;
    WRT_FOR_LANES (i) {
        walks.top.c[i] = top[i], walks.node.c[i] = node[i], walks.entry.c[i] = entry[i], walks.leave.c[i] = leave[i];
        done |= waiting[i] ? 1u << i : 0u;
    }
    return done;
}

/// Moves the linked rows to the start of the log; returns the first free row. Rows are moved oldest first: the k-th oldest is
/// in row k or later, so no row is overwritten before it is moved.
template <int W, int DEPTH, class Walks> inline CUDA_CALLABLE int compact_log(Walks& walks, int* log)
{
    int used = 0;
    for (int i = 0; i < W; ++i) {
        int rows[DEPTH], size = 0;
        for (int row = walks.top.c[i]; row >= 0; row = log[(row * 4 + 3) * W + i]) rows[size++] = row;
        for (int k = 0; k < size; ++k) {
            const int* from = log + rows[size - 1 - k] * (4 * W) + i;
            int* to = log + k * (4 * W) + i;
            to[0] = from[0], to[W] = from[W], to[2 * W] = from[2 * W], to[3 * W] = k - 1;
        }
        walks.top.c[i] = size - 1;
        used = size > used ? size : used;
    }
    return used;
}

}  // namespace
}  // namespace wrt
