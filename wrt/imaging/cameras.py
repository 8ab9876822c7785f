"""Cameras: images of given size, and the ray through each pixel.

A camera is placed at `position`, points at `look_at` (the image centre), and `up` points upward in the image. Images have
the shape (height, width); row 0 is at the top, column 0 at the left, and pixels are square. **Pixels:** pixel (row, column)
covers the square from (column, row) to (column + 1, row + 1), so its centre is at (column + 0.5, row + 0.5), and the image's
centre at (width / 2, height / 2). (`wrt.sensors.Camera` has OpenCV's pixels, whose centres are whole numbers: 0.5 less.)
With one sample per pixel, its ray passes through the pixel centre. With S samples, ray s takes point s of the Hammersley set,
the same in each pixel: samples cover all S columns and, for powers of two, all S rows of a pixel once, which keeps edges
smooth. Another seed shifts the pattern (Cranley and Patterson), so that images with different seeds can be averaged.

References: hammersley-1960; cranley-patterson-1976.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.engine.rays.rays import Rays
from wrt.imaging.view_frames import check_pose, corners_of, default_view, frame_of, nearest_view
from wrt.kernels.compilation.kernel_cache import init_warp
from wrt.kernels.runtime.launch import launch, refuse_capture
from wrt.kernels.shading.pixel_rays import View, orthographic_origins, pinhole_directions
from wrt.kernels.validation import as_float, as_int, as_point
from wrt.meshes.up_axis import default_up

if TYPE_CHECKING:
    from typing_extensions import Self

    from wrt.array_types import ArrayLike
    from wrt.clouds.point_cloud import PointCloud
    from wrt.meshes.instance import Geometry
    from wrt.scene.scene import Scene

__all__ = ["OrthographicCamera", "PinholeCamera"]

_MAX_PIXELS = 2**31 - 1


class _Camera:
    """Base class of cameras: the image frame, and the mapping from pixels to rays.

    Attributes:
        width, height: size of the image in pixels.
        position, look_at: (3,) float64.
        forward, right, up: (3,) float64, orthogonal unit vectors.
    """

    def __init__(self, width: int, height: int, position: ArrayLike, look_at: ArrayLike, up: ArrayLike) -> None:
        self.width = as_int("width", width, 1)
        self.height = as_int("height", height, 1)
        if self.width * self.height > _MAX_PIXELS:
            raise ValueError(f"width x height is {self.width * self.height}; an image has at most {_MAX_PIXELS} pixels")
        self.position = as_point("position", position)
        self.look_at = as_point("look_at", look_at)
        self.forward, self.right, self.up = frame_of(self.look_at - self.position, as_point("up", up))

    @classmethod
    def from_opencv(cls, width: int, height: int, pose: ArrayLike, **options: float) -> Self:
        """A camera at a pose of OpenCV, ROS or COLMAP: x to the right, y down, z forward.

        Args:
            width, height: size of the image in pixels.
            pose: (4, 4) from the camera to the world: a rotation and a position. Extrinsics map the world to the camera: pass
                their inverse.
            options: `fov` of a `wrt.PinholeCamera`, `view_height` of a `wrt.OrthographicCamera`.

        Raises:
            TypeError: not numbers; an unknown option.
            ValueError: another shape, numbers that are not finite, scale, shear or mirroring; as the class.
        """
        return cls._at(width, height, check_pose("pose", pose), 1.0, options)

    @classmethod
    def from_opengl(cls, width: int, height: int, pose: ArrayLike, **options: float) -> Self:
        """A camera at a pose of OpenGL, glTF, trimesh or NeRF data: x to the right, y up, looking along -z.

        Args:
            width, height: size of the image in pixels.
            pose: (4, 4) from the camera to the world: a rotation and a position. A view matrix maps the world to the camera:
                pass its inverse.
            options: `fov` of a `wrt.PinholeCamera`, `view_height` of a `wrt.OrthographicCamera`.

        Raises:
            TypeError, ValueError: as `from_opencv`.
        """
        return cls._at(width, height, check_pose("pose", pose), -1.0, options)

    @classmethod
    def _at(cls, width: int, height: int, pose: np.ndarray, sign: float, options: dict[str, Any]) -> Self:
        """sign: 1 for a camera that looks along z, with y down; -1 for one that looks along -z, with y up."""
        if taken := {"position", "look_at", "up"} & options.keys():
            raise TypeError(f"{min(taken)} is in the pose; leave it out")
        position, forward, up = pose[:3, 3], sign * pose[:3, 2], -sign * pose[:3, 1]
        camera = cls(width, height, position=position, look_at=position + forward, up=up, **options)
        camera.forward, camera.right, camera.up = frame_of(forward, up)  # far from the origin, look_at is rounded
        return camera

    @property
    def pose(self) -> np.ndarray:
        """(4, 4) float64, from the optical frame (x to the right, y down, z forward) to the world, as in `wrt.sensors`."""
        pose = np.eye(4)
        pose[:3, :3] = np.stack([self.right, -self.up, self.forward], axis=1)
        pose[:3, 3] = self.position
        return pose

    def rays(self, sample: int = 0, samples: int = 1, seed: int = 0) -> Rays[np.ndarray]:
        """One ray per pixel, on the CPU: a `wrt.Rays` of shape (height, width).

        Args:
            sample: index of the pixel's ray, 0 <= sample < samples.
            samples: number of rays per pixel; with 1, the ray passes through the pixel centre, whatever the seed.
            seed: another seed shifts all rays within their pixels; the same arguments always give the same rays.

        Raises:
            TypeError: an argument is not a whole number.
            ValueError: a value out of range.
        """
        init_warp()
        device = wp.get_device("cpu")
        refuse_capture("rays in NumPy arrays", device)
        rays = self.rays_on(device, 0, self.width * self.height, pixel_offset(sample, samples, seed))
        arrays = (rays.origins.numpy(), rays.directions.numpy())
        shape = (self.height, self.width, 3)
        return Rays(*(a.reshape(shape) if a.size != 3 else a.reshape(1, 1, 3) for a in arrays))

    def rays_on(
        self, device: wp.Device, first_pixel: int, count: int, offset: tuple[float, float] = (0.5, 0.5)
    ) -> Rays[wp.array]:
        """Rays of `count` pixels, row by row from `first_pixel`, as Warp arrays on a device.

        Args:
            device: device of the rays.
            first_pixel: index of the first pixel, row by row.
            count: number of pixels.
            offset: position of the ray within its pixel, in [0, 1)^2 from the top left corner (`pixel_offset`).

        Returns:
            Rays of shape (count,), unit directions in float32, origins in float64; an array that all rays share has shape
            (1,).
        """
        raise NotImplementedError

    def _half_extent(self) -> tuple[float, float]:
        """Half width and half height of the image, in the units of `View`."""
        raise NotImplementedError

    def _view(self, offset: tuple[float, float]) -> View:
        half_width, half_height = self._half_extent()
        view = View()
        view.width, view.height = self.width, self.height
        view.offset = wp.vec2d(*offset)
        view.position = wp.vec3d(*self.position)
        view.forward = wp.vec3d(*self.forward)
        view.right = wp.vec3d(*(half_width * self.right))
        view.up = wp.vec3d(*(half_height * self.up))
        return view


class PinholeCamera(_Camera):
    """A perspective camera: all rays start at one point.

        camera = wrt.PinholeCamera(640, 480, fov=40, position=(0, -3, 1), look_at=(0, 0, 0))
        camera = wrt.PinholeCamera.from_opengl(640, 480, pose, fov=40)     # also from_opencv, from_blender
        lens, pose = wrt.sensors.Camera.from_camera(camera)                # the same view with OpenCV's pixels

    Row 0 is at the top. Pixel (row, column) has its centre at (column + 0.5, row + 0.5), and the image at (width / 2, height /
    2): the optical axis passes there. `forward` points along the axis, `up` upward in the image.

    Args:
        width, height: size of the image in pixels, >= 1.
        fov: vertical field of view, from the lower to the upper edge of the image, in degrees, in (0, 180).
        position: (3,) the camera's position; kept in float64.
        look_at: (3,) the point at the image centre.
        up: (3,) upward direction of the image, of any length, not parallel to the viewing direction.

    Raises:
        TypeError: an argument has a wrong type.
        ValueError: a value out of range, NaN or infinite; position equals look_at; up is parallel to the viewing direction.
    """

    def __init__(
        self,
        width: int,
        height: int,
        *,
        fov: float = 45.0,
        position: ArrayLike,
        look_at: ArrayLike,
        up: ArrayLike = (0.0, 0.0, 1.0),
    ) -> None:
        super().__init__(width, height, position, look_at, up)
        self.fov = check_fov(fov)

    def __repr__(self) -> str:
        return (
            f"PinholeCamera({self.width}, {self.height}, fov={self.fov:g}, position={_text(self.position)}, "
            f"look_at={_text(self.look_at)})"
        )

    @classmethod
    def from_blender(cls, width: int, height: int, matrix_world: ArrayLike, *, angle: float) -> PinholeCamera:
        """The view of a perspective camera of Blender, with the sensor fit "AUTO" and no shift.

        Args:
            width, height: resolution of the render, in pixels.
            matrix_world: (4, 4) of the camera object: `np.array(camera.matrix_world)`. Its frame is OpenGL's; scale is not
                allowed.
            angle: `camera.data.angle`: the field of view along the longer side of the image, in radians, in (0, pi).

        Raises:
            TypeError, ValueError: as `from_opengl`; an angle out of range.
        """
        if not 0.0 < (angle := as_float("angle", angle)) < np.pi:
            raise ValueError(f"angle is {angle:g}; it is the field of view along the longer side in radians, between 0 and pi")
        width, height = as_int("width", width, 1), as_int("height", height, 1)
        tangent = np.tan(angle / 2) * height / max(width, height)
        pose = check_pose("matrix_world", matrix_world)
        return cls._at(width, height, pose, -1.0, {"fov": float(np.degrees(2 * np.arctan(tangent)))})

    @classmethod
    def framing(
        cls,
        geometry: Geometry | Scene | PointCloud,
        width: int,
        height: int,
        *,
        fov: float = 45.0,
        towards: ArrayLike | None = None,
        up: ArrayLike | None = None,
        margin: float = 0.05,
    ) -> PinholeCamera:
        """A camera that shows all of a mesh, scene or point cloud, as large as the image allows.

        Args:
            geometry: a `wrt.TriangleMesh`, `wrt.Scene` or `wrt.sensors.PointCloud`.
            width, height, fov: as in the constructor.
            up: as in the constructor; None for the upward direction of the mesh, `wrt.TriangleMesh.up`: y if it was read from
                a glTF, OBJ, OFF or PLY file. z if it has none, or if those of a scene's meshes differ.
            towards: (3,) viewing direction; None for a view from the front, slightly from the right and above. The front is
                -y if z is up, and +z if y is up.
            margin: free share of the image along the tightest edges, in [0, 1).

        Raises:
            TypeError: `geometry` is none of these.
            ValueError: as in the constructor, and for a `margin` out of range.
        """
        if not 0.0 <= (margin := as_float("margin", margin)) < 1.0:
            raise ValueError(f"margin is {margin}; it must be in [0, 1)")
        up = as_point("up", default_up(geometry) if up is None else up)
        towards = default_view(up) if towards is None else as_point("towards", towards)
        forward, right, upward = frame_of(towards, up)
        height, width = as_int("height", height, 1), as_int("width", width, 1)
        points, center = corners_of(geometry)
        tangent = np.tan(np.radians(check_fov(fov)) / 2) * (1.0 - margin)
        position = nearest_view(points, (right, upward, forward), (tangent * width / height, tangent))
        depth = max(float(-position @ forward), float(np.ptp(points @ forward)))
        return cls(
            width,
            height,
            fov=fov,
            position=center + position,
            look_at=center + position + depth * forward,
            up=up,
        )

    def rays_on(
        self, device: wp.Device, first_pixel: int, count: int, offset: tuple[float, float] = (0.5, 0.5)
    ) -> Rays[wp.array]:
        """Rays of some pixels, as in the base class: origins of shape (1,), directions of shape (count,)."""
        directions = wp.empty(count, dtype=wp.vec3, device=device)
        launch(pinhole_directions, count, [self._view(offset), first_pixel, directions], device=device, chunk=4096)
        return Rays(wp.array([self.position], dtype=wp.vec3d, device=device), directions)

    def _half_extent(self) -> tuple[float, float]:
        tangent = float(np.tan(np.radians(self.fov) / 2))
        return tangent * self.width / self.height, tangent


class OrthographicCamera(_Camera):
    """A camera with parallel rays, which start in the plane through its position; geometry behind that plane is not
    visible.

    Pixels and directions are those of `wrt.PinholeCamera`: row 0 is at the top, pixel (row, column) has its centre at
    (column + 0.5, row + 0.5), and the axis passes through (width / 2, height / 2).

    Args:
        width, height: size of the image in pixels, >= 1.
        view_height: distance between the lower and the upper edge of the image, in units of the scene.
        position, look_at, up: as in `PinholeCamera`.

    Raises:
        TypeError, ValueError: as in `PinholeCamera`.
    """

    def __init__(
        self,
        width: int,
        height: int,
        *,
        view_height: float,
        position: ArrayLike,
        look_at: ArrayLike,
        up: ArrayLike = (0.0, 0.0, 1.0),
    ) -> None:
        super().__init__(width, height, position, look_at, up)
        self.view_height = _check_number("view_height", view_height)
        if self.view_height <= 0.0:
            raise ValueError(
                f"view_height is {self.view_height}; it is the height of the image in scene units, and must be above 0"
            )

    @classmethod
    def from_blender(cls, width: int, height: int, matrix_world: ArrayLike, *, ortho_scale: float) -> OrthographicCamera:
        """The view of an orthographic camera of Blender, with the sensor fit "AUTO" and no shift.

        Args:
            width, height: resolution of the render, in pixels.
            matrix_world: as in `PinholeCamera.from_blender`.
            ortho_scale: `camera.data.ortho_scale`: the longer side of the image, in units of the scene, > 0.

        Raises:
            TypeError, ValueError: as `from_opengl`; a scale out of range.
        """
        if (ortho_scale := as_float("ortho_scale", ortho_scale, finite=True)) <= 0.0:
            raise ValueError(
                f"ortho_scale is {ortho_scale:g}; it is the longer side of the image in scene units, and must be above 0"
            )
        width, height = as_int("width", width, 1), as_int("height", height, 1)
        pose = check_pose("matrix_world", matrix_world)
        return cls._at(width, height, pose, -1.0, {"view_height": ortho_scale * height / max(width, height)})

    def __repr__(self) -> str:
        return (
            f"OrthographicCamera({self.width}, {self.height}, view_height={self.view_height:g}, "
            f"position={_text(self.position)}, look_at={_text(self.look_at)})"
        )

    def rays_on(
        self, device: wp.Device, first_pixel: int, count: int, offset: tuple[float, float] = (0.5, 0.5)
    ) -> Rays[wp.array]:
        """Rays of some pixels, as in the base class: origins of shape (count,), directions of shape (1,)."""
        origins = wp.empty(count, dtype=wp.vec3d, device=device)
        launch(orthographic_origins, count, [self._view(offset), first_pixel, origins], device=device, chunk=4096)
        return Rays(origins, wp.array([self.forward], dtype=wp.vec3, device=device))

    def _half_extent(self) -> tuple[float, float]:
        return self.view_height / 2 * self.width / self.height, self.view_height / 2


def pixel_offset(sample: int, samples: int, seed: int) -> tuple[float, float]:
    """Position of ray `sample` of `samples` within every pixel: x, y in [0, 1) from the top left corner."""
    samples = as_int("samples", samples, 1)
    sample = as_int("sample", sample, 0)
    seed = as_int("seed", seed, 0)
    if sample >= samples:
        raise ValueError(f"sample is {sample}, but a pixel has {samples} samples: choose from 0 to {samples - 1}")
    if samples == 1:
        return 0.5, 0.5
    bits = (samples - 1).bit_length()
    reversed_bits = int(f"{sample:0{bits}b}"[::-1], 2)
    x, y = (sample + 0.5) / samples, (reversed_bits + 0.5) / 2**bits
    if seed:
        shift = np.random.default_rng(seed).random(2)
        x, y = (x + shift[0]) % 1.0, (y + shift[1]) % 1.0
    return float(x), float(y)


def check_fov(fov: Any) -> float:
    """Returns a field of view in degrees; raises an error if it is not in (0, 180)."""
    value = _check_number("fov", fov)
    if not 0.0 < value < 180.0:
        raise ValueError(f"fov is {value:g}; it is the vertical field of view in degrees, between 0 and 180")
    return value


def _check_number(name: str, value: Any) -> float:
    return as_float(name, value, finite=True)


def _text(point: np.ndarray) -> str:
    return "(" + ", ".join(f"{x:g}" for x in point) + ")"
