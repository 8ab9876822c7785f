"""The kernels that a scene, a query or a picture is going to need, so that they are compiled side by side beforehand.

The plan of a query is chosen from what is known of its rays, without the rays. A wrong guess costs the time to compile a kernel
that is not used, or one more wait.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from wrt.engine.facts.facts import RayFacts
from wrt.engine.facts.query_kinds import ANY, AUTO, CLOSEST, FEW_RAYS_OF_MANY, Query
from wrt.engine.facts.wide_trees import wide_form_pays
from wrt.engine.launch.triangle_records import record_kernel
from wrt.engine.plan.choices import current_plan
from wrt.engine.plan.packet_sample import sample_kernel
from wrt.engine.plan.plan import config_for_layout, kernel_factory, plan_for_query, traversal_config
from wrt.engine.plan.planner import choose_plan, situation_of
from wrt.kernels.layout.mesh_placement import make_shift
from wrt.kernels.layout.ray_batch import center_float64_points
from wrt.kernels.query.ordering.coherence_detection import measure_coherence
from wrt.kernels.runtime import job_queue
from wrt.kernels.runtime.launch import expect, get_num_threads, specialise
from wrt.kernels.simd.lanes import native_width

if TYPE_CHECKING:
    from wrt.accelerators.accelerator import Accelerator
    from wrt.engine.facts.scene_state import SceneState

MAX_EXPECTED = 256
"""Builds that are remembered."""

MANY_TRIANGLES = 4096
"""Triangles from which a build is divided among threads."""


ExpectedRays = tuple[str, RayFacts]
"""Kind of query, and what is known of rays that are still to be made."""


def expected_rays(kind: str, count: int, *, coherent: bool = True, shared_origin: bool = False) -> ExpectedRays:
    """A flat list of rays."""
    return kind, RayFacts(count, (count,), shared_origin, coherent)


FEW = (expected_rays(CLOSEST, FEW_RAYS_OF_MANY), expected_rays(ANY, FEW_RAYS_OF_MANY))
"""Few rays, which go one by one."""


def picture_rays(pixels: int, shared_origin: bool, shadows: bool) -> list[ExpectedRays]:
    """The rays of this many pixels: of the camera, and to the light."""
    found = [expected_rays(CLOSEST, pixels, shared_origin=shared_origin)]
    return found + ([expected_rays(ANY, pixels)] if shadows else [])


def build_kernels(accelerator: Accelerator, device: wp.Device, dtype: type, triangles: int) -> list[wp.Kernel]:
    """The kernels that build a scene: none if the tree is not a BVH, whose builders alone can tell.

    Args:
        accelerator: the description of the tree.
        device: the scene's.
        dtype: of the vertices.
        triangles: how many there are.
    """
    from wrt.accelerators.tree_descriptions import Bvh
    from wrt.builders.triangle_boxes import compute_boxes

    if not isinstance(accelerator, Bvh):
        return []
    shift = specialise(make_shift, wp.vec3 if dtype == np.float32 else wp.vec3d)
    helpers = [job_queue.run_as_helper] if triangles >= MANY_TRIANGLES and get_num_threads() > 1 else []
    return [shift, compute_boxes, *helpers, *accelerator.kernels(triangles, native_width(device))]


def expect_build(accelerator: Accelerator, device: wp.Device, dtype: type, triangles: int) -> None:
    """Begins to compile the kernels of a build (`build_kernels`); at once if the same was expected before."""
    key = accelerator, device.alias, dtype, triangles, get_num_threads()
    if key not in _expected:
        expect(build_kernels(accelerator, device, dtype, triangles), wp.get_device("cpu"))
        if len(_expected) >= MAX_EXPECTED:
            _expected.clear()
        _expected.add(key)


_expected: set[Hashable] = set()
"""Builds whose kernels were expected: to list them takes longer than to build a few thousand triangles."""


def query_kernels(
    scene: SceneState,
    rays: Iterable[ExpectedRays],
    traversal: str = AUTO,
    triangle_test: str = AUTO,
    *,
    measured: bool = False,
) -> list[wp.Kernel]:
    """The kernels that trace rays through a scene of meshes with a complete tree; none for other scenes.

    Args:
        scene: the state, with its tree.
        rays: what is known of them.
        traversal, triangle_test: as in `wrt.Scene.intersect`.
        measured: whether the calls are measured, so that single rays stand in for a plan whose kernel is not compiled.

    Raises:
        ValueError: as in `wrt.Scene.intersect`.
    """
    if scene.instances or scene.lazy_tree is not None or scene.area_trees is not None or scene.facts.points:
        return []
    found = []
    for kind, facts in rays:
        query = Query(kind, traversal, triangle_test)
        if measured:
            plan = current_plan(scene, facts, query).carried_out
        else:
            plan = plan_for_query(choose_plan(scene, facts, query), kind)
        config = config_for_layout(traversal_config(plan, scene, kind, False), plan, scene)
        kernel = specialise(kernel_factory(plan, scene), config)
        found += [kernel, record_kernel(plan)]
        found += [measure_coherence] if facts.count > scene.few_rays else []
        situation = situation_of(scene.facts, facts, kind, has_wide_form=wide_form_pays(scene, facts))
        found += [sample_kernel(scene)] if traversal == AUTO and situation.needs_sample else []
    return [*dict.fromkeys(found), center_float64_points]
