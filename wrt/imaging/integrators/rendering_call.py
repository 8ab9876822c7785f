"""`wrt.render`: a picture in one call, by any integrator."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from wrt.imaging import rendering
from wrt.imaging.integrators.render_settings import INTEGRATORS, RenderSettings
from wrt.imaging.integrators.rendering_job import Rendering
from wrt.imaging.integrators.scene_motion import Motion
from wrt.imaging.rendering import Camera
from wrt.scene.scene import Scene

__all__ = ["render"]


def render(
    scene: Scene,
    camera: Camera,
    *,
    integrator: str = "ambient",
    lights: Any = None,
    materials: Any = None,
    motion: Motion | None = None,
    settings: RenderSettings | None = None,
    progress: Callable[[int, int], Any] | None = None,
    **options: Any,
) -> np.ndarray:
    """Renders an image.

        image = wrt.render(scene, camera)                                   # a point light and ambient occlusion
        image = wrt.render(scene, camera, integrator="path", samples=64)    # materials and lights

    The same arguments give the same image bit for bit, whatever the number of threads.

    Integrators:

    * "ambient": all surfaces of one colour, or one for each triangle; a point light with hard shadows; ambient occlusion. Its
      options are those of `wrt.imaging.rendering.AmbientRendering`: samples, light, light_color, shadows, ambient_samples,
      ambient_distance, ambient_color, albedo, background, smooth, crease_angle, seed, traversal, triangle_test.
    * "whitted": Whitted's ray tracing: mirrors, glass, hard shadows.
    * "distribution": distribution ray tracing (Cook et al. 1984): also penumbrae, gloss, translucency, depth of field, motion
      blur.
    * "path": path tracing: all light, however often it is scattered.

    Args:
        scene: the scene.
        camera: a `wrt.PinholeCamera` or `wrt.OrthographicCamera`.
        integrator: one of these.
        lights, materials, motion, settings: as in `wrt.pictures.Rendering`; not of "ambient".
        progress: called as progress(done, total) after each tile or wave; an exception that it raises ends the rendering.
        options: of "ambient" as above; of others the fields of `wrt.pictures.RenderSettings`, which replace those of
            `settings`.

    Returns:
        (height, width, 3) float32 for display, as `wrt.save_image` takes it. For linear values, noise, layers, and pictures
        that are continued, use `wrt.pictures.Rendering`.

    Raises:
        TypeError: an argument has a wrong type; an unknown option.
        ValueError: a value out of range, or an unknown name.
    """
    if integrator not in INTEGRATORS:
        raise ValueError(f"unknown integrator {integrator!r}; choose from {', '.join(INTEGRATORS)}")
    given = {"lights": lights, "materials": materials, "motion": motion, "settings": settings}
    if integrator != "ambient":
        return Rendering(scene, camera, integrator=integrator, **given, **options).advance(progress=progress).image()
    unused = [name for name, value in given.items() if value is not None]
    if unused:
        raise TypeError(
            f"integrator 'ambient' has no {unused[0]}; choose integrator='path', 'distribution' or 'whitted', or give "
            "light= and albedo="
        )
    return rendering.render(scene, camera, progress=progress, **options)
