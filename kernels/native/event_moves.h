// Events of a level of a kd-tree to the children of their nodes (wrt.builders.kdtree.levelwise.event_moves).
#pragma once
#include "grid_sums.h"

namespace wrt {
namespace {

/// Events of a thread, those of a warp's threads in turns: neighbours read and write neighbours.
constexpr int EVENTS_EACH = 8;

/// Four words by one access to memory on CUDA.
template <class Words> inline CUDA_CALLABLE Words load_four(const Words* from)
{
#if defined(__CUDA_ARCH__)
    const int4 found = *(const int4*)from;
    Words words;
    words.c[0] = found.x, words.c[1] = found.y, words.c[2] = found.z, words.c[3] = found.w;
    return words;
#else
    return *from;
#endif
}

template <class Words> inline CUDA_CALLABLE void store_four(Words* to, const Words& words)
{
#if defined(__CUDA_ARCH__)
    *(int4*)to = make_int4(words.c[0], words.c[1], words.c[2], words.c[3]);
#else
    *to = words;
#endif
}

/// The children that a triangle goes to: 1 left, 2 right, 3 both; as `wrt.builders.core.levels.side_of`.
template <class Split> inline CUDA_CALLABLE int side_of(const Split& split, float low, float high)
{
    if (!(low < high) && low == split.position) return split.planar_left ? 1 : 2;
    return (low < split.position ? 1 : 0) + (high > split.position ? 2 : 0);
}

/// Moves the events of a thread. boxes: low and high of triangles, axis by axis; totals: the level's sums of left and of right
/// triangles are its second and third.
template <class Words, class Node>
inline CUDA_CALLABLE void move_events(int thread, int count, const float* low, const float* high, size_t row,
    const Words* events, const Node* nodes, const int* totals, Tile* tiles, int turn, Words* moved, int room, int* listed)
{
    const int lanes = warp_lanes(), first = (thread - warp_lane()) * EVENTS_EACH + warp_lane();
    unsigned sides = 0;
    Sums own = {};
    for (int k = 0; k < EVENTS_EACH; ++k) {
        const int i = first + k * lanes;
        int side = 0, begins = 0;
        if (i < count) {
            const Words words = load_four(events + i);
            const Node& node = nodes[words.c[2] >> 2];
            const int triangle = words.c[1] >> 2;
            begins = words.c[1] & 1;
            if (!node.is_leaf) {
                const size_t at = node.split.axis * row + triangle;
                side = side_of(node.split, low[at], high[at]);
            } else if (begins && (words.c[2] & 3) == 0) listed[node.child + words.c[3]] = triangle;
        }
        sides |= (unsigned)side << 2 * k;
        own.of[0] += count_votes(vote(side & 1));
        own.of[1] += count_votes(vote(side & 2));
        own.of[2] += count_votes(vote(side & begins));
        own.of[3] += count_votes(vote(side >> 1 & begins));
    }
    Sums before = sums_of_warps_before(tiles, turn, own);
    const int lefts = totals[1], rights = totals[2];
    for (int k = 0; k < EVENTS_EACH; ++k) {
        const int i = first + k * lanes, side = sides >> 2 * k & 3;
        Words words = {};
        if (side) words = load_four(events + i);
        const int begins = words.c[1] & 1, axis = words.c[2] & 3;
        const unsigned to_left = vote(side & 1), to_right = vote(side & 2);
        const unsigned left_begun = vote(side & begins), right_begun = vote(side >> 1 & begins);
        if (side) {
            const Node& node = nodes[words.c[2] >> 2];
            const int left_first = axis * lefts + node.left_before, right_first = axis * rights + node.right_before;
            const int left = 2 * right_first + before.of[0] + votes_before(to_left);
            const int right = 2 * (left_first + node.split.left) + before.of[1] + votes_before(to_right);
            words.c[2] = node.child << 2 | axis;
            words.c[3] = before.of[2] + votes_before(left_begun) - left_first;
            if (side & 1 && (unsigned)left < (unsigned)room) store_four(moved + left, words);
            words.c[2] = (node.child + 1) << 2 | axis;
            words.c[3] = before.of[3] + votes_before(right_begun) - right_first;
            if (side & 2 && (unsigned)right < (unsigned)room) store_four(moved + right, words);
        }
        before.of[0] += count_votes(to_left);
        before.of[1] += count_votes(to_right);
        before.of[2] += count_votes(left_begun);
        before.of[3] += count_votes(right_begun);
    }
}

}  // namespace
}  // namespace wrt
