// What all threads of a launch find together, the same in whatever order they come: least values, and sums in the order of the
// threads (wrt.builders.kdtree.levelwise). On CUDA a launch has whole blocks of threads, all of which come; on the CPU a thread
// is a warp and a block of its own.
#pragma once
#include "loops.h"

namespace wrt {
namespace {

#if defined(__CUDA_ARCH__)
constexpr unsigned ALL_LANES = 0xffffffffu;
#endif

/// Threads of a warp, and this one's place among them.
inline CUDA_CALLABLE int warp_lanes()
{
#if defined(__CUDA_ARCH__)
    return 32;
#else
    return 1;
#endif
}

inline CUDA_CALLABLE int warp_lane()
{
#if defined(__CUDA_ARCH__)
    return threadIdx.x & 31;
#else
    return 0;
#endif
}

/// A word becomes the least of it and the key. On CUDA, a look before is cheaper than to change it for nothing.
inline CUDA_CALLABLE void keep_less(long long* found, long long key)
{
#if defined(__CUDA_ARCH__)
    if (key < *(volatile long long*)found) atomicMin(found, key);
#else
    long long known = __atomic_load_n(found, __ATOMIC_RELAXED);
    while (key < known && !__atomic_compare_exchange_n(found, &known, key, true, __ATOMIC_RELAXED, __ATOMIC_RELAXED)) { }
#endif
}

/// keys[node] becomes the least of it and the keys of all threads of a warp with this node; -1 for none. Neighbours mostly have
/// one node, and the first of them does it.
inline CUDA_CALLABLE void keep_least(long long* keys, int node, long long key)
{
#if defined(__CUDA_ARCH__)
    const int lane = threadIdx.x & 31;
    for (int step = 1; step < 32; step <<= 1) {
        const long long other = __shfl_down_sync(ALL_LANES, key, step);
        const int other_node = __shfl_down_sync(ALL_LANES, node, step);
        if (lane + step < 32 && other_node == node && other < key) key = other;
    }
    const int node_before = __shfl_up_sync(ALL_LANES, node, 1);
    if (lane > 0 && node_before == node) return;
#endif
    if (node >= 0) keep_less(keys + node, key);
}

/// Adds to a word; returns what it was.
inline CUDA_CALLABLE long long add_to(long long* sum, long long value)
{
#if defined(__CUDA_ARCH__)
    return (long long)atomicAdd((unsigned long long*)sum, (unsigned long long)value);
#else
    return __atomic_fetch_add(sum, value, __ATOMIC_RELAXED);
#endif
}

/// Four sums side by side.
struct Sums {
    int of[4];

