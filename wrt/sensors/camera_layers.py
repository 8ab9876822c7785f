"""What a camera's images show beside depth and ids: colours of surfaces, optical flow, and light.

Light is computed by the integrators of `wrt.pictures.Rendering`, with the camera's lens in place of a pinhole. Cameras are
those of `wrt.sensors.Camera`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from copy import copy
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.engine.host_arrays import as_array
from wrt.engine.memory import empty
from wrt.imaging.cameras import PinholeCamera
from wrt.imaging.integrators.device_materials import device_materials, scene_materials, shaded_mesh
from wrt.imaging.integrators.rendering_job import Rendering
from wrt.kernels.runtime.launch import launch
from wrt.kernels.shading.wavefront.ray_queue import Wave
from wrt.materials.material import Material
from wrt.sensors.checks import check_at_least

if TYPE_CHECKING:
    from wrt.clouds.point_cloud import PointCloud
    from wrt.kernels.sensors.camera_images import Images
    from wrt.kernels.sensors.lidar_beams import Beams
    from wrt.scene.scene import Scene
    from wrt.sensors.outputs.captured_images import CapturedLayers
    from wrt.sensors.time_slices import TracedSlice
    from wrt.sensors.trajectory import StillPoses, Trajectory


def extra_images(
    camera: Any,
    scene: Scene | PointCloud,
    path: Trajectory | StillPoses,
    motions: Mapping[int, Trajectory],
    times: tuple[float, float],
    albedo: bool,
    materials: Any,
    flow: float | None,
) -> dict[str, Any]:
    """The images that were asked for, to be filled; arguments and errors as in `Camera.capture`, and times of exposures."""
    count = camera.width * camera.height * math.prod(getattr(path, "shape", ()))
    found: dict[str, Any] = {}
    if albedo:
        if scene.state.tangents is not None:
            raise ValueError("albedo needs materials, and points have none; leave it out, and look colours up by primitive_id")
        found["albedo"] = Albedo(scene, materials, count)  # type: ignore[arg-type]  # no cloud
    if flow is not None:
        found["flow"] = Flow(camera, path, motions, flow, times, len(scene.state.instances), count, scene.device)
    return found


class Albedo:
    """The image of colours, filled slice by slice.

    Args:
        scene: whose surfaces these are.
        materials: as in `wrt.pictures.Rendering`.
        count: number of pixels.
    """

    def __init__(self, scene: Scene, materials: Any, count: int) -> None:
        from wrt.kernels.shading.wavefront.scene_light import LitScene

        self._lit, self.values = LitScene(), empty(count, wp.vec3, scene.device)
        self._lit.shaded = shaded_mesh(scene, None)
        self._lit.materials = device_materials(scene_materials(scene, materials, Material()), scene.device)

    def fill(self, beams: Beams, made: CapturedLayers) -> None:
        """Writes all pixels."""
        from wrt.kernels.sensors.surface_images import fill_albedo

        for found in made.found:
            self._lit.shaded.mesh = found.mesh
            inputs = [beams, found.traced, found.uvs(), self._lit, self.values]
            launch(fill_albedo, found.part.end - found.part.begin, inputs, device=self.values.device, chunk=1024)


class Flow:
    """The image of optical flow, filled slice by slice.

    Args:
        camera: whose image it is.
        path: of the camera.
        motions: of instances.
        duration: seconds from the exposure to the other image.
        times: of the first and the last exposure.
        instances: number of instances.
        count: number of pixels.
        device: of the image.

    Raises:
        TypeError: `duration` is not a number.
        ValueError: it is 0, or a trajectory does not cover the time.
    """

    def __init__(
        self,
        camera: Any,
        path: Trajectory | StillPoses,
        motions: Mapping[int, Trajectory],
        duration: float,
        times: tuple[float, float],
        instances: int,
        count: int,
        device: wp.Device,
    ) -> None:
        if check_at_least("flow", duration, -np.inf) == 0.0:
            raise ValueError("flow is 0; pass the seconds from this image to the other one, or None for no flow")
        begin, end = sorted((times[0] + duration, times[1] + duration))
        path.check_covers(begin, end, "the times of the flow")
        for number, body in motions.items():
            body.check_covers(begin, end, f"motions[{number}]: the times of the flow")
        self._camera, self._path, self._motions, self._duration = camera, path, motions, float(duration)
        self._carried = np.full(instances if motions else 0, -1, dtype=np.int32)
        self._carried[list(motions)] = np.arange(len(motions))
        self.values = empty(count, wp.vec2, device)

    def fill(self, beams: Beams, made: CapturedLayers) -> None:
        """Writes all pixels, from their positions and instances."""
        from wrt.kernels.sensors.camera_images import Images

        made.make(("position", "instance"))
        images = Images()
        images.position, images.instance = as_array(made.arrays["position"]), as_array(made.arrays["instance"])
        for found in made.found:
            self._fill_slice(beams, images, found)

    def _fill_slice(self, beams: Beams, images: Images, found: TracedSlice) -> None:
        from wrt.kernels.sensors.surface_images import Later, fill_flow

        device, later, time = self.values.device, Later(), found.part.time
        carries = [body.at(time + self._duration) @ np.linalg.inv(body.at(time)) for body in self._motions.values()]
        later.duration = wp.float64(self._duration)
        later.carried = wp.array(self._carried, dtype=int, device=device)
        later.carries = wp.array(np.reshape(carries, (-1, 4, 4)), dtype=wp.mat44d, device=device)
        lens, columns, path = self._camera.lens.struct(), self._camera.width, self._path.path(device)
        inputs = [beams, path, found.part.begin, lens, columns, images, later, self.values]
        launch(fill_flow, found.part.end - found.part.begin, inputs, device=device, chunk=1024)


class LensRendering(Rendering):
    """A `wrt.pictures.Rendering` through a lens of `wrt.sensors`: samples are spread over pixels by the pixel filter.

    Args:
        scene: as in `wrt.pictures.Rendering`; instances that move are where they shall be.
        camera: the camera.
        path: its poses.
        time: of the first row.
        options: as in `wrt.pictures.Rendering`, without `motion` and `lens_radius`.
    """

    def __init__(self, scene: Any, camera: Any, path: Trajectory, time: float, **options: Any) -> None:
        pose = path.at(time)
        ahead, up = pose[:3, 3] + pose[:3, 2], -pose[:3, 1]
        self.sensor, self._path, self._time = camera, path, time
        view = PinholeCamera(camera.width, camera.height, position=pose[:3, 3], look_at=ahead, up=up)
        super().__init__(scene, view, **options)
        if self.settings.lens_radius > 0.0:
            raise ValueError("lens_radius is of thin lenses; lenses of wrt.sensors have none")

    def _follow_in_tiles(self, wave: Wave, count: int) -> bool:
        return False  # camera rays are replaced

    @property
    def _starts_at_one_point(self) -> bool:
        return False  # a lens may have several centres, and the camera moves while rows are read

    def _start(self, wave: Wave, count: int) -> None:
        from wrt.kernels.sensors.surface_images import start_lens_rays

        super()._start(wave, count)
        device, delay = self._scene.device, wp.float64(self.sensor.line_delay)
        rays = [self._model, self._wave.samples, wave, self._wave.queue]
        inputs = [self.sensor.lens.struct(), self._path.path(device), wp.float64(self._time), delay, *rays]
        launch(start_lens_rays, count, inputs, device=device, chunk=1024)

    @property
    def key(self) -> str:
        from wrt.imaging.integrators.saved_samples import fingerprint

        lens = self.sensor.lens
        poses = (self._path.times, self._path.positions, self._path.rotations, self._time, self.sensor.line_delay)
        return fingerprint(super().key, type(lens).__name__, *vars(lens).values(), *poses)


def render(
    scene: Any, camera: Any, path: Trajectory, time: float, motions: Mapping[int, Trajectory], **options: Any
) -> LensRendering:
    """A picture through a lens, without samples; instances are where they are in the middle of the exposure."""
    if motions:
        scene = copy(scene)
        middle = time + camera.line_delay * (camera.height - 1) / 2
        scene.update(list(motions), transform=np.array([body.at(middle) for body in motions.values()]))
    return LensRendering(scene, camera, path, time, **options)
