"""Crossings: how a block of triangles offers its hits one by one, and how a crossing is offered once, if its triangle is in
several leaves. And the block step of kinds of answers that test triangles themselves.

**Problem.** A closest hit may be found twice, and a ray on an edge may hit both triangles there: the result is the same. A
count would be wrong. The triangle test decides edges and vertices (`TriangleTest.crossing`), and every triangle is in one leaf
of a BVH, unless it was split (see below); but a kd-tree lists a triangle in each leaf that it overlaps.

**Idea.** A mailbox would have to remember every triangle that a ray has crossed. Instead, a crossing is reported only in the
leaf that owns it. The interval of a leaf on the ray must contain the t of the hit, which excludes nearly all other leaves.
Intervals are conservative (`wrt.kernels.simd.boxes`), so those of neighbours overlap slightly, and a hit in the overlap has
several leaves. Of the leaves that list its triangle and whose intervals contain its t, the first one in the order of the nodes
owns it. A leaf tests for an earlier one: on the path from the root to the leaf, at each node where the path goes to the right
child, it searches the left child if its interval contains t.

**Uniqueness and existence.** The first leaf depends only on the ray, t and the triangle, and a leaf whose interval contains t
is visited. Such a leaf exists. In a tree without split clipping, descend from the root: if the triangle straddles the plane, t
is in the near interval, or beyond its end and so after the start of the far interval. If the triangle does not straddle the
plane, its box lies on one side, t is in the interval of the box, and rounding is monotone. For clipped triangles see
`wrt.builders.core.clip`.

Kinds of answers to which a hit may be offered twice do not need this (`Rules.once`).

**Cost.** A leaf searches only for a hit in the overlap with its neighbours, which is as wide as the slack of the boxes: one hit
in many thousands.

**In a BVH after spatial splits** (`wrt.builders.bvh.spatial.spatial_build`) a triangle is in several leaves, whose boxes are
around its parts. The boxes overlap a little, and those of other triangles in the leaves enlarge them, so a ray may find the
same crossing in two leaves. As in a kd-tree, of the places that list the triangle, the first whose leaf has an interval on the
ray that contains the t of the hit owns the crossing. All leaves that might be the owner are below boxes that contain t, so a
search from the root with the range [t, t] finds them. The walk visits all of them: its range contains t. The cost is a search
around a point of the ray for each crossing (notebooks/records/2026-11-23-spatial-splits-and-compact-subtrees.md).
"""

from functools import cache

import warp as wp

from wrt.kernels.answers.answer_kind import BestHit
from wrt.kernels.layout import bvh_nodes as bvh
from wrt.kernels.layout import kdtree_nodes as kdtree
from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.kdtree_nodes import LEAF, MAX_TREE_DEPTH, KdNodes
from wrt.kernels.layout.unchecked import load_int, store_int
from wrt.kernels.simd.box_lanes import intersected_boxes
from wrt.kernels.simd.boxes import RaySlabs, cross_plane
from wrt.kernels.simd.lanes import lanes, lowest_bit
from wrt.kernels.traversal.leaf import Leaf, clamp_block, leaf_search
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks


@cache
def owns_shared(width: int, levels: int) -> wp.Function:
    """`wp.func(tree, triangles, slot, slabs, t) -> bool`: whether the place `slot` of a leaf reports the crossing at t of the
    triangle that it lists.

    Args:
        width: children of a node and triangles of a block, at least 2.
        levels: greatest number of inner nodes on a path.
    """
    test_boxes, Lanes, room = intersected_boxes(width), lanes(width), levels * (width - 1) + 1

    @wp.func
    def owns(tree: WideNodes, triangles: TriangleBlocks, slot: int, slabs: wp.ref[RaySlabs], t: float):
        waiting = wp.zeros(shape=(room,), dtype=int)
        store_int(waiting, 0, 0)
        size = int(1)
        first = bool(True)
        inside = bool(False)  # a leaf is tested whether or not its own part of the ray contains t
        primitive = triangles.primitive[slot]
        while size > 0 and first:
            size -= 1
            node = load_int(waiting, size)
            entry = Lanes()
            mask = test_boxes(tree.bounds, node, slabs, t, t, entry)
            while mask != wp.uint32(0):
                child = load_int(tree.child, node * wp.static(width) + lowest_bit(mask))
                mask = mask & (mask - wp.uint32(1))
                if child >= 0:
                    store_int(waiting, size, child)
                    size += 1
                else:
                    place = bvh.first_block(child) * wp.static(width)
                    end = place + bvh.leaf_triangles(child)
                    inside = inside or (place <= slot and slot < end)
                    end = wp.min(end, slot)
                    while place < end:
                        if triangles.primitive[place] == primitive:
                            first = False
                        place += 1
        return first and inside

    return owns


