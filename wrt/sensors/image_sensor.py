"""Cameras with lenses, rolling shutters and images of what they see."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import lru_cache
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.engine.memory import empty
from wrt.kernels.runtime.launch import as_device, kept, launch, use_threads
from wrt.kernels.validation import as_bool, as_float, as_int, as_numbers, convert_fields
from wrt.sensors.camera_conversion import camera_of, lens_of
from wrt.sensors.checks import as_time, check_at_least, check_scene
from wrt.sensors.fired_rays import fire, spread_on
from wrt.sensors.lens_models import LensModel
from wrt.sensors.outputs.captured_images import CameraImages, CapturedLayers
from wrt.sensors.outputs.hit_outputs import as_layers
from wrt.sensors.placed.device_poses import DevicePoses, as_poses
from wrt.sensors.placed.values_on_devices import refuse_captured_scan, refuse_part
from wrt.sensors.time_slices import (
    Bodies,
    SensorRays,
    Slice,
    as_motions,
    check_slices,
    cut_slices,
    for_each_ray,
    labels_on,
    no_order,
    slice_error,
    trace_slices,
)
from wrt.sensors.trajectory import Trajectory, as_trajectory

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from wrt.array_types import ArrayLike, Numbers
    from wrt.clouds.point_cloud import PointCloud
    from wrt.engine.plan.plan import Plan
    from wrt.imaging.cameras import OrthographicCamera, PinholeCamera
    from wrt.imaging.integrators.render_settings import RenderSettings, SettingOptions
    from wrt.imaging.integrators.rendering_job import Rendering
    from wrt.kernels.sensors.lidar_beams import Beams
    from wrt.lights.device_lights import Lights
    from wrt.materials.material import Materials
    from wrt.scene.scene import Scene
    from wrt.sensors.trajectory import Pose

MAX_PIXELS = (1 << 31) - 1

KEPT_CAMERAS = 16
"""Cameras whose rays are kept."""


@dataclass(frozen=True)
class Camera:
    """A camera with a lens: `capture` traces the ray of each pixel's centre.

        lens = wrt.sensors.BrownConrady.from_matrix(K, distortion)
        camera = wrt.sensors.Camera(1280, 720, lens)
        images = camera.capture(scene, wrt.sensors.pose_from_extrinsics(extrinsics))
        images.depth, images.normal, images.instance_id

    **Pixels** are OpenCV's: row 0 is at the top, the centre of pixel (row, column) is at (column, row), whole numbers, and the
    image's centre at ((width - 1) / 2, (height - 1) / 2). The optical frame has x to the right, y down and z forward, along the
    axis. `wrt.PinholeCamera` has its pixel centres 0.5 further to the right and down; `from_camera` and `to_camera` convert.

    Attributes:
        width, height: of the image, in pixels.
        lens: one of the lens models, in these pixels.
        line_delay: seconds between the exposures of two rows, from the top down; 0 for a global shutter.

    Raises:
        TypeError: a value of a wrong type.
        ValueError: a value out of range.
    """

    width: int
    height: int
    lens: LensModel
    line_delay: float = 0.0

    def __post_init__(self) -> None:
        convert_fields(self)
        for name in ("width", "height"):
            as_int(name, getattr(self, name), 1)
        if self.width * self.height > MAX_PIXELS:
            raise ValueError(f"width x height is {self.width * self.height}; an image has at most {MAX_PIXELS} pixels")
        if not isinstance(self.lens, LensModel):
            raise TypeError(f"lens must be a lens of wrt.sensors, such as BrownConrady, not {type(self.lens).__name__}")
        check_at_least("line_delay", self.line_delay, 0.0)

    @classmethod
    def from_camera(cls, camera: PinholeCamera | OrthographicCamera) -> tuple[Camera, np.ndarray]:
        """The same view as that of a `wrt.PinholeCamera` or `wrt.OrthographicCamera`, pixel by pixel.

            sensor, pose = wrt.sensors.Camera.from_camera(camera)
            depth = sensor.capture(scene, pose).depth

        Args:
            camera: the camera.

        Returns:
            The camera with its lens, and the pose for `capture`.

        Raises:
            TypeError: it is neither.
        """
        lens = lens_of(camera)
        return cls(camera.width, camera.height, lens), camera.pose

    def to_camera(self, pose: ArrayLike) -> PinholeCamera | OrthographicCamera:
        """The same view as a `wrt.PinholeCamera`, or a `wrt.OrthographicCamera` for an orthographic lens.

        Args:
            pose: (4, 4) from the optical frame to the world, as in `capture`.

        Raises:
            TypeError: not a matrix.
            ValueError: a view that these cameras do not have: distortion, skew, a fisheye lens, an axis that does not pass
                through the image's centre, pixels that are not square, a rolling shutter; or no rigid pose.
        """
        if self.line_delay:
            raise ValueError(f"line_delay is {self.line_delay}; a wrt.PinholeCamera sees all rows at once")
        return camera_of(self.lens, self.width, self.height, pose)

    def capture(
        self,
        scene: Scene | PointCloud,
        pose: Pose,
        *,
        time: float = 0.0,
        motions: Mapping[int, Trajectory] | None = None,
        slices: int = 1,
        labels: ArrayLike | None = None,
        miss: float = np.inf,
        mask: Numbers | None = None,
        environment: Numbers | None = None,
        traversal: str | Plan = "auto",
        albedo: bool = False,
        materials: Materials | None = None,
        flow: float | None = None,
        layers: Sequence[str] | None = None,
        to_warp: bool | None = None,
    ) -> CameraImages:
        """Traces one image.

        Args:
            scene: a `wrt.Scene`, or a `PointCloud`, which counts as one mesh. It is not changed, whatever moves.
            pose: (4, 4) from the optical frame (x right, y down, z forward) to the world, or a `Trajectory`: with a rolling
                shutter, each row is seen from the pose at its own time. Or (..., 4, 4) of many cameras at rest, which see in
                one call; or a Warp array (...) of `wp.transform` on the scene's device, whose values are not checked.
            time: exposure of the first row, on the clock of the trajectories.
            motions, slices: instances that move, and number of time slices, as in `Lidar.scan`.
            labels: (I,) integers >= 0, the semantic class of each instance (of each mesh, in a scene without instances).
            miss: distance and depth of a pixel without a hit.
            mask, environment: as in `wrt.Scene.intersect`, one number, or one for each of many cameras.
            traversal: as in `wrt.Scene.intersect`.
            albedo: whether to make the image of the surfaces' own colours.
            materials: those of the colours, as in `wrt.pictures.Rendering`: None for those of the meshes.
            flow: seconds from this image to another one, after it or before, for the optical flow between them; None for no
                flow. Trajectories must cover its exposure, too.
            layers: names of the layers that will be read, such as ("depth", "instance_id"): distance, depth, position, normal,
                camera_normal, instance_id, geometry_id, primitive_id, semantic_id. None for all. NumPy arrays are computed when
                they are first read, so choosing them saves the time and memory of what is computed along with them.
            to_warp: whether images are Warp arrays on the scene's device instead of NumPy arrays; None: if poses are a Warp
                array.

        An image can be captured in a graph as a scan can (`Lidar.scan`), without `albedo` and `flow`.

        Raises:
            TypeError: an argument of a wrong type.
            ValueError: an argument out of range, a trajectory that does not cover the exposure, motions in a scene without
                instances, or `albedo` of a `PointCloud`.
            RuntimeError: a graph is being captured, which cannot repeat the image.
        """
        check_scene(scene)
        if materials is not None and not albedo:
            raise ValueError("materials are those of the colours; pass albedo=True, or leave materials out")
        path, time, slices = as_poses(pose, scene.device), as_time(time), check_slices(slices)
        miss, albedo = as_miss(miss), as_bool("albedo", albedo)
        to_warp = isinstance(path, DevicePoses) if to_warp is None else as_bool("to_warp", to_warp)
        refuse_captured_scan(scene.device, path, motions, to_warp)
        if scene.device.is_capturing and (albedo or flow is not None):
            refuse_part("albedo and flow", "leave them out")
        flow = None if flow is None else as_float("flow", flow, finite=True)
        chosen = as_layers(layers, CapturedLayers.KINDS)
        begin, end = time, time + self.line_delay * (self.height - 1)
        path.check_covers(begin, end, "the times of the image")
        motions = as_motions(motions, scene, begin, end)
        cameras, device = getattr(path, "shape", ()), scene.device
        order, parts = self._cut(cameras, time, slices if motions else 1)
        beams, pixels = self.beams(device, order, time), self.width * self.height
        each = for_each_ray({"mask": mask, "environment": environment}, cameras, pixels, 1, order, device)
        numbers = labels_on(labels, scene)
        extra = {}
        if albedo or flow is not None:
            from wrt.sensors.camera_layers import extra_images

            extra = extra_images(self, scene, path, motions, (begin, end), albedo, materials, flow)
        with use_threads(scene.num_threads):
            key, count = self if order is None else None, prod(cameras)
            fired = fire(beams, path, device, (count, pixels, self.lens.one_centre), None, key)
            rays = SensorRays(*fired, 1, (*cameras, self.height, self.width), np.inf, traversal, each)
            found = list(trace_slices(copy(scene), rays, Bodies(motions, parts), parts))
            given = beams, path.path(device), numbers, miss, count * pixels, scene.num_threads
            made = CapturedLayers(found, *given, slice_error(motions, scene, parts))
            for layer in extra.values():
                layer.fill(beams, made)
        values = {name: layer.values for name, layer in extra.items()}
        return CameraImages(self, made, path, time, to_warp, chosen, values)

    def _cut(self, cameras: tuple[int, ...], time: float, slices: int) -> tuple[np.ndarray | None, list[Slice]]:
        """As `wrt.sensors.time_slices.cut_slices`, of all pixels of all cameras."""
        rows: Any = np.float64(0.0)
        if slices > 1 and self.line_delay > 0.0:
            rows = (self.line_delay * np.arange(self.height))[:, None]
        times = np.broadcast_to(rows, (*cameras, self.height, self.width))
        return cut_slices(times, (0.0, self.line_delay * (self.height - 1)), time, slices)

    def render(
        self,
        scene: Scene,
        pose: Pose,
        *,
        time: float = 0.0,
        motions: Mapping[int, Trajectory] | None = None,
        integrator: str = "path",
        lights: Lights | None = None,
        materials: Materials | None = None,
        settings: RenderSettings | None = None,
        **options: Unpack[SettingOptions],
    ) -> Rendering:
        """A picture in colour, by the integrators of `wrt.pictures.Rendering`, all samples of which are made.

            picture = camera.render(scene, pose, samples=64, lights=[wrt.lights.Sky(1.0)])
            wrt.save_image("view.png", picture.image())

        Rays through a pixel are spread by the pixel filter. Pixels without a ray are black. With a rolling shutter each row is
        seen from the pose at its own time; instances are where they are in the middle of the exposure.

        Args:
            scene, pose, time, motions: as in `capture`; one pose or trajectory.
            integrator, lights, materials, settings, options: as in `wrt.pictures.Rendering`.

        Returns:
            A `wrt.pictures.Rendering`: `image()` for display, `linear`, `noise` and `layers`.

        Raises:
            TypeError, ValueError: as `capture` and `wrt.pictures.Rendering`; many poses.
        """
        from wrt.sensors.camera_layers import render

        path, time = as_trajectory(pose), as_time(time)
        end = time + self.line_delay * (self.height - 1)
        path.check_covers(time, end, "the times of the image")
        motions = as_motions(motions, scene, time, end)
        given: dict[str, Any] = {"lights": lights, "materials": materials, "settings": settings, **options}
        return render(scene, self, path, time, motions, integrator=integrator, **given).advance()

    def beams(self, device: wp.Device, order: np.ndarray | None, time: float) -> Beams:
        """The rays of all pixels in the optical frame, for kernels.

        Args:
            device: where they are read.
            order: in which they are traced, the numbers of pixels; None for row by row.
            time: exposure of the first row, in seconds.
        """
        from wrt.kernels.runtime.argument_packing import copied

        beams = copied(_optical_beams(self, device.alias))
        if order is not None:
            beams.order = wp.array(order, dtype=int, device=device)
        beams.start = wp.float64(time)
        return beams


@lru_cache(maxsize=KEPT_CAMERAS)
def _optical_beams(camera: Camera, device: str) -> Beams:
    """The rays of all pixels in the optical frame, row by row; kept for the next image."""
    from wrt.kernels.sensors.lenses import image_rays
    from wrt.kernels.sensors.lidar_beams import Beams

    on, count, beams = as_device(device), camera.width * camera.height, Beams()
    with kept(on):
        directions, times = empty(count, wp.vec3, on), empty(count, wp.float64, on)
        offsets = wp.empty(0 if camera.lens.one_centre else count, dtype=wp.vec3, device=on)
        inputs = [camera.lens.struct(), camera.width, wp.float64(camera.line_delay), offsets, directions, times]
        launch(image_rays, count, inputs, device=on, chunk=1024)
    beams.directions, beams.offsets, beams.times = directions, offsets, times
    beams.order, beams.spread = no_order(device), spread_on(1, 0.0, device)
    return beams


def as_miss(miss: Any) -> float:
    """The distance of a pixel without a hit: any number, NaN included.

    Raises:
        TypeError: not a number.
    """
    return miss if type(miss) is float else float(as_numbers("miss", miss, (), finite=False))
