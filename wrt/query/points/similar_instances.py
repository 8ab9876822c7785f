"""Points in scenes of instances: maps that do not multiply all distances alike are refused."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from wrt.engine.facts.scene_state import SceneState

UNEVEN = 1e-6
"""How far the axes of a map may differ in length and from right angles, relative to their length."""


def check_maps(scene: SceneState, query: str) -> None:
    """Refuses instances whose maps do not multiply all distances alike; those with mask 0 do not matter.

    Raises:
        ValueError: there is one; the message names it.
    """
    table = scene.table  # type: ignore[attr-defined]
    if table is None:  # instances have moved on the device
        table = scene.device_mesh.placements.numpy()
    linear = table["to_scene"].reshape(-1, 3, 3)
    products = np.einsum("nji,njk->nik", linear, linear)
    squares = np.trace(products, axis1=1, axis2=2) / 3.0
    is_uneven = np.abs(products / squares[:, None, None] - np.eye(3)).max(axis=(1, 2)) > UNEVEN
    is_uneven &= table["mask"].reshape(-1) != 0
    if is_uneven.any():
        raise ValueError(
            f"{query} needs instances that are moved, turned, mirrored or scaled alike along all axes, and instance "
            f"{int(is_uneven.argmax())} is not; use wrt.Scene(scene.flattened())"
        )
