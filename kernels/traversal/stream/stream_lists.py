"""The lists of streams, and their compaction.

A list is compacted without branches: every number is written to the end of the new list, and the end advances only past those
that stay. With AVX-512 one instruction does that for 16 numbers. With AVX2 eight numbers at a time are permuted, by an index
vector that a table holds for each of the 256 masks. (The instructions pdep and pext make the same vector, but take tens of
cycles on Zen 1 and 2.) All methods write up to 16 numbers past the end, so every list has `LIST_LANES` spare elements. A list
may be compacted in place, because the writes never pass the reads.
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.lanes import BITS, FOR_LANES, lane_bits
from wrt.kernels.traversal.stream.stream_kernel import LIST_LANES, RAY_BITS

exact_module(__name__)

PAIRS = 256
"""Greatest number of pairs, and of candidates, before they are tested; the lists also have room for those that one more step
finds."""

PairList = wp.types.vector(length=PAIRS + 2 * LIST_LANES, dtype=wp.int32)


@wp.struct
class Pairs:
    """Lists of pairs: (ray, leaf) to be tested, and (ray, triangle) candidates."""

    rays: PairList
    """Ray of each pair to be tested."""
    leaves: PairList
    """Leaf of each pair: a child word of `wrt.kernels.layout.bvh_nodes`."""
    candidate_rays: PairList
    """Ray of each candidate: its line meets the triangle."""
    candidates: PairList
    """Slot of the candidate's triangle: block * W + lane."""


@wp.struct
class RayIntervals:
    """A list of rays of a stream, or a stack of lists, with the interval of t in which each ray is in the list's node."""

    rays: wp.array(dtype=int)
    """Numbers of the rays in the stream."""
    entry: wp.array(dtype=float)
    leave: wp.array(dtype=float)


@wp.func_native("list.rays = rays; list.entry = entry; list.leave = leave;")
def set_arrays(
    list: wp.ref[RayIntervals], rays: wp.array(dtype=int), entry: wp.array(dtype=float), leave: wp.array(dtype=float)
):
    """Makes a list use local arrays; Warp assigns them to no field of a struct."""
    ...


@wp.func_native("leaf = pairs.leaves.c[p]; return pairs.rays.c[p];")
def load_pair(pairs: wp.ref[Pairs], p: int, leaf: wp.ref[int]) -> int:
    """Ray and leaf of a pair."""
    ...


@wp.func_native("pairs.rays.c[p] = ray; pairs.leaves.c[p] = leaf;")
def store_pair(pairs: wp.ref[Pairs], p: int, ray: int, leaf: int):
    """Stores a pair at index p."""
    ...


@wp.func_native("slot = pairs.candidates.c[p]; return pairs.candidate_rays.c[p];")
def load_candidate(pairs: wp.ref[Pairs], p: int, slot: wp.ref[int]) -> int:
    """Ray and slot of a candidate."""
    ...


def kept_lanes(mask: int) -> int:
    """Indices of the bits that are set in a mask of 8, one a byte, the first in the lowest byte; 0 in the bytes left over."""
    return sum(lane << 8 * place for place, lane in enumerate(lane for lane in range(8) if mask >> lane & 1))


KEPT_LANES = ", ".join(f"{kept_lanes(mask):#x}ull" for mask in range(256))
"""The table of `kept_lanes`, as C++."""

