// Merging of neighbouring clusters of triangles into a binary tree (wrt.builders.bvh.phases.cluster_merging).
//
// On CUDA a warp merges a list of clusters, one in each of its threads; on the CPU a thread does, in loops over lanes. Both do
// the same operations on the same numbers, so they make the same tree.
#pragma once
#include "lanes.h"

namespace wrt {
namespace {

/// Clusters that a list keeps, and those of a list of two such lists.
constexpr int KEPT_CLUSTERS = 16, MAX_CLUSTERS = 2 * KEPT_CLUSTERS;

/// Places in the list up to which a cluster looks for its partner.
constexpr int RADIUS = 8;

/// Number of a pair that does not exist: above that of any other.
constexpr unsigned long long NO_PAIR = ~0ull;

/// A cluster in 16 bytes. node: its root, -1 for none. first: its first triangle in the order of the codes.
struct alignas(16) Cluster {
    int node, first, size, unused;
};

/// The number by which pairs are compared: the area of the box around both, then their places. Of equal areas, the pair whose
/// places differ in the lowest bits is first, so that a row of equal clusters is halved, and not made a chain. An area that is
/// not finite counts as the greatest that is.
inline CUDA_CALLABLE unsigned long long pair_number(float area, int i, int j)
{
    const float finite = area <= 3.402823466e38f ? area : 3.402823466e38f;
    const unsigned places = (unsigned)((i ^ j) << 16 | i << 8 | j);
    return (unsigned long long)__builtin_bit_cast(unsigned, finite) << 32 | places;
}

/// Half the area of the box of these sides; 0 if only places are to count.
inline CUDA_CALLABLE float pair_area(float x, float y, float z, bool by_area)
{
    const float area = x * y + y * z + z * x;
    return by_area ? area + 0.0f : 0.0f;  // -0, of two points, has the greatest bits of all
}

/// Where the codes of triangle k and the next one differ: the greater, the higher the node that divides them.
inline CUDA_CALLABLE unsigned long long step_after(const int* codes, int k)
{
    const unsigned differing = (unsigned)codes[k] ^ (unsigned)codes[k + 1];
    return (unsigned long long)differing << 32 | (unsigned)(k ^ (k + 1));
}

/// Whether the range of a node is the left part of its parent's.
inline CUDA_CALLABLE bool is_left(const int* codes, int left, int right, int count)
{
    return left == 0 || (right != count - 1 && step_after(codes, right) < step_after(codes, left - 1));
}

/// The first thread to come to a node says which end of its range it has; the second is told.
inline CUDA_CALLABLE int exchange(int* at, int value)
{
#if defined(__CUDA_ARCH__)
    __threadfence();
    const int before = atomicExch(at, value);
    __threadfence();
    return before;
#else
    return __atomic_exchange_n(at, value, __ATOMIC_ACQ_REL);
#endif
}

/// A range of triangles whose node has been reached from both sides; done: another thread goes on.
struct Range {
    int left, right, split;
    bool done;
};

/// Goes from a range to its parent's.
inline CUDA_CALLABLE void climb(Range& range, const int* codes, int* waiting, int count)
{
    const bool left = is_left(codes, range.left, range.right, count);
    const int other = exchange(waiting + (left ? range.right : range.left - 1), left ? range.left : range.right);
    range.done = other < 0;
    if (range.done) return;
    if (left) {
        range.split = range.right + 1;
        range.right = other;
    } else {
        range.split = range.left;
        range.left = other;
    }
}

/// Arrays of a tree that is being made (`MergedTree`).
template <class Tree> struct Merging {
    const Tree& tree;
    int count;
    bool by_area;

    CUDA_CALLABLE float* box(int node) const { return tree.box.data + 8 * (size_t)node; }
    CUDA_CALLABLE Cluster* list(int place) const { return (Cluster*)tree.cluster.data + place; }

    /// Writes what a new node is, but for its box and its children.
    CUDA_CALLABLE void link(int node, int left, int right, int size) const
    {
        tree.size.data[node - count] = size;
        tree.parent.data[left] = 2 * (node - count);
        tree.parent.data[right] = 2 * (node - count) + 1;
        if (size == count) tree.root.data[0] = node;
    }
};

#if defined(__CUDA_ARCH__)

constexpr unsigned ALL_THREADS = 0xffffffffu;

inline __device__ float4 joined(float4 a, float4 b, int word)
{
    return make_float4(fminf(a.x, b.x), fminf(a.y, b.y), fminf(a.z, b.z), __int_as_float(word));
}

inline __device__ float4 of_thread(float4 v, int lane)
{
    return make_float4(
        __shfl_sync(ALL_THREADS, v.x, lane), __shfl_sync(ALL_THREADS, v.y, lane), __shfl_sync(ALL_THREADS, v.z, lane), 0.0f);
}

/// Merges the two lists of a range, by all threads of a warp. places: 32 words of shared memory.
template <class Tree>
inline __device__ void merge_range(const Merging<Tree>& all, int left, int split, int end, int enough, int* places)
{
    const int lane = threadIdx.x & 31;
    Cluster c = {-1, 0, 0, 0};
    auto load = [&](int place) {
        const int4 v = __ldcg((const int4*)all.list(place));
        c = {v.x, v.y, v.z, 0};
    };
    if (lane < KEPT_CLUSTERS && left + lane < split) load(left + lane);
    const int lefts = __popc(__ballot_sync(ALL_THREADS, c.node >= 0)), k = lane - lefts;
    if (k >= 0) {
        c.node = -1;
        if (k < KEPT_CLUSTERS && split + k < end) load(split + k);
    }
    int count = __popc(__ballot_sync(ALL_THREADS, c.node >= 0));
    float4 low = make_float4(0.0f, 0.0f, 0.0f, 0.0f), high = low;  // low corner, and the high one with its sign changed
    if (c.node >= 0) {
        low = __ldcg((const float4*)all.box(c.node));
        high = __ldcg((const float4*)all.box(c.node) + 1);
    }
    while (count > enough) {
        unsigned long long nearest = NO_PAIR;
        for (int r = 1; r <= RADIUS; ++r) {
            const float x = -(fminf(low.x, __shfl_down_sync(ALL_THREADS, low.x, r))
                + fminf(high.x, __shfl_down_sync(ALL_THREADS, high.x, r)));
            const float y = -(fminf(low.y, __shfl_down_sync(ALL_THREADS, low.y, r))
                + fminf(high.y, __shfl_down_sync(ALL_THREADS, high.y, r)));
            const float z = -(fminf(low.z, __shfl_down_sync(ALL_THREADS, low.z, r))
                + fminf(high.z, __shfl_down_sync(ALL_THREADS, high.z, r)));
            const unsigned long long number
                = lane + r < count ? pair_number(pair_area(x, y, z, all.by_area), lane, lane + r) : NO_PAIR;
            nearest = number < nearest ? number : nearest;
            const unsigned long long before = __shfl_up_sync(ALL_THREADS, number, r);
            if (lane >= r && before < nearest) nearest = before;
        }
        const int i = (int)(nearest >> 8) & 31, j = (int)nearest & 31;
        const int partner = lane < count ? (i == lane ? j : i) : lane;
        const bool mutual = __shfl_sync(ALL_THREADS, partner, partner) == lane && lane < count && partner != lane;
        const bool merges = mutual && lane < partner;
        const int node = __shfl_sync(ALL_THREADS, c.node, partner), first = __shfl_sync(ALL_THREADS, c.first, partner),
                  size = __shfl_sync(ALL_THREADS, c.size, partner);
        const float4 other_low = of_thread(low, partner), other_high = of_thread(high, partner);
        if (merges) {
            low = joined(low, other_low, c.node);
            high = joined(high, other_high, node);
            const int made = all.count + first;
            __stcg((float4*)all.box(made), low);
            __stcg((float4*)all.box(made) + 1, high);
            all.link(made, c.node, node, c.size + size);
            c.node = made;
            c.size += size;
        }
        const bool stays = lane < count && !(mutual && lane > partner);
        const unsigned staying = __ballot_sync(ALL_THREADS, stays);
        if (stays) places[__popc(staying & ((1u << lane) - 1u))] = lane;
        __syncwarp();
        count = __popc(staying);
        const int from = lane < count ? places[lane] : lane;
        __syncwarp();
        c.node = __shfl_sync(ALL_THREADS, c.node, from);
        c.first = __shfl_sync(ALL_THREADS, c.first, from);
        c.size = __shfl_sync(ALL_THREADS, c.size, from);
        low = of_thread(low, from);
        high = of_thread(high, from);
        if (lane >= count) c.node = -1;
    }
    if (lane < KEPT_CLUSTERS && left + lane < end) {
        __stcg((int4*)all.list(left + lane), lane < count ? make_int4(c.node, c.first, c.size, 0) : make_int4(-1, 0, 0, 0));
    }
    __threadfence();
    __syncwarp();
}

/// Triangle i of `count`; all threads of a warp come here, also those beyond the last triangle.
template <class Tree> inline __device__ void merge_from(const Tree& tree, int i, int count, bool by_area)
{
    __shared__ int lists[1024];
    const Merging<Tree> all = {tree, count, by_area};
    int* const places = lists + (threadIdx.x & ~31u);
    Range range = {i, i, 0, i >= count};
    while (__ballot_sync(ALL_THREADS, !range.done)) {
        if (!range.done) climb(range, tree.code.data, tree.waiting.data, count);
        const bool whole = !range.done && range.left == 0 && range.right == count - 1;
        const bool merges = !range.done && (range.right - range.left + 1 > KEPT_CLUSTERS || whole);
        unsigned todo = __ballot_sync(ALL_THREADS, merges);
        while (todo) {
            const int source = __ffs(todo) - 1;
            todo &= todo - 1;
            const int left = __shfl_sync(ALL_THREADS, range.left, source),
                      right = __shfl_sync(ALL_THREADS, range.right, source),
                      split = __shfl_sync(ALL_THREADS, range.split, source);
            merge_range(all, left, split, right + 1, left == 0 && right == count - 1 ? 1 : KEPT_CLUSTERS, places);
        }
        if (whole) range.done = true;
    }
}

#else

/// The clusters of two lists, in lanes; a row has room for what the search reads beyond the last one.
struct ClusterLanes {
    static constexpr int W = MAX_CLUSTERS;
    float corner[6][W + RADIUS];
    unsigned long long nearest[W + RADIUS];
    Cluster cluster[W];
    int count;

