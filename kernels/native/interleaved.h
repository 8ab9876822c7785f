// Interleaved walks of a wide BVH: slots with rays that take turns, and the passes that move them through inner nodes.
//
// The kernel is wrt.kernels.traversal.interleaved.interleaved_bvh.
#pragma once
#include "stream.h"

namespace wrt {
namespace {

/// What a slot keeps of a ray. in, out: t of a near plane is plane * inverse + in, of a far plane plane * inverse + out; in_at,
/// out_at: where these planes are in a node, in bytes. The fourth element of each fills a vector. top: its stack; ray: its
/// number.
struct Slot {
    float inverse[4], in[4], out[4];
    unsigned in_at[4], out_at[4];
    float t_min, t_max;
    int top, ray;
};

// The box test of interleaved walks: one fused multiply-add a plane, with margins that keep it conservative.
//
// **Problem.** The box test of `wrt.kernels.simd.boxes` subtracts and multiplies for each of six planes.
//
// **Idea.** t = plane * inverse + c, where c = -origin * inverse is computed once a ray. Its rounding is relative to origin *
// inverse, not to t. So c is moved outwards by more than all roundings, those of the test that it stands for included: a ray
// that meets a widened box by `slab_interval` meets it here, and enters it no later. Nothing else is asked of a box test
// (`wrt.kernels.simd.boxes`, the consistency rule): hits are found by the triangles' own boxes.
//
// **Margins.** All errors in units of 1 / direction, along one axis.
//
//     u           2^-24
//     o, r        origin; reach of the ray: planes p have |p - o| <= r, so |p| <= |o| + r
//     in, out     the moved origins of `RaySlabs`, apart = |in - out|
//     m           the margin, apart / 4 + 2^-20 |o|
//
//     apart >= 2^-19 r - 2 u |o|                          in and out are rounded
//     r <= 2^19 apart + 2^-4 |o|                          the same, the other way round
//     u |o|                                               product of c
//     u (|o| + m)                                         its difference from the margin
//     u (|o| + r)                                         product of the multiply-add, if that is not fused
//     u (r + m)                                           its sum
//     2 u r                                               difference and product of `slab_interval`
//     sum <= u (3 |o| + 5 r) <= 0.157 apart + 3.4 u |o|   by the second line; u m <= u r / 2
//     m - sum >= 0.09 apart + 12 u |o| >= 2^-23 r         by the first
//
// So the margin is 1.5 times what roundings need, and the entry is earlier than that of `slab_interval` by 2^-23 r at least.
// 2^-126 is added to distances and to t, for numbers that are not normal. Searched by `fused` of tests/bounds.
//
// **Axes along which a ray hardly moves.** 1 / direction may be infinite, and c would be a NaN. |1 / direction| is limited to
// 2^30 times that of the largest component. If the origin is between the widened planes, the ray then leaves them at
// 2^30 2^-23 r / |largest component| or later, after it has left the scene along the largest. If a plane is in front of it, the
// sign of t is right, and t is no later than it was; the far plane is apart farther and is left at
// 2^30 2^-20 r / |largest component| or later. Where products would overflow, both planes of an axis are at infinity: such rays
// (directions shorter than 2^-90 of the origin's distance) visit boxes that they miss.
//
// Empty children have planes at infinity and are never met, because 1 / direction is neither 0 nor infinite here.

/// Prepares the box tests of a ray, from the numbers of `RaySlabs`; four of each must be readable.
template <int W> inline CUDA_CALLABLE void set_boxes(Slot& slot, const float* inverse, const float* in, const float* out)
{
    constexpr float TINY = 1.1754944e-38f, GREATEST = 3.4028235e38f;
    constexpr float LARGE = 4.0564819e31f;  // 2^105: a margin below it says that (|origin| + reach) / direction < 2^126
    const float size_x = WRT_ABS(inverse[0]), size_y = WRT_ABS(inverse[1]), size_z = WRT_ABS(inverse[2]);
    float min_size = size_x < size_y ? size_x : size_y;
    min_size = min_size < size_z ? min_size : size_z;
    const float limit = min_size * 1073741824.0f;
    float kept[4], near[4], far[4], margins[4];
    unsigned near_at[4], far_at[4];
    WRT_FOR (4, a) {  // the fourth is not used
        const float whole = WRT_ABS(inverse[a]), size = whole < limit ? whole : limit;
        const float i = inverse[a] < 0.0f ? -size : size, apart = WRT_ABS(in[a] - out[a]);
        const float margin = ((apart * 0.25f + TINY) + WRT_ABS(in[a]) * 9.5367432e-7f) * size + TINY;
        const unsigned low = 4 * W * (unsigned)a, other = inverse[a] < 0.0f ? 12 * W : 0;
        kept[a] = i;
        near[a] = -(in[a] * i) - margin;
        far[a] = margin - out[a] * i;
        margins[a] = margin;
        near_at[a] = low + other;
        far_at[a] = (low + 12 * W) - other;
    }
    float max_margin = margins[0] > margins[1] ? margins[0] : margins[1];
    max_margin = margins[2] > max_margin ? margins[2] : max_margin;
    if (!(max_margin < LARGE)) {
        for (int a = 0; a < 3; ++a) {
            if (margins[a] < LARGE) continue;
            kept[a] = inverse[a] < 0.0f ? -TINY : TINY;
            near[a] = -GREATEST;
            far[a] = GREATEST;
        }
    }
    copy(slot.inverse, kept);
    copy(slot.in, near);
    copy(slot.out, far);
    copy(slot.in_at, near_at);
    copy(slot.out_at, far_at);
}

/// The W boxes of the node at `box`. met: -1 for those that the ray meets, else 0.
template <int W> inline CUDA_CALLABLE void meet(const Slot& slot, const char* box, float* entry, int* met)
{
    const PlanePointers planes
        = {{(const float*)(box + slot.in_at[0]), (const float*)(box + slot.in_at[1]), (const float*)(box + slot.in_at[2])},
            {(const float*)(box + slot.out_at[0]), (const float*)(box + slot.out_at[1]), (const float*)(box + slot.out_at[2])}};
    const BoxRay ray = {{slot.inverse[0], slot.inverse[1], slot.inverse[2]}, {slot.in[0], slot.in[1], slot.in[2]},
        {slot.out[0], slot.out[1], slot.out[2]}};
    const float t_min = slot.t_min, t_max = slot.t_max;
    WRT_FOR_LANES (i) {
        const Interval own = slab<Fused>(planes, ray, i, t_min, t_max);
        entry[i] = own.enter;
        met[i] = own.enter <= own.leave ? -1 : 0;
    }
}

// Children that a ray meets, put on its stack with the nearest on top: a sort without branches.
//
// **Problem.** A ray meets zero to W children of a node. Sorting them by a loop costs a branch per comparison, which the
// processor cannot predict.
//
// **Idea.** Keys and children are sorted in registers by Batcher's bitonic sorter, whose comparisons do not depend on the data.
// A key is the bit pattern of the t at which the ray enters a child's box, with the child's lane in the lowest bits
// (`wrt.kernels.simd.box_lanes`). It is -1 for a child that the ray misses. Keys are sorted in descending order, so the
// children that the ray meets come first, the nearest last; all W are written, and the stack grows by the number of those met.
// With AVX-512 the keys of the children met are first moved together (as in Fuetterling et al. 2017); if there are at most
// `FEW`, which is nearly always the case, sorting that many lanes is enough. With AVX2, sorting all 8 lanes takes as long as
// moving them (notebooks/records/2026-11-22-interleaved-rays.md).
//
// References:
//     K. E. Batcher: Sorting networks and their applications. AFIPS Spring Joint Computer Conference 1968.
//     V. Fuetterling, C. Lojewski, F.-J. Pfreundt, A. Ebert: Accelerated single ray tracing for wide vector units. High
//         Performance Graphics 2017.

/// Lanes that are sorted where few of 16 children are met.
constexpr int FEW = 4;

#if WRT_VECTORS && defined(__AVX512F__)
/// The lanes of the mask first, in descending order; the others are -1.
template <int... I> inline Vector<int, 16> sort_few(Vector<int, 16> v, int count, Numbers<int, I...>)
{
    const auto few = sort<FEW>(__builtin_shufflevector(v, v, 0, 1, 2, 3));
    return count > FEW ? sort<16>(v) : __builtin_shufflevector(few, few, (I < FEW ? I : -1)...);
}
#endif

/// Writes the keys of the children in the mask to `to`, and their words DEPTH words behind, in descending order of the keys;
/// returns how many. Writes W words to each. key: W keys, -1 outside the mask.
template <int W, int DEPTH> inline CUDA_CALLABLE int push_sorted(const int* key, unsigned mask, const int* child, int* to)
{
#if WRT_VECTORS
    const int count = __builtin_popcount(mask);
    auto v = load<Vector<int, W>>(key);
#if defined(__AVX512F__)
    if constexpr (W == 16) {
        v = compressed(v, mask, (Vector<int, 16>)(-1));
        v = sort_few(v, count, Lanes<16>());
        save(to, v);
        save(to + DEPTH, permuted(load<Vector<int, 16>>(child), v));
        return count;
    }
#endif
    v = sort<W>(v);
#if defined(__AVX2__)
    if constexpr (W == 8) {
        save(to, v);
        save(to + DEPTH, permuted(load<Vector<int, 8>>(child), v));
        return count;
    }
#endif
    for (int i = 0; i < W; ++i) {
        to[i] = v[i];
        to[DEPTH + i] = child[v[i] < 0 ? 0 : v[i] & (W - 1)];
    }
    return count;
#else
    int count = 0;
    for (int i = 0; i < W; ++i) {
        if (!(mask >> i & 1u)) continue;
        int j = count++;
        for (; j > 0 && to[j - 1] < key[i]; --j) {
            to[j] = to[j - 1];
            to[DEPTH + j] = to[DEPTH + j - 1];
        }
        to[j] = key[i];
        to[DEPTH + j] = child[i];
    }
    return count;
#endif
}

/// Writes the children in the mask to `to`, the one with the lowest lane last; the others are in any order. Writes W words.
template <int W> inline CUDA_CALLABLE void push_reversed(int* to, const int* child, unsigned mask)
{
#if WRT_VECTORS && defined(__AVX512F__)
    if constexpr (W == 16) {
        const auto c = load<Vector<int, 16>>(child);
        const int first = child[__builtin_ctz(mask | 32768u)], others = __builtin_popcount(mask) - 1;
        save(to, compressed(c, mask & (mask - 1u)));
        to[mask ? others : 15] = first;
        return;
    }
#endif
#if WRT_VECTORS && defined(__AVX2__)
    if constexpr (W == 8) {
        save(to, permuted(load<Vector<int, 8>>(child), lanes_in(LAST_LANES_FIRST.of[mask])));
        return;
    }
#endif
    append_one_by_one<W, true>(to, child, mask);
}

/// The slots of a thread and their lists; see wrt.kernels.traversal.interleaved.interleaved_bvh.
template <int W, bool ORDERED, bool COUNTING, int DEPTH, int STRIDE, int LEAF_WORDS, class Ray> struct Walk {
    static constexpr int L = block_lanes(W), SLOTS = 64, SPARE = 16, LIST = SLOTS + SPARE, EMPTY = -1;
    static constexpr int BLOCKS = (63 + W - 1) / W, ROOM = (SLOTS + 1) * BLOCKS;
    static constexpr int BOTTOM = sizeof(Slot) / 4, CHILDREN = ORDERED ? DEPTH : 0;

    const float* bounds;
    const int* children;
    const float* records;
    const Ray* rays;
    const int* list;
    int count, following;
    int* pairs;
    int &visited, &triangles;
    int* const stacks;  // each slot is followed by its stacks
    int* const keys = stacks + STRIDE * SLOTS;
    int* const listed = keys + (ORDERED ? W * SLOTS : 0);  // slots before an inner node, or before whatever they come to
    int* const words = listed + LIST;  // their nodes
    int* const masks = words + LIST;
    int* const outer = masks + LIST;  // slots that have left that list
    int* const outer_words = outer + LIST;
    int* const at_leaf = outer_words + LIST;
    int* const idle = at_leaf + LIST;  // slots without a ray
    int inners = 0, outers = 0, leaves = 0, idles = 0, paired = 0;

    CUDA_CALLABLE Slot& slot_at(int place) { return *(Slot*)((char*)stacks + (size_t)(unsigned)place); }

    CUDA_CALLABLE void fetch_node(int word)
    {
        const char* const node = (const char*)bounds + (size_t)(unsigned)(word & ~(word >> 31)) * (24 * W);
        WRT_UNROLLED
        for (int b = 0; b < 24 * W; b += 64) {
            WRT_FETCH(node + b);
        }
    }

    /// Takes the next child from a stack.
    CUDA_CALLABLE int pop(Slot& slot, int top)
    {
        if (ORDERED) {
            const int limit = __builtin_bit_cast(int, slot.t_max) | (W - 1);  // a key has a lane in those bits
            while (stacks[top] > limit) --top;
        }
        slot.top = top;
        return stacks[top + CHILDREN];
    }

    /// Slots before inner nodes stay in the list, the others leave it.
    CUDA_CALLABLE void partition(int size)
    {
        inners = 0;
        for (int j = 0; j < size; j += L) {
            int leaf[L];
            WRT_FOR (L, i) {
                leaf[i] = words[j + i] < 0 ? -1 : 0;
            }
            const unsigned here = size - j < L ? (1u << (size - j)) - 1u : (1u << L) - 1u;
            const unsigned leaving = bits<L>(leaf) & here, staying = here & ~leaving;
            append<L>(outer + outers, listed + j, leaving);
            outers += append<L>(outer_words + outers, words + j, leaving);
            append<L>(listed + inners, listed + j, staying);
            inners += append<L>(words + inners, words + j, staying);
        }
    }

    /// Puts the next ray before the root or, where the order of children is free, before one of its children.
    CUDA_CALLABLE void start(int place)
    {
        Slot& slot = slot_at(place);
        const Ray& ray = rays[following];
        const float* const slabs = (const float*)&ray;
        set_boxes<W>(slot, slabs, slabs + 3, slabs + 6);
        slot.t_min = ray.t_min;
        slot.t_max = ray.best.t + 0.0f;
        slot.top = place / 4 + BOTTOM + 1;
        slot.ray = following;
        if constexpr (ORDERED) {
            words[inners] = 0;
            listed[inners++] = place;
        } else {
            const unsigned mask = (unsigned)list[following] >> RAY_BITS;
            push_reversed<W>(stacks + slot.top, children, mask);
            slot.top += count_bits(mask) - 1;
            const int word = stacks[slot.top], leaf = word < 0 ? 1 : 0;
            fetch_node(word);
            ++visited;  // the root
            words[inners] = word;
            listed[inners] = place;
            inners += 1 - leaf;
            outer_words[outers] = word;
            outer[outers] = place;
            outers += leaf;
        }
        ++following;
    }

    /// Lists the leaves of the slots that have left the list, and starts rays in those that are idle.
    CUDA_CALLABLE void settle()
    {
        do {
            WRT_SCALAR
            for (int j = 0; j < outers; ++j) {
                const int place = outer[j], word = outer_words[j], ends = word == EMPTY ? 1 : 0;
                const int block = (int)((unsigned)~word >> 6), blocks = ((~word & 63) + W - 1) / W, ray = slot_at(place).ray;
                const char* const leaf = (const char*)records + (size_t)block * (4 * LEAF_WORDS * W);
                WRT_UNROLLED
                for (int b = 0; b < 36 * W; b += 64) {
                    WRT_FETCH(leaf + b);
                }
                at_leaf[leaves] = place;
                leaves += 1 - ends;
                idle[idles] = place;
                idles += ends;
                int own[BLOCKS], all[BLOCKS];
                WRT_FOR (BLOCKS, i) {
                    own[i] = ray;
                    all[i] = block + i;
                }
                copy(pairs + paired, own);
                copy(pairs + ROOM + paired, all);
                paired += blocks;
                if (COUNTING) triangles += ~word & 63;
            }
            outers = 0;
            while (idles > 0 && following < count) start(idle[--idles]);
        } while (outers > 0);
    }

    CUDA_CALLABLE void begin()
    {
        for (int s = 0; s < SLOTS; ++s) {
            int* const stack = stacks + s * STRIDE + BOTTOM;
            stack[0] = (int)0x80000000;
            stack[CHILDREN] = EMPTY;
            idle[idles++] = s * 4 * STRIDE;
        }
    }

    /// Goes on with the slots whose leaves have been tested.
    CUDA_CALLABLE void resume(int waiting)
    {
        WRT_SCALAR
        for (int j = 0; j < waiting; ++j) {
            const int place = at_leaf[j];
            Slot& slot = slot_at(place);
            const float t = rays[slot.ray].best.t + 0.0f;  // turns -0 into +0: as an integer, -0 is less than any key
            if (ORDERED) slot.t_max = t;
            const int word = pop(slot, slot.top - 1), next_word = !ORDERED && t < 0.0f ? EMPTY : word;
            fetch_node(next_word);
            listed[j] = place;
            words[j] = next_word;
        }
        partition(waiting);
    }

    CUDA_CALLABLE void test_boxes(int j)
    {
        const size_t node = (unsigned)words[j];
        WRT_FETCH(children + node * W);
        float entry[W];
        int met[L] = {};
        meet<W>(slot_at(listed[j]), (const char*)bounds + node * (24 * W), entry, met);
        if (ORDERED) {
            int* const key = keys + W * j;
            WRT_FOR_LANES (i) {
                key[i] = met[i] ? (__builtin_bit_cast(int, entry[i]) & -W) | i : -1;
            }
        }
        masks[j] = (int)bits<L>(met);
    }

    CUDA_CALLABLE void step(int j)
    {
        Slot& slot = slot_at(listed[j]);
        const int* const child = children + (size_t)(unsigned)words[j] * W;
        const unsigned mask = (unsigned)masks[j];
        const int top = slot.top;
        int word;
        if constexpr (ORDERED) {
            word = pop(slot, top + push_sorted<W, DEPTH>(keys + W * j, mask, child, stacks + top) - 1);
        } else {
            push_reversed<W>(stacks + top, child, mask);
            slot.top = top - 1 + count_bits(mask);
            word = stacks[slot.top];
        }
        words[j] = word;
        fetch_node(word);
    }

    /// Passes over the slots before inner nodes, until there are none.
    CUDA_CALLABLE void pass_all()
    {
        while (inners > 0) {
            visited += inners;
            WRT_SCALAR
            for (int j = 0; j < inners; ++j) test_boxes(j);
            WRT_SCALAR
            for (int j = 0; j < inners; ++j) step(j);
            partition(inners);
            settle();
        }
    }
};

/// Moves all slots to leaves; see wrt.kernels.traversal.interleaved.interleaved_bvh.walk_to_leaves.
template <int W, bool ORDERED, bool COUNTING, int DEPTH, int STRIDE, int LEAF_WORDS, class Tree, class Ray>
inline CUDA_CALLABLE int walk_to_leaves(const Tree& tree, const float* records, const Ray* rays, const int* list, int count,
    int* memory, int& next, int& waiting, int& visited, int& triangles, int* pairs)
{
    int* const stacks = (int*)(((size_t)memory + 63) & ~(size_t)63);
    Walk<W, ORDERED, COUNTING, DEPTH, STRIDE, LEAF_WORDS, Ray> walk
        = {tree.bounds.data, tree.child.data, records, rays, list, count, next, pairs, visited, triangles, stacks};
    if (next == 0) walk.begin();
    else walk.resume(waiting);
    walk.settle();
    walk.pass_all();
    next = walk.following;
    waiting = walk.leaves;
    return walk.paired;
}

}  // namespace
}  // namespace wrt
