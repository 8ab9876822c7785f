"""The kernel around a walk that traces one ray at a time, for every kind of tree."""

from collections.abc import Callable

import warp as wp

from wrt.kernels.layout.ray_batch import HitBatch, RayBatch, load_ray
from wrt.kernels.runtime.options import specialised_kernel
from wrt.kernels.traversal.leaf import CounterRows, Counters, start, store_best
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks


def make_ray_kernel(config: TraversalConfig, Tree: type, make_walk: Callable[[TraversalConfig], wp.Function]) -> wp.Kernel:
    """A kernel for one specialisation that traces one ray per item.

    Args:
        config: the specialisation of the walk.
        Tree: struct of the tree.
        make_walk: makes `wp.func(tree, triangles, ray, hits, i, work) -> best` for ray number i, which must be valid.
    """
    walk, store, counting = make_walk(config), store_best(config), config.counters

    def single_ray(
        first: int,
        tree: Tree,
        triangles: TriangleBlocks,
        rays: RayBatch,
        hits: HitBatch,
        counters: CounterRows,
    ):
        i = first + wp.tid()
        ray = load_ray(rays, i)
        best = start(ray.t_max)
        work = Counters()
        if ray.valid:
            best = walk(tree, triangles, ray, hits, i, work)
        store(hits, i, best)
        if wp.static(counting):
            counters.rows[i] = work

    return specialised_kernel(single_ray)
