"""A picture in the making: samples are added until there are enough, or until the caller stops."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.imaging.cameras import OrthographicCamera, PinholeCamera
from wrt.imaging.image_files import save_exr, save_image
from wrt.imaging.integrators.device_materials import (
    SceneMaterials,
    scene_materials,
    shaded_mesh,
    tiled_materials,
)
from wrt.imaging.integrators.ray_tracer import RayTracer
from wrt.imaging.integrators.render_settings import FRESNEL, INTEGRATORS, RenderSettings
from wrt.imaging.integrators.saved_samples import NOT_IN_SAMPLES, fingerprint, read_samples, write_samples
from wrt.imaging.integrators.scene_motion import Motion
from wrt.imaging.integrators.wavefront import SQUARE, Wave, pixel_samples, square_order
from wrt.imaging.sampled_picture import Camera, SampledPicture, default_light
from wrt.kernels.runtime.launch import launch, use_threads
from wrt.kernels.shading.wavefront import picture, ray_queue
from wrt.kernels.shading.wavefront.camera_rays import FILTERS, CameraModel
from wrt.kernels.shading.wavefront.pixel_samples import SAMPLERS
from wrt.kernels.shading.wavefront.scene_light import LitScene
from wrt.kernels.validation import as_float
from wrt.lights.device_lights import check_lights, device_lights
from wrt.lights.light_sources import DirectionalLight, PointLight
from wrt.lights.sky_image import Sky
from wrt.materials.material import Material
from wrt.scene.filtered_scene import given_filter
from wrt.scene.scene import Scene
from wrt.tables import one_of

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from wrt.imaging.integrators.render_settings import SettingOptions
    from wrt.lights.device_lights import Lights
    from wrt.materials.material import Materials

__all__ = ["LAYERS", "Rendering"]

LAYERS = ("depth", "normal", "albedo", "primitive_id", "geometry_id", "instance_id", "material_id")

NOT_HIT = (
    "no path hits a {}: it does not shine through glass, and what is behind glass gets none of its light; give a "
    "wrt.lights.AreaLight in its place, or leave panes out by scene.filtered(ignore=...)"
)

OPEN_GLASS = (
    "mesh {} has glass and is not closed: a ray that goes through a hole counts as outside where it is inside, so that what is "
    "seen through the glass is wrong; close the mesh (a pane needs two sides and a rim)"
)

DEFAULT_SKY = ((0.79, 0.81, 0.83), (0.48, 0.59, 0.73), (0.2, 0.2, 0.2))
"""Horizon, zenith and ground, if there are neither lights nor emissive materials."""


class Rendering(SampledPicture):
    """A picture to which samples are added.

        rendering = wrt.pictures.Rendering(scene, camera, integrator="path", samples=256, lights=[wrt.lights.Sky(1.0)])
        rendering.advance(16)
        preview = rendering.image()
        rendering.advance()                     # the other 240
        rendering.linear, rendering.noise, rendering.layers["depth"]

    The same arguments give the same picture bit for bit, whatever the number of threads, the size of waves, and the steps
    in which it advances.

    Args:
        scene: the scene. Later updates of it do not show.
        camera: a `wrt.PinholeCamera` or `wrt.OrthographicCamera`.
        integrator: "whitted", "distribution" or "path".
        lights: lights and sky: `wrt.lights.PointLight`, `wrt.lights.SpotLight`, `wrt.lights.DirectionalLight`,
            `wrt.lights.AreaLight`, `wrt.lights.Sky`; None: a sky, and a point light above and to the left of the camera, unless
            a material emits.
        materials: a `wrt.Material` for all triangles or one for each mesh; None: those of the meshes.
        motion: what moves while the shutter is open, a `wrt.moving.Motion`.
        settings: a `wrt.pictures.RenderSettings`.
        options: fields of the settings, which replace those of `settings`.

    Attributes:
        samples: number of samples of a pixel when the picture is complete.
        done: number of samples so far.

    Raises:
        TypeError: an argument has a wrong type; an unknown option.
        ValueError: a value out of range, or an unknown name.

    Warns:
        UserWarning: "path" is asked for the light of points, spots or the sun in a scene with glass: none passes it.
    """

    wave_type = Wave
    """What follows the samples; a study measures by another one."""

    def __init__(
        self,
        scene: Scene,
        camera: Camera,
        *,
        integrator: str = "path",
        lights: Lights | None = None,
        materials: Materials | None = None,
        motion: Motion | None = None,
        settings: RenderSettings | None = None,
        **options: Unpack[SettingOptions],
    ) -> None:
        super().__init__(scene, camera)
        one_of(INTEGRATORS[1:], integrator, "integrator")
        settings = RenderSettings() if settings is None else settings
        if not isinstance(settings, RenderSettings):
            raise TypeError(f"settings must be a wrt.pictures.RenderSettings, not {type(settings).__name__}")
        self.settings = settings = settings.with_options(integrator, options)
        self.integrator, self.samples = integrator, settings.samples_of(integrator)
        self._scene = scene if motion is None else motion.begin(scene)
        self._motion = motion
        self._shown = tuple(self._scene.meshes), tuple(self._scene.instances), materials
        found = scene_materials(self._scene, materials, Material())
        given = None if lights is None else check_lights(lights)
        self._lights = _default_lights(camera, scene) if given is None and not found.emission.any() else given or ()
        self._found = found
        _warn_of_open_glass(self._scene, found)
        if integrator == "path" and given:
            _warn_of_glass(given, found)
        device = scene.device
        with use_threads(scene.num_threads):
            self._lit = LitScene()
            self._lit.schlick = settings.fresnel == FRESNEL[1]
            self._lit.materials, self._tiles = tiled_materials(found, device, settings.texture_memory)
            self._take_state()
            self._sums = self._zeros()
        self._tile = min(self.pixels, settings.wave)
        if SQUARE * SQUARE < self._tile < self.pixels:
            self._tile -= self._tile % (SQUARE * SQUARE)
        order = square_order(camera.width, camera.height)
        self._order = wp.array(order, dtype=int, device=device, copy=not device.is_cpu)
        self._pass = max(1, min(settings.wave // self._tile, self.samples)) if motion is None else 1
        source = pixel_samples(SAMPLERS.index(settings.sampler), self.samples, settings.seed, device)
        ambient = self._ambient()
        slots = self._tile * self._pass
        self._wave = self.wave_type(self._lit, device, integrator, settings, source, ambient, slots, self._tiles)

    def _zeros(self) -> tuple[wp.array, ...]:
        return self._black(wp.vec3), self._black(wp.float32)

    def _ambient(self) -> Sequence[float]:
        if self.settings.ambient is not None:
            return self.settings.ambient
        sky = next((light for light in self._lights if isinstance(light, Sky)), None)
        return (0.0, 0.0, 0.0) if sky is None or self.integrator != "whitted" else tuple(sky.mean)

    def _take_state(self) -> None:
        """Reads the scene as it is now; what moves also moves its centre."""
        scene, settings = self._scene, self.settings
        self._model = camera_model(self.camera, settings, scene, self.samples)
        self._tracer = RayTracer(scene.state, settings.traversal, settings.triangle_test)
        self._lit.shaded = shaded_mesh(scene, settings.crease_angle if settings.smooth else None)
        self._lit.lights = device_lights(scene, self._lights, self._found.emission, self._found.of_face)

    @property
    def rays(self) -> int:
        """Number of rays traced so far."""
        return self._wave.ray_count

    @property
    def tile_loads(self) -> int:
        """Number of tiles of textures loaded so far; 0 without `texture_memory`, or if the whole images fit it."""
        return 0 if self._tiles is None else self._tiles.loads

    def _begin_pass(self) -> None:
        if self._motion is not None:
            self._motion.move(self._scene, (self.done + 0.5) / self.samples)
            self._take_state()

    @property
    def _starts_at_one_point(self) -> bool:
        """Whether all camera rays start at the same point."""
        return self._model.is_perspective and self.settings.lens_radius == 0.0

    def _samples_of(self, first: int, sample: int, samples: int) -> ray_queue.Wave:
        """A wave of this many samples of a pixel, from number `sample` on; `first` is the place of its first pixel."""
        wave = ray_queue.Wave()
        wave.order, wave.first_pixel, wave.first_sample, wave.samples = self._order, first, sample, samples
        return wave

    def _follow_in_tiles(self, wave: ray_queue.Wave, count: int) -> bool:
        """Follows the paths of a wave tile by tile, if that is possible."""
        inputs = self._tracer, self._model, wave, count, self._collected, self._starts_at_one_point
        return self._motion is None and self._wave.follow_in_tiles(*inputs)  # stages for a moving scene would serve once

    @property
    def _collected(self) -> picture.Film:
        film = picture.Film()
        film.sums, film.squares = self._sums
        film.limit = float(self.settings.max_radiance)
        return film

    def _start(self, wave: ray_queue.Wave, count: int) -> None:
        """Writes the camera rays of a wave of this many samples."""
        self._wave.start(self._model, wave, count)

    def _expose(self, first: int, pixels: int, samples: int) -> None:
        """Adds this many samples to some pixels."""
        self._add(self._samples_of(first, self.done, samples), pixels)

    def _expose_chosen(self, chosen: np.ndarray, first: int, samples: int) -> None:
        """Adds samples to chosen pixels only, which `done` does not count: `wrt.pictures.AdaptiveRendering` does.

        Args:
            chosen: (M,) int32 numbers of pixels, row by row.
            first: number of the first sample, among those of a pixel.
            samples: number of samples of each.
        """
        device = self._scene.device
        with use_threads(self._scene.num_threads):
            for begin in range(0, len(chosen), self._tile):
                part = chosen[begin : begin + self._tile]
                order = wp.array(part, dtype=int, device=device)
                for sample in range(first, first + samples, self._pass):
                    wave = self._samples_of(0, sample, min(self._pass, first + samples - sample))
                    wave.order = order
                    self._add(wave, len(part))

    def _collected_sums(self) -> tuple[np.ndarray, np.ndarray]:
        """(pixels, 3) and (pixels,) float32: the sums of the samples so far, and of the squares of their luminance."""
        return self._sums[0].numpy(), self._sums[1].numpy()

    def _add(self, wave: ray_queue.Wave, pixels: int) -> None:
        """Adds the samples of a wave of some pixels."""
        samples, count = wave.samples, pixels * wave.samples
        if not self._follow_in_tiles(wave, count):
            self._start(wave, count)
            self._wave.finish(self._tracer, self._wave.first_hits(self._tracer, self._starts_at_one_point))
        elif self._wave.develops_in_tiles(samples):
            return
        launch(
            picture.develop_wave, pixels, [wave, self._wave.radiance, self._collected], device=self._scene.device, chunk=4096
        )

    @property
    def linear(self) -> np.ndarray:
        """(height, width, 3) float32, linear: the mean of the samples so far.

        Raises:
            ValueError: there are none.
        """
        return self._of_pixels(picture.mean_of_samples, wp.vec3, self._sums[0], self.done).numpy()

    @property
    def noise(self) -> np.ndarray:
        """(height, width) float32: standard error of each pixel's luminance, from the spread of its samples; 0 for one sample.

        Samplers other than "random" spread samples evenly, so the true error is smaller.
        """
        return self._of_pixels(picture.standard_errors, float, *self._sums, self.done).numpy()

    def developed(self, tone_mapping: str | None = None, exposure: float | None = None) -> wp.array:
        """(height, width) vec3 on the scene's device, for display; arguments and errors as in `image`."""
        mapping = self.settings.tone_mapping if tone_mapping is None else tone_mapping
        number = picture.TONE_MAPPINGS.index(one_of(picture.TONE_MAPPINGS, mapping, "tone_mapping"))
        factor = self.settings.exposure if exposure is None else as_float("exposure", exposure)
        return self._of_pixels(picture.map_tones, wp.vec3, self._sums[0], self.done, float(factor), number)

    def image(self, tone_mapping: str | None = None, exposure: float | None = None) -> np.ndarray:
        """(height, width, 3) float32 for display, as `wrt.save_image` takes it.

        Args:
            tone_mapping, exposure: None for those of the settings.

        Raises:
            ValueError: an unknown name, or no samples yet.
        """
        return self.developed(tone_mapping, exposure).numpy()

    @property
    def layers(self) -> dict[str, np.ndarray]:
        """What the first sample of each pixel sees, by name:

        * "depth": (height, width) float32, distance from the camera; inf for a miss.
        * "normal", "albedo": (height, width, 3) float32, shading normal on the side of the camera, and colour; 0 for a miss.
        * "primitive_id", "geometry_id", "instance_id", "material_id": (height, width) int32, -1 for a miss.

        Traced at each access.
        """
        scene, made = self._scene, _new_layers(self.pixels, self._scene.device)
        with use_threads(scene.num_threads):
            if self._motion is not None:
                self._motion.move(scene, 0.5 / self.samples)
                self._take_state()
            for first in range(0, self.pixels, self._tile):
                pixels = min(self._tile, self.pixels - first)
                wave = self._samples_of(first, 0, 1)
                self._start(wave, pixels)
                hits = self._wave.first_hits(self._tracer, self._starts_at_one_point)
                found = hits.struct()
                for start, stop in self._wave.ranges(found):
                    inputs = [start, self._lit, wave, self._wave.queue, found, made]
                    launch(picture.write_layers, stop - start, inputs, device=scene.device)
        return {name: self._shaped(getattr(made, name)).numpy() for name in LAYERS}

    def save(self, path: str | Path) -> None:
        """Writes the picture: for display, or linear to ".exr" (with all layers) and ".npy".

        In the .exr file, depth is "Z", the others are "normal.X", "albedo.R", "primitive_id" and so on. Ids are uint32; a miss
        is 4294967295. It needs the package OpenEXR (`wrt[exr]`).

        Args:
            path: of the file; its extension decides.

        Raises:
            ValueError: no samples yet, an unknown extension, or OpenEXR is missing.
            FileNotFoundError: the folder does not exist.
        """
        suffix = Path(path).suffix.lower()
        if suffix != ".exr":
            save_image(path, self.linear if suffix == ".npy" else self.image())
            return
        layers, linear = self.layers, self.linear
        channels = {name: linear[..., i] for i, name in enumerate("RGB")} | {"Z": layers["depth"]}
        for layer, names in (("normal", "XYZ"), ("albedo", "RGB")):
            channels |= {f"{layer}.{name}": layers[layer][..., i] for i, name in enumerate(names)}
        save_exr(path, channels | {name: layers[name].view(np.uint32) for name in LAYERS if name.endswith("_id")})

    @property
    def key(self) -> str:
        """64 hexadecimal digits: equal for renderings whose samples are equal by the same version of wrt. They follow from
        the scene, the camera, the lights, the motion and the settings."""
        settings = {name: value for name, value in vars(self.settings).items() if name not in NOT_IN_SAMPLES}
        scene = (*self._shown, self.camera, self._lights, self._motion, *given_filter(self._scene.state))
        return fingerprint(self.integrator, self.samples, settings, *scene)

    def save_samples(self, path: str | Path) -> None:
        """Writes the samples so far to a file (.npz), from which `load_samples` continues.

        Args:
            path: of the file.

        Raises:
            ValueError: there are none.
            OSError: the file cannot be written.
        """
        if self.done == 0:
            raise ValueError("the picture has no samples yet; call advance() first")
        write_samples(Path(path), self.key, self.done, *(one.numpy() for one in self._sums))

    def load_samples(self, path: str | Path) -> Rendering:
        """Takes the samples of a file in place of those so far. The picture will be the same bit for bit as if it had not been
        interrupted.

        Args:
            path: of a file that `save_samples` of an equal rendering wrote.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: the samples are of another picture or another version of wrt, or the file is damaged.
        """
        self.done, film, squares = read_samples(Path(path), self.key, self.samples, self.pixels)
        for held, read in zip(self._sums, (film, squares), strict=True):
            held.assign(read)
        return self

    def __repr__(self) -> str:
        size = f"{self.camera.width} x {self.camera.height}"
        return f"Rendering({self.integrator!r}, {size}, {self.done} of {self.samples} samples)"