    template <class Tree> void take(const Merging<Tree>& all, int begin, int end)
    {
        for (int k = 0; k < KEPT_CLUSTERS && begin + k < end; ++k) {
            const Cluster c = *all.list(begin + k);
            if (c.node < 0) break;
            const float* const box = all.box(c.node);
            for (int a = 0; a < 3; ++a) {
                corner[a][count] = box[a];
                corner[3 + a][count] = box[4 + a];
            }
            cluster[count++] = c;
        }
    }

    void search(bool by_area)
    {
        for (int i = 0; i < W + RADIUS; ++i) nearest[i] = NO_PAIR;
        for (int r = 1; r <= RADIUS; ++r) {
            unsigned long long number[W];
            WRT_FOR_LANES (i) {
                float side[3];
                for (int a = 0; a < 3; ++a) {
                    side[a] = -(smaller(corner[a][i], corner[a][i + r]) + smaller(corner[3 + a][i], corner[3 + a][i + r]));
                }
                const unsigned long long own = pair_number(pair_area(side[0], side[1], side[2], by_area), i, i + r);
                number[i] = i + r < count ? own : NO_PAIR;
            }
            WRT_FOR_LANES (i) {
                nearest[i] = number[i] < nearest[i] ? number[i] : nearest[i];
            }
            WRT_FOR_LANES (i) {
                nearest[i + r] = number[i] < nearest[i + r] ? number[i] : nearest[i + r];
            }
        }
    }

