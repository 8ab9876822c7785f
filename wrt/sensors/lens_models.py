"""Lens models: projection of points to pixels, and of pixels to rays.

All use OpenCV's pixels: the centre of the first pixel is at (0, 0), u counts columns to the right and v rows down. An image
of W columns spans -0.5 to W - 0.5 (`wrt.PinholeCamera` counts from the corner of the image instead, 0 to W). Points are in the
optical frame: x to the right, y down, z forward.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, overload

import numpy as np
import warp as wp

from wrt.kernels.runtime.launch import as_device, launch, refuse_capture
from wrt.kernels.validation import as_int, as_real_array, convert_fields
from wrt.sensors.checks import check_at_least, check_real

if TYPE_CHECKING:
    from wrt.array_types import ArrayLike, NumpyLike
    from wrt.kernels.sensors.lenses import Lens as DeviceLens

MODELS = ("brown_conrady", "kannala_brandt", "f_theta", "double_sphere", "equirectangular", "orthographic")
"""In the order of their numbers in `wrt.kernels.sensors.lenses`."""

OPENCV_LENGTHS = (0, 4, 5, 8, 12)


class LensModel:
    """Base class of lenses: `project` and `unproject`."""

    model: ClassVar[str]
    one_centre: ClassVar[bool] = True
    """Whether all rays start at one point."""

    @overload
    def project(self, points: NumpyLike) -> np.ndarray: ...
    @overload
    def project(self, points: wp.array) -> wp.array: ...
    def project(self, points: ArrayLike) -> np.ndarray | wp.array:
        """Pixels of points.

        Args:
            points: (..., 3) in the camera's optical frame; real numbers, or a Warp array of vec3d.

        Returns:
            (..., 2) float64 pixels u, v, or a Warp array of vec2d; NaN for a point that the lens does not see.

        Raises:
            TypeError, ValueError: a wrong type or shape.
        """
        from wrt.kernels.sensors.lenses import project_points

        given, device, shape = _flat("points", points, wp.vec3d)
        pixels = wp.empty(len(given), dtype=wp.vec2d, device=device)
        launch(project_points, len(given), [self.struct(), given, pixels], device=device, chunk=1024)
        return pixels.reshape(shape) if isinstance(points, wp.array) else pixels.numpy().reshape(*shape, 2)

    @overload
    def unproject(self, pixels: NumpyLike) -> tuple[np.ndarray, np.ndarray]: ...
    @overload
    def unproject(self, pixels: wp.array) -> tuple[wp.array, wp.array]: ...
    def unproject(self, pixels: ArrayLike) -> Any:
        """Rays of pixels.

        Args:
            pixels: (..., 2) real numbers, or a Warp array of vec2d.

        Returns:
            Origins and unit directions in the optical frame, each (..., 3) float64 or a Warp array of vec3d. Directions are NaN
            for a pixel that has no ray. Origins are 0 but for an orthographic lens.

        Raises:
            TypeError, ValueError: a wrong type or shape.
        """
        from wrt.kernels.sensors.lenses import unproject_pixels

        given, device, shape = _flat("pixels", pixels, wp.vec2d)
        rays = [wp.empty(len(given), dtype=wp.vec3d, device=device) for _ in range(2)]
        launch(unproject_pixels, len(given), [self.struct(), given, *rays], device=device, chunk=256)
        if isinstance(pixels, wp.array):
            return tuple(values.reshape(shape) for values in rays)
        return tuple(values.numpy().reshape(*shape, 3) for values in rays)

    def struct(self) -> DeviceLens:
        """The lens for kernels."""
        from wrt.kernels.sensors.lenses import COEFFICIENTS, Coefficients, Lens

        lens = Lens()
        lens.model = MODELS.index(self.model)
        lens.fx, lens.fy, lens.cx, lens.cy, coefficients, lens.max_angle = self._numbers()  # type: ignore[assignment]
        lens.skew = getattr(self, "skew", 0.0)  # type: ignore[arg-type]
        lens.c = Coefficients(*coefficients, *(0.0,) * (COEFFICIENTS - len(coefficients)))
        return lens

    def _numbers(self) -> tuple[float, float, float, float, tuple[float, ...], float]:
        """fx, fy, cx, cy, coefficients, largest angle."""
        raise NotImplementedError


@dataclass(frozen=True)
class _FocalLens(LensModel):
    """Base class of lenses with focal lengths and a principal point.

    Attributes:
        fx, fy: focal lengths in pixels.
        cx, cy: principal point, in pixels.
    """

    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        convert_fields(self)
        for name in ("fx", "fy"):
            check_at_least(name, getattr(self, name), np.finfo(np.float64).tiny)
        check_real("cx and cy", [self.cx, self.cy])


@dataclass(frozen=True)
class BrownConrady(_FocalLens):
    """The lens of OpenCV's `projectPoints`: radial (rational), tangential and thin prism distortion (Brown 1966).

    Attributes:
        fx, fy: focal lengths in pixels.
        cx, cy: principal point, in pixels.
        distortion: 0, 4, 5, 8 or 12 coefficients in OpenCV's order: k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4. OpenCV's
            tilted sensors (14 coefficients) are not supported.
        skew: by how many pixels a point at height 1 on the image plane (y / z, distorted) is moved to the right: K[0, 1] of a
            camera matrix, 0 where columns are at right angles to rows. OpenCV's functions ignore it; calibrations of Matlab
            have it.

    Raises:
        TypeError: a value of a wrong type.
        ValueError: a wrong number of coefficients, or a value out of range.
    """

    model = "brown_conrady"
    distortion: tuple[float, ...] = ()
    skew: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        values = check_real("distortion", self.distortion).ravel()
        if len(values) == 14 and not values[12:].any():
            values = values[:12]
        if len(values) not in OPENCV_LENGTHS:
            raise ValueError(f"distortion has {len(values)} coefficients; OpenCV's lens has 0, 4, 5, 8 or 12 (untilted)")
        object.__setattr__(self, "distortion", tuple(values.tolist()))

    @classmethod
    def from_matrix(cls, matrix: ArrayLike, distortion: ArrayLike = ()) -> BrownConrady:
        """The lens of a camera matrix K: without distortion, pixel (u, v) looks along K^-1 (u, v, 1).

        Args:
            matrix: (3, 3), fx skew cx, 0 fy cy, 0 0 1.
            distortion: as in the class.

        Raises:
            TypeError, ValueError: as the class; a matrix of another form.
        """
        *focal, skew = _focal(matrix)
        return cls(*focal, distortion, skew)  # type: ignore[arg-type, call-arg]

    def _numbers(self) -> tuple[float, float, float, float, tuple[float, ...], float]:
        return self.fx, self.fy, self.cx, self.cy, self.distortion, np.pi / 2


@dataclass(frozen=True)
class KannalaBrandt(_FocalLens):
    """OpenCV's fisheye lens: angle (1 + k1 angle^2 + ... + k4 angle^8) (Kannala and Brandt 2006).

    Attributes:
        fx, fy: focal lengths in pixels.
        cx, cy: principal point, in pixels.
        distortion: up to four coefficients k1, k2, k3, k4.
        max_angle: largest angle to the optical axis, in radians, in (0, pi].
        skew: as in `BrownConrady`; fx times the alpha of OpenCV's fisheye functions.

    Raises:
        TypeError: a value of a wrong type.
        ValueError: too many coefficients, or a value out of range.
    """

    model = "kannala_brandt"
    distortion: tuple[float, ...] = ()
    max_angle: float = np.pi
    skew: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        values = check_real("distortion", self.distortion).ravel()
        if len(values) > 4:
            raise ValueError(f"distortion has {len(values)} coefficients; the fisheye lens has k1, k2, k3 and k4")
        object.__setattr__(self, "distortion", tuple(values.tolist()))
        _check_angle(self.max_angle)

    @classmethod
    def from_matrix(cls, matrix: ArrayLike, distortion: ArrayLike = (), max_angle: float = np.pi) -> KannalaBrandt:
        """The lens of a camera matrix K; arguments and errors as in `BrownConrady.from_matrix` and the class."""
        *focal, skew = _focal(matrix)
        return cls(*focal, distortion, max_angle, skew)  # type: ignore[arg-type, call-arg]

    def _numbers(self) -> tuple[float, float, float, float, tuple[float, ...], float]:
        return self.fx, self.fy, self.cx, self.cy, self.distortion, self.max_angle


@dataclass(frozen=True)
class FTheta(LensModel):
    """A lens whose distance from the image centre is a polynomial of the angle to the axis: c[0] angle + c[1] angle^2 + ...

    Attributes:
        cx, cy: image centre, in pixels.
        coefficients: 1 to 12 factors, in pixels; the first one > 0.
        max_angle: largest angle to the optical axis, in radians, in (0, pi].

    Raises:
        TypeError: a value of a wrong type.
        ValueError: a wrong number of coefficients, or a value out of range.
    """

    model = "f_theta"
    cx: float
    cy: float
    coefficients: tuple[float, ...]
    max_angle: float = np.pi

    def __post_init__(self) -> None:
        convert_fields(self)
        check_real("cx and cy", [self.cx, self.cy])
        values = check_real("coefficients", self.coefficients).ravel()
        if not 1 <= len(values) <= 12 or values[0] <= 0.0:
            raise ValueError(
                f"coefficients are {values.tolist()}; they must be 1 to 12 numbers, the first one, pixels per radian at the "
                "centre, above 0"
            )
        object.__setattr__(self, "coefficients", tuple(values.tolist()))
        _check_angle(self.max_angle)

    def _numbers(self) -> tuple[float, float, float, float, tuple[float, ...], float]:
        return 1.0, 1.0, self.cx, self.cy, self.coefficients, self.max_angle


@dataclass(frozen=True)
class DoubleSphere(_FocalLens):
    """The double sphere model (Usenko, Demmel and Cremers 2018), for fisheye lenses beyond a half space.

    Attributes:
        fx, fy: focal lengths in pixels.
        cx, cy: principal point, in pixels.
        xi: shift of the second sphere, in (-1, 1).
        alpha: in [0, 1].

    Raises:
        TypeError: a value of a wrong type.
        ValueError: a value out of range.
    """

    model = "double_sphere"
    xi: float = 0.0
    alpha: float = 0.5

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (-1.0 < self.xi < 1.0 and 0.0 <= self.alpha <= 1.0):
            raise ValueError(f"xi is {self.xi} and alpha {self.alpha}; they must be in (-1, 1) and [0, 1]")

    def _numbers(self) -> tuple[float, float, float, float, tuple[float, ...], float]:
        return self.fx, self.fy, self.cx, self.cy, (self.xi, self.alpha), np.pi


@dataclass(frozen=True)
class Equirectangular(LensModel):
    """A panorama: columns are proportional to longitude, rows to latitude; its middle looks along z, its top up (-y).

    Attributes:
        width, height: of the whole panorama, in pixels.

    Raises:
        TypeError, ValueError: not positive numbers.
    """

    model = "equirectangular"
    width: int
    height: int

    def __post_init__(self) -> None:
        convert_fields(self)
        as_int("width", self.width, 1)
        as_int("height", self.height, 1)

    def _numbers(self) -> tuple[float, float, float, float, tuple[float, ...], float]:
        return self.width / (2 * np.pi), self.height / np.pi, (self.width - 1) / 2, (self.height - 1) / 2, (), np.pi


@dataclass(frozen=True)
class Orthographic(_FocalLens):
    """Parallel rays along z, from the plane z = 0. fx and fy are pixels per unit of length.

    Attributes:
        fx, fy: pixels per unit of length.
        cx, cy: the pixel on the optical axis.

    Raises:
        TypeError, ValueError: a value of a wrong type or out of range.
    """

    model = "orthographic"
    one_centre = False

    def _numbers(self) -> tuple[float, float, float, float, tuple[float, ...], float]:
        return self.fx, self.fy, self.cx, self.cy, (), np.pi / 2


def _focal(matrix: Any) -> tuple[float, float, float, float, float]:
    """fx, fy, cx, cy and skew of a camera matrix.

    Raises:
        TypeError: not real numbers.
        ValueError: another shape or form.
    """
    matrix = check_real("matrix", matrix, (3, 3))
    others = matrix.copy()
    others[[0, 1, 0, 1, 0], [0, 1, 2, 2, 1]] = 0.0
    if not np.array_equal(others, np.diag([0.0, 0.0, 1.0])):
        raise ValueError(
            f"matrix must be [[fx, skew, cx], [0, fy, cy], [0, 0, 1]], not {matrix.tolist()}; divide it by its last number, or "
            "pass rays of wrt.compat.RaycastingScene.create_rays_pinhole, which takes any invertible matrix, to intersect"
        )
    fx, fy, cx, cy, skew = (float(matrix[i, j]) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2), (0, 1)))
    return fx, fy, cx, cy, skew


def _check_angle(angle: float) -> None:
    if not 0.0 < angle <= np.pi:
        raise ValueError(f"max_angle is {angle}; it must be in (0, pi]")


def _flat(name: str, values: Any, dtype: type) -> tuple[wp.array, wp.Device, tuple[int, ...]]:
    """Vectors as a flat Warp array, its device, and the leading shape."""
    size = 3 if dtype is wp.vec3d else 2
    if isinstance(values, wp.array):
        if values.dtype is not dtype:
            raise TypeError(f"{name} must be a Warp array of vec{size}d, not of {values.dtype.__name__}")
        return values.contiguous().flatten(), values.device, values.shape
    values = as_real_array(name, values)
    if values.shape[-1:] != (size,):
        raise ValueError(f"{name} must have shape (..., {size}), not {values.shape}")
    device = as_device("cpu")
    refuse_capture(f"{name} in a NumPy array", device)
    flat = np.ascontiguousarray(values, dtype=np.float64).reshape(-1, size)
    return wp.array(flat, dtype=dtype, device=device), device, values.shape[:-1]
