"""The traversal path of a ray through a scene: of one tree (`tree_walk`), or of instances (`instance_walk`)."""

from __future__ import annotations

from itertools import islice
from typing import Any

import numpy as np

from wrt.engine.facts.scene_state import SceneState
from wrt.viewer.trees.instance_walk import InstanceWalk
from wrt.viewer.trees.tree_walk import Placed, Visit, Walk

__all__ = ["walk"]

MAX_VISITS = 10_000
"""Visits after which a way ends."""


def walk(scene: SceneState, origin: Any, direction: Any) -> list[Visit]:
    """The boxes that a ray visits on its way to its closest hit.

    Args:
        scene: the state of a scene with a single tree, or of instances.
        origin, direction: (3,) of the ray.

    Raises:
        ValueError: the scene has many trees, and no instances.
    """
    origin, direction = np.asarray(origin, dtype=np.float64), np.asarray(direction, dtype=np.float64)
    if scene.instances:
        return [*islice(InstanceWalk(scene, origin, direction).visits(), MAX_VISITS)]  # type: ignore[arg-type]
    if not hasattr(scene.tree, "nodes" if scene.accelerator.kind == "kdtree" else "child"):
        raise ValueError("the scene has many trees; pick in a wrt.Scene of meshes or instances")
    center = np.asarray(scene.center, dtype=np.float64)
    return [*islice(Walk(scene, origin - center, direction, Placed(np.eye(3), center)).visits(), MAX_VISITS)]
