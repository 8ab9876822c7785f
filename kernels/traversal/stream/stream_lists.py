"""The lists of streams, and how they are compacted.

A list is compacted without a branch: every number is written to the end of the new list, and the end moves on only past
those that stay. Where the compiler knows AVX-512, one instruction does that for 16 numbers. Both write up to 16 numbers
past the end, so every list has `LIST_LANES` numbers of room behind it; a list may be compacted in place, because what is
written never reaches past what has been read.
"""

from functools import cache

import warp as wp

from wrt.kernels.simd.lanes import BITS, FOR_LANES, lane_bits
from wrt.kernels.traversal.stream.stream_kernel import LIST_LANES, RAY_BITS

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

PAIRS = 256
"""Pairs, and candidates, that wait at most before they are tested; lists have room for those that one more step finds."""

PairList = wp.types.vector(length=PAIRS + 2 * LIST_LANES, dtype=wp.int32)


@wp.struct
class Pairs:
    """Lists of pairs of a ray and something that it may meet."""

    rays: PairList
    """Rays of the pairs to be tested, and"""
    leaves: PairList
    """their leaves: child words of `wrt.kernels.layout.bvh_nodes`."""
    candidate_rays: PairList
    """Rays whose line meets a triangle, and"""
    candidates: PairList
    """the triangle's slot in its block."""


@wp.func_native("leaf = pairs.leaves.c[p]; return pairs.rays.c[p];")
def load_pair(pairs: wp.ref[Pairs], p: int, leaf: wp.ref[int]) -> int:
    """Ray and leaf of a pair."""
    ...


@wp.func_native("pairs.rays.c[p] = ray; pairs.leaves.c[p] = leaf;")
def store_pair(pairs: wp.ref[Pairs], p: int, ray: int, leaf: int):
    """Puts a pair into its place."""
    ...


@wp.func_native("slot = pairs.candidates.c[p]; return pairs.candidate_rays.c[p];")
def load_candidate(pairs: wp.ref[Pairs], p: int, slot: wp.ref[int]) -> int:
    """Ray and slot of a candidate."""
    ...


LISTS = f"""{FOR_LANES}
    constexpr int L = {LIST_LANES}, RAY_BITS = {RAY_BITS}, RAY = (1 << RAY_BITS) - 1;
{lane_bits("L")}{BITS}#if defined(__AVX512F__) && defined(__clang__) && !defined(__CUDA_ARCH__)
    auto wrt_append = [](int* to, const int* from, unsigned mask) {{
        wrt_ints v;
        __builtin_memcpy(&v, from, sizeof(v));
        v = __builtin_ia32_compresssi512_mask(v, v, (unsigned short)mask);
        __builtin_memcpy(to, &v, sizeof(v));
        return (int)__builtin_popcount(mask);
    }};
#else
    auto wrt_append = [](int* to, const int* from, unsigned mask) {{
        int size = 0;
        for (int i = 0; i < L; ++i) {{ const int value = from[i]; to[size] = value; size += mask >> i & 1u; }}
        return size;
    }};
#endif
"""
"""Head of a list snippet. `wrt_bits(flags)`: a bit for each of L flags that is not 0.
`wrt_append(to, from, mask)`: the numbers of the mask, in order; returns how many."""


_APPEND_CANDIDATES = """
    WRT_FETCH(primitives.data + (size_t)block * W);
    int slot[L];
    WRT_FOR(L, i) { pairs.candidate_rays.c[count + i] = ray; slot[i] = block * W + i; }
    return count + wrt_append(pairs.candidates.c + count, slot, mask);
"""


@cache
def append_candidates(width: int) -> wp.Function:
    """`func(primitives, pairs, count, ray, block, mask) -> int`: a ray with the triangles of a mask of a block, appended to the
    candidates 0 .. count - 1; how many they are then.

    The ids of the block's triangles are asked for: no cache has them yet when the candidates' turn comes, and without it random
    rays took up to 1.2 times as long. (Asking for the blocks themselves ahead of their turn gained nothing.)
    """

    @wp.func_native(f"{LISTS}    constexpr int W = {width};{_APPEND_CANDIDATES}")
    def append_native(
        primitives: wp.array(dtype=int),
        pairs: wp.ref[Pairs],
        count: int,
        ray: int,
        block: int,
        mask: wp.uint32,
    ) -> int: ...

    return append_native