@cache
def offering_step(config: TraversalConfig, Tree: type) -> wp.Function:
    """`wp.func(tree, leaf, block, search, cells, hits, i, best) -> best`: offers the hits of a leaf's block.

    leaf: `Leaf` that ray i is in. search: `leaf_search`, where the triangles are. cells: the ray in the tree's space, which may
    be another. hits: `State` of `wrt.kernels.answers.answer_kind.Search`.
    """
    test, width, answer = TRIANGLE_TESTS[config.triangle_test], config.width, config.answer
    Lanes, LeafSearch = lanes(width), leaf_search(config.triangle_test)
    intersect_block = test.forms(answer.rules.crossings, answer.rules.oriented).block_test(width)
    clamp = clamp_block(test.record, width, config.cull_backfaces)
    accept, owns, Search = answer.search.accept, owns_crossing(width), answer.search.State
    owns_split = owns_shared(max(width, 2), config.stack.levels)
    in_cells = answer.rules.once and Tree is KdNodes
    in_boxes = answer.rules.once and Tree is WideNodes and config.shared_leaves

    @wp.func
    def step(
        tree: Tree,
        leaf: Leaf,
        block: int,
        search: wp.ref[LeafSearch],
        cells: wp.ref[RaySlabs],
        hits: wp.ref[Search],
        i: int,
        best: BestHit,
    ):
        t_lanes = Lanes()
        u_lanes = Lanes()
        v_lanes = Lanes()
        mask = intersect_block(search.triangles.records, block, search.state, t_lanes, u_lanes, v_lanes)
        if mask != wp.uint32(0):
            mask = clamp(search.triangles.records, block, search.slabs, mask, t_lanes, leaf.within[0], leaf.within[1])
        while mask != wp.uint32(0):
            lane = lowest_bit(mask)
            mask = mask & (mask - wp.uint32(1))
            slot = block * wp.static(width) + lane
            owned = bool(True)
            if wp.static(in_cells):
                owned = owns(tree, leaf.node, leaf.within, search.triangles, slot, cells, t_lanes[lane])
            if wp.static(in_boxes):
                owned = owns_split(tree, search.triangles, slot, cells, t_lanes[lane])
            if owned:
                primitive = search.triangles.primitive[slot]
                best = accept(hits, i, best, t_lanes[lane], primitive, u_lanes[lane], v_lanes[lane])
        return best

    return step


@wp.func
def overlap(slabs: wp.ref[RaySlabs]):
    """Upper bound of the overlap of the intervals of two children, rounding included; inf or NaN for a ray parallel to an axis.

    A ray that stays in the widened plane has its whole interval in both children.
    """
    widest = float(0.0)
    for axis in range(3):
        width = wp.abs(slabs.origin_in[axis] - slabs.origin_out[axis]) * wp.abs(slabs.inverse[axis])
        widest = wp.where(width <= widest, widest, width)
    return 2.0 * widest


@wp.func
def contains_t(crossing: wp.vec3, is_left: bool, t: float):
    """Whether the interval of a child, as bounded by its parent's plane, contains t; crossing: see `cross_plane`."""
    is_near = is_left == (not (crossing[0] < 0.0))
    return (is_near and not (t > crossing[1])) or (not is_near and not (t < crossing[2]))


