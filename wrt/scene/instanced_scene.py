"""Scenes of instances, under a name of their own."""

from __future__ import annotations

from typing import TYPE_CHECKING

from wrt.engine.facts.query_kinds import AUTO
from wrt.engine.facts.scene_settings import as_settings
from wrt.kernels.runtime.launch import use_threads
from wrt.scene.instanced_state import build_instanced_state
from wrt.scene.scene import Scene

if TYPE_CHECKING:
    from pathlib import Path

    import warp as wp

    from wrt.accelerators.accelerator import Accelerator, AcceleratorName
    from wrt.meshes.instance import Geometry
    from wrt.scene.storage import TreeSource


class InstancedScene(Scene):
    """A scene of two levels, as `wrt.Scene` makes it of instances; here also of meshes without a transform.

    Triangles that instances share are stored once. Hits have the instance (`Hits.instance_id`), the mesh (`Hits.geometry_id`,
    index in `meshes`) and the triangle of the mesh as it was given; `uv` weighs that triangle's second and third vertex; `t`,
    `position` and `normal` are in the scene's space, and `normal` points outward for mirrored instances, too. Ties go to the
    smaller t, then to the earlier instance, then to the smaller triangle.

    If trees are BVHs, many rays on the CPU are traced in packets or streams, sorted by instance. Few rays, lists of all hits,
    and rays whose work is counted (`counters=True`) are traced one by one (`Hits.plan`). These scenes support ray masks, but
    not triangle tests with records for one origin (`komatsu`, `benthin`).

    Arguments as in `wrt.Scene`.

    Attributes:
        instances: tuple of `wrt.Instance`, in the order given; those of a trimesh.Scene in the order of its graph.
        meshes: tuple of `TriangleMesh`, one for each mesh, in the order of their first instances.
        geometry_ids: tuple of int, the mesh of each instance.

    Raises:
        TypeError, ValueError: as `wrt.Scene` and `wrt.Instance`; more than 2^31 - 1 triangles of all instances together; an
            instance smaller than 1e-12 of its distance from the scene's centre, unless its mask is 0.
    """

    def __init__(
        self,
        geometry: Geometry,
        accelerator: AcceleratorName | Accelerator = AUTO,
        *,
        triangle_test: str = AUTO,
        device: str | wp.Device | None = None,
        num_threads: int | None = None,
        cache: str | Path | TreeSource | None = None,
    ) -> None:
        settings = as_settings(accelerator, triangle_test, device, num_threads)
        with use_threads(settings.num_threads):
            self.state = build_instanced_state(geometry, settings, cache)
