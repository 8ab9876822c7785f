"""The lists of streams, and their compaction.

A list is compacted without branches: every number is written to the end of the new list, and the end advances only past those
that stay. With AVX-512 one instruction does that for 16 numbers. With AVX2 eight numbers at a time are permuted, by an index
vector that a table holds for each of the 256 masks. (The instructions pdep and pext make the same vector, but take tens of
cycles on Zen 1 and 2.) All methods write up to 16 numbers past the end, so every list has `LIST_LANES` spare elements. A list
may be compacted in place, because the writes never pass the reads.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.ray_batch import HitBatch
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.traversal.stream.stream_kernel import LIST_LANES

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
class StreamHits:
    """Where hits go that are not stored with the rays of a stream: in queries for all hits."""

    hits: HitBatch
    begin: int
    """Number of the stream's first ray."""


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


@cache
def append_candidates(width: int, fetching: bool = True) -> wp.Function:
    """`func(primitives, pairs, count, ray, block, mask) -> int`: appends candidates of a ray and the triangles in the mask of a
    block.

    Returns the new number of candidates. If `fetching`, the ids of the triangles are prefetched, because they are not in a
    cache when the candidates are evaluated (notebooks/records/2026-11-22-stream-candidates.md).
    """
    call = f"wrt::append_candidates<{width}, {int(fetching)}>(primitives.data, pairs, count, ray, block, mask)"

    @native.func_native("stream.h", f"return {call};")
    def append_native(
        primitives: wp.array(dtype=int),
        pairs: wp.ref[Pairs],
        count: int,
        ray: int,
        block: int,
        mask: wp.uint32,
    ) -> int: ...

    return append_native
