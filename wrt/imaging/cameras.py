"""Cameras: images of given size, and the ray through each pixel.

A camera is placed at `position`, points at `look_at` (the image centre), and `up` points upward in the image. Images have
the shape (height, width); row 0 is at the top, column 0 at the left, and pixels are square. With one sample per pixel, its
ray passes through the pixel centre. With S samples, ray s takes point s of the Hammersley set, the same in each pixel:
samples cover all S columns and, for powers of two, all S rows of a pixel once, which keeps edges smooth. Another seed
shifts the pattern (Cranley and Patterson), so that images with different seeds can be averaged.

References: hammersley-1960; cranley-patterson-1976.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from wrt.kernels.runtime.launch import launch, refuse_capture
from wrt.kernels.shading.pixel_rays import View, orthographic_origins, pinhole_directions
from wrt.kernels.validation import as_float, as_int, as_numbers
from wrt.meshes.up_axis import default_up
from wrt.rays.rays import Rays

__all__ = ["OrthographicCamera", "PinholeCamera"]

_MAX_PIXELS = 2**31 - 1
_SINE_OF_PARALLEL = 1e-6


class _Camera:
    """Base class of cameras: the image frame, and the mapping from pixels to rays.

    Attributes:
        width, height: size of the image in pixels.
        position, look_at: (3,) float64.
        forward, right, up: (3,) float64, orthogonal unit vectors.
    """

    def __init__(self, width: int, height: int, position: Any, look_at: Any, up: Any) -> None:
        self.width = check_whole("width", width, 1)
        self.height = check_whole("height", height, 1)
        if self.width * self.height > _MAX_PIXELS:
            raise ValueError(f"width x height is {self.width * self.height}; an image has at most {_MAX_PIXELS} pixels")
        self.position = check_point("position", position)
        self.look_at = check_point("look_at", look_at)
        self.forward, self.right, self.up = _frame(self.look_at - self.position, check_point("up", up))

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
        self, width: int, height: int, *, fov: float = 45.0, position: Any, look_at: Any, up: Any = (0.0, 0.0, 1.0)
    ) -> None:
        super().__init__(width, height, position, look_at, up)
        self.fov = check_fov(fov)

    def __repr__(self) -> str:
        return (
            f"PinholeCamera({self.width}, {self.height}, fov={self.fov:g}, position={_text(self.position)}, "
            f"look_at={_text(self.look_at)})"
        )

    @classmethod
    def framing(
        cls,
        geometry: Any,
        width: int,
        height: int,
        *,
        fov: float = 45.0,
        towards: Any = None,
        up: Any = None,
        margin: float = 0.05,
    ) -> PinholeCamera:
        """A camera that shows all of a mesh or scene, as large as the image allows.

        Args:
            geometry: a `wrt.TriangleMesh` or `wrt.Scene`.
            width, height, fov: as in the constructor.
            up: as in the constructor; None for the upward direction of the mesh, `wrt.TriangleMesh.up`: y if it was read from
                a glTF, OBJ, OFF or PLY file. z if it has none, or if those of a scene's meshes differ.
            towards: (3,) viewing direction; None for a view from the front, slightly from the right and above. The front is
                -y if z is up, and +z if y is up.
            margin: free share of the image along the tightest edges, in [0, 1).

        Raises:
            TypeError: `geometry` is neither a mesh nor a scene.
            ValueError: as in the constructor, and for a `margin` out of range.
        """
        if not 0.0 <= (margin := as_float("margin", margin)) < 1.0:
            raise ValueError(f"margin is {margin}; it must be in [0, 1)")
        up = check_point("up", default_up(geometry) if up is None else up)
        towards = _default_view(up) if towards is None else check_point("towards", towards)
        forward, right, upward = _frame(towards, up)
        height, width = check_whole("height", height, 1), check_whole("width", width, 1)
        points, center = _corners(geometry)
        tangent = np.tan(np.radians(check_fov(fov)) / 2) * (1.0 - margin)
        position = _fit(points, (right, upward, forward), (tangent * width / height, tangent))
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

    Args:
        width, height: size of the image in pixels, >= 1.
        view_height: distance between the lower and the upper edge of the image, in units of the scene.
        position, look_at, up: as in `PinholeCamera`.

    Raises:
        TypeError, ValueError: as in `PinholeCamera`.
    """

    def __init__(
        self, width: int, height: int, *, view_height: float, position: Any, look_at: Any, up: Any = (0.0, 0.0, 1.0)
    ) -> None:
        super().__init__(width, height, position, look_at, up)
        self.view_height = _check_number("view_height", view_height)
        if self.view_height <= 0.0:
            raise ValueError(
                f"view_height is {self.view_height}; it is the height of the image in scene units, and must be above 0"
            )

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
    samples = check_whole("samples", samples, 1)
    sample = check_whole("sample", sample, 0)
    seed = check_whole("seed", seed, 0)
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


