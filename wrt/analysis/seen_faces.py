"""What a camera sees, and what of a terrain is seen from places on it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from wrt.analysis.analysis_arguments import state_of
from wrt.kernels.validation import as_direction, as_float, as_int, as_numbers

if TYPE_CHECKING:
    from wrt.array_types import ArrayLike
    from wrt.imaging.cameras import OrthographicCamera, PinholeCamera
    from wrt.scene.scene import Scene

MAX_SAMPLES = 1 << 16
"""Most rays through a pixel."""


def visible_faces(scene: Scene, camera: PinholeCamera | OrthographicCamera, *, samples: int = 1) -> np.ndarray:
    """Which triangles a camera sees: those that are hit first by a ray through a pixel.

        seen = wrt.analysis.visible_faces(scene, camera)
        left = wrt.TriangleMesh(mesh.vertices, mesh.faces[seen])

    A triangle between rays is not found: `samples` rays in every pixel, or a larger picture, find smaller ones.

    Args:
        scene: a `wrt.Scene`.
        camera: a camera of wrt.
        samples: rays per pixel, from 1 to 2^16; with 1, the ray passes through the pixel's centre.

    Returns:
        (F,) bool, for all triangles numbered through the scene, as in `scene.flattened()`: those of mesh 0, or instance 0,
        first.

    Raises:
        TypeError: not a scene, camera is not a camera of wrt, or samples is not an int.
        ValueError: samples is less than 1, or more than 2^16.
    """
    state, samples = state_of(scene), as_int("samples", samples, 1, MAX_SAMPLES)
    if not callable(getattr(camera, "rays", None)):
        raise TypeError(f"camera must be a camera, such as wrt.PinholeCamera, not {type(camera).__name__}")
    seen = np.zeros(scene.triangle_count, dtype=bool)
    first = state.device_mesh.geometry_first.numpy().astype(np.int64)
    for sample in range(samples):
        hits = scene.intersect(camera.rays(sample, samples))
        hit = hits.is_hit
        seen[first[hits.instance_id[hit]] + hits.primitive_id[hit]] = True
    return seen


def viewshed(
    scene: Scene,
    points: ArrayLike,
    observers: ArrayLike,
    *,
    eye_height: float = 1.7,
    target_height: float = 0.0,
    up: ArrayLike = (0, 0, 1),
) -> np.ndarray:
    """Which points of a terrain are seen by observers who stand on it.

        terrain = wrt.TriangleMesh.from_heightmap(heights, spacing=30.0)
        cells = terrain.vertices.reshape(*heights.shape, 3)
        seen = wrt.analysis.viewshed(wrt.Scene(terrain), cells, cells[120, 80])     # (rows, columns) bool

    The line from the eye to the point is tested (`wrt.Scene.visible`); the terrain's curvature is not, it must be in the mesh.

    Args:
        scene: the terrain, with all that stands on it.
        points: (..., 3) points of the ground.
        observers: (3,) or (K, 3) points of the ground; heights are above them, along `up`.
        eye_height: of observers, at least 0, in the scene's units.
        target_height: of what is to be seen, above `points`, at least 0.
        up: upward direction, of any length.

    Returns:
        (...) bool for one observer, (K, ...) for several.

    Raises:
        TypeError: an argument has a wrong type.
        ValueError: wrong shapes, a negative height, or `up` is 0.
    """
    state_of(scene)
    heights = {"eye_height": as_float("eye_height", eye_height, finite=True)}
    heights["target_height"] = as_float("target_height", target_height, finite=True)
    for name, height in heights.items():
        if height < 0.0:
            raise ValueError(f"{name} must be 0 or more, not {height}")
    above = as_direction("up", up)
    ground, places = as_numbers("points", points, finite=False), as_numbers("observers", observers)
    if ground.ndim < 1 or ground.shape[-1] != 3:
        raise ValueError(f"points must have shape (..., 3), not {ground.shape}")
    if places.ndim not in (1, 2) or places.shape[-1] != 3:
        raise ValueError(f"observers must have shape (3,) or (K, 3), not {places.shape}")
    eyes = (places + heights["eye_height"] * above).reshape(places.shape[:-1] + (1,) * (ground.ndim - 1) + (3,))
    return scene.visible(eyes, ground + heights["target_height"] * above)
