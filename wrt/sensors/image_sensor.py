"""Cameras with lenses, rolling shutters and images of what they see."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.engine.memory import ArraysOfBlock, empty, outputs_of
from wrt.kernels.runtime.launch import as_device, kept, launch, refuse_capture, use_threads
from wrt.kernels.validation import as_bool, as_float, as_int, as_numbers, as_real_array, convert_fields
from wrt.sensors.camera_conversion import camera_of, lens_of
from wrt.sensors.checks import as_time, check_at_least
from wrt.sensors.hit_outputs import HitOutputs
from wrt.sensors.lens_models import LensModel
from wrt.sensors.lidar import spread_on
from wrt.sensors.time_slices import (
    Bodies,
    SensorRays,
    as_motions,
    check_slices,
    cut_slices,
    for_each_ray,
    no_order,
    no_vectors,
    slice_error,
    trace_slices,
)
from wrt.sensors.trajectory import StillPoses, Trajectory, as_poses, as_trajectory

if TYPE_CHECKING:
    from wrt.imaging.cameras import OrthographicCamera, PinholeCamera
    from wrt.imaging.integrators.rendering_job import Rendering
    from wrt.kernels.sensors.camera_images import Images
    from wrt.kernels.sensors.lidar_beams import Beams
    from wrt.scene.scene import Scene

MAX_PIXELS = (1 << 31) - 1

KEPT_CAMERAS = 16
"""Cameras whose rays are kept."""

IMAGES = {
    "distance": wp.float32,
    "depth": wp.float32,
    "position": wp.vec3d,
    "normal": wp.vec3,
    "camera_normal": wp.vec3,
    "instance": wp.int32,
    "geometry": wp.int32,
    "primitive": wp.int32,
    "semantic": wp.int32,
}


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

    def to_camera(self, pose: Any) -> PinholeCamera | OrthographicCamera:
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
        scene: Scene,
        pose: Any,
        *,
        time: float = 0.0,
        motions: Mapping[int, Trajectory] | None = None,
        slices: int = 1,
        labels: Any = None,
        miss: float = np.inf,
        mask: Any = None,
        environment: Any = None,
        traversal: Any = "auto",
        albedo: bool = False,
        materials: Any = None,
        flow: float | None = None,
        to_warp: bool = False,
    ) -> CameraImages:
        """Traces one image.

        Args:
            scene: a `wrt.Scene`. It is not changed, whatever moves.
            pose: (4, 4) from the optical frame (x right, y down, z forward) to the world, or a `Trajectory`: with a rolling
                shutter, each row is seen from the pose at its own time. Or (..., 4, 4) of many cameras at rest, which see in
                one call.
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
            to_warp: whether images are Warp arrays on the scene's device instead of NumPy arrays.

        Raises:
            TypeError: an argument of a wrong type.
            ValueError: an argument out of range, a trajectory that does not cover the exposure, or motions in a scene without
                instances.
            RuntimeError: a graph is being captured.
        """
        from wrt.kernels.sensors.camera_images import fill_images

        refuse_capture("capture", scene.device)
        if materials is not None and not albedo:
            raise ValueError("materials are those of the colours; pass albedo=True, or leave materials out")
        path, time, slices = as_poses(pose), as_time(time), check_slices(slices)
        miss, albedo, to_warp = as_miss(miss), as_bool("albedo", albedo), as_bool("to_warp", to_warp)
        flow = None if flow is None else as_float("flow", flow, finite=True)
        rows = np.repeat(self.line_delay * np.arange(self.height), self.width).reshape(self.height, self.width)
        begin, end = time, time + float(rows[-1, 0])
        path.check_covers(begin, end, "the times of the image")
        motions = as_motions(motions, scene, begin, end)
        cameras, device = getattr(path, "shape", ()), scene.device
        times = np.broadcast_to(rows, (*cameras, *rows.shape))
        order, parts = cut_slices(times, (0.0, float(rows[-1, 0])), time, slices if motions else 1)
        beams, (images, arrays) = self.beams(device, order, time), _new_images(times.size, device)
        each = for_each_ray({"mask": mask, "environment": environment}, cameras, rows.size, 1, order, device)
        labels = wp.array(as_labels(labels, scene), dtype=int, device=device)
        extra = {}
        if albedo or flow is not None:
            from wrt.sensors.camera_layers import extra_images

            extra = extra_images(self, scene, path, motions, (begin, end), albedo, materials, flow)
        with use_threads(scene.num_threads):
            fired = _fire(beams, path, self, times.size, device)
            rays = SensorRays(*fired, 1, times.shape, np.inf, traversal, each)
            for found in trace_slices(copy(scene), rays, Bodies(motions, parts), parts):
                inputs = [beams, path.path(device), found.traced, found.origins, found.mesh, labels, miss, images]
                launch(fill_images, found.part.end - found.part.begin, inputs, device=device, chunk=1024)
                for layer in extra.values():
                    layer.fill(beams, images, found)
        values = {name: layer.values for name, layer in extra.items()}
        return CameraImages(self, arrays, path, time, to_warp, slice_error(motions, scene, parts), values)

    def render(
        self,
        scene: Any,
        pose: Any,
        *,
        time: float = 0.0,
        motions: Mapping[int, Trajectory] | None = None,
        integrator: str = "path",
        lights: Any = None,
        materials: Any = None,
        settings: Any = None,
        **options: Any,
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
        options = {"integrator": integrator, "lights": lights, "materials": materials, "settings": settings, **options}
        return render(scene, self, path, time, motions, **options).advance()

    def beams(self, device: wp.Device, order: np.ndarray | None, time: float) -> Beams:
        """The rays of all pixels in the optical frame, for kernels.

        Args:
            device: where they are read.
            order: in which they are traced, the numbers of pixels; None for row by row.
            time: exposure of the first row, in seconds.
        """
        from wrt.kernels.sensors.lidar_beams import Beams

        beams = Beams()
        beams.directions, beams.offsets, beams.times = _optical_rays(self, device.alias)
        beams.order = no_order(device.alias) if order is None else wp.array(order, dtype=int, device=device)
        beams.spread = spread_on(1, 0.0, device.alias)
        beams.start = wp.float64(time)
        return beams


class CameraImages(HitOutputs):
    """What a `Camera` saw: images of shape (height, width), NumPy arrays, or Warp arrays on request.

    Those of many cameras have the leading shape of their poses before it.

    Attributes:
        distance: float32, along the ray; the miss value where there is no hit.
        depth: float32, along the optical axis (z); the miss value where there is no hit.
        position: (..., 3) float64 in the world; NaN for a miss.
        normal: (..., 3) float32 in the world, by the winding of the triangle; 0 for a miss.
        camera_normal: (..., 3) float32, the same in the optical frame at the time of the row.
        instance_id: int32, index of the instance, or of the mesh in a scene without instances; -1 for a miss.
        geometry_id, primitive_id: int32, the mesh and the triangle within it; -1 for a miss.
        semantic_id: int32, the label of the instance; -1 for a miss, and without labels.
        albedo: (..., 3) float32, the colour of the surface's material, linear, without light; 0 for a miss. None unless asked
            for.
        flow: (..., 2) float32, by how many pixels to the right and down the surface point is elsewhere in the image some time
            after the pixel's own; NaN for a miss, and where the lens does not see it then. Other surfaces may hide it. None
            unless asked for.
        time: (height,) float64, when each row was exposed.
        camera, trajectory, start: how they were made.
        motion_error: bound on the displacement of surfaces by time slices (`wrt.sensors.time_slices`).
    """

    def __init__(
        self,
        camera: Camera,
        images: Mapping[str, wp.array] | ArraysOfBlock,
        trajectory: Trajectory | StillPoses,
        start: float,
        to_warp: bool,
        motion_error: float,
        extra: Mapping[str, wp.array],
    ) -> None:
        self.camera, self.trajectory, self.start, self.motion_error = camera, trajectory, start, motion_error
        self._extra = extra
        super().__init__(images, (*getattr(trajectory, "shape", ()), camera.height, camera.width), to_warp)

    @cached_property
    def distance(self) -> Any:
        return self._out("distance")

    @cached_property
    def depth(self) -> Any:
        return self._out("depth")

    @cached_property
    def camera_normal(self) -> Any:
        return self._out("camera_normal")

    @cached_property
    def semantic_id(self) -> Any:
        return self._out("semantic")

    @cached_property
    def albedo(self) -> Any:
        return self._shaped(self._extra.get("albedo"))

    @cached_property
    def flow(self) -> Any:
        return self._shaped(self._extra.get("flow"))

    @cached_property
    def time(self) -> np.ndarray:
        return self.start + self.camera.line_delay * np.arange(self.camera.height)


@lru_cache(maxsize=KEPT_CAMERAS)
def _optical_rays(camera: Camera, device: str) -> tuple[wp.array, wp.array, wp.array]:
    """Directions, offsets (0,) or (N,), and times of all pixels' rays in the optical frame; kept for the next image."""
    from wrt.kernels.sensors.lenses import image_rays

    on, count = as_device(device), camera.width * camera.height
    with kept(on):
        directions, times = empty(count, wp.vec3, on), empty(count, wp.float64, on)
        offsets = wp.empty(0 if camera.lens.one_centre else count, dtype=wp.vec3, device=on)
        inputs = [camera.lens.struct(), camera.width, wp.float64(camera.line_delay), offsets, directions, times]
        launch(image_rays, count, inputs, device=on, chunk=1024)
    return directions, offsets, times


