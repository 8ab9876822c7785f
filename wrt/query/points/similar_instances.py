"""Points in scenes of instances: maps that do not multiply all distances alike are refused."""

from __future__ import annotations

from typing import TYPE_CHECKING

from wrt.instances.device_moves import uneven_maps
from wrt.kernels.runtime.launch import refuse_capture

if TYPE_CHECKING:
    from wrt.engine.facts.scene_state import SceneState


def check_maps(scene: SceneState, query: str) -> None:
    """Refuses instances whose maps do not multiply all distances alike; those with mask 0 do not matter.

    Raises:
        ValueError: there is one; the message names it.
        RuntimeError: a graph is being captured, and instances have moved on the device by matrices.
    """
    table = scene.table  # type: ignore[attr-defined]
    if table is None:  # instances have moved on the device
        if scene.device_moves.are_similar:  # type: ignore[attr-defined]
            return
        refuse_capture(f"{query} among instances whose transforms are matrices on the device, not wp.transform,", scene.device)
        table = scene.device_mesh.placements.numpy()
    is_uneven = uneven_maps(table)
    if is_uneven.any():
        raise ValueError(
            f"{query} needs instances that are moved, turned, mirrored or scaled alike along all axes, and instance "
            f"{int(is_uneven.argmax())} is not; use wrt.Scene(scene.flattened())"
        )
