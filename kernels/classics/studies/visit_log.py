"""Logs of the nodes and leaves that single rays visit, for the model of a cache
(`wrt.kernels.classics.studies.cache_model`)."""

from functools import cache

import warp as wp

from wrt.kernels.answers.answer_kind import BestHit
from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.ray_batch import HitBatch, RayBatch, load_ray
from wrt.kernels.runtime.options import specialised_kernel
from wrt.kernels.simd.boxes import BoxRay, ray_slabs, reach
from wrt.kernels.traversal.leaf import Counters, begin_search, leaf_search
from wrt.kernels.traversal.queued.queued_bvh import QueuedNodes
from wrt.kernels.traversal.single.key_walk import make_key_walk
from wrt.kernels.traversal.single.single_bvh import make_leaf
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks


@cache
def logged_search(triangle_test: str) -> type:
    """The struct of the search state of a ray whose visits are logged."""

    class LoggedSearch:
        leaf: leaf_search(triangle_test)
        words: wp.array(dtype=int)
        next: int

    LoggedSearch.__qualname__ = f"LoggedSearch_{triangle_test}"
    return wp.struct(LoggedSearch)


@cache
def make_log_kernel(config: TraversalConfig) -> wp.Kernel:
    """The kernel that logs the visits of a waiting ray in its subtree: nodes by their numbers, leaves by their child words.

    Item: a place in the order. ends: (waiting,) receives the number of visits if `words` is empty; otherwise the place of the
    ray's first visit in `words`. Nothing is stored in `hits`.
    """
    Search, begin, leaf = logged_search(config.triangle_test), begin_search(config.triangle_test), make_leaf(config)
    load = config.answer.stored.load

    @wp.func
    def note(word: int, search: wp.ref[Search]):
        if search.words.shape[0] > 0:
            search.words[search.next] = word
        search.next += 1

    @wp.func
    def visit(
        tree: WideNodes,
        child: int,
        search: wp.ref[Search],
        hits: wp.ref[HitBatch],
        i: int,
        best: BestHit,
        work: wp.ref[Counters],
    ):
        note(child, search)
        return leaf(tree, child, search.leaf, hits, i, best, work)

    walk_keys = make_key_walk(config, config.stack.levels, Search, visit, note)

    def log_visits(
        first: int,
        tree: QueuedNodes,
        triangles: TriangleBlocks,
        rays: RayBatch,
        hits: HitBatch,
        words: wp.array(dtype=int),
        ends: wp.array(dtype=int),
    ):
        place = first + wp.tid()
        i = tree.order[place]
        root = tree.roots[tree.queue.point[i]]
        ray = load_ray(rays, i)
        best = load(hits, i, ray.t_max)
        slabs = ray_slabs(ray.origin, ray.direction, reach(ray.origin, tree.nodes.low, tree.nodes.high))
        search = Search()
        search.leaf = begin(triangles, ray, slabs)
        search.words = words
        if words.shape[0] > 0:
            search.next = ends[place]
        work = Counters()
        if root >= 0:
            best = walk_keys(tree.nodes, root, BoxRay(slabs, ray.t_min), search, hits, i, best, work)
        else:
            best = visit(tree.nodes, root, search, hits, i, best, work)
        if words.shape[0] == 0:
            ends[place] = search.next

    return specialised_kernel(log_visits)
