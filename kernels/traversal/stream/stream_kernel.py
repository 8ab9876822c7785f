"""Stream traversal: hundreds of rays, filtered node by node into compact lists of active rays.

**Problem.** A packet visits every node that any of its rays visits, with all of them; once the rays diverge, most lanes are
idle. A single ray has few lanes' worth of work between two decisions, and waits for each of them.

**Idea.** Tracing is filtering. A stream of rays reaches a node; a filter tests all of them and appends those that pass to the
stream of each child. Only active rays continue, and the lists of their numbers are compact, so rays that meet at a node need
not be neighbours: the longer the stream, the fuller the vectors. At a leaf the rays are filtered by the triangles in the same
way (Gribble and Ramani 2008; Wald et al. 2007; Rahikainen 2013, section 3.4).

**Implementation.** A stream has up to `StreamConfig.rays` rays, with any origins, signs and ranges. Its rays are in a
local array (`stream_ray`); everything else is lists of their numbers.
* In the wide BVH (`stream_bvh`) the lanes of a box test hold the W children, as for a single ray. The gain of a stream is that
  there is no decision between consecutive tests, and that the children's lists are compacted 16 rays at a time. At the root the
  lanes hold rays, while they are loaded (`stream_load`).
* In the kd-tree (`stream_kdtree`) the lanes hold rays, as in the papers.
* At leaves, pairs (ray, leaf) are filtered (`stream_candidates`): which triangles of a block does the ray's line meet? One ray
  is tested against W triangles, because most lists at leaves are too short for W rays x one triangle, and blocks are full. The
  remaining candidates are evaluated 16 at a time, across rays. In the wide BVH, leaves of few triangles that many rays meet are
  tested with rays in the lanes (`stream_leaves`).

**Differences from the papers.** The papers simulate a machine that gathers and compacts W rays at a time. Current CPUs have
such instructions; elsewhere the compaction is a loop without branches. Finished rays (any hit), and rays whose best hit lies
before a child, are dropped in the BVH when the child's list is filtered by its boxes, because these intervals end at the best
hit; in the kd-tree when its list is popped from the stack.

**Limits.** The order of children is the same for all rays of a list: a child is visited when the first of them enters it, so
some rays visit nodes that a single ray would skip. A stream needs some hundred bytes of local memory per ray and occupies one
thread; this does not suit CUDA, where it compiles but has not been measured. Neighbouring rays are faster in packets, whose
culling avoids most of their tests.

References: wald-2007-streams; gribble-ramani-2008; rahikainen-2013 (section 3.4).
"""

import ctypes
from functools import cache

import warp as wp

from wrt.kernels.answers.answer_kind import BestHit
from wrt.kernels.layout.ray_batch import HitBatch
from wrt.kernels.runtime import native
from wrt.kernels.simd.boxes import RaySlabs
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle import TRIANGLE_TESTS

LIST_LANES = 16
"""Elements of a list that are filtered at a time, independent of the tree's width."""

RAY_BITS = 16
"""Bits of a ray's number in a list of the BVH; the bits of the children are above."""

NONE, NEAR, FAR = range(3)
"""Which child of a node comes first: any, the nearest, the farthest."""


@wp.struct
class StreamCounters:
    """Work done for one stream, recorded at the number of its first ray.

    A vector of a list is full if all its lanes hold rays. The lanes of a triangle test hold the W triangles of a block, or rays
    of a list if the leaf has few triangles.
    """

    nodes: int
    """Rays tested at inner nodes: a list of n rays counts as n. Rays that leave when they are loaded do not count."""
    leaves: int
    """Pairs (ray, leaf)."""
    triangles: int
    """Pairs of a ray and a triangle that were tested."""
    traversal_slots: int
    """Lanes of the vectors that filtered lists."""
    traversal_active: int
    """Those of them that held a ray."""
    intersection_slots: int
    """Lanes of the triangle tests."""
    intersection_active: int
    """Those of them that held a triangle."""


@wp.struct
class StreamCounterRows:
    """The array to which kernels write stream counters; `wrt.kernels.traversal.leaf.CounterRows` explains why it is in a
    struct."""

    rows: wp.array(dtype=StreamCounters)


@wp.func
def round_up(count: int):
    """Number of lanes of the vectors that a list of `count` rays fills."""
    return (count + wp.static(LIST_LANES - 1)) & wp.static(-LIST_LANES)


