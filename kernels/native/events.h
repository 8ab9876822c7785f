// Events of an exact sweep, along an axis: starts and ends of boxes, and boxes that are flat (`wrt.builders.kdtree.events`).
//
// An event of a task is two words: the bits of its position, and the triangle's index in the task << 2 | kind.
#pragma once
#include "cost.h"
#include "reference.h"
#include "sorting.h"

namespace wrt {
namespace {

/// Kinds of events, in the order of a sweep.
constexpr int END = 0, PLANAR = 1, START = 2;

template <class Event> inline CUDA_CALLABLE void write_event(Event& to, float position, int index, int kind)
{
    to.c[0] = __builtin_bit_cast(int, position);
    to.c[1] = index << 2 | kind;
}

/// Writes the events of references along an axis, unsorted but those of a kind together; returns their number.
template <class Event> inline CUDA_CALLABLE int write_events(const float* from, int count, int axis, Event* const events)
{
    Event* to = events;
    for (int kind = END; kind <= START; ++kind)
        for (int i = 0; i < count; ++i) {
            const float low = from[(size_t)i * 8 + axis], high = -from[(size_t)i * 8 + 4 + axis] + 0.0f;
            const bool planar = !(low < high);
            if (planar == (kind == PLANAR)) write_event(*to++, kind == END ? high : low, i, kind);
        }
    return (int)(to - events);
}

/// Writes the events of references along an axis, each with the index in its id, one triangle after the other; returns their
/// number.
template <class Event> inline CUDA_CALLABLE int write_new_events(const float* from, int count, int axis, Event* const events)
{
    Event* to = events;
    for (int i = 0; i < count; ++i, from += 8) {
        const float low = from[axis], high = -from[4 + axis] + 0.0f;
        const int index = id_of(from);
        write_event(*to++, low, index, low < high ? START : PLANAR);
        if (low < high) write_event(*to++, high, index, END);
    }
    return (int)(to - events);
}

/// Stores an event as a side of a reference's box.
template <class Event> inline CUDA_CALLABLE void note_event(const Event& event, int axis, float* reference)
{
    const int kind = event.c[1] & 3;
    const float position = __builtin_bit_cast(float, event.c[0]);
    if (kind != END) reference[axis] = position;
    if (kind != START) reference[4 + axis] = -position;
    reference[3] = __builtin_bit_cast(float, (event.c[1] >> 2) + ID_OFFSET);
}

/// The least cost at the events of a range, none of which is of a planar triangle; see
/// `wrt.builders.kdtree.events.sweep_planes`. left, right: triangles that have begun before them, that have not ended before
/// them.
template <class Cost, class Frame, class Event, class BestPlane>
inline CUDA_CALLABLE void find_best_plane(
    const Cost& cost, const Frame& frame, const Event* events, int count, int left, int right, BestPlane& found)
{
    constexpr int W = 16;
    float best_cost[W];
    int block[W], blocks_left[W], blocks_right[W];
    WRT_FOR_LANES (j) {
        best_cost[j] = WRT_INFINITY;
        block[j] = 0;
        blocks_left[j] = 0;
        blocks_right[j] = 0;
    }
    for (int first = 0; first < count; first += W) {
        const Event* from = events + first;
        const int lanes = count - first < W ? count - first : W;
        float positions[W];
        int lefts[W], rights[W];
        const int block_left = left, block_right = right;
        for (int j = 0; j < lanes; ++j) {
            const int kind = from[j].c[1] & 3;
            positions[j] = __builtin_bit_cast(float, from[j].c[0]);
            right -= kind == END;
            lefts[j] = left;
            rights[j] = right;
            left += kind == START;
        }
        for (int j = lanes; j < W; ++j) {
            positions[j] = WRT_INFINITY;  // not inside
            lefts[j] = rights[j] = 1;
        }
        WRT_FOR_LANES (j) {
            const float candidate = plane_cost(cost, frame, positions[j], lefts[j], rights[j]);
            const bool better = (candidate < best_cost[j]) & (positions[j] > frame.low) & (positions[j] < frame.high);
            best_cost[j] = better ? candidate : best_cost[j];
            block[j] = better ? first : block[j];
            blocks_left[j] = better ? block_left : blocks_left[j];
            blocks_right[j] = better ? block_right : blocks_right[j];
        }
    }
    int best = 0;
    for (int j = 1; j < W; ++j)
        if (best_cost[j] < best_cost[best] || (best_cost[j] == best_cost[best] && block[j] < block[best])) best = j;
    found.cost = best_cost[best];
    found.event = block[best];
    found.left = blocks_left[best];
    found.right = blocks_right[best];
}

/// Counts, per live node, the triangles that begin and those that end among the events begin .. end - 1, and finds the node's
/// first event there. events: triangle << 2 | kind; node, shared: of `wrt.builders.kdtree.phases.membership`.
template <class Count>
inline CUDA_CALLABLE void count_events(
    const int* events, int begin, int end, const int* node, const int* shared, Count* of_node, int live)
{
    for (int i = 0; i < live; ++i) {
        of_node[i].c[0] = of_node[i].c[1] = 0;
        of_node[i].c[2] = -1;
    }
    for (int i = begin; i < end; ++i) {
        const int kind = events[i] & 3, own = node[events[i] >> 2];
        const int* const several = shared + ~own;
        const int* const nodes = own < 0 ? several + 1 : &own;
        const int members = own < 0 ? *several : 1;
        for (int m = 0; m < members; ++m) {
            Count& count = of_node[nodes[m]];
            count.c[0] += kind != END;
            count.c[1] += kind != START;
            if (count.c[2] < 0) count.c[2] = i;
        }
    }
}

}  // namespace
}  // namespace wrt
