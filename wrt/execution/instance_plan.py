"""How a query to a scene of instances is answered: what `wrt.execution.plan` asks for two levels."""

from __future__ import annotations

from typing import TYPE_CHECKING

from wrt.execution.query_kinds import ALIKE, ALL, ANY, CLOSEST

if TYPE_CHECKING:
    from wrt.execution.scene_state import SceneState
    from wrt.kernels.traversal import Traversal
    from wrt.kernels.triangle import TriangleTest
    from wrt.rays.ray_buffers import RayBuffers

TRIANGLES_PER_RAY = 8
"""Triangles of all instances a ray up to which packets go through two levels: measured on views of 10 and 100 bunnies, they are
1.0 to 2 times as fast as single rays with up to 7 triangles a ray, and 0.7 to 1.1 times with 27."""

RAYS_PER_INSTANCE, SCATTERED_PER_INSTANCE = 256, 1 << 16
"""Rays an instance of the scene from which on it pays to bring those together that reach the same: neighbours that look alike
(1.2 to 1.4 times as fast as single rays), and others (1.05 times, with a mesh of 70,000 triangles)."""


def choose_for_instances(scene: SceneState, rays: RayBuffers, query: str, cull_backfaces: bool) -> tuple[str, str]:
    """Name of the traversal, and the reason: `wrt.execution.plan.choose_traversal` for many rays on the CPU."""
    alone = "two levels, a ray at a time"
    if scene.accelerator.kind != "bvh" or query == ALL:
        return "single", alone
    if rays.coherent and rays.laid_out.origin_stride == 0 and query in (CLOSEST, ANY) and not cull_backfaces:
        dense = rays.count * TRIANGLES_PER_RAY >= scene.triangle_count
        return ("packet", f"two levels, {ALIKE}") if dense else ("single", f"{alone}: triangles are small")
    least = (RAYS_PER_INSTANCE if rays.coherent else SCATTERED_PER_INSTANCE) * len(scene.instances)
    return ("stream", "two levels, rays sorted by instance") if rays.count >= least else ("single", alone)


def check_instances(scene: SceneState, query: str, way: Traversal, test: TriangleTest) -> None:
    """Refuses what does not go with a scene of instances.

    Raises:
        ValueError: a traversal of one level, or records for one origin, were asked for.
    """
    together = scene.accelerator.kind == "bvh" and query != ALL and scene.device.is_cpu
    able = ("single", "packet", "stream") if together else ("single",)
    if way.name not in able:
        raise ValueError(
            f"traversal {way.name!r} does not answer the query {query!r} on two levels of {scene.accelerator.kind}; "
            f"for this scene of instances choose from auto, {', '.join(able)}"
        )
    if test.record.per_origin:
        raise ValueError(
            f"triangle_test {test.name!r} needs one origin for all triangles, and each instance sees the rays from another; "
            "choose triangle_test='woop'"
        )