def camera_model(camera: Camera, settings: RenderSettings, scene: Scene, samples: int) -> CameraModel:
    """The camera for kernels.

    Raises:
        ValueError: a lens on an orthographic camera, or a focus that is not in front of the camera.
    """
    model = CameraModel()
    model.view = camera._view((0.5, 0.5))
    model.center = wp.vec3d(*map(float, scene.center))
    model.is_perspective = isinstance(camera, PinholeCamera)
    model.filter = FILTERS.index(settings.pixel_filter)
    model.at_center = samples == 1 and settings.pixel_filter == "box"
    if settings.lens_radius > 0.0 and isinstance(camera, OrthographicCamera):
        raise ValueError("lens_radius needs a wrt.PinholeCamera; rays of an orthographic camera do not pass through a lens")
    focus = settings.focus_distance
    focus = float((camera.look_at - camera.position) @ camera.forward) if focus is None else float(focus)
    model.lens_right = wp.vec3d(*(settings.lens_radius * camera.right))
    model.lens_up = wp.vec3d(*(settings.lens_radius * camera.up))
    model.focus = focus  # type: ignore[assignment]
    return model


def _warn_of_open_glass(scene: Scene, found: SceneMaterials) -> None:
    """Says which mesh with glass is not closed, the first of them."""
    glass = [number for number, material in enumerate(found.mesh.materials) if material.kind == "dielectric"]
    if not glass:
        return
    sizes = np.cumsum([mesh.triangle_count for mesh in scene.meshes])[:-1]
    for number, (mesh, own) in enumerate(zip(scene.meshes, np.split(found.of_face, sizes), strict=True)):
        if np.isin(own, glass).any() and not mesh.is_closed:
            warnings.warn(OPEN_GLASS.format(number), stacklevel=3)
            return