    template <class Tree> void merge(const Merging<Tree>& all)
    {
        const int before = count;
        count = 0;
        for (int i = 0; i < before; ++i) {
            const int a = (int)(nearest[i] >> 8) & 31, b = (int)nearest[i] & 31, partner = a == i ? b : a;
            const bool mutual = nearest[i] == nearest[partner];
            if (mutual && partner < i) continue;
            Cluster c = cluster[i];
            float joint[6];
            for (int k = 0; k < 6; ++k) joint[k] = corner[k][i];
            if (mutual) {
                const Cluster other = cluster[partner];
                const int made = all.count + other.first;
                float* const box = all.box(made);
                for (int k = 0; k < 6; ++k) joint[k] = smaller(joint[k], corner[k][partner]);
                for (int k = 0; k < 3; ++k) {
                    box[k] = joint[k];
                    box[4 + k] = joint[3 + k];
                }
                box[3] = __builtin_bit_cast(float, c.node);
                box[7] = __builtin_bit_cast(float, other.node);
                all.link(made, c.node, other.node, c.size + other.size);
                c.node = made;
                c.size += other.size;
            }
            for (int k = 0; k < 6; ++k) corner[k][count] = joint[k];
            cluster[count++] = c;
        }
    }
};

template <class Tree> inline void merge_range(const Merging<Tree>& all, int left, int split, int end, int enough)
{
    ClusterLanes lanes;
    for (auto& row : lanes.corner) {
        for (float& value : row) value = 0.0f;
    }
    lanes.count = 0;
    lanes.take(all, left, split);
    lanes.take(all, split, end);
    while (lanes.count > enough) {
        lanes.search(all.by_area);
        lanes.merge(all);
    }
    for (int k = 0; k < KEPT_CLUSTERS && left + k < end; ++k) {
        *all.list(left + k) = k < lanes.count ? lanes.cluster[k] : Cluster {-1, 0, 0, 0};
    }
}

/// Triangle i of `count`.
template <class Tree> inline void merge_from(const Tree& tree, int i, int count, bool by_area)
{
    const Merging<Tree> all = {tree, count, by_area};
    Range range = {i, i, 0, count == 1};
    while (!range.done) {
        climb(range, tree.code.data, tree.waiting.data, count);
        if (range.done) break;
        range.done = range.left == 0 && range.right == count - 1;
        if (range.right - range.left + 1 <= KEPT_CLUSTERS && !range.done) continue;
        merge_range(all, range.left, range.split, range.right + 1, range.done ? 1 : KEPT_CLUSTERS);
    }
}

#endif

}  // namespace
}  // namespace wrt
