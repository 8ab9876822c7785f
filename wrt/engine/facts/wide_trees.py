"""The wide form of a scene's kd-tree (`wrt.builders.convert.wide_kdtree`): made once it pays for the rays traced so far, and
kept.

The number of future rays is unknown: the tree of an animation may serve a single image. So the wide form is made when it
would have saved as much time as it takes to make. For any later rays, the total time is then at most twice that of the
better choice.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import warp as wp

from wrt.kernels.runtime.launch import use_threads

if TYPE_CHECKING:
    from wrt.builders.tree import Bvh
    from wrt.engine.facts.facts import RayFacts
    from wrt.engine.facts.query_cache import KnownRecords
    from wrt.engine.facts.scene_state import SceneState

MIN_WIDTH = 2
"""Smallest number of children of a wide node, whatever the width of the kd-tree's blocks."""

SAVED_INCOHERENT, SAVED_COHERENT = 1.0, 1.0 / 16.0
"""Time that the wide form saves per ray, over the time to make it per triangle: for incoherent rays, and for coherent ones
(notebooks/records/2026-11-21-plans.md).
"""


@dataclass(frozen=True)
class WideForm:
    """The wide form of a kd-tree on the scene's device, and the triangle records in its order (`records_of`)."""

    tree: Bvh
    records: KnownRecords = field(default_factory=dict)


def wide_width(width: int) -> int:
    """Children of a wide node, and triangles of its blocks, by the width of the kd-tree's blocks."""
    return max(width, MIN_WIDTH)


def wide_tree(scene: SceneState) -> Bvh:
    """The wide form of a scene's kd-tree, which must not be lazy; built on the CPU unless the scene has it already."""
    cache = scene.cache
    if cache.wide is None:
        with use_threads(scene.num_threads):
            cache.wide = WideForm(_make(scene))
    return cache.wide.tree


def _make(scene: SceneState) -> Bvh:
    from wrt.accelerators.tree_descriptions import Bvh as Description
    from wrt.builders.convert.wide_kdtree import to_wide_bvh
    from wrt.builders.triangle_boxes import triangle_boxes

    host, width, mesh = wp.get_device("cpu"), wide_width(scene.width), scene.device_mesh
    triangles = triangle_boxes(mesh.vertices.to(host), mesh.faces.to(host), scene.center)
    config = Description(width=width).config(width)
    return to_wide_bvh(scene.tree.to(host), triangles, config).to(scene.device)


def wide_form_pays(scene: SceneState, rays: RayFacts) -> bool:
    """Whether rays are traced through the wide form: it exists, or it pays for these rays and those before them."""
    if not scene.facts.can_be_wide:
        return False
    if scene.cache.wide is not None:
        return True
    return scene.cache.missed_savings + wide_form_savings(rays.count, rays.coherent) >= scene.triangle_count


def wide_form_savings(count: int, coherent: bool) -> float:
    """Time that the wide form saves for these rays, in units of the time to make it for one triangle."""
    return count * (SAVED_COHERENT if coherent else SAVED_INCOHERENT)