def _new_images(count: int, device: wp.Device) -> tuple[Images, Mapping[str, wp.array] | ArraysOfBlock]:
    """Memory for images: as kernels see it, and the arrays."""
    from wrt.kernels.sensors.camera_images import Images

    images = Images()
    return images, outputs_of(images, IMAGES, count, device)


def _fire(
    beams: Beams, path: Trajectory | StillPoses, camera: Camera, count: int, device: wp.Device
) -> tuple[wp.array, wp.array]:
    """Origins and directions of all pixels' rays in the world, in the order in which they are traced."""
    from wrt.kernels.sensors.lidar_beams import fire_beams

    shared = path.is_still and camera.lens.one_centre and count == camera.width * camera.height
    origins = empty(1 if shared else count, wp.vec3d, device)
    directions = empty(count, wp.vec3, device)
    launch(
        fire_beams,
        count,
        [beams, path.path(device), origins, wp.vec3d(), no_vectors(device.alias), directions],
        device=device,
        chunk=2048,
    )
    return origins, directions


def as_miss(miss: Any) -> float:
    """The distance of a pixel without a hit: any number, NaN included.

    Raises:
        TypeError: not a number.
    """
    return miss if type(miss) is float else float(as_numbers("miss", miss, (), finite=False))


def as_labels(labels: Any, scene: Scene) -> np.ndarray:
    """(I,) int32, or (0,) for none.

    Raises:
        TypeError: not integers.
        ValueError: another number of labels, or a negative one.
    """
    if labels is None:
        return np.zeros(0, dtype=np.int32)
    values, count = as_real_array("labels", labels), len(scene.instances) or len(scene.meshes)
    if values.dtype.kind not in "iu":
        raise TypeError(f"labels must hold integers, not {values.dtype}")
    if values.shape != (count,) or values.min() < 0 or values.max() >= 1 << 31:
        raise ValueError(f"labels must be {count} numbers from 0 to 2**31 - 1, one for each instance, not {labels!r:.80}")
    return values.astype(np.int32)
