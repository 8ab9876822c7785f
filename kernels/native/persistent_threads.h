// Walks of trees by persistent threads: a thread that is done takes the next ray or point
// (wrt.kernels.traversal.persistent).
#pragma once
#include "lanes.h"

namespace wrt {
namespace {

/// The node of a walk that is done, and those of one that is done with an instance and goes back to the node above it, or on to
/// the next of a list; inner nodes are less, leaves negative.
constexpr int DONE = 0x7fffffff, BACK = 0x7ffffffe, NEXT = 0x7ffffffd;

/// Bits of a leaf's word that hold the number of its triangles (wrt.kernels.layout.bvh_nodes).
constexpr int LEAF_BITS = 6;

#if defined(__CUDA_ARCH__)
/// `count` walks, of rays or points, by all threads of a launch. next: number of the next one that no thread has, and how many
/// threads are done; both are 0 before and after. FETCH: threads of a warp without a walk for which new ones are fetched. KEEP:
/// threads that may wait at a node for those of the warp that have come to leaves. STEPS: between two votes about that.
///
/// Where walks also move between spaces (`Walk::MOVES`), the threads that do, and those that test triangles, take turns: the
/// more numerous ones are next, while the others wait to become more.
///
/// Votes take the threads that began (`team`), not those that are active: else a warp that has parted votes apart for good.
template <int FETCH, int KEEP, int STEPS, class Walk, class All>
__device__ void walk_all(const All& all, unsigned count, int* next, int threads)
{
    const unsigned team = __activemask();
    const int lane = threadIdx.x & 31, leader = __ffs(team) - 1;
    int stack[All::LEVELS];
    Walk walk;
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
            unsigned first = 0;  // beyond the last one in the end, also where their number is the largest int
            if (lane == leader) first = (unsigned)atomicAdd(next, __popc(idle));
            first = __shfl_sync(team, first, leader);
            const unsigned own = first + __popc(idle & ((1u << lane) - 1u));
            if ((idle >> lane & 1u) && own < count) walk.begin(all, (int)own, stack);
            more = first + __popc(idle) < count;
            __syncwarp(team);
            if (__ballot_sync(team, walk.number >= 0) == 0) break;
        }
        if constexpr (Walk::MOVES) {
            for (;;) {
                const int inner = __popc(__ballot_sync(team, walk.is_inner()));
                if (inner <= KEEP && (inner == 0 || __any_sync(team, walk.is_leaf()))) break;
#pragma unroll 1
                for (int k = 0; k < STEPS; ++k)
                    if (walk.is_inner()) walk.step(all, stack);
            }
            const bool moves = walk.moves(), tests = walk.is_leaf() && !moves;
            const int moving = __popc(__ballot_sync(team, moves)), testing = __popc(__ballot_sync(team, tests));
            if (moving >= testing ? moves : tests) walk.leaf(all, stack);
        } else {
            do {
#pragma unroll 1
                for (int k = 0; k < STEPS; ++k)
                    if (walk.is_inner()) walk.step(all, stack);
            } while (__popc(__ballot_sync(team, walk.is_inner())) > KEEP);
            if (walk.is_leaf()) walk.leaf(all, stack);
        }
        __syncwarp(team);
    }
    // no thread fetches any more when the last ones of the launch come here
    if (lane == leader && atomicAdd(next + 1, __popc(team)) + __popc(team) == threads) next[0] = next[1] = 0;
}
#endif

}  // namespace
}  // namespace wrt
