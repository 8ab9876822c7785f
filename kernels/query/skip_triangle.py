"""Queries in which each ray ignores one triangle: the single-ray walks with the step of
`wrt.kernels.traversal.single.skip_step`."""

from functools import cache

import warp as wp

from wrt.kernels.layout.ray_batch import HitBatch, RayBatch, load_ray
from wrt.kernels.runtime.options import exact_module, specialised_kernel
from wrt.kernels.traversal.leaf import Counters, start, store_best
from wrt.kernels.traversal.search_results import Skipping
from wrt.kernels.traversal.single.walk_table import WALKS
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks

exact_module(__name__)


@cache
def make_kernel(kind: str, config: TraversalConfig) -> wp.Kernel:
    """The kernel for a kind of tree (a key in `WALKS`) and a config with `skipping` set.

    Its argument `skipped` has the ignored triangle of each ray: (N,), or (n,) for rays in rows of n that share them by column;
    -1 ignores nothing.
    """
    Tree, make_walk = WALKS[kind]
    walk, store = make_walk(config), store_best(config)

    def skipping_hits(
        first: int,
        tree: Tree,
        triangles: TriangleBlocks,
        rays: RayBatch,
        skipped: wp.array(dtype=int),
        hits: HitBatch,
    ):
        i = first + wp.tid()
        ray = load_ray(rays, i)
        best = start(ray.t_max)
        if ray.valid:
            search = Skipping()
            search.t_min = ray.t_min
            search.skipped = skipped[i % skipped.shape[0]]
            work = Counters()
            best = walk(tree, triangles, ray, search, i, work)
        store(hits, i, best)

    return specialised_kernel(skipping_hits)
