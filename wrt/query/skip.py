"""Queries whose rays each ignore one triangle: usually the one that they start on.

Rays are traced one at a time (`wrt.kernels.answers.skipped_triangle`), whatever their number. A lazy tree is completed
first, and the trees of influence areas are not used. For many rays, streams from `Hits.spawn` are about twice as fast
(notebooks/records/2026-11-21-queries.md).
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import warp as wp

from wrt.engine.device_hits import DeviceHits
from wrt.engine.executor import Answer, on_device
from wrt.engine.facts.query_kinds import AUTO, Query
from wrt.engine.launch.traversal_launch import counter_rows, divide, no_work
from wrt.engine.launch.triangle_records import records_of
from wrt.engine.plan.choices import find_plan
from wrt.engine.plan.plan import kernel_factory, plan_for_query, stack_levels, traversal_config, traversal_of
from wrt.engine.rays.ray_integers import as_integers
from wrt.kernels.answers import SKIPPING
from wrt.kernels.runtime.launch import launch, specialise, use_threads
from wrt.kernels.traversal.capabilities import Capabilities
from wrt.kernels.traversal.leaf import Counters
from wrt.query.hits import Hits

if TYPE_CHECKING:
    from wrt.engine.facts.scene_state import SceneState
    from wrt.engine.plan.plan import Plan
    from wrt.engine.rays.device_rays import DeviceRays
    from wrt.engine.rays.rays import GivenRays
    from wrt.kernels.layout.ray_batch import RayBatch


class SceneTriangles(NamedTuple):
    """A value of `skip` from inside: a triangle for each ray, numbered through all meshes, -1 for none.

    Attributes:
        numbers: (N,) int32 on the scene's device.
    """

    numbers: wp.array


def answer_skipping(scene: SceneState, rays: GivenRays, query: Query) -> Answer:
    """Answers a query "closest", "any" or "count" of rays that each pass through one triangle; see `wrt.Scene.intersect`.

    Args:
        scene: what the rays meet.
        rays: the rays.
        query: of its options only `cull_backfaces` can be combined with `skip`.
    """
    with use_threads(scene.num_threads):
        buffers = on_device(scene, rays, query)
        check_skip(scene, {name: getattr(query, name) for name in ("traversal", "triangle_test", "counters", "precise")})
        skipped = skipped_triangles(query.skip, scene, buffers)
        traversal = AUTO if scene.device.is_cuda else "single"
        chosen = find_plan(scene, buffers.facts, Query(query.kind, traversal, AUTO, query.cull_backfaces)).plan
        plan = replace(chosen, reason="each ray skips a triangle")
        scene.complete()
        hits = trace_skipping(scene, plan_for_query(plan, query.kind), buffers.batch, query.kind, skipped)
    return Answer(hits, buffers.form, plan)


def trace_skipping(scene: SceneState, plan: Plan, rays: RayBatch, kind: str, skipped: wp.array) -> DeviceHits:
    """The answers to rays that go one by one, each through the triangle of `skipped_triangles`.

    Args:
        scene: what the rays meet.
        plan: the query's own (`plan_for_query`); of a traversal of single rays.
        rays: the rays.
        kind: of the query.
        skipped: what the rays ignore.
    """
    device = scene.device
    hits, counters = DeviceHits.new(kind, rays.count, device), counter_rows(no_work(Counters, device.alias))
    config = replace(traversal_config(plan, scene, kind, False), variant=SKIPPING)
    if Capabilities.PERSISTENT in traversal_of(plan).capabilities:
        from wrt.engine.launch.persistent_launch import kernel_and_trees, next_ray

        kernel, trees = kernel_and_trees(scene, config)
        inputs = [*trees, rays, hits.struct(), counters, next_ray(device, rays.count, skipped)]
        launch(kernel, divide(scene, plan, config, rays.count)[1], inputs, device=device, chunk=1024)
        return hits
    if scene.instances:
        from wrt.kernels.traversal.two_level.instance_single import make_instance_kernel

        trees = [scene.upper(), scene.lower(plan, rays)]
        factory = partial(make_instance_kernel, kind=plan.accelerator, levels=stack_levels(scene.tree.depth))
        kernel = specialise(factory, config)
    else:
        trees = [scene.tree.struct(), records_of(scene, plan, rays)]
        kernel = specialise(kernel_factory(plan, scene), config)
    launch(kernel, rays.count, [*trees, rays, hits.struct(), counters, skipped], device=device, chunk=1024)
    return hits


def check_skip(scene: SceneState, others: dict[str, Any]) -> None:
    """Refuses arguments and scenes that `skip` does not support.

    Raises:
        ValueError: a `wrt.moving.FuzzyScene`, alpha masks, or an argument in `others` that is neither "auto" nor False.
    """
    if scene.only_single:
        raise ValueError(
            "skip needs a scene with one tree; start rays at hits.spawn(directions) instead, or use wrt.Scene(scene.meshes)"
        )
    scene.require_opaque("skip")
    if given := [name for name, value in others.items() if value not in (AUTO, False)]:
        raise ValueError(f"skip cannot be combined with {', '.join(given)}; leave one or the other out")


def skipped_triangles(skip: Any, scene: SceneState, buffers: DeviceRays) -> wp.array:
    """The triangle that each ray ignores, numbered through all meshes, for
    `wrt.kernels.traversal.single.single_kernel.make_variant_kernel`.

    Raises:
        TypeError: neither hits nor integers.
        ValueError: hits of another scene, integers in a scene of several meshes or out of range, a shape that does not
            broadcast, or an array on another device.
    """
    values: np.ndarray | wp.array
    if isinstance(skip, SceneTriangles):
        values, shape = skip.numbers, skip.numbers.shape
    elif isinstance(skip, Hits):
        if not skip.is_of(scene):
            raise ValueError("skip holds hits of another scene; pass hits of this scene")
        values, shape = skip.batch.primitive, skip.shape
    else:
        if (count := len(scene.instances) or len(scene.meshes)) > 1:
            what = "instance" if scene.instances else "mesh"
            raise ValueError(
                f"skip holds triangles of one {what}, and the scene has {count}; pass the wrt.Hits where rays start"
            )
        values = skip if isinstance(skip, wp.array) else as_triangles(skip, scene.triangle_count)
        shape = values.shape
    if isinstance(values, wp.array) and values.device != scene.device:
        raise ValueError(f"skip is on {values.device}, the scene on {scene.device}; copy it there, or make the hits there")
    if isinstance(values, wp.array) and values.dtype is not wp.int32:
        raise TypeError(f"skip must be a Warp array of int32, not of {values.dtype.__name__}")
    return spread_rows(values, shape, buffers.shape, scene.device)


def as_triangles(skip: Any, count: int) -> np.ndarray:
    """Checked triangle indices of a mesh of `count` triangles as int32; errors as those of `as_integers`."""
    return as_integers("skip", skip, -1, count - 1, "; pass a wrt.Hits, or primitive ids, -1 for none").astype(np.int32)


def spread_rows(values: np.ndarray | wp.array, shape: tuple[int, ...], wanted: tuple[int, ...], device: wp.Device) -> wp.array:
    """Values that broadcast to the wanted shape: a flat array, repeated only where whole rows do not repeat.

    Raises:
        ValueError: the shape does not broadcast.
    """
    row = shape
    while row and row[0] == 1:
        row = row[1:]
    if wanted[len(wanted) - len(row) :] != row or len(shape) > len(wanted):
        try:
            values = np.broadcast_to((values.numpy() if isinstance(values, wp.array) else values).reshape(shape), wanted)
        except ValueError:
            raise ValueError(
                f"skip has the shape {shape}, which does not broadcast to that of the rays, {wanted}; "
                "broadcast the rays to the shape of skip"
            ) from None
    if isinstance(values, wp.array):
        return values.contiguous().flatten()
    return wp.array(values.reshape(-1), dtype=int, device=device)
