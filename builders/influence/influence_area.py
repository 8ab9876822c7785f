"""Influence areas: descriptions of the parts of a scene in which the directions of rays are known.

A plane influence area holds parallel rays, such as those of a directional light or an orthographic camera. It is a cuboid whose
rays leave one face, the window, at right angles. A point influence area holds radial rays, such as those of a point light or a
pinhole camera. It is a frustum whose rays leave its near plane on lines through its apex. Trees are built for areas
(`wrt.builders.influence.projected_cost`), and rays are assigned to areas (`affine`; for traced batches, by the loops of
`wrt.kernels.influence.area_lanes`).

References: falcone-2024 (chapter 3, section 5.4).
"""

from dataclasses import dataclass
from math import isfinite, radians, sin, tan

import numpy as np
import warp as wp

from wrt.kernels.influence.view import AreaView, mark_rays_of_area
from wrt.kernels.runtime.launch import launch, refuse_capture
from wrt.kernels.validation import as_float, as_numbers, as_real_array, convert_fields

Point = tuple[float, float, float]

SINE_OF_PARALLEL = 1e-6
"""Least sine of the angle between `up` and the direction."""


class _Area:
    """What both kinds of areas can say."""

    @property
    def frame(self: "InfluenceArea") -> np.ndarray:
        """(3, 3) float64: the orthogonal unit vectors right, up, forward."""
        return frame_of(self.direction, self.up)

    def affine(self: "InfluenceArea", origins: np.ndarray, directions: np.ndarray, tolerance: float = 1.0) -> np.ndarray:
        """Which rays belong to the area, in either direction: (N,) bool. See `rays_of_area`.

        Args:
            origins, directions: (N, 3).
            tolerance: greatest angle between a ray and the area's ray through its origin, in degrees, in [0, 90).

        Raises:
            ValueError: as in `rays_of_area`.
        """
        return rays_of_area(self, origins, directions, tolerance)


@dataclass(frozen=True, kw_only=True)
class PlaneInfluenceArea(_Area):
    """A cuboid of parallel rays.

    Rays leave a rectangle and run along `direction`. The ray at (x, y) leaves position + x right + y up, for |x| <= width / 2
    and |y| <= height / 2 (`frame`). The area is the closed set of points at most `depth` in front of the rectangle.

    Attributes:
        position: centre of the rectangle.
        direction: direction of the rays, of any length.
        width, height: sides of the rectangle, in scene units.
        depth: extent of the area along the rays, in scene units; may be inf.
        up: upward direction of the rectangle, of any length; None for the coordinate axis most perpendicular to the rays.

    Raises:
        TypeError: width, height or depth is not a number.
        ValueError: a value is not finite or not above 0, the direction is 0, or `up` is parallel to it.
    """

    position: Point
    direction: Point
    width: float
    height: float
    depth: float
    up: Point | None = None

    def __post_init__(self) -> None:
        _normalise(self)
        convert_fields(self)
        for name in ("width", "height"):
            check_positive(name, getattr(self, name))
        check_positive("depth", self.depth, endless=True)

    def view(self, center: np.ndarray) -> AreaView:
        """The area for kernels, relative to `center`, (3,) float64, the centre of a scene."""
        view = _view(self, center)
        view.near, view.far = 0.0, self.depth
        view.half = wp.vec2(self.width / 2, self.height / 2)
        view.radial = False
        return view


@dataclass(frozen=True, kw_only=True)
class PointInfluenceArea(_Area):
    """A frustum of rays on lines through one point.

    The area is the closed set of points that are visible from `position`, at a depth in [near, far] along `direction` and
    within half the field of view to each side. Rays leave the near plane.

    Attributes:
        position: the point through which all lines pass.
        direction: centre of the field of view, of any length.
        fov: horizontal and vertical field of view, in degrees, each in (0, 180).
        near, far: depths in scene units, 0 < near < far; far may be inf.
        up: upward direction of the image, of any length; None for the coordinate axis most perpendicular to the direction.

    Raises:
        TypeError: near or far is not a number.
        ValueError: a value is out of its range or not finite, the direction is 0, or `up` is parallel to it.
    """

    position: Point
    direction: Point
    fov: tuple[float, float]
    near: float
    far: float
    up: Point | None = None

    def __post_init__(self) -> None:
        _normalise(self)
        convert_fields(self)
        object.__setattr__(self, "fov", check_numbers("fov", self.fov, 2))
        if not all(0.0 < angle < 180.0 for angle in self.fov):
            raise ValueError(f"fov is {self.fov}; both angles must be above 0 and below 180 degrees")
        check_positive("near", self.near)
        check_positive("far", self.far, endless=True)
        if self.far <= self.near:
            raise ValueError(f"far is {self.far}; it must be above near, which is {self.near}")

    @property
    def tangents(self) -> tuple[float, float]:
        """Half the window's width and height at depth 1."""
        return tan(radians(self.fov[0]) / 2), tan(radians(self.fov[1]) / 2)

    def view(self, center: np.ndarray) -> AreaView:
        """The area for kernels, relative to `center`, (3,) float64, the centre of a scene."""
        view = _view(self, center)
        view.near, view.far = self.near, self.far
        view.half = wp.vec2(*self.tangents)
        view.radial = True
        return view


