"""Shaded images: a point light with hard shadows, and uniform sky light with ambient occlusion.

The colour of a point is `albedo * (light_color * cosine, if it sees the light + ambient_color * openness)`, all linear; the
light does not fall off with distance. Both sides of every surface are shaded alike. Openness is the share of the sky that
is visible from the point (`wrt.kernels.shading.ambient`). A pixel's samples are averaged, then encoded for display (sRGB).

An image is made in passes: one camera ray per pixel, tile by tile, then the next sample of all pixels. All intermediate
data stays on the scene's device; the steps are the kernels of `wrt.kernels.shading`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.engine.facts.query_kinds import AUTO
from wrt.engine.launch.expected_kernels import picture_rays, query_kernels
from wrt.engine.rays.rays import Rays
from wrt.imaging.ambient_rays import AmbientRays, max_rays
from wrt.imaging.cameras import PinholeCamera, pixel_offset
from wrt.imaging.sampled_picture import Camera, SampledPicture, corner_normals, default_light
from wrt.imaging.view_frames import is_cloud
from wrt.kernels.runtime.launch import expect, launch, use_threads
from wrt.kernels.shading import ambient, film, normals, surface
from wrt.kernels.shading.pixel_rays import pinhole_directions
from wrt.kernels.validation import as_bool, as_float, as_int, as_numbers, as_point

if TYPE_CHECKING:
    from wrt.array_types import ArrayLike, Numbers
    from wrt.clouds.point_cloud import PointCloud
    from wrt.scene.scene import Scene

__all__ = ["AmbientRendering"]

TILE_PIXELS = 1 << 16
"""Camera rays traced at once; bounds the memory, and the time between two calls of `progress`."""

MAX_RADIUS = 8
BACKGROUND = ((0.90, 0.91, 0.92), (0.72, 0.79, 0.87))
LIGHT_COLOR = (0.80, 0.77, 0.71)
AMBIENT_COLOR = (0.36, 0.39, 0.43)


class AmbientRendering(SampledPicture):
    """A picture by point light and ambient occlusion to which samples are added.

    The same arguments give the same picture bit for bit, whatever the number of threads and the steps in which it advances.

    Args:
        scene: the scene, or a `wrt.sensors.PointCloud`. Later updates of it do not show.
        camera: a `wrt.PinholeCamera` or `wrt.OrthographicCamera`.
        samples: camera rays per pixel, >= 1.
        light: (3,) position of the light; None for a position above and to the left of the camera (`default_light`).
        light_color, ambient_color: radiance of the light and the sky, linear: a number or (3,), each >= 0.
        shadows: whether the light casts shadows.
        ambient_samples: ambient rays per camera ray; 0 for no ambient occlusion.
        ambient_distance: length of ambient rays in scene units: geometry beyond it does not occlude; None for no limit.
        ambient_radius: pixels share their ambient rays with those up to this many rows and columns away, if these see the same
            smooth surface: less noise, blurred small shadows; 0 to 8, 0 for none. The picture then depends on `tile_pixels`.
        albedo: share of light that is reflected, linear, in [0, 1]: a number, (3,), or (F, 3) for all triangles of the
            scene in the order of `scene.meshes`, or for all points; instances of a mesh share its albedo.
        background: colour of pixels without a hit, as displayed (sRGB, [0, 1]): a number, (3,), or a pair of these for the
            lower and the upper edge of the image.
        smooth: whether to interpolate normals between triangles; False shows facets.
        crease_angle: edges between triangles whose planes differ by more than this angle stay sharp; in degrees, in (0,
            90).
        seed: seed of the sample pattern.
        traversal, triangle_test: as in `Scene.intersect`; points have no triangle test.
        tile_pixels: most camera rays that are traced at once; None for 65536. It does not change the picture.

    Attributes:
        samples: number of samples of a pixel when the picture is complete.
        done: number of samples so far.

    Raises:
        TypeError: `scene` or `camera` has a wrong type.
        ValueError: a value out of range, or an unknown name.
    """

    _takes_points = True

    def __init__(
        self,
        scene: Scene | PointCloud,
        camera: Camera,
        *,
        samples: int = 1,
        light: ArrayLike | None = None,
        light_color: Numbers = LIGHT_COLOR,
        shadows: bool = True,
        ambient_samples: int = 16,
        ambient_distance: float | None = None,
        ambient_radius: int = 0,
        ambient_color: Numbers = AMBIENT_COLOR,
        albedo: Numbers = 0.8,
        background: Numbers = BACKGROUND,
        smooth: bool = True,
        crease_angle: float = 60.0,
        seed: int = 0,
        traversal: str = AUTO,
        triangle_test: str = AUTO,
        tile_pixels: int | None = None,
    ) -> None:
        super().__init__(scene, camera)
        shadows, smooth = as_bool("shadows", shadows), as_bool("smooth", smooth) and not is_cloud(scene)
        if not 0.0 < (crease_angle := as_float("crease_angle", crease_angle)) < 90.0:
            raise ValueError(
                f"crease_angle is {crease_angle}; it must be between 0 and 90 degrees (smooth=False for flat shading)"
            )
        self.samples = as_int("samples", samples, 1)
        self._seed = as_int("seed", seed, 0)
        self._settings = _Settings(
            light=default_light(camera) if light is None else as_point("light", light),
            lighting=_lighting(light_color, ambient_color, background),
            shadows=shadows,
            ambient_samples=as_int("ambient_samples", ambient_samples, 0),
            ambient_distance=_check_distance(ambient_distance),
            ambient_radius=as_int("ambient_radius", ambient_radius, 0),
            seed=(self._seed * 0x9E3779B1 + 0x7F4A7C15) & 0xFFFFFFFF,
            query=_query(scene, traversal, triangle_test),
        )
        if self._settings.ambient_radius > MAX_RADIUS:
            raise ValueError(f"ambient_radius is {ambient_radius}; it must be at most {MAX_RADIUS}")
        tiles = -(-self.pixels // as_int("tile_pixels", TILE_PIXELS if tile_pixels is None else tile_pixels, 1))
        self._tile = -(-self.pixels // tiles)  # of one size, as streams of rays depend on it and would be compiled for each
        with use_threads(scene.num_threads):
            expect(_kernels(scene, camera, self._tile, self._settings, smooth), scene.device)
            self._ambient = _ambient_rays(scene, self._tile, camera.width, self._settings)
            self._look = _appearance(scene, albedo, crease_angle if smooth else None)
            self._sums = self._zeros()
        self._rays = 0

    def _zeros(self) -> tuple[wp.array, ...]:
        return (self._black(wp.vec3),)

    @property
    def rays(self) -> int:
        """Number of rays traced so far."""
        return self._rays + (0 if self._ambient is None else self._ambient.ray_count)

    def _expose(self, first: int, pixels: int, samples: int) -> None:
        scene, sample = self._scene, self.done
        rays = self.camera.rays_on(scene.device, first, pixels, pixel_offset(sample, self.samples, self._seed))
        tile = _Tile(scene, self._look, self._settings, first, pixels)
        tile.expose(rays, sample, self._ambient, self._shaped(self._sums[0]))
        self._rays += pixels * (2 if self._settings.shadows else 1)

    def developed(self) -> wp.array:
        """(height, width) vec3 on the scene's device, in [0, 1], encoded for display: the mean of the samples so far.

        Raises:
            ValueError: there are none.
        """
        return self._of_pixels(film.develop, wp.vec3, self._sums[0], self.done)


def _query(scene: Scene | PointCloud, traversal: str, triangle_test: str) -> dict[str, Any]:
    """Options of the queries."""
    if not is_cloud(scene):
        return {"traversal": traversal, "triangle_test": triangle_test}
    if triangle_test != AUTO:
        raise ValueError(f"triangle_test is {triangle_test!r}, and points have no triangles; leave it out")
    return {"traversal": traversal}


def _kernels(scene: Any, camera: Camera, tile: int, settings: _Settings, smooth: bool) -> list[wp.Kernel]:
    """One kernel of each module that a picture needs."""
    shared = isinstance(camera, PinholeCamera)
    rays = picture_rays(tile, shared, settings.shadows)
    ambient = [max_rays(tile, settings.ambient_samples)] if settings.ambient_samples else []
    kernels = query_kernels(scene.state, ambient, **settings.query)  # first, as they take longest to compile
    kernels += query_kernels(scene.state, rays, **settings.query, measured=True)
    return [*kernels, *shading_kernels(smooth, settings.ambient_samples > 0)]


def shading_kernels(smooth: bool, ambient_rays: bool) -> list[wp.Kernel]:
    """One kernel of each module that makes a picture of hits."""
    kernels = [pinhole_directions, surface.find_surface, film.develop]
    kernels += [normals.face_normals_and_angles] if smooth else []
    return kernels + ([ambient.ambient_rays] if ambient_rays else [])


@dataclass(frozen=True)
class _Settings:
    """Settings that all tiles share."""

    light: np.ndarray
    lighting: film.Lighting
    shadows: bool
    ambient_samples: int
    ambient_distance: float
    ambient_radius: int
    seed: int
    query: dict[str, Any]


class _Tile:
    """A range of pixels: one camera ray each, and its secondary rays."""

    def __init__(self, scene: Any, look: surface.Appearance, settings: _Settings, first: int, count: int) -> None:
        self.scene, self.look, self.settings = scene, look, settings
        self.first, self.count = first, count
        self.surface = surface.Surface()
        for name in ("face_normal", "normal", "albedo", "shadow_direction"):
            setattr(self.surface, name, self._empty(wp.vec3))
        for name in ("origin", "shadow_origin"):
            setattr(self.surface, name, self._empty(wp.vec3d))
        self.surface.cosine = self._empty(float)

    def expose(self, rays: Rays, sample: int, ambient_rays: AmbientRays | None, picture: wp.array) -> None:
        """Adds the light of these rays to the image."""
        hits = self.scene.intersect(rays, **self.settings.query)
        stride, light = 0 if rays.directions.size == 1 else 1, wp.vec3d(*self.settings.light)
        self.look.mesh, primitive, uv = hits._surface
        if is_cloud(self.scene):
            self.look.point = hits.batch.primitive
        self._run(surface.find_surface, self.look, light, rays.directions, stride, primitive, uv, self.surface)
        received = film.Received()
        received.shadows = self.settings.shadows
        received.ambient_samples = self.settings.ambient_samples
        if received.shadows:
            toward = self.surface.shadow_direction
            received.in_shadow = self.scene.occluded(self.surface.shadow_origin, toward, 0.0, 1.0, **self.settings.query)
        if ambient_rays is not None:
            received.open_rays = ambient_rays.count_open(self.surface, primitive, self.first, sample)
            received.ambient_samples *= ambient_rays.scale
        self._run(film.expose, self.surface, received, self.settings.lighting, self.first, picture)

    def _empty(self, dtype: type) -> wp.array:
        return wp.empty(self.count, dtype=dtype, device=self.scene.device)

    def _run(self, kernel: wp.Kernel, *inputs: Any) -> None:
        launch(kernel, self.count, inputs, device=self.scene.device, chunk=1024)


def _ambient_rays(scene: Any, tile: int, width: int, settings: _Settings) -> AmbientRays | None:
    if settings.ambient_samples == 0:
        return None
    rays = settings.ambient_samples, settings.ambient_distance, settings.seed, {"triangle_test": AUTO, **settings.query}
    return AmbientRays(scene, tile, *rays, width, settings.ambient_radius)


def _appearance(scene: Any, albedo: Any, crease_angle: float | None) -> surface.Appearance:
    look = surface.Appearance()
    look.mesh, look.point = scene.state.device_mesh, wp.empty(0, dtype=int, device=scene.device)
    look.smooth = crease_angle is not None
    if crease_angle is not None:
        look.corner_normals = corner_normals(scene, crease_angle)
    colors = _colors("albedo", albedo, (1, sum(part.triangle_count for part in scene.state.parts)), 1.0)
    look.albedo = wp.array(colors, dtype=wp.vec3, device=scene.device)
    look.albedo_stride = 0 if len(colors) == 1 else 1
    return look


def _check_distance(ambient_distance: float | None) -> float:
    distance = np.inf if ambient_distance is None else as_float("ambient_distance", ambient_distance)
    if not distance > 0.0:
        raise ValueError(f"ambient_distance is {ambient_distance}; it must be above 0, or None for no limit")
    return distance


def _lighting(light_color: Any, ambient_color: Any, background: Any) -> film.Lighting:
    displayed = _colors("background", background, (1, 2), 1.0).astype(np.float64)
    linear = np.where(displayed <= 0.04045, displayed / 12.92, ((displayed + 0.055) / 1.055) ** 2.4)
    lighting = film.Lighting()
    lighting.light = wp.vec3(*_colors("light_color", light_color, (1,), np.inf)[0])
    lighting.ambient = wp.vec3(*_colors("ambient_color", ambient_color, (1,), np.inf)[0])
    lighting.background_low, lighting.background_high = wp.vec3(*linear[0]), wp.vec3(*linear[-1])
    return lighting


def _colors(name: str, value: Any, counts: tuple[int, ...], maximum: float) -> np.ndarray:
    """(N, 3) float32 for one of the allowed counts N; a number becomes a grey."""
    try:
        colors = as_numbers(name, value, finite=False).astype(np.float32)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be a number or an array of colours (3,), not {value!r}") from None
    if colors.ndim == 0 or (colors.ndim == 1 and colors.shape == (2,) and 2 in counts):
        colors = np.repeat(colors.reshape(-1, 1), 3, axis=1)
    colors = colors.reshape(1, 3) if colors.shape == (3,) else colors
    if colors.ndim != 2 or colors.shape[1] != 3 or len(colors) not in counts:
        shapes = " or ".join("(3,)" if count == 1 else f"({count}, 3)" for count in counts)
        raise ValueError(f"{name} must be a number or of shape {shapes}, not of shape {np.shape(value)}")
    if not (np.isfinite(colors).all() and (colors >= 0.0).all() and (colors <= maximum).all()):
        limit = f"from 0 to {maximum:g}" if np.isfinite(maximum) else "finite and not negative"
        raise ValueError(f"{name} must be {limit}, but ranges from {colors.min():g} to {colors.max():g}")
    return colors
