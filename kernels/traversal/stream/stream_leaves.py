"""Leaves of a node that a stream has come to.

Most leaves are tested ray by ray, against the triangles of a block (`wrt.kernels.traversal.stream.stream_candidates`). A leaf
of few triangles leaves most lanes of a block idle. In scenes with walls and floors such leaves are the ones that most rays
meet, and many rays of a list meet the same. So these are tested with rays in the lanes: 16 of them are read and transposed, and
each triangle of the leaf is tested against all of them, without looking for candidates first. Figures:
notebooks/records/2026-11-24-streams.md.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.bvh_nodes import WideNodes, leaf_triangles
from wrt.kernels.layout.unchecked import load_int
from wrt.kernels.runtime import native
from wrt.kernels.simd.lanes import lowest_bit
from wrt.kernels.traversal.stream.stream_candidates import Pairs, StreamHits, evaluates_in_lanes, lane_form, pair_tester
from wrt.kernels.traversal.stream.stream_kernel import StreamCounters, round_up, stream_ray
from wrt.kernels.traversal.stream.stream_lanes import collect_words, list_leaves
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks

FEW_TRIANGLES = 4
"""Triangles of a leaf that is tested with rays in lanes, at most."""

MANY_RAYS = 32
"""Rays of a list from which that pays."""


@cache
def leaf_in_lanes(config: TraversalConfig) -> wp.Function:
    """`func(records, primitives, rays, words, begin, count, leaf)`: tests the rays of a list against all triangles of a
    leaf of one block. words[begin .. begin + count - 1]: the list, of whose words only the rays' numbers remain. leaf: a child
    word of `wrt.kernels.layout.bvh_nodes`."""
    StreamRay = stream_ray(config.triangle_test)
    arguments = "records.data, primitives.data, rays.data, words.data + begin, count, leaf"

    @native.func_native("stream_candidates.h", f"wrt::test_leaf<{lane_form(config)}>({arguments});")
    def test_leaf_native(
        records: wp.array(dtype=float),
        primitives: wp.array(dtype=int),
        rays: wp.array(dtype=StreamRay),
        words: wp.array(dtype=int),
        begin: int,
        count: int,
        leaf: int,
    ): ...

    return test_leaf_native


@wp.struct
class NodeList:
    """The list of a node."""

    node: int
    begin: int
    """Where it begins in the stack of words; what is behind it may be written."""
    size: int
    """Number of its words."""
    leaves: wp.uint32
    """Bits of the leaves that a ray meets."""


@cache
def small_leaf_tester(config: TraversalConfig) -> wp.Function:
    """`wp.func(tree, triangles, stream, words, list, work) -> leaves`: tests the leaves of few triangles, if the list is long;
    arguments as in `leaf_tester`. Returns the bits of the leaves that remain."""
    StreamRay, test_leaf = stream_ray(config.triangle_test), leaf_in_lanes(config)
    width, counting = config.width, config.counters

    @wp.func
    def test_small_leaves(
        tree: WideNodes,
        triangles: TriangleBlocks,
        stream: wp.array(dtype=StreamRay),
        words: wp.array(dtype=int),
        list: NodeList,
        work: wp.ref[StreamCounters],
    ):
        large = wp.uint32(list.leaves)
        left = wp.where(list.size >= wp.static(MANY_RAYS), list.leaves, wp.uint32(0))
        behind = list.begin + list.size
        while left != wp.uint32(0):
            lane = lowest_bit(left)
            left = left & (left - wp.uint32(1))
            leaf = load_int(tree.child, list.node * wp.static(width) + lane)
            if leaf_triangles(leaf) <= wp.static(FEW_TRIANGLES):
                large = large & ~(wp.uint32(1) << wp.uint32(lane))
                met = collect_words(words, list.begin, list.size, wp.uint32(1) << wp.uint32(lane))
                test_leaf(triangles.records, triangles.primitive, stream, words, behind, met, leaf)
                if wp.static(counting):
                    work.leaves += met
                    work.triangles += met * leaf_triangles(leaf)
                    work.intersection_slots += round_up(met) * leaf_triangles(leaf)
                    work.intersection_active += met * leaf_triangles(leaf)
        return large

    return test_small_leaves


@cache
def leaf_tester(config: TraversalConfig) -> wp.Function:
    """`wp.func(tree, triangles, stream, words, list, pairs, found, work)`: tests the leaves of the node of a
    `NodeList`.

    words: the stack of words. found: `StreamHits`.
    """
    StreamRay, list_pairs, test_pairs = stream_ray(config.triangle_test), list_leaves(config.width), pair_tester(config)
    in_lanes = evaluates_in_lanes(config) and config.width >= FEW_TRIANGLES
    test_small = small_leaf_tester(config) if in_lanes else None

    @wp.func
    def test_leaves(
        tree: WideNodes,
        triangles: TriangleBlocks,
        stream: wp.array(dtype=StreamRay),
        words: wp.array(dtype=int),
        list: NodeList,
        pairs: wp.ref[Pairs],
        found: wp.ref[StreamHits],
        work: wp.ref[StreamCounters],
    ):
        left = wp.uint32(list.leaves)
        if wp.static(in_lanes):
            left = test_small(tree, triangles, stream, words, list, work)
        if left != wp.uint32(0):
            behind = list.begin + list.size
            met = collect_words(words, list.begin, list.size, left)
            listed = int(0)
            while listed < met:
                paired = list_pairs(tree.child, list.node, words, behind, met, left, listed, pairs)
                test_pairs(triangles, stream, pairs, paired, found, work)

    return test_leaves
