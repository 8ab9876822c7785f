"""Queries by single rays whose leaves test triangles one by one, or a block at once: what a triangle test costs in a tree.

Testing one by one is for measurements only, so no `wrt.results.Plan` names it. A kernel's `SingleConfig.scalar_test` does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace

from wrt.engine.device_hits import DeviceHits
from wrt.engine.launch.traversal_launch import divide, kernel_and_inputs, no_work
from wrt.engine.plan.choices import make_plan
from wrt.engine.plan.plan import plan_for_query, traversal_config
from wrt.engine.rays.device_rays import to_device
from wrt.engine.rays.rays import Rays
from wrt.kernels.runtime.launch import launch, use_threads
from wrt.kernels.traversal.leaf import Counters
from wrt.kernels.traversal.traversal_config import SingleConfig
from wrt.scene.scene import Scene


def leaf_query(scene: Scene, rays: Rays, triangle_test: str, kind: str, *, scalar_test: bool) -> Callable[[], DeviceHits]:
    """Prepares a query by single rays.

    Args:
        scene: a complete tree of one level, without influence areas.
        rays: the rays.
        triangle_test: key in `wrt.kernels.triangle.TRIANGLE_TESTS`.
        kind: "closest" or "any".
        scalar_test: whether the triangles of a leaf are tested one after the other, by the scalar form of the test.

    Returns:
        A function that traces all rays. Each call writes its hits to the same arrays.
    """
    state, buffers = scene.state, to_device(rays, scene.device, scene.center)
    plan = plan_for_query(make_plan(state, buffers, "single", triangle_test, kind), kind)
    config = replace(traversal_config(plan, state, kind, False), single=SingleConfig(scalar_test=scalar_test))
    batch, hits = buffers.batch, DeviceHits.new(kind, buffers.count, scene.device)
    kernel, inputs = kernel_and_inputs(state, plan, config, batch, hits.struct(), no_work(Counters, scene.device.alias))

    def trace() -> DeviceHits:
        with use_threads(scene.num_threads):
            batch.run, items, chunks = divide(state, plan, config, batch.count)
            launch(kernel, items, inputs, device=scene.device, **asdict(chunks))
        return hits

    return trace