@cache
def is_listed(width: int) -> wp.Function:
    """`wp.func(tree, root, triangles, primitive, slabs, t) -> bool`: whether a leaf at or below a node lists the triangle and
    contains t."""

    @wp.func
    def search(tree: KdNodes, root: int, triangles: TriangleBlocks, primitive: int, slabs: wp.ref[RaySlabs], t: float):
        waiting = wp.zeros(shape=(MAX_TREE_DEPTH,), dtype=int)
        store_int(waiting, 0, root)
        size = int(1)
        found = bool(False)
        while size > 0 and not found:
            size -= 1
            node = load_int(waiting, size)
            word = kdtree.load_node(tree.nodes, node)
            axis = kdtree.split_axis(word)
            if axis == LEAF:
                slot = kdtree.first_block(word) * wp.static(width)
                end = slot + kdtree.leaf_triangles(word)
                while slot < end and not found:
                    found = triangles.primitive[slot] == primitive
                    slot += 1
            else:
                crossing = cross_plane(slabs, axis, kdtree.split_position(word))
                if contains_t(crossing, False, t):
                    store_int(waiting, size, kdtree.right_child(word))
                    size += 1
                if contains_t(crossing, True, t):
                    store_int(waiting, size, node + 1)
                    size += 1
        return found

    return search


@cache
def owns_crossing(width: int) -> wp.Function:
    """`wp.func(tree, leaf, interval, triangles, slot, slabs, t) -> bool`: whether this leaf reports the crossing.

    leaf: a leaf that lists the triangle in the slot. interval: its interval of t, which contains t.
    """
    search = is_listed(width)

    @wp.func
    def owns(
        tree: KdNodes,
        leaf: int,
        interval: wp.vec2,
        triangles: TriangleBlocks,
        slot: int,
        slabs: wp.ref[RaySlabs],
        t: float,
    ):
        margin = overlap(slabs)
        owned = bool(True)
        if not (t > interval[0] + margin and t < interval[1] - margin):
            node = int(tree.root)
            while owned and node != leaf:
                word = kdtree.load_node(tree.nodes, node)
                right = kdtree.right_child(word)
                if leaf < right:  # nodes are in depth-first order
                    node += 1
                else:
                    crossing = cross_plane(slabs, kdtree.split_axis(word), kdtree.split_position(word))
                    if contains_t(crossing, True, t):
                        owned = not search(tree, node + 1, triangles, triangles.primitive[slot], slabs, t)
                    node = right
        return owned

    return owns


def make_leaf_step(config: TraversalConfig, Tree: type) -> wp.Function:
    """A block step with the parameters of `wrt.kernels.traversal.crossings.offering_step`."""
    return (own_test_step if config.answer.search.own_test is not None else offering_step)(config, Tree)


@cache
def own_test_step(config: TraversalConfig, Tree: type) -> wp.Function:
    """The step of a kind with a test of its own: it gets the triangles whose boxes the ray meets; `hits` is its search."""
    test, width, answer = TRIANGLE_TESTS[config.triangle_test], config.width, config.answer
    Lanes, LeafSearch, meet_boxes = lanes(width), leaf_search(config.triangle_test), clamp_block(test.record, width)
    lane_mask, search = (1 << width) - 1, answer.search
    Search, test_triangle, best_of = search.State, search.own_test, search.best_of

    @wp.func
    def step(
        tree: Tree,
        leaf: Leaf,
        block: int,
        search: wp.ref[LeafSearch],
        cells: wp.ref[RaySlabs],
        hits: wp.ref[Search],
        i: int,
        best: BestHit,
    ):
        starts = Lanes(leaf.within[0])
        mask = wp.uint32(wp.static(lane_mask))
        mask = meet_boxes(search.triangles.records, block, search.slabs, mask, starts, leaf.within[0], best.t)
        while mask != wp.uint32(0):
            primitive = search.triangles.primitive[block * wp.static(width) + lowest_bit(mask)]
            mask = mask & (mask - wp.uint32(1))
            if primitive >= 0:
                test_triangle(hits, primitive)
        return best_of(hits, best)

    return step
