"""Choosing a plan: what "auto" stands for, from the scene, the device and the rays."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from wrt.execution.instance_plan import check_instances, choose_for_instances
from wrt.execution.plan import ChosenPlan, Plan, plan_for
from wrt.execution.plan_checks import TILED, check_culling, check_origins, check_plan, check_query, check_spaces, check_wide
from wrt.execution.query_kinds import ALIKE, ALL, AUTO, CLOSEST, COUNT, DIFFERENT, FEW_RAYS, Query
from wrt.execution.wide_trees import can_be_wide, pays, saved, wide_width
from wrt.kernels.runtime.launch import get_num_threads
from wrt.tables import lookup

if TYPE_CHECKING:
    from wrt.execution.scene_state import SceneState
    from wrt.kernels.traversal import Traversal
    from wrt.kernels.triangle import TriangleTest
    from wrt.rays.ray_buffers import RayBuffers

DEFAULT_TEST = "woop"
"""The triangle test of "auto": the only watertight one. It costs a few per cent over Moeller and Trumbore's test at most
(notebooks/records/2026-11-21-plans.md).
"""

PACKET_VECTORS = 2
"""Rays of a packet, in vectors of the tree's width: best or within 5 % of the best of 1, 2, 4 and 8
(notebooks/records/2026-11-21-plans.md).
"""

RAYS_PER_TRIANGLE = 0.125
"""Rays per triangle of the scene from which coherent rays are traced in packets. With fewer, triangles are smaller than the
distance between rays, the rays of a packet diverge, and streams are faster (notebooks/records/2026-11-21-plans.md).
"""

ROUGH_RAYS_PER_TRIANGLE = 2.0
"""Rays per triangle of the scene up to which camera rays use a transient frustum at each leaf in place of vertex culling: a
packet then reaches a leaf with few active rays (notebooks/records/2026-11-21-plans.md).
"""

STREAMS, CUDA_STREAM = (4096, 1024, 256), 64
"""Rays of a stream, the largest first. Longer streams fill their vector lanes better, if each thread still has several
streams. On CUDA, a thread traces a stream and holds its rays in local memory.
"""

STREAMS_PER_THREAD = 4

LEAST_TO_REORDER = 1 << 16
"""Smallest batch whose rays are sorted before tracing."""

CACHED_BYTES = 1 << 24
"""Bytes of triangle records that the caches of a core hold. Rays are not sorted for scenes with fewer."""


def make_plan(
    scene: SceneState,
    rays: RayBuffers,
    traversal: str | Plan,
    triangle_test: str,
    query: str = CLOSEST,
    cull_backfaces: bool = False,
) -> Plan:
    """Chooses what the caller left on "auto". A given plan is checked.

    Raises:
        ValueError: an unknown name, a traversal that does not support the scene's tree or the query, or a plan that does
            not fit the scene and the rays.
    """
    return find_plan(scene, rays, Query(query, traversal, triangle_test, cull_backfaces)).plan


def find_plan(scene: SceneState, rays: RayBuffers, query: Query) -> ChosenPlan:
    """The plan of a query about rays, from the scene's cache or made; errors as of `make_plan`."""
    kind, traversal, triangle_test, cull_backfaces, _ = query
    if isinstance(traversal, Plan):
        culled = cull_backfaces or traversal.cull_backfaces
        return chosen_plan(scene, check_plan(replace(traversal, cull_backfaces=culled), scene, rays, kind), rays, kind)
    if not (isinstance(traversal, str) and isinstance(triangle_test, str)) or is_changing(scene, rays):
        plan = choose_plan(scene, rays, traversal, triangle_test, kind, cull_backfaces)
        return chosen_plan(scene, plan, rays, kind)
    # Plans are looked up: the longer Python takes for one, the longer a GPU waits for its kernel, and cores for theirs.
    count, origin_stride = rays.count, rays.arrays_or_batch.origin_stride
    one_by_one = traversal == AUTO and (count <= FEW_RAYS or scene.device.is_cuda)
    size = count > 1 if one_by_one else (rays.shape, get_num_threads())
    found = origin_stride, rays.coherent, rays.scattered, rays.columns > 0
    key = kind, traversal, triangle_test, cull_backfaces, size, found
    chosen = scene.cache.plan(key)
    if chosen is not None:
        return chosen
    plan = choose_plan(scene, rays, traversal, triangle_test, kind, cull_backfaces)
    return scene.cache.keep_plan(key, choose_for(scene, plan, rays, kind))


