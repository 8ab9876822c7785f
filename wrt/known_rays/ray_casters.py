"""Ray casters: batches of rays with a known distribution, for measurements, and shadow rays from visible points.

    rays = wrt.known_rays.PlaneCaster(position=(0, 0, 9), direction=(0, 0, -1), width=4, height=3).rays(1 << 20)
    rays = wrt.known_rays.CircularCapCaster(position=(0, 0, 9), direction=(0, 0, -1), angle=20).rays(1 << 20, seed=7)
    rays = wrt.known_rays.SquareCapCaster(position=(0, 0, 9), direction=(0, 0, -1), fov=(60, 40)).rays(1 << 20)
    seen = scene.intersect(camera.rays())
    dark = scene.occluded(wrt.known_rays.point_shadow_rays(seen, (0, 0, 9)))
    dark = scene.occluded(wrt.known_rays.directional_shadow_rays(seen, (0.3, 0.2, -1)))

The same seed gives the same rays, whatever the count, in a low-discrepancy pattern (`wrt.kernels.influence.ray_casting`).
Cameras sample the image plane uniformly, square caps the sphere.

References: falcone-2024 (section 5.6.2, appendix B).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import radians, sin, tan
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.builders.influence.influence_area import Point, check_numbers, check_positive, frame_of
from wrt.engine.rays.rays import Rays
from wrt.kernels.runtime.launch import launch, refuse_capture
from wrt.kernels.validation import as_int, convert_fields

if TYPE_CHECKING:
    from wrt.array_types import ArrayLike
    from wrt.builders.influence.influence_area import PlaneInfluenceArea, PointInfluenceArea
    from wrt.kernels.influence.ray_casting import Aim
    from wrt.query.hits import Hits


@dataclass(frozen=True, kw_only=True)
class _Caster:
    """Base class of casters: a position and a direction.

    Attributes:
        position: (3,) origin of the rays, or the centre of their origins.
        direction: (3,) central direction of the rays, of any length.
        up: (3,) upward direction across the rays, of any length; None for the coordinate axis most perpendicular to them.
    """

    position: Point
    direction: Point
    up: Point | None = None

    def __post_init__(self) -> None:
        for name in ("position", "direction", "up"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, check_numbers(name, getattr(self, name), 3))
        convert_fields(self)
        frame_of(self.direction, self.up)

    def _aim(self) -> Aim:
        from wrt.kernels.influence.ray_casting import Aim

        aim = Aim()
        aim.position = wp.vec3d(*self.position)
        aim.right, aim.up, aim.forward = (wp.vec3d(*axis) for axis in frame_of(self.direction, self.up))
        return aim

    def _directions(self, kernel: wp.Kernel, aim: Aim, count: int, seed: int) -> Rays:
        """Rays that start at the position."""
        directions = wp.empty(count, dtype=wp.vec3, device="cpu")
        launch(kernel, count, [aim, wp.uint32(seed), directions], device=directions.device, chunk=4096)
        return Rays(np.array([self.position]), directions.numpy())


@dataclass(frozen=True, kw_only=True)
class PlaneCaster(_Caster):
    """Parallel rays, distributed uniformly over a rectangle perpendicular to them.

    Attributes:
        position, direction, up: centre of the rectangle, direction of the rays, and upward direction in the rectangle.
        width, height: sides of the rectangle, in units of the scene.
        tolerance: largest angle between a ray and the direction, in degrees, in [0, 90]; rays are uniform over that cap.

    Raises:
        TypeError: a size or an angle is not a number.
        ValueError: a value is not finite or out of range, the direction is 0, or `up` is parallel to it.
    """

    width: float
    height: float
    tolerance: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_positive("width", self.width)
        check_positive("height", self.height)
        if not 0.0 <= self.tolerance <= 90.0:
            raise ValueError(f"tolerance is {self.tolerance}; it must be from 0 to 90 degrees")

    @classmethod
    def of(cls, area: PlaneInfluenceArea, tolerance: float = 0.0) -> PlaneCaster:
        """The caster of an influence area's rays; tolerance: as in the class."""
        sizes: dict[str, Any] = {"width": area.width, "height": area.height, "up": area.up}
        return cls(position=area.position, direction=area.direction, tolerance=tolerance, **sizes)

    def rays(self, count: int, seed: int = 0) -> Rays:
        """`count` rays on the CPU: origins float64, unit directions float32.

        Args:
            count: number of rays, at least 0; longer batches begin with the same rays.
            seed: 0 to 2^32 - 1; another seed gives other rays.

        Raises:
            TypeError: an argument is not a whole number.
            ValueError: a value out of range.
        """
        from wrt.kernels.influence.ray_casting import cast_plane

        count, seed = _check_batch(count, seed)
        aim = self._aim()
        aim.half = wp.vec2d(self.width / 2, self.height / 2)
        aim.rise = _rise(self.tolerance)  # type: ignore[assignment]
        origins, directions = (wp.empty(count, dtype=kind, device="cpu") for kind in (wp.vec3d, wp.vec3))
        launch(cast_plane, count, [aim, wp.uint32(seed), origins, directions], device=origins.device, chunk=4096)
        return Rays(origins.numpy(), directions.numpy())