def rays_per_item(config: TraversalConfig) -> int:
    """Rays of a stream; an item of the kernel is one or more streams (`RayBatch.run`)."""
    return config.stream.rays


@cache
def stream_ray(triangle_test: str) -> type:
    """The struct of a ray of a stream: the data that tests need, and its best hit."""
    RayState = TRIANGLE_TESTS[triangle_test].ray_state

    class StreamRay:
        slabs: RaySlabs
        t_min: float
        best: BestHit
        state: RayState
        number: int

    StreamRay.__doc__ = """The data of a ray for box and triangle tests. `best.t` is -inf if it needs no more tests. `number`
    counts the rays of the batch from the first that was loaded."""
    return wp.struct(StreamRay)


def ray_words(triangle_test: str) -> int:
    """4-byte words of a `stream_ray`."""
    return ctypes.sizeof(stream_ray(triangle_test).ctype) // 4


@cache
def get_ray(triangle_test: str) -> wp.Function:
    """`wp.func(stream, k, slabs, state, best) -> t_min`: loads ray k of a stream."""
    StreamRay = stream_ray(triangle_test)
    RayState = TRIANGLE_TESTS[triangle_test].ray_state

    @wp.func_native(
        "slabs = rays.data[k].slabs; state = rays.data[k].state; best = rays.data[k].best; return rays.data[k].t_min;"
    )
    def get_ray_native(
        rays: wp.array(dtype=StreamRay),
        k: int,
        slabs: wp.ref[RaySlabs],
        state: wp.ref[RayState],
        best: wp.ref[BestHit],
    ) -> float: ...

    return get_ray_native


@cache
def ray_number(triangle_test: str) -> wp.Function:
    """`func(stream, k) -> int`: which of the loaded rays ray k of a stream is."""

    @wp.func_native("return rays.data[k].number;")
    def number_of(rays: wp.array(dtype=stream_ray(triangle_test)), k: int) -> int: ...

    return number_of


_MISSES = {
    "t": "for (int k = 0; k < count; ++k) hits.t.data[begin + k] = __builtin_bit_cast(float, 0x7f800000);",
    "primitive": "for (int k = 0; k < count; ++k) hits.primitive.data[begin + k] = -1;",
    "uv": "for (int k = 0; k < count; ++k) hits.uv.data[begin + k] = wp::vec2(0.0f, 0.0f);",
    "occluded": "for (int k = 0; k < count; ++k) hits.occluded.data[begin + k] = false;",
    "counts": "for (int k = 0; k < count; ++k) hits.counts.data[begin + k] = 0;",
}
"""What writes each array of answers for rays that miss (`COLUMNS`)."""


@cache
def store_stream(config: TraversalConfig) -> wp.Function:
    """`wp.func(stream, size, begin, count, hits)`: writes the results of the rays begin .. begin + count - 1, of which `size`
    are in the stream; the others miss."""
    StreamRay, number_of = stream_ray(config.triangle_test), ray_number(config.triangle_test)
    store_one = config.answer.stored.store

    @native.func_native("lanes.h", "\n".join(_MISSES[name] for name in config.answer.stored.columns))
    def store_misses(begin: int, count: int, hits: HitBatch): ...

    if config.answer.rules.ends_at_first:

        @native.func_native(
            "lanes.h",
            """
            WRT_SCALAR for (int k = 0; k < size; ++k) {
                occluded.data[begin + rays.data[k].number] = rays.data[k].best.primitive >= 0;
            }
        """,
        )
        def store_any(rays: wp.array(dtype=StreamRay), size: int, begin: int, occluded: wp.array(dtype=wp.bool)): ...

        @wp.func
        def store_occluded(stream: wp.array(dtype=StreamRay), size: int, begin: int, count: int, hits: HitBatch):
            if size < count:
                store_misses(begin, count, hits)
            store_any(stream, size, begin, hits.occluded)

        return store_occluded

    @wp.func_native("best = rays.data[k].best;")
    def get_best(rays: wp.array(dtype=StreamRay), k: int, best: wp.ref[BestHit]): ...

    @wp.func
    def store(stream: wp.array(dtype=StreamRay), size: int, begin: int, count: int, hits: HitBatch):
        if size < count:
            store_misses(begin, count, hits)
        for k in range(size):
            best = BestHit()
            get_best(stream, k, best)
            store_one(hits, begin + number_of(stream, k), best)

    return store