APPEND = f"""#if defined(__AVX512F__) && defined(__clang__) && !defined(__CUDA_ARCH__)
    auto wrt_append = [](int* to, const int* from, unsigned mask) {{
        wrt_ints v;
        __builtin_memcpy(&v, from, sizeof(v));
        v = __builtin_ia32_compresssi512_mask(v, v, (unsigned short)mask);
        __builtin_memcpy(to, &v, sizeof(v));
        return (int)__builtin_popcount(mask);
    }};
#elif defined(__AVX2__) && defined(__clang__) && !defined(__CUDA_ARCH__)
    static const unsigned long long WRT_KEPT_LANES[256] = {{{KEPT_LANES}}};
    auto wrt_append = [](int* to, const int* from, unsigned mask) {{
        typedef int ints __attribute__((ext_vector_type(8)));
        typedef unsigned char bytes __attribute__((ext_vector_type(8)));
        int size = 0;
        for (int i = 0; i < L; i += 8) {{
            const unsigned own = mask >> i & 255u;
            ints v; __builtin_memcpy(&v, from + i, sizeof(v));
            bytes lane; __builtin_memcpy(&lane, WRT_KEPT_LANES + own, sizeof(lane));
            v = __builtin_ia32_permvarsi256(v, __builtin_convertvector(lane, ints));
            __builtin_memcpy(to + size, &v, sizeof(v));
            size += __builtin_popcount(own);
        }}
        return size;
    }};
#else
    auto wrt_append = [](int* to, const int* from, unsigned mask) {{
        int size = 0;
        for (int i = 0; i < L; ++i) {{ const int value = from[i]; to[size] = value; size += mask >> i & 1u; }}
        return size;
    }};
#endif
"""
"""C++ of `wrt_append(to, from, mask)`: appends those of L numbers that the mask selects, in order, and returns how many. L is a
constant of the snippet: a multiple of 8, and 16 with AVX-512. It writes L numbers."""

LISTS = f"""{FOR_LANES}
    constexpr int L = {LIST_LANES}, RAY_BITS = {RAY_BITS}, RAY = (1 << RAY_BITS) - 1;
{lane_bits("L")}{BITS}{APPEND}"""
"""Head of a list snippet. `wrt_bits(flags)`: one bit for each of L flags that is not 0. `wrt_append`: see `APPEND`."""


BLOCK_LANES = f"""
#if defined(__AVX512F__) && !defined(__CUDA_ARCH__)
    enum {{ L = 16 }};
#else
    enum {{ L = (W + 7) / 8 * 8 }};
#endif
{lane_bits("L")}{BITS}{APPEND}"""
"""C++ of `wrt_bits` and `wrt_append` for the W lanes of a node or a block, in vectors of L. Without AVX-512, 8 of them
need half of the lanes of `LISTS`. L is an enumerator, so that a lambda without captures may use it."""


_APPEND_CANDIDATES = """
    if (FETCHING) WRT_FETCH(primitives.data + (size_t)block * W);
    int slot[L];
    WRT_FOR(L, i) { pairs.candidate_rays.c[count + i] = ray; }
#if defined(__AVX2__) && !defined(__AVX512F__) && defined(__clang__) && !defined(__CUDA_ARCH__)
    if (L == 8) {
        const unsigned char* const kept = (const unsigned char*)(WRT_KEPT_LANES + (mask & 255u));
        WRT_FOR(8, i) { slot[i] = block * W + kept[i]; }
        __builtin_memcpy(pairs.candidates.c + count, slot, sizeof(slot));
        return count + (int)wrt_count_bits(mask);
    }
#endif
    WRT_FOR(L, i) { slot[i] = block * W + i; }
    return count + wrt_append(pairs.candidates.c + count, slot, mask);
"""


@cache
def append_candidates(width: int, fetching: bool = True) -> wp.Function:
    """`func(primitives, pairs, count, ray, block, mask) -> int`: appends candidates of a ray and the triangles in the mask of a
    block.

    Returns the new number of candidates. If `fetching`, the ids of the triangles are prefetched, because they are not in a
    cache when the candidates are evaluated (notebooks/records/2026-11-22-stream-candidates.md).
    """

    constants = f"    constexpr int W = {width}; constexpr bool FETCHING = {int(fetching)};\n"

    @wp.func_native(f"{FOR_LANES}{constants}{BLOCK_LANES}{_APPEND_CANDIDATES}")
    def append_native(
        primitives: wp.array(dtype=int),
        pairs: wp.ref[Pairs],
        count: int,
        ray: int,
        block: int,
        mask: wp.uint32,
    ) -> int: ...

    return append_native