InfluenceArea = PlaneInfluenceArea | PointInfluenceArea


def rays_of_area(area: InfluenceArea, origins: np.ndarray, directions: np.ndarray, tolerance: float) -> np.ndarray:
    """Which rays start in an area and run along its ray through their origin, in the same or the opposite direction.

    Args:
        area: the influence area.
        origins, directions: (N, 3).
        tolerance: greatest angle between a ray and the area's ray, in degrees, in [0, 90).

    Returns:
        (N,) bool.

    Raises:
        ValueError: origins and directions are not (N, 3), or the tolerance is out of its range.
    """
    if not 0.0 <= (tolerance := as_float("tolerance", tolerance)) < 90.0:
        raise ValueError(f"tolerance is {tolerance}; it must be at least 0 and below 90 degrees")
    origins = as_real_array("origins", origins).astype(np.float64, copy=False)
    directions = as_real_array("directions", directions).astype(np.float32, copy=False)
    if origins.shape != directions.shape or origins.ndim != 2 or origins.shape[1] != 3:
        raise ValueError(f"origins {origins.shape} and directions {directions.shape} must both be (N, 3)")
    center, device = np.array(area.position), wp.get_device("cpu")
    refuse_capture("affine", device)
    with np.errstate(over="ignore"):
        near = np.ascontiguousarray((origins - center).astype(np.float32))
    rays = [wp.array(a, dtype=wp.vec3, device=device) for a in (near, np.ascontiguousarray(directions))]
    belong = wp.empty(len(near), dtype=wp.bool, device=device)
    launch(mark_rays_of_area, len(near), [area.view(center), *rays, sin(radians(tolerance)), belong], device=device, chunk=4096)
    return belong.numpy()


def frame_of(direction: Point, up: Point | None) -> np.ndarray:
    """(3, 3) float64: orthogonal unit vectors right, up, forward = direction.

    Raises:
        ValueError: `direction` or `up` is 0, or they are parallel.
    """
    forward = np.array(direction)
    scale = np.abs(forward).max()
    if scale == 0.0:
        raise ValueError("direction is zero; pass a vector of any other length")
    forward = forward / scale
    forward /= np.linalg.norm(forward)
    upward = np.eye(3)[np.abs(forward).argmin()] if up is None else np.array(up)
    right = np.cross(forward, upward)
    sine, length = np.linalg.norm(right), np.linalg.norm(upward)
    if not sine > SINE_OF_PARALLEL * length:
        raise ValueError(f"up is {up}, which is zero or parallel to the direction; omit it or pass another vector")
    right /= sine
    return np.array([right, np.cross(right, forward), forward])


def check_numbers(name: str, value: object, count: int) -> tuple[float, ...]:
    """Returns `count` finite numbers; raises a TypeError or ValueError that names the argument otherwise."""
    numbers = as_numbers(name, value, finite=False)
    if numbers.shape != (count,) or not np.isfinite(numbers).all():
        raise ValueError(f"{name} must be {count} finite numbers, not {value!r}")
    return tuple(numbers.tolist())


def check_positive(name: str, value: float, endless: bool = False) -> None:
    """Raises ValueError for a number not above 0, or infinite unless `endless`."""
    if not (value > 0.0 and (endless or isfinite(value))):
        raise ValueError(f"{name} is {value}; it must be above 0{'' if endless else ' and finite'}")


def _normalise(area: InfluenceArea) -> None:
    """Converts the attributes of an area to tuples, and checks that its directions define a frame."""
    object.__setattr__(area, "position", check_numbers("position", area.position, 3))
    object.__setattr__(area, "direction", check_numbers("direction", area.direction, 3))
    if area.up is not None:
        object.__setattr__(area, "up", check_numbers("up", area.up, 3))
    frame_of(area.direction, area.up)


def _view(area: InfluenceArea, center: np.ndarray) -> AreaView:
    """A view with the position and the axes of an area."""
    view = AreaView()
    view.eye = wp.vec3(*(np.array(area.position) - center))
    view.right, view.up, view.forward = (wp.vec3(*axis) for axis in area.frame)
    return view
