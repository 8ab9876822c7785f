"""Queued traversal of a wide BVH: rays wait at subtrees that fit a cache, and are traced subtree by subtree.

**Problem.** A tree that is larger than the caches is read from memory again by every packet or ray that passes: rays that reach
the same triangles do so at different times.

**Idea** (Pharr et al. 1997; Navrátil et al. 2007). The tree is cut into an upper part and subtrees, each with its triangles no
larger than the L2 cache (`wrt.builders.convert.queue_points`). A ray is queued at the root of the next subtree that it enters.
In each generation, all rays are sorted by subtree, and each subtree with its rays is worked off before the next: it is read
from memory once, however many rays wait there. A ray without a hit before its next subtree moves on to the next generation.

**Data.** A waiting ray is its number in the list `order`, its best hit in the answers, and the last queue point that it has
passed (`wrt.kernels.traversal.queued.next_queue`). `wrt.engine.launch.queued_tracing` has the loop over generations.

**Differences from the papers.** Generations here are steps of rays that exist, from subtree to subtree, not bounces: shading is
the caller's, who passes each bounce as a batch. The cut depends on bytes, also within what would be one voxel of Pharr's grid.

**Limits.** Rays go one by one through a subtree, not in lanes of packets or streams. The state of a waiting ray is written and
read once per subtree.

References: pharr-1997; navratil-2007; navratil-2010; rahikainen-2013 (section 3.1, Algorithm 3.1.1).
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.ray_batch import HitBatch, RayBatch, load_ray
from wrt.kernels.runtime.options import specialised_kernel
from wrt.kernels.simd.boxes import BoxRay, ray_slabs, reach
from wrt.kernels.traversal.leaf import CounterRows, Counters, begin_search, leaf_search
from wrt.kernels.traversal.queued.next_queue import RayQueue
from wrt.kernels.traversal.single.key_walk import make_key_walk
from wrt.kernels.traversal.single.single_bvh import make_leaf
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks


@wp.struct
class QueuedNodes:
    """A tree, the subtrees at which rays wait, and the rays that wait, sorted by subtree."""

    nodes: WideNodes
    roots: wp.array(dtype=int)
    """(points,) child word of the root of each subtree."""
    order: wp.array(dtype=int)
    """(waiting,) ray numbers."""
    queue: RayQueue
    """The subtree of each ray."""


@cache
def make_queued_bvh_kernel(config: TraversalConfig) -> wp.Kernel:
    """The kernel that traces each waiting ray through its subtree. Item: a place in the order."""
    Search, begin, leaf = leaf_search(config.triangle_test), begin_search(config.triangle_test), make_leaf(config)
    walk_keys = make_key_walk(config, config.stack.levels, Search, leaf)
    load, store, counting = config.answer.stored.load, config.answer.stored.store, config.counters

    def queued_bvh(
        first: int,
        tree: QueuedNodes,
        triangles: TriangleBlocks,
        rays: RayBatch,
        hits: HitBatch,
        counters: CounterRows,
    ):
        i = tree.order[first + wp.tid()]
        root = tree.roots[tree.queue.point[i]]
        ray = load_ray(rays, i)
        best = load(hits, i, ray.t_max)
        slabs = ray_slabs(ray.origin, ray.direction, reach(ray.origin, tree.nodes.low, tree.nodes.high))
        search = begin(triangles, ray, slabs)
        work = Counters()
        if root >= 0:
            best = walk_keys(tree.nodes, root, BoxRay(slabs, ray.t_min), search, hits, i, best, work)
        else:
            best = leaf(tree.nodes, root, search, hits, i, best, work)
        store(hits, i, best)
        if wp.static(counting):
            counters.rows[i].nodes += work.nodes
            counters.rows[i].leaves += work.leaves
            counters.rows[i].triangles += work.triangles
            counters.rows[i].boxes += work.boxes

    return specialised_kernel(queued_bvh)
