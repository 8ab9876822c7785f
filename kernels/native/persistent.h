// One ray a thread through a tree of 64-byte nodes, by persistent threads (wrt.kernels.traversal.persistent). On the CPU an item
// traces one ray, by the same steps.
#pragma once
#include "packed_triangles.h"

namespace wrt {
namespace {

/// The node of a ray that is done; inner nodes are less, leaves negative.
constexpr int DONE = 0x7fffffff;

/// Bits of a leaf's word that hold the number of its triangles (wrt.kernels.layout.bvh_nodes).
constexpr int LEAF_BITS = 6;

struct WalkWork {
    int nodes, leaves, triangles;
};

/// A kernel's arguments and options. LEVELS: inner nodes on a path at most.
template <int LEVELS_, bool ANY_, bool CULLING_, bool COUNTING_, class Tree, class Triangles, class Rays, class Hits,
    class Rows>
struct Walks {
    static constexpr int LEVELS = LEVELS_;
    static constexpr bool ANY = ANY_, CULLING = CULLING_, COUNTING = COUNTING_;
    const Tree& tree;
    const Triangles& triangles;
    const Rays& rays;
    const Hits& hits;
    const Rows& rows;
};

/// The arguments of a kernel with its options.
template <int LEVELS, bool ANY, bool CULLING, bool COUNTING, class Tree, class Triangles, class Rays, class Hits, class Rows>
inline CUDA_CALLABLE Walks<LEVELS, ANY, CULLING, COUNTING, Tree, Triangles, Rays, Hits, Rows> walks_of(
    const Tree& tree, const Triangles& triangles, const Rays& rays, const Hits& hits, const Rows& rows)
{
    return {tree, triangles, rays, hits, rows};
}

/// The walk of one ray through the tree. Its stack, LEVELS + 1 words, is apart: of a struct with an array that is indexed by a
/// variable, nothing would be in registers. FROM_ZERO: whether t_min is 0 for all rays, as in most calls; that saves two registers.
template <class All, bool FROM_ZERO> struct Walk {
    int top, node, number;
    float own_t_min;
    FilterRay filter;
    TurnedRay turned_ray;
    PackedHit best;
    WalkWork work;

    CUDA_CALLABLE float t_min() const { return FROM_ZERO ? 0.0f : own_t_min; }

    CUDA_CALLABLE bool is_inner() const { return (unsigned)node < (unsigned)DONE; }

    CUDA_CALLABLE bool is_leaf() const { return node < 0; }

    CUDA_CALLABLE void begin(const All& all, int i, int* stack)
    {
        const GivenRay given = given_ray(all.tree, all.rays, i);
        const float x = given.direction[0], y = given.direction[1], z = given.direction[2];
        const float px = given.origin[0], py = given.origin[1], pz = given.origin[2];
        const float last = all.rays.t_max.data[(size_t)i * all.rays.t_max_stride];
        own_t_min = all.rays.t_min.data[(size_t)i * all.rays.t_min_stride];
        best = {last > FARTHEST ? FARTHEST : last, 0.0f, 0.0f, -1};
        turned_ray = turned(given);
        filter = filter_ray(x, y, z, px, py, pz, given.reach, t_min(), best.t);
        number = i, top = 1, stack[0] = DONE;
        work = {0, 0, 0};
        node = is_ray(x, y, z, px, py, pz, t_min(), best.t) ? 0 : DONE;
    }

    /// From an inner node to the nearer child, or to what waits.
    CUDA_CALLABLE void step(const All& all, int* stack)
    {
        const NearAndFar met = meet_children<FROM_ZERO>((const float*)all.tree.nodes.data, node, filter);
        if (All::COUNTING) ++work.nodes;
        if (met.both) stack[top++] = met.far;
        node = met.near;
        if (!met.any) node = stack[--top];
    }

    /// Tests the triangles of a leaf, and goes on with what waits.
    CUDA_CALLABLE void leaf(const All& all, int* stack)
    {
        const int word = ~node, count = word & ((1 << LEAF_BITS) - 1), first = 2 * (word >> LEAF_BITS);
        const auto given = [&]() { return given_ray(all.tree, all.rays, number); };
        const float* const triangles = (const float*)all.triangles.corners.data;
        node = stack[--top];
        if (All::COUNTING) ++work.leaves, work.triangles += count;
        for (int slot = first; slot < first + count; ++slot) {
            const float scale = meet_triangle<All::CULLING>(triangles, slot, turned_ray, t_min(), given, best);
            if (scale == 0.0f) continue;
            if (All::ANY) {
                node = DONE;
                break;
            }
            filter.t_max = bound_of(best.t, scale);
        }
    }

    CUDA_CALLABLE void store(const All& all) const
    {
        if constexpr (All::ANY) {
            all.hits.occluded.data[number] = best.id >= 0;
        } else {
            all.hits.t.data[number] = best.id < 0 ? WRT_INFINITY : best.t;
            all.hits.primitive.data[number] = best.id;
            float* const uv = (float*)(all.hits.uv.data + number);
            uv[0] = best.u, uv[1] = best.v;
        }
        if constexpr (All::COUNTING) {
            auto& row = all.rows.rows.data[number];
            row.nodes = work.nodes, row.leaves = work.leaves, row.triangles = work.triangles;
        }
    }
};

#if defined(__CUDA_ARCH__)
/// The rays of a launch, by all of its threads. next: number of the next ray that no thread has, and how many threads are done;
/// both are 0 before and after. FETCH: threads of a warp without a ray for which new ones are fetched. KEEP: threads that may
/// wait at a node for those of the warp that have come to leaves. STEPS: between two votes about that.
///
/// Votes take the threads that began (`team`), not those that are active: else a warp that has parted votes apart for good.
template <int FETCH, int KEEP, int STEPS, bool FROM_ZERO, class All>
__device__ void walk_all(const All& all, int* next, int threads)
{
    const unsigned team = __activemask();
    const int lane = threadIdx.x & 31, leader = __ffs(team) - 1;
    const unsigned count = all.rays.count;
    int stack[All::LEVELS + 1];
    Walk<All, FROM_ZERO> walk;
    walk.node = DONE, walk.number = -1;
    bool more = true;
    for (;;) {
        const unsigned idle = __ballot_sync(team, walk.node == DONE);
        if ((more && __popc(idle) >= FETCH) || idle == team) {
            if (walk.node == DONE && walk.number >= 0) {
                walk.store(all);
                walk.number = -1;
            }
            __syncwarp(team);
            if (!more) break;
            unsigned first = 0;  // beyond the rays in the end, also where their number is the largest int
            if (lane == leader) first = (unsigned)atomicAdd(next, __popc(idle));
            first = __shfl_sync(team, first, leader);
            const unsigned own = first + __popc(idle & ((1u << lane) - 1u));
            if ((idle >> lane & 1u) && own < count) walk.begin(all, (int)own, stack);
            more = first + __popc(idle) < count;
            __syncwarp(team);
            if (__ballot_sync(team, walk.number >= 0) == 0) break;
        }
        do {
#pragma unroll 1
            for (int k = 0; k < STEPS; ++k)
                if (walk.is_inner()) walk.step(all, stack);
        } while (__popc(__ballot_sync(team, walk.is_inner())) > KEEP);
        if (walk.is_leaf()) walk.leaf(all, stack);
        __syncwarp(team);
    }
    // no thread fetches any more when the last ones of the launch come here
    if (lane == leader && atomicAdd(next + 1, __popc(team)) + __popc(team) == threads) next[0] = next[1] = 0;
}
#endif

#if !defined(__CUDA_ARCH__)
/// The ray of an item on the CPU.
template <bool FROM_ZERO, class All> inline void walk_alone(const All& all, int i)
{
    int stack[All::LEVELS + 1];
    Walk<All, FROM_ZERO> walk;
    walk.begin(all, i, stack);
    while (walk.node != DONE) {
        while (walk.is_inner()) walk.step(all, stack);
        if (walk.is_leaf()) walk.leaf(all, stack);
    }
    walk.store(all);
}
#endif

/// On CUDA the rays of a launch, by all of its threads; else ray i.
template <int FETCH, int KEEP, int STEPS, bool FROM_ZERO, class All>
inline CUDA_CALLABLE void walk_rays(const All& all, int* next, int threads, int i)
{
#if defined(__CUDA_ARCH__)
    (void)i;
    walk_all<FETCH, KEEP, STEPS, FROM_ZERO>(all, next, threads);
#else
    (void)next, (void)threads;
    walk_alone<FROM_ZERO>(all, i);
#endif
}

}  // namespace
}  // namespace wrt
