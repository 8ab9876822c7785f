"""The kernels around a walk that traces one ray at a time, for every kind of tree, on one level and on two."""

from typing import Any

import warp as wp

from wrt.kernels.answers.answer_kind import start
from wrt.kernels.layout.instance_maps import scene_ray
from wrt.kernels.layout.ray_batch import HitBatch, RayBatch, load_ray
from wrt.kernels.runtime.options import specialised_kernel
from wrt.kernels.traversal.leaf import CounterRows, Counters
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks


def make_ray_kernel(config: TraversalConfig, Tree: type, walk: wp.Function, Parts: Any = None) -> wp.Kernel:
    """A kernel for one specialisation that traces one ray per item.

    Of a variant, it is that of `make_variant_kernel`. Through instances, lists of all hits are written from
    `HitBatch.begins` on, so the hits of each ray must be counted first.

    Args:
        config: the specialisation of the walk.
        Tree: struct of the tree.
        walk: `wp.func(tree, triangles, ray, hits, i, work) -> best` for ray number i, which must be valid; or a walk through
            instances (`wrt.kernels.traversal.two_level.instance_single.make_instance_walk`).
        Parts: type of the array of geometries that instances place; None for a walk on one level.
    """
    if config.answer.search.Given is not None:
        return make_variant_kernel(config, Tree, walk, Parts)
    store, counting, two_level = config.answer.stored.store, config.counters, Parts is not None
    lists, Triangles = two_level and bool(config.answer.stored.listed), Parts if two_level else TriangleBlocks

    def single_ray(
        first: int,
        tree: Tree,
        triangles: Triangles,
        rays: RayBatch,
        hits: HitBatch,
        counters: CounterRows,
    ):
        i = first + wp.tid()
        ray = load_ray(rays, i)
        best = start(ray.t_max)
        work = Counters()
        if ray.valid:
            if wp.static(two_level):
                best = walk(tree, triangles, scene_ray(rays, i, ray), hits, i, work)
            else:
                best = walk(tree, triangles, ray, hits, i, work)
            if wp.static(lists):
                hits.begins[i] = hits.begins[i] - (best.primitive + 1)
        store(hits, i, best)
        if wp.static(counting):
            counters.rows[i] = work

    return specialised_kernel(single_ray)


def make_variant_kernel(config: TraversalConfig, Tree: type, walk: wp.Function, Parts: Any = None) -> wp.Kernel:
    """The same for a variant of a kind of query (`Search.Given`): each ray ignores one triangle, or passes through holes.

    After the counters it gets what the variant needs: `skipped`, (N,) the ignored triangle of each ray, or (n,) for rays in
    rows of n that share them by column, -1 for none, numbered through all instances; or `AlphaMasks`.
    """
    answer, counting, two_level = config.answer, config.counters, Parts is not None
    store, begin, Given = answer.stored.store, answer.search.begin, answer.search.Given
    lists, Triangles = two_level and bool(answer.stored.listed), Parts if two_level else TriangleBlocks

    def variant_ray(
        first: int,
        tree: Tree,
        triangles: Triangles,
        rays: RayBatch,
        hits: HitBatch,
        counters: CounterRows,
        given: Given,
    ):
        i = first + wp.tid()
        ray = load_ray(rays, i)
        best = start(ray.t_max)
        work = Counters()
        if ray.valid:
            search = begin(given, hits, i, ray.t_min)
            if wp.static(two_level):
                best = walk(tree, triangles, scene_ray(rays, i, ray), search, i, work)
            else:
                best = walk(tree, triangles, ray, search, i, work)
            if wp.static(lists):
                hits.begins[i] = hits.begins[i] - (best.primitive + 1)
        store(hits, i, best)
        if wp.static(counting):
            counters.rows[i] = work

    return specialised_kernel(variant_ray)
