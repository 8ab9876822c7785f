// The upper levels of a merged tree, made anew from the root down (wrt.builders.bvh.phases.parallel_reinsertion): by one block
// of threads on CUDA, by one thread on the CPU. Both do the same operations on the same numbers.
#pragma once
#include "reinsertion.h"

namespace wrt {
namespace {

/// Subtrees that the upper levels end at.
constexpr int MAX_SUBTREES = 128;

/// Calls a function with 0 .. count - 1; on CUDA, by all threads of the block, which then wait for each other.
template <class Function> inline CUDA_CALLABLE void for_all(int count, Function&& call)
{
#if defined(__CUDA_ARCH__)
    for (int i = threadIdx.x; i < count; i += blockDim.x) call(i);
    __syncthreads();
#else
    for (int i = 0; i < count; ++i) call(i);
#endif
}

/// Replaces a number of the block by a greater one.
inline CUDA_CALLABLE void raise_int(int* at, int value)
{
#if defined(__CUDA_ARCH__)
    atomicMax(at, value);
#else
    if (*at < value) *at = value;
#endif
}

/// Replaces a number of the block by a smaller one.
inline CUDA_CALLABLE void lower(unsigned long long* at, unsigned long long value)
{
#if defined(__CUDA_ARCH__)
    atomicMin(at, value);
#else
    if (value < *at) *at = value;
#endif
}

/// A number that is not finite, or not a number at all, counts as the greatest that is.
inline CUDA_CALLABLE float finite(float value) { return value <= 3.402823466e38f ? value : 3.402823466e38f; }

/// What threads share. Places are those in the order of the subtrees; nodes that are being divided have a range of places.
struct TopLevels {
    LinkedBox box[MAX_SUBTREES];
    float area[MAX_SUBTREES];  // -1: of a triangle
    int node[MAX_SUBTREES], size[MAX_SUBTREES], rank[MAX_SUBTREES];
    int inner[MAX_SUBTREES];  // the nodes above the subtrees
    float area_before[MAX_SUBTREES], area_after[MAX_SUBTREES];  // theirs
    int inner_link[MAX_SUBTREES], subtree_link[MAX_SUBTREES];  // where they are to be linked
    int order[2][MAX_SUBTREES], begin[2][MAX_SUBTREES];  // by place: a subtree, the first place of its range
    int end[2][MAX_SUBTREES], link[2][MAX_SUBTREES];  // by the first place of a range: its end, and where its node is linked
    unsigned long long best[MAX_SUBTREES];  // likewise, the best plane
    int count, opened, ranges;
    bool is_cheaper;
};

/// A link that has been made.
constexpr int NO_LINK = -2;

template <class All> inline CUDA_CALLABLE void set_subtree(const All& all, TopLevels& top, int i, int node)
{
    top.node[i] = node;
    top.box[i] = all.box(node);
    top.size[i] = all.made_size(node);
    top.area[i] = node < all.count ? -1.0f : finite(area_of(top.box[i]));
}

/// Finds the subtrees: opens the larger half of those found so far, again and again.
template <class All> inline CUDA_CALLABLE void find_subtrees(const All& all, TopLevels& top)
{
    for_all(1, [&](int) {
        set_subtree(all, top, 0, all.tree.root.data[0]);
        top.count = 1;
    });
    for (;;) {
        const int count = top.count, half = (count + 1) / 2, most = MAX_SUBTREES - count < half ? MAX_SUBTREES - count : half;
        for_all(count, [&](int i) {
            int rank = 0;
            for (int j = 0; j < count; ++j) rank += top.area[j] > top.area[i] || (top.area[j] == top.area[i] && j < i);
            top.rank[i] = rank;
            if (i == 0) top.opened = 0;
        });
        for_all(count, [&](int i) {
            const int rank = top.rank[i];
            if (rank >= most || top.area[i] < 0.0f) return;
            const LinkedBox box = top.box[i];
            top.inner[count - 1 + rank] = top.node[i];
            top.area_before[count - 1 + rank] = top.area[i];
            set_subtree(all, top, i, box.left);
            set_subtree(all, top, count + rank, box.right);
            raise_int(&top.opened, rank + 1);
        });
        if (top.opened == 0) return;
        for_all(1, [&](int) { top.count = count + top.opened; });
    }
}

/// Whether subtree i is on the left of the plane behind subtree j.
inline CUDA_CALLABLE bool is_before(const TopLevels& top, int axis, int i, int j)
{
    const float a = top.box[i].low[axis] - top.box[i].high[axis], b = top.box[j].low[axis] - top.box[j].high[axis];
    return a < b || (a == b && i <= j);
}

/// The number by which planes are compared: the cost, without its last digits, then how unequal the sides are. So equal boxes
/// are halved, and do not make a chain.
inline CUDA_CALLABLE unsigned long long plane_number(float cost, int unequal, int axis, int item)
{
    const unsigned digits = __builtin_bit_cast(unsigned, finite(cost) + 0.0f) & ~0xffu;
    return (unsigned long long)digits << 32 | (unsigned)(unequal << 16 | axis << 8 | item);
}

/// Offers the planes behind the subtree at a place, by the surface area heuristic.
inline CUDA_CALLABLE void offer_planes(TopLevels& top, const int* order, int begin, int end, int place)
{
    const int item = order[place];
    for (int axis = 0; axis < 3; ++axis) {
        LinkedBox side[2];
        int sizes[2] = {0, 0}, unequal = 0;
        for (int k = begin; k < end; ++k) {
            const int other = order[k], right = is_before(top, axis, other, item) ? 0 : 1;
            side[right] = sizes[right] == 0 ? top.box[other] : around(side[right], top.box[other]);
            sizes[right] += top.size[other];
            unequal += 1 - 2 * right;
        }
        if (sizes[1] == 0) continue;
        const float cost = area_of(side[0]) * (float)sizes[0] + area_of(side[1]) * (float)sizes[1];
        lower(&top.best[begin], plane_number(cost, unequal < 0 ? -unequal : unequal, axis, item));
    }
}

/// The area of the box around a range.
inline CUDA_CALLABLE float area_of_range(const TopLevels& top, const int* order, int begin, int end)
{
    LinkedBox whole = top.box[order[begin]];
    for (int k = begin + 1; k < end; ++k) whole = around(whole, top.box[order[k]]);
    return finite(area_of(whole));
}

/// Divides the range of a place, if it has more than one: moves the place's subtree, and, for the first one, links the node.
inline CUDA_CALLABLE void divide(TopLevels& top, int count, int from, int place)
{
    const int to = 1 - from, item = top.order[from][place], begin = top.begin[from][place], end = top.end[from][begin];
    const int link = top.link[from][begin];
    if (end - begin == 1) {
        if (link != NO_LINK) top.subtree_link[item] = link;
        top.order[to][place] = item;
        top.begin[to][place] = place;
        top.end[to][place] = end;
        top.link[to][place] = NO_LINK;
        return;
    }
    const int axis = (int)(top.best[begin] >> 8) & 3, last = (int)top.best[begin] & 0xff;
    const bool left = is_before(top, axis, item, last);
    int lefts = 0, before = 0;
    for (int k = begin; k < end; ++k) {
        const bool other = is_before(top, axis, top.order[from][k], last);
        lefts += other;
        before += k < place && other == left;
    }
    const int middle = begin + lefts, first = left ? begin : middle;
    top.order[to][first + before] = item;
    top.begin[to][first + before] = first;
    if (place != begin) return;
    top.inner_link[middle - 1] = link;
    top.area_after[middle - 1] = area_of_range(top, top.order[from], begin, end);
    for (int side = 0; side < 2; ++side) {
        top.end[to][side == 0 ? begin : middle] = side == 0 ? middle : end;
        top.link[to][side == 0 ? begin : middle] = 2 * (top.inner[middle - 1] - count) + side;
    }
    raise_int(&top.ranges, 1);
}

/// Divides the subtrees into two, and those again, until they are alone.
inline CUDA_CALLABLE void divide_all(TopLevels& top, int count)
{
    const int subtrees = top.count;
    for_all(subtrees, [&](int i) {
        top.order[0][i] = i;
        top.begin[0][i] = 0;
        if (i != 0) return;
        top.end[0][0] = subtrees;
        top.link[0][0] = -1;
    });
    for (int from = 0;; from = 1 - from) {
        for_all(subtrees, [&](int place) {
            top.best[place] = ~0ull;
            if (place == 0) top.ranges = 0;
        });
        for_all(subtrees, [&](int place) {
            const int begin = top.begin[from][place], end = top.end[from][begin];
            if (end - begin > 1) offer_planes(top, top.order[from], begin, end, place);
        });
        for_all(subtrees, [&](int place) { divide(top, count, from, place); });
        if (top.ranges == 0) return;
        for_all(0, [&](int) { });  // all have read `ranges` before it is 0 again
    }
}

/// Makes the upper levels anew, if that makes the tree cheaper. Boxes and sizes of nodes remain those of before.
template <class Tree, class Moves> inline CUDA_CALLABLE void rebuild_top(const Tree& tree, const Moves& moves, int count)
{
    const MovingTree<Tree, Moves> all = {tree, moves, count};
#if defined(__CUDA_ARCH__)
    __shared__ TopLevels top;
#else
    TopLevels top;
#endif
    find_subtrees(all, top);
    divide_all(top, count);
    for_all(1, [&](int) {
        float before = 0.0f, after = 0.0f;
        for (int k = 0; k + 1 < top.count; ++k) {
            before += top.area_before[k];
            after += top.area_after[k];
        }
        top.is_cheaper = after < before;
    });
    if (!top.is_cheaper) return;
    for_all(top.count, [&](int i) { all.put(top.node[i], top.subtree_link[i]); });
    for_all(top.count - 1, [&](int k) { all.put(top.inner[k], top.inner_link[k]); });
}

}  // namespace
}  // namespace wrt