def _warn_of_glass(lights: Sequence[Any], found: SceneMaterials) -> None:
    """Says which of the lights that were given shine through no glass of the scene."""
    unhit = next((light for light in lights if isinstance(light, (PointLight, DirectionalLight))), None)
    if unhit is None:
        return
    glass = [number for number, material in enumerate(found.mesh.materials) if material.kind == "dielectric"]
    if glass and np.isin(found.of_face, glass).any():
        warnings.warn(NOT_HIT.format(type(unhit).__name__), stacklevel=3)


def _default_lights(camera: Camera, scene: Scene) -> tuple[Any, ...]:
    """A sky, and a point light above and to the left of the camera."""
    from wrt.lights.light_sources import PointLight
    from wrt.meshes.up_axis import default_up

    position = default_light(camera)
    distance = float(np.linalg.norm(position - camera.look_at))
    return PointLight(position, 1.5 * distance**2), Sky.gradient(*DEFAULT_SKY, up=default_up(scene))


def _new_layers(pixels: int, device: wp.Device) -> picture.Layers:
    layers = picture.Layers()
    for name in LAYERS:
        dtype = {"depth": float, "normal": wp.vec3, "albedo": wp.vec3}.get(name, int)
        setattr(layers, name, wp.zeros(pixels, dtype=dtype, device=device))
    return layers
