"""Plans for scenes of instances: the choices of `wrt.execution.plan` that two levels need."""

from __future__ import annotations

from typing import TYPE_CHECKING

from wrt.execution.query_kinds import ALIKE, ALL, ANY, CLOSEST

if TYPE_CHECKING:
    from wrt.execution.scene_state import SceneState
    from wrt.kernels.traversal import Traversal
    from wrt.kernels.triangle import TriangleTest
    from wrt.rays.ray_buffers import RayBuffers

TRIANGLES_PER_RAY = 8
"""Triangles of all instances per ray up to which packets traverse two levels faster than single rays
(notebooks/records/2026-11-21-instances.md).
"""

RAYS_PER_INSTANCE, SCATTERED_PER_INSTANCE = 256, 1 << 16
"""Rays per instance from which sorting rays by instance pays: for coherent rays, and for others
(notebooks/records/2026-11-21-instances.md).
"""


def choose_for_instances(scene: SceneState, rays: RayBuffers, query: str, cull_backfaces: bool) -> tuple[str, str]:
    """Name of the traversal, and the reason: `wrt.execution.plan.choose_traversal` for large batches on the CPU."""
    alone = "two levels, one ray at a time"
    if scene.accelerator.kind != "bvh" or query == ALL:
        return "single", alone
    if rays.coherent and rays.arrays_or_batch.origin_stride == 0 and query in (CLOSEST, ANY) and not cull_backfaces:
        dense = rays.count * TRIANGLES_PER_RAY >= scene.triangle_count
        return ("packet", f"two levels, {ALIKE}") if dense else ("single", f"{alone}: triangles are small")
    least = (RAYS_PER_INSTANCE if rays.coherent else SCATTERED_PER_INSTANCE) * len(scene.instances)
    return ("stream", "two levels, rays sorted by instance") if rays.count >= least else ("single", alone)


def check_instances(scene: SceneState, query: str, way: Traversal, test: TriangleTest) -> None:
    """Refuses what a scene of instances does not support.

    Raises:
        ValueError: the traversal walks only single-level trees, or the test has records for one origin.
    """
    together = scene.accelerator.kind == "bvh" and query != ALL and scene.device.is_cpu
    able = ("single", "packet", "stream") if together else ("single",)
    if way.name not in able:
        raise ValueError(
            f"traversal {way.name!r} does not answer the query {query!r} on two levels of {scene.accelerator.kind}; "
            f"for this scene of instances, choose from auto, {', '.join(able)}"
        )
    if test.record.per_origin:
        raise ValueError(
            f"triangle_test {test.name!r} needs one origin for all triangles, and each instance has its own coordinates; "
            "choose triangle_test='woop'"
        )
