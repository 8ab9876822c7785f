"""The walk of a wide tree with a row of keys per level: nearest child first, whatever the leaves contain.

Each level of the current path keeps the keys of its W children (`wrt.kernels.simd.box_lanes`); the next child is their minimum,
computed in the lanes. A level is done as soon as its smallest key lies beyond the best hit. Leaves contain triangles
(`wrt.kernels.traversal.single.single_bvh`), instances (`wrt.kernels.traversal.two_level.instance_single`) or whole trees in
spaces of their own (`wrt.kernels.traversal.two_level.fuzzy_boxes`).
"""

from functools import cache

import warp as wp

from wrt.kernels.answers.answer_kind import BestHit
from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.unchecked import load_int, store_int
from wrt.kernels.simd.box_lanes import NO_CHILD, entry_of, nearest_child, ray_boxes
from wrt.kernels.simd.boxes import BoxRay
from wrt.kernels.traversal.leaf import Counters
from wrt.kernels.traversal.traversal_config import TraversalConfig


@cache
def make_key_walk(
    config: TraversalConfig, levels: int, Search: type, visit: wp.Function, enter_node: wp.Function | None = None
) -> wp.Function:
    """`wp.func(tree, root, ray, search, hits, i, best, work) -> best`: traverses the subtree of a node, for ray number i.

    Args:
        config: the specialisation; a node has at least 2 children.
        levels: greatest number of inner nodes on a path of the tree.
        Search: struct of the search state that leaves need.
        visit: `wp.func(tree, child, search, hits, i, best, work) -> best`: processes a leaf.
        enter_node: `wp.func(node, search)`: for measurements, is called at each inner node; None for nothing.
    """
    width, counting = max(config.width, 2), config.counters
    any_hit, Results = config.answer.rules.ends_at_first, config.answer.search.State
    test_boxes, nearest, row, noting = ray_boxes(width), nearest_child(width), levels * width, enter_node is not None

    @wp.func
    def walk_keys(
        tree: WideNodes,
        root: int,
        ray: BoxRay,
        search: wp.ref[Search],
        hits: wp.ref[Results],
        i: int,
        best: BestHit,
        work: wp.ref[Counters],
    ):
        keys = wp.zeros(shape=(row,), dtype=int)
        path = wp.zeros(shape=(levels,), dtype=int)
        store_int(path, 0, root)
        level = int(0)
        key = test_boxes(tree.bounds, root, ray.slabs, ray.t_min, best.t, keys, 0)
        if wp.static(counting):
            work.nodes += 1
            work.boxes += wp.static(width)
        if wp.static(noting):
            enter_node(root, search)
        while level >= 0:
            if entry_of(key, wp.static(width)) <= best.t:
                lane = key & wp.static(width - 1)
                store_int(keys, level * wp.static(width) + lane, NO_CHILD)
                child = load_int(tree.child, load_int(path, level) * wp.static(width) + lane)
                if child >= 0:
                    level += 1
                    store_int(path, level, child)
                    key = test_boxes(tree.bounds, child, ray.slabs, ray.t_min, best.t, keys, level * wp.static(width))
                    if wp.static(counting):
                        work.nodes += 1
                        work.boxes += wp.static(width)
                    if wp.static(noting):
                        enter_node(child, search)
                else:
                    best = visit(tree, child, search, hits, i, best, work)
                    key = nearest(keys, level * wp.static(width))
                    if wp.static(any_hit):
                        level = wp.where(best.primitive < 0, level, -1)
            else:
                level -= 1
                if level >= 0:
                    key = nearest(keys, level * wp.static(width))
        return best

    return walk_keys