@dataclass(frozen=True, kw_only=True)
class CircularCapCaster(_Caster):
    """Rays from a point, distributed uniformly over a circular cap of the sphere around it.

    Attributes:
        position, direction, up: the point, the centre of the cap; `up` rotates the pattern.
        angle: largest angle between a ray and the direction, in degrees, in [0, 180]; 180 is the whole sphere.

    Raises:
        ValueError: a value is not finite or out of range, the direction is 0, or `up` is parallel to it.
    """

    angle: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 <= self.angle <= 180.0:
            raise ValueError(f"angle is {self.angle}; it must be from 0 to 180 degrees")

    def rays(self, count: int, seed: int = 0) -> Rays:
        """`count` rays that share their origin; arguments and errors as in `PlaneCaster.rays`."""
        from wrt.kernels.influence.ray_casting import cast_circular_cap

        aim = self._aim()
        aim.rise = _rise(self.angle)  # type: ignore[assignment]
        return self._directions(cast_circular_cap, aim, *_check_batch(count, seed))


@dataclass(frozen=True, kw_only=True)
class SquareCapCaster(_Caster):
    """Rays from a point, distributed uniformly over the part of the sphere seen through a rectangular window.

    Attributes:
        position, direction, up: the point, the centre of the window, and its upward direction.
        fov: horizontal and vertical angle of the window, in degrees, each in (0, 180).

    Raises:
        ValueError: a value is not finite or out of range, the direction is 0, or `up` is parallel to it.
    """

    fov: tuple[float, float]

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "fov", check_numbers("fov", self.fov, 2))
        if not all(0.0 < angle < 180.0 for angle in self.fov):
            raise ValueError(f"fov is {self.fov}; both angles must be above 0 and below 180 degrees")

    @classmethod
    def of(cls, area: PointInfluenceArea) -> SquareCapCaster:
        """The caster of an influence area's rays, from its apex."""
        return cls(position=area.position, direction=area.direction, fov=area.fov, up=area.up)

    def rays(self, count: int, seed: int = 0) -> Rays:
        """`count` rays that share their origin; arguments and errors as in `PlaneCaster.rays`."""
        from wrt.kernels.influence.ray_casting import cast_square_cap

        aim = self._aim()
        aim.half = wp.vec2d(*(tan(radians(angle) / 2) for angle in self.fov))
        return self._directions(cast_square_cap, aim, *_check_batch(count, seed))


def point_shadow_rays(hits: Hits, position: ArrayLike) -> Rays:
    """Rays from hits to a point light; they start off the surface on the light's side (`Hits.spawn`) and end at the light.

    Args:
        hits: the visible points, on the CPU.
        position: (3,) position of the light.

    Returns:
        Rays of the hits' shape, with t = 1 at the light. Rays of misses start at NaN, and so miss.

    Raises:
        TypeError: the hits are Warp arrays.
        ValueError: the position is not a finite point.
    """
    light = np.array(check_numbers("position", position, 3))
    with np.errstate(invalid="ignore"):
        origins = hits.spawn(light - _positions(hits))
        return Rays(origins, light - origins, 0.0, 1.0)


def directional_shadow_rays(hits: Hits, direction: ArrayLike) -> Rays:
    """Rays from hits towards a light at infinity; errors as in `point_shadow_rays`.

    Args:
        hits: the visible points, on the CPU.
        direction: (3,) direction in which the light shines, of any length but 0.

    Returns:
        Rays of the hits' shape. Rays of misses start at NaN, and so miss.
    """
    against = -frame_of(check_numbers("direction", direction, 3), None)[2]  # type: ignore[arg-type]
    directions = np.broadcast_to(against, _positions(hits).shape)
    return Rays(hits.spawn(directions), directions)


def _positions(hits: Hits) -> np.ndarray:
    if isinstance(hits.position, wp.array):
        raise TypeError("hits are Warp arrays; shadow rays need hits of NumPy rays")
    return hits.position


def _rise(angle: float) -> float:
    """1 - cos of an angle in degrees, accurate for small angles, too."""
    return 2.0 * sin(radians(angle) / 2) ** 2


def _check_batch(count: int, seed: int) -> tuple[int, int]:
    refuse_capture("rays in NumPy arrays", wp.get_device("cpu"))
    return as_int("count", count, 0), as_int("seed", seed, 0, (1 << 32) - 1)