    inline CUDA_CALLABLE void add(const Sums& other)
    {
        for (int k = 0; k < 4; ++k) of[k] += other.of[k];
    }
};

/// What a block of threads tells those behind it: 64 bytes. `told` is 2 turn if it is the block's own sums, 2 turn + 1 if it is
/// the sums up to its end; less in turns before.
struct Tile {
    int told, unused[3];
    int own[4], upto[4], more[4];
};

#if defined(__CUDA_ARCH__)
inline __device__ void tell(Tile* tile, int* to, const Sums& sums, int told)
{
    __stcg((int4*)to, make_int4(sums.of[0], sums.of[1], sums.of[2], sums.of[3]));
    __threadfence();
    *(volatile int*)&tile->told = told;
}

/// The sums of all blocks before this one, by one warp of it: looks at 32 blocks at a time, back to one that has told the sums
/// up to its end (decoupled look-back; Merrill and Garland 2016).
inline __device__ Sums look_back(Tile* tiles, int turn, const Sums& own)
{
    const int lane = threadIdx.x & 31, block = blockIdx.x;
    Sums before = {};
    if (block > 0) {
        if (lane == 0) tell(tiles + block, tiles[block].own, own, 2 * turn);
        for (int last = block - 1;; last -= 32) {
            const int at = last - lane;
            int told = 2 * turn + 1;
            if (at >= 0) do
                    told = *(volatile int*)&tiles[at].told;
                while (told < 2 * turn);
            __syncwarp();
            __threadfence();
            int4 found = make_int4(0, 0, 0, 0);
            if (at >= 0) found = __ldcg((const int4*)(told & 1 ? tiles[at].upto : tiles[at].own));
            const unsigned ends = __ballot_sync(ALL_LANES, told & 1);
            const bool counts = ends == 0 || lane < __ffs(ends);
            Sums here = {counts ? found.x : 0, counts ? found.y : 0, counts ? found.z : 0, counts ? found.w : 0};
            for (int step = 16; step > 0; step >>= 1)
                for (int k = 0; k < 4; ++k) here.of[k] += __shfl_xor_sync(ALL_LANES, here.of[k], step);
            before.add(here);
            if (ends) break;
        }
    }
    if (lane == 0) {
        Sums upto = before;
        upto.add(own);
        tell(tiles + block, tiles[block].upto, upto, 2 * turn + 1);
    }
    return before;
}
#endif

/// The sums of all warps before this one; own: the same in all threads of a warp. tiles: one for each block, as they were left
/// by the turn before; turn: above 0, rises with each launch. On the CPU, the launch is one chunk.
inline CUDA_CALLABLE Sums sums_of_warps_before(Tile* tiles, int turn, const Sums& own)
{
#if defined(__CUDA_ARCH__)
    __shared__ Sums of_warp[32];
    __shared__ Sums of_blocks;
    const int warp = threadIdx.x >> 5, warps = blockDim.x >> 5;
    if ((threadIdx.x & 31) == 0) of_warp[warp] = own;
    __syncthreads();
    if (warp == 0) {
        Sums all = {};
        for (int w = 0; w < warps; ++w) all.add(of_warp[w]);
        const Sums before = look_back(tiles, turn, all);
        if (threadIdx.x == 0) of_blocks = before;
    }
    __syncthreads();
    Sums before = of_blocks;
    for (int w = 0; w < warp; ++w) before.add(of_warp[w]);
    return before;
#else
    Sums so_far = {};
    if (tiles->told == turn)
        for (int k = 0; k < 4; ++k) so_far.of[k] = tiles->upto[k];
    for (int k = 0; k < 4; ++k) tiles->upto[k] = so_far.of[k] + own.of[k];
    tiles->told = turn;
    return so_far;
#endif
}

/// The sums of all threads before this one; own: its own.
inline CUDA_CALLABLE Sums sums_before(Tile* tiles, int turn, const Sums& own)
{
#if defined(__CUDA_ARCH__)
    const int lane = threadIdx.x & 31;
    Sums upto = own, all;
    for (int k = 0; k < 4; ++k) {
        for (int step = 1; step < 32; step <<= 1) {
            const int other = __shfl_up_sync(ALL_LANES, upto.of[k], step);
            if (lane >= step) upto.of[k] += other;
        }
        all.of[k] = __shfl_sync(ALL_LANES, upto.of[k], 31);
    }
    Sums before = sums_of_warps_before(tiles, turn, all);
    for (int k = 0; k < 4; ++k) before.of[k] += upto.of[k] - own.of[k];
    return before;
#else
    return sums_of_warps_before(tiles, turn, own);
#endif
}

/// The threads of a warp for which something holds, as bits; and how many of them come before this one.
inline CUDA_CALLABLE unsigned vote(bool holds)
{
#if defined(__CUDA_ARCH__)
    return __ballot_sync(ALL_LANES, holds);
#else
    return holds;
#endif
}

inline CUDA_CALLABLE int count_votes(unsigned votes)
{
#if defined(__CUDA_ARCH__)
    return __popc(votes);
#else
    return (int)votes;
#endif
}

inline CUDA_CALLABLE int votes_before(unsigned votes)
{
#if defined(__CUDA_ARCH__)
    return __popc(votes & ((1u << (threadIdx.x & 31)) - 1u));
#else
    return (int)votes >> 1;
#endif
}

}  // namespace
}  // namespace wrt