def chosen_plan(scene: SceneState, plan: Plan, rays: RayBuffers, kind: str) -> ChosenPlan:
    """A plan for a kind of query, with what is prepared for it in the scene's cache."""
    key = plan, kind, rays.count <= FEW_RAYS
    return scene.cache.plan(key) or scene.cache.keep_plan(key, choose_for(scene, plan, rays, kind))


def choose_for(scene: SceneState, plan: Plan, rays: RayBuffers, kind: str) -> ChosenPlan:
    """A plan for a kind of query, and whether such queries can be prepared: see `wrt.execution.executor`."""
    from wrt.kernels.triangle import TRIANGLE_TESTS

    own = plan_for(plan, kind)
    through_instances = bool(scene.instances) and own.traversal != "single"
    by_area = scene.area_trees is not None and (scene.device.is_cuda or rays.count > FEW_RAYS)
    by_origin = TRIANGLE_TESTS[own.triangle_test].record.per_origin
    prepares = not (scene.lazy_tree is not None or through_instances or by_area or by_origin or own.reorder == "cells")
    missed = 0.0 if own.is_wide or not can_be_wide(scene) else saved(1, own.coherent)
    return ChosenPlan(plan, own, prepares, missed)


def is_changing(scene: SceneState, rays: RayBuffers) -> bool:
    """Whether the plan depends on what came before: on how much of a tree is built, or on whether a wide form pays."""
    if scene.lazy_tree is not None:
        return True
    return rays.count > FEW_RAYS and not scene.device.is_cuda and (bool(scene.instances) or can_be_wide(scene))


def choose_plan(
    scene: SceneState, rays: RayBuffers, traversal: str, triangle_test: str, query: str, cull_backfaces: bool
) -> Plan:
    """A new plan for these rays; arguments and errors as in `make_plan`."""
    from wrt.kernels.traversal import TRAVERSALS
    from wrt.kernels.triangle import TRIANGLE_TESTS

    test = lookup(TRIANGLE_TESTS, default_test(scene, query) if triangle_test == AUTO else triangle_test, "triangle_test")
    check_origins(test, rays)
    name, reason = choose_traversal(scene, rays, query, cull_backfaces) if traversal == AUTO else (traversal, "as asked")
    way = lookup(TRAVERSALS, name, "traversal")
    accelerator = tree_for(way, scene)
    check_query(query, way, accelerator, test)
    check_culling(cull_backfaces, way, accelerator)
    if scene.instances:
        check_instances(scene, query, way, test)
    check_spaces(scene, way)
    check_wide(scene, way)
    width = wide_width(scene) if way.wide else scene.width
    options: dict[str, object] = {}
    if way.packets:
        options["packet"] = PACKET_VECTORS * width
        options["culling"] = choose_culling(scene, rays, way, test)
    if way.streams:
        options["stream"] = stream_size(scene, rays)
    if traversal == AUTO or way.name in TILED:
        options["reorder"] = choose_order(scene, rays, way, test)
    return Plan(
        accelerator=accelerator,
        traversal=way.name,
        triangle_test=test.name,
        width=width,
        coherent=rays.coherent,
        shared_origin=rays.arrays_or_batch.origin_stride == 0 and not scene.instances,
        reason=reason,
        cull_backfaces=cull_backfaces,
        **options,
    )