# -- framing -----------------------------------------------------------------------------------------------------------


def _frame(sight: np.ndarray, up: np.ndarray) -> tuple[np.ndarray, ...]:
    """Unit vectors forward, right and up of a camera with this viewing direction."""
    length = np.linalg.norm(sight)
    if length == 0.0:
        raise ValueError(
            "there is no viewing direction: position and look_at are the same point, or towards is zero; change one"
        )
    forward = sight / length
    right = np.cross(forward, _unit_up(up))
    sine = np.linalg.norm(right)
    if sine < _SINE_OF_PARALLEL:
        other = "(0, 1, 0)" if abs(forward[1]) < 0.9 else "(0, 0, 1)"
        raise ValueError(f"up is parallel to the viewing direction; choose another direction, such as {other}")
    right /= sine
    return forward, right, np.cross(right, forward)


def _unit_up(up: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(up)
    if length == 0.0:
        raise ValueError("up is zero; give a direction, such as (0, 0, 1)")
    return up / length


def _default_view(up: np.ndarray) -> np.ndarray:
    """Viewing direction from the front, slightly from the right and above."""
    upward = _unit_up(up)
    front = np.array([0.0, -1.0, 0.0]) if abs(upward[1]) < 0.9 else np.array([0.0, 0.0, np.sign(upward[1])])
    front = front - (front @ upward) * upward
    front /= np.linalg.norm(front)
    right = np.cross(upward, front)
    return -(0.85 * front + 0.4 * right + 0.4 * upward)


def _corners(geometry: Any) -> tuple[np.ndarray, np.ndarray]:
    """Vertices of all triangles, relative to the centre of their bounding box, and that centre."""
    meshes = getattr(geometry, "meshes", (geometry,))
    if not all(hasattr(mesh, "vertices") and hasattr(mesh, "faces") for mesh in meshes):
        raise TypeError(f"geometry must be a wrt.TriangleMesh or a wrt.Scene, not {type(geometry).__name__}")
    points = []
    for mesh in meshes:
        used = np.zeros(len(mesh.vertices), dtype=bool)
        used[mesh.faces] = True
        points.append(np.asarray(mesh.vertices[used], dtype=np.float64))
    joined = np.concatenate(points)
    center = joined.min(axis=0) / 2 + joined.max(axis=0) / 2
    return joined - center, center


def _fit(points: np.ndarray, axes: tuple[np.ndarray, ...], tangents: tuple[float, float]) -> np.ndarray:
    """The nearest position from which all points are inside the image, with equal margins on opposite sides.

    A point at (x, y, depth z) is inside the right edge of a camera at (x0, y0, z0) if x - x0 <= tangent (z - z0), and so
    on: each edge bounds x0 or y0, and z0, by the extreme of x -+ tangent z over the points.
    """
    depth = points @ axes[2]
    across, back = [], []
    for axis, tangent in zip(axes[:2], tangents, strict=True):
        along = points @ axis
        high, low = (along - tangent * depth).max(), (-along - tangent * depth).max()
        across.append((high - low) / 2)
        back.append(-(high + low) / (2 * tangent))
    nearest = depth.min() - 1e-3 * max(np.ptp(points, axis=0).max(), np.finfo(np.float64).tiny)
    return across[0] * axes[0] + across[1] * axes[1] + min(*back, nearest) * axes[2]


# -- checks ------------------------------------------------------------------------------------------------------------


def check_whole(name: str, value: Any, minimum: int) -> int:
    """Returns a whole number of at least `minimum`; raises an error that names the argument otherwise."""
    return as_int(name, value, minimum)


def check_point(name: str, value: Any) -> np.ndarray:
    """Returns (3,) finite float64; raises a TypeError or ValueError that names the argument otherwise."""
    point = as_numbers(name, value, finite=False)
    if point.shape != (3,):
        raise ValueError(f"{name} must be three numbers x, y, z, not an array of shape {point.shape}")
    if not np.isfinite(point).all():
        raise ValueError(f"{name} is {_text(point)}; its three numbers must be finite")
    return point


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
