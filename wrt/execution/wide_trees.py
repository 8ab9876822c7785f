"""The wide form of a scene's kd-tree (`wrt.builders.convert.wide_kdtree`): made once rays have paid for it, and kept.

Nobody knows whether more rays will come: a tree of an animation may live for a picture. So the form is made when as much time
would have been saved as that takes. Whatever comes then, rays and form have not taken twice the time of the better choice.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import warp as wp

from wrt.kernels.runtime.launch import use_threads

if TYPE_CHECKING:
    from wrt.builders.tree import Bvh
    from wrt.execution.query_cache import KnownRecords
    from wrt.execution.scene_state import SceneState
    from wrt.rays.ray_buffers import RayBuffers

LEAST_WIDTH = 2
"""Children of a wide node at least, whatever the width of the kd-tree's blocks."""

SAVED_ALONE, SAVED_TOGETHER = 1.0, 1.0 / 16.0
"""What the form saves a ray, of what it takes to make it, by the triangle: rays that look different, and neighbours that look
alike. (Bunny, one thread: 0.19 us a triangle; random rays 0.20 us, ambient occlusion 0.23, a view 0.005 to 0.015.)"""


@dataclass(frozen=True)
class WideForm:
    """The wide form of a kd-tree on the scene's device, and the triangle records in its order (`records_of`)."""

    tree: Bvh
    records: KnownRecords = field(default_factory=dict)


def wide_width(scene: SceneState) -> int:
    """Children of a wide node, and triangles of its blocks."""
    return max(scene.width, LEAST_WIDTH)


def wide_tree(scene: SceneState) -> Bvh:
    """The wide form of a scene's kd-tree, which does not grow; made on the CPU if the scene has none of this tree."""
    cache = scene.cache
    if cache.wide is None:
        with use_threads(scene.num_threads):
            cache.wide = WideForm(_make(scene))
    return cache.wide.tree


def _make(scene: SceneState) -> Bvh:
    from wrt.accelerators.accelerator import Bvh as Description
    from wrt.builders.convert.wide_kdtree import wide_form
    from wrt.builders.triangle_boxes import triangle_boxes

    host, width, mesh = wp.get_device("cpu"), wide_width(scene), scene.device_mesh
    triangles = triangle_boxes(mesh.vertices.to(host), mesh.faces.to(host), scene.center)
    config = Description(width=width).config(width)
    return wide_form(scene.tree.to(host), triangles, config).to(scene.device)


def can_be_wide(scene: SceneState) -> bool:
    """Whether the scene has one kd-tree, all of it."""
    return scene.accelerator.kind == "kdtree" and scene.lazy_tree is None and not scene.instances and not scene.only_single


def pays(scene: SceneState, rays: RayBuffers) -> bool:
    """Whether rays are traced through the wide form: it is there, or they and those before them pay for it."""
    if not can_be_wide(scene):
        return False
    return scene.cache.wide is not None or scene.cache.missed + saved(rays.count, rays.coherent) >= scene.triangle_count


def saved(count: int, coherent: bool) -> float:
    """What the form would save rays, in triangles that it could be made of."""
    return count * (SAVED_TOGETHER if coherent else SAVED_ALONE)
