"""What the functions of `wrt.analysis` check of a scene and of points on its surface, and arrays of these on the host."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from wrt.query.api import Queries

if TYPE_CHECKING:
    from wrt.engine.facts.scene_state import SceneState


def state_of(scene: Any) -> SceneState:
    """The state of a scene.

    Raises:
        TypeError: not a scene, or one whose parts are on disk.
    """
    if not isinstance(scene, Queries):
        raise TypeError(f"scene must be a wrt.Scene, not {type(scene).__name__}; make one with wrt.Scene(mesh)")
    return scene.state


def check_surface(scene: Any, surface: Any) -> None:
    """Refuses what is not a scene, and what is not hits.

    Raises:
        TypeError: as `state_of`, or a surface without points on triangles.
    """
    state_of(scene)
    if not callable(getattr(surface, "spawn", None)):
        raise TypeError(
            f"surface must be hits, as scene.points_on and wrt.analysis.sample_surface return, not {type(surface).__name__}"
        )


def host(values: Any) -> np.ndarray:
    """Attributes of hits as a NumPy array."""
    return values if isinstance(values, np.ndarray) else np.asarray(values.numpy() if hasattr(values, "numpy") else values)
