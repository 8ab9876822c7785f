"""`wrt.render`: a picture in one call, by any integrator."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from wrt.imaging.ambient_rendering import AmbientRendering
from wrt.imaging.integrators import INTEGRATORS
from wrt.imaging.integrators.render_settings import AmbientOptions
from wrt.imaging.sampled_picture import Camera, SampledPicture
from wrt.tables import one_of

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from wrt.clouds.point_cloud import PointCloud
    from wrt.imaging.integrators.render_settings import PictureOptions, RenderSettings
    from wrt.imaging.integrators.scene_motion import Motion
    from wrt.lights.device_lights import Lights
    from wrt.materials.material import Materials
    from wrt.scene.scene import Scene

__all__ = ["new_picture", "render"]

OF_OTHERS = ("lights", "materials", "motion", "settings")
"""Arguments that the integrator "ambient" does not have."""


def render(
    scene: Scene | PointCloud,
    camera: Camera,
    *,
    integrator: str = "ambient",
    lights: Lights | None = None,
    materials: Materials | None = None,
    motion: Motion | None = None,
    settings: RenderSettings | None = None,
    progress: Callable[[int, int], object] | None = None,
    **options: Unpack[PictureOptions],
) -> np.ndarray:
    """Renders an image.

        image = wrt.render(scene, camera)                                   # a point light and ambient occlusion
        image = wrt.render(scene, camera, integrator="path", samples=64)    # materials and lights

    The same arguments give the same image bit for bit, whatever the number of threads.

    Integrators:

    * "ambient": all surfaces of one colour, or one for each triangle; a point light with hard shadows; ambient occlusion. Its
      options are those of `wrt.pictures.AmbientRendering`: samples, light, light_color, shadows, ambient_samples,
      ambient_distance, ambient_radius, ambient_color, albedo, background, smooth, crease_angle, seed, traversal,
      triangle_test, tile_pixels.
    * "whitted": Whitted's ray tracing: mirrors, glass, hard shadows.
    * "distribution": distribution ray tracing (Cook et al. 1984): also penumbrae, gloss, translucency, depth of field, motion
      blur.
    * "path": path tracing: all light, however often it is scattered.

    Args:
        scene: the scene; for "ambient", also a `wrt.sensors.PointCloud`.
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
    given = {"lights": lights, "materials": materials, "motion": motion, "settings": settings, **options}
    return new_picture(scene, camera, integrator, **given).advance(progress=progress).image()


def new_picture(scene: Any, camera: Camera, integrator: str, **options: Any) -> SampledPicture:
    """A picture by any integrator, without samples; arguments and errors as in `render`."""
    if one_of(INTEGRATORS, integrator, "integrator") != "ambient":
        from wrt.imaging.integrators.rendering_job import Rendering  # whose kernels need time to be imported

        return Rendering(scene, camera, integrator=integrator, **options)
    unknown = [name for name in options if name not in OF_OTHERS and name not in AmbientOptions.__annotations__]
    if unknown:
        known = ", ".join(AmbientOptions.__annotations__)
        raise TypeError(f"integrator 'ambient' has no option {unknown[0]!r}; its options are {known}")
    of_others = {name: options.pop(name, None) for name in OF_OTHERS}
    unused = [name for name, value in of_others.items() if value is not None]
    if unused:
        raise TypeError(
            f"integrator 'ambient' has no {unused[0]}; choose integrator='path', 'distribution' or 'whitted', or give "
            "light= and albedo="
        )
    return AmbientRendering(scene, camera, **options)