def default_test(scene: SceneState, query: str) -> str:
    """Name of the triangle test for queries that name none: the scene's, or the default test if the query counts and the
    scene's test cannot.
    """
    from wrt.kernels.triangle import TRIANGLE_TESTS

    if scene.triangle_test == AUTO or (query in (COUNT, ALL) and TRIANGLE_TESTS[scene.triangle_test].crossing is None):
        return DEFAULT_TEST
    return scene.triangle_test


def choose_traversal(scene: SceneState, rays: RayBuffers, query: str, cull_backfaces: bool = False) -> tuple[str, str]:
    """Name of the traversal, and the reason for it."""
    if scene.device.is_cuda:
        return "single", "one CUDA thread per ray"
    if scene.only_single:
        return "single", "each tree has its own coordinate space"
    if rays.count <= FEW_RAYS:
        return "single", "few rays"
    if scene.instances:
        return choose_for_instances(scene, rays, query, cull_backfaces)
    if query in (COUNT, ALL) or cull_backfaces:
        what = "all hits" if query in (COUNT, ALL) else "front faces"
        is_bvh = scene.accelerator.kind == "bvh"
        return ("stream", f"{what} of many rays") if is_bvh else ("single", f"the traversal that finds {what} on a kd-tree")
    is_bvh, is_wide = scene.accelerator.kind == "bvh", pays(scene, rays)
    if not (is_bvh or is_wide):
        return ("packet", ALIKE) if rays.coherent else ("lockstep", DIFFERENT)
    stream, packet = ("wide_stream", "wide_packet") if is_wide else ("stream", "packet")
    if not rays.coherent:
        return stream, DIFFERENT
    if rays.count < RAYS_PER_TRIANGLE * scene.triangle_count:
        return stream, f"{ALIKE}, but triangles are small"
    return packet, ALIKE


def tree_for(way: Traversal, scene: SceneState) -> str:
    """Kind of tree that a traversal walks in a scene.

    Raises:
        ValueError: the traversal does not walk the scene's kind of tree.
    """
    from wrt.kernels.traversal import TRAVERSALS

    kind = scene.accelerator.kind
    if way.trees == ("none",):
        return "none"
    if kind not in way.trees:
        able = ", ".join(name for name, entry in TRAVERSALS.items() if kind in entry.trees)
        other = f"make the scene with accelerator={way.trees[0]!r}"
        raise ValueError(f"traversal {way.name!r} does not walk a {kind}; {other}, or choose from auto, {able}")
    return kind


def stream_size(scene: SceneState, rays: RayBuffers) -> int:
    """Rays of a stream: fewer if the batch would not give each thread several streams."""
    if scene.device.is_cuda:
        return CUDA_STREAM
    share = rays.count / max(STREAMS_PER_THREAD * get_num_threads(), len(scene.instances))
    return next((size for size in STREAMS if size <= share), STREAMS[-1])


def choose_culling(scene: SceneState, rays: RayBuffers, way: Traversal, test: TriangleTest) -> str:
    """Name of the culling. A transient frustum around the active rays at a leaf pays where packets are wide or leaves are
    small.
    """
    if not test.accurate:
        return "interval"
    if not (way.wide or scene.accelerator.kind == "bvh"):
        return "vertex"
    narrow = rays.arrays_or_batch.origin_stride == 0 and not scene.instances
    fine = rays.count >= ROUGH_RAYS_PER_TRIANGLE * scene.triangle_count
    return "vertex" if narrow and fine else "transient_frustum"


def choose_order(scene: SceneState, rays: RayBuffers, way: Traversal, test: TriangleTest) -> str:
    """The order in which rays are traced."""
    if way.name in TILED:
        return "tiles" if rays.columns > 0 else "none"
    return "cells" if rays.scattered and is_large(scene, rays, test) else "none"


def is_large(scene: SceneState, rays: RayBuffers, test: TriangleTest) -> bool:
    """Whether the batch and the triangle records are large enough for sorting the rays to pay."""
    return rays.count >= LEAST_TO_REORDER and len(scene.tree.primitive) * 4 * test.record.components >= CACHED_BYTES
