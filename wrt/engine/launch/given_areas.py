"""Areas that come with the rays, as `areas=` of a query: what is then left to find out.

    one area of all triangles    nothing: its tree is the scene's tree for any ray, and queries are prepared as for any tree
    areas of some triangles      whether a ray starts in the region of its area, and where it leaves it

The directions of rays are not compared with those of their areas: they decide which tree is fast, not which is right.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.engine.rays.ray_integers import as_integers, broadcast

if TYPE_CHECKING:
    from wrt.engine.facts.scene_state import SceneState


@dataclass(frozen=True)
class GivenAreas:
    """The areas of rays, on the device.

    Attributes:
        areas: (rays,) or (1,) ints: places in `AreaTrees`, -1 for none.
        stride: 1, or 0 if all rays have the same.
    """

    areas: wp.array
    stride: int


def take_areas(scene: SceneState, areas: Any, shape: tuple[int, ...]) -> tuple[SceneState, GivenAreas | None]:
    """The scene to trace, and the areas that are left to be looked at.

    Args:
        scene: of a `wrt.known_rays.RayAwareBvh`.
        areas: an int or integers that broadcast to the rays' shape, from -1 to the number of areas less one.
        shape: of the rays.

    Raises:
        TypeError: something else than integers.
        ValueError: a scene without areas, a number of no area, or a shape that does not broadcast.
    """
    values = check_areas(scene, areas)
    trees = scene.area_trees
    if trees is None:  # no triangle is in any area
        return scene, None
    places = np.full(len(scene.accelerator.areas) + 1, -1, dtype=np.int32)  # the last for -1
    places[list(trees.numbers)] = np.arange(len(trees))
    if values.size == 1:
        place = int(places[values.flat[0]])
        if place >= 0 and trees.triangles[place] == scene.triangle_count:
            return trees.scenes[place], None
        return scene, GivenAreas(wp.array([place], dtype=int, device=scene.device), 0)
    each = broadcast("areas", places[values], shape)
    return scene, GivenAreas(wp.array(np.ascontiguousarray(each).ravel(), dtype=int, device=scene.device), 1)


def check_areas(scene: SceneState, areas: Any) -> np.ndarray:
    """The numbers of areas; errors as those of `take_areas`."""
    from wrt.accelerators.ray_aware_bvh import RayAwareBvh

    if not isinstance(scene.accelerator, RayAwareBvh):
        raise ValueError(
            "areas needs a scene with influence areas, and this one has none; build it with wrt.known_rays.RayAwareBvh"
        )
    hint = ": places in the accelerator's areas, -1 for none"
    return as_integers("areas", areas, -1, len(scene.accelerator.areas) - 1, hint)
