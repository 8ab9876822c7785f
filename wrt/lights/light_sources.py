"""Lights: points, spots, parallel light, and flat or round areas.

Lights are not part of the scene. Points and directions are seen by nobody; areas are seen by the camera and in mirrors, but
rays pass through them, so that they cast no shadow. For a light that does, give a mesh an emissive material
(`wrt.Material(emission=...)`): it is found in the same way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from wrt.kernels.validation import as_bool, as_direction, as_float, as_point
from wrt.materials.material import Color, as_color
from wrt.meshes.placement import MAX_COORDINATE

if TYPE_CHECKING:
    from wrt.array_types import ArrayLike, Numbers

__all__ = ["AreaLight", "DirectionalLight", "PointLight", "SpotLight"]


def place(name: str, value: Any) -> np.ndarray:
    """(3,) float64, a point or an edge that float32 can hold.

    Raises:
        ValueError: not three finite numbers, or one beyond `MAX_COORDINATE`.
    """
    point = as_point(name, value)
    if np.abs(point).max() > MAX_COORDINATE:
        raise ValueError(f"{name} is {point.tolist()}; coordinates go up to {MAX_COORDINATE:.3g}: scale the scene down")
    return point


class PointLight:
    """Light from one point, as strong in all directions.

    Args:
        position: (3,).
        intensity: radiant intensity, linear: a number or (3,), each >= 0. A surface that faces the light at distance d receives
            the irradiance `intensity / d^2`.

    Raises:
        ValueError: a value that is not finite, or negative; a position beyond 2^120.
    """

    def __init__(self, position: ArrayLike, intensity: Numbers = 1.0) -> None:
        self.position = place("position", position)
        self.intensity: Color = as_color("intensity", intensity)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.position.tolist()}, {self.intensity})"


class SpotLight(PointLight):
    """Light from one point within a cone.

    Args:
        position, intensity: as in `PointLight`; the intensity is that within `inner`.
        look_at: (3,) a point on the axis.
        angle: half the angle of the cone, in degrees, in (0, 90).
        inner: angle to the axis at which the light begins to fade, in degrees, in [0, angle); None for 0.8 of `angle`.

    Raises:
        ValueError: a value out of range; `look_at` equals `position`.
    """

    def __init__(
        self,
        position: ArrayLike,
        look_at: ArrayLike,
        intensity: Numbers = 1.0,
        *,
        angle: float = 30.0,
        inner: float | None = None,
    ) -> None:
        super().__init__(position, intensity)
        self.direction = as_direction("look_at - position", as_point("look_at", look_at) - self.position)
        angle = as_float("angle", angle)
        if not 0.0 < angle < 90.0:
            raise ValueError(f"angle is {angle}; half the angle of a spot light's cone must be between 0 and 90 degrees")
        inner = 0.8 * angle if inner is None else as_float("inner", inner)
        if not 0.0 <= inner < angle:
            raise ValueError(f"inner is {inner}; it must be from 0 to below angle, which is {angle}")
        self.angle, self.inner = angle, inner


class DirectionalLight:
    """Parallel light, such as the sun's.

    Args:
        direction: (3,) in which the light travels, of any length.
        irradiance: on a surface that faces the light, linear: a number or (3,), each >= 0.

    Raises:
        ValueError: a value that is not finite, or negative; no direction.
    """

    def __init__(self, direction: ArrayLike, irradiance: Numbers = 1.0) -> None:
        self.direction = as_direction("direction", direction)
        self.irradiance: Color = as_color("irradiance", irradiance)

    def __repr__(self) -> str:
        return f"DirectionalLight({self.direction.tolist()}, {self.irradiance})"


@dataclass(frozen=True, eq=False)
class AreaLight:
    """A flat or round light of constant radiance; made by `rectangle`, `triangle` or `sphere`.

    Attributes:
        shape: "rectangle", "triangle" or "sphere".
        position: (3,) a corner, or the centre of a sphere.
        edge1, edge2: (3,) from the corner to its neighbours; 0 for a sphere.
        radius: of a sphere; else 0.
        radiance: linear.
        two_sided: whether a flat light emits on both sides. The front is where its corner, the end of `edge1` and that of
            `edge2` are in counter-clockwise order.
    """

    shape: str
    position: np.ndarray
    edge1: np.ndarray
    edge2: np.ndarray
    radius: float
    radiance: Color
    two_sided: bool

    @classmethod
    def rectangle(
        cls, corner: ArrayLike, edge1: ArrayLike, edge2: ArrayLike, radiance: Numbers = 1.0, *, two_sided: bool = False
    ) -> AreaLight:
        """A parallelogram; its front is the side of edge1 x edge2.

        Args:
            corner, edge1, edge2: (3,) each.
            radiance: linear: a number or (3,), each >= 0.
            two_sided: whether the back emits, too.

        Raises:
            ValueError: no area, or a value that is not finite or negative.
        """
        return cls._flat("rectangle", corner, edge1, edge2, radiance, two_sided)

    @classmethod
    def triangle(
        cls, a: ArrayLike, b: ArrayLike, c: ArrayLike, radiance: Numbers = 1.0, *, two_sided: bool = False
    ) -> AreaLight:
        """A triangle; its front is the side from which its corners are in counter-clockwise order.

        Args:
            a, b, c: corners, (3,) each.
            radiance, two_sided: as in `rectangle`.

        Raises:
            ValueError: as in `rectangle`.
        """
        a = place("a", a)
        return cls._flat("triangle", a, place("b", b) - a, place("c", c) - a, radiance, two_sided)

    @classmethod
    def sphere(cls, center: ArrayLike, radius: float, radiance: Numbers = 1.0) -> AreaLight:
        """A sphere, which emits outward; it lights nothing inside it.

        Args:
            center: (3,).
            radius: above 0.
            radiance: linear: a number or (3,), each >= 0.

        Raises:
            ValueError: a radius that is not above 0, or a value that is not finite or negative.
        """
        if not 0.0 < (radius := as_float("radius", radius)) <= MAX_COORDINATE:
            raise ValueError(f"radius is {radius}; it must be above 0, and at most {MAX_COORDINATE:.3g}")
        zero = np.zeros(3)
        return cls("sphere", place("center", center), zero, zero, radius, as_color("radiance", radiance), False)

    @classmethod
    def _flat(cls, shape: str, corner: Any, edge1: Any, edge2: Any, radiance: Any, two_sided: bool) -> AreaLight:
        corner, edge1, edge2 = (place(name, value) for name, value in (("corner", corner), ("edge1", edge1), ("edge2", edge2)))
        if not np.linalg.norm(np.cross(edge1, edge2)) > 0.0:
            raise ValueError(f"the light has no area: its edges {edge1.tolist()} and {edge2.tolist()} are parallel, or zero")
        return cls(shape, corner, edge1, edge2, 0.0, as_color("radiance", radiance), as_bool("two_sided", two_sided))

    @property
    def area(self) -> float:
        """Area that emits, both sides of a flat light counted once."""
        if self.shape == "sphere":
            return 4.0 * np.pi * self.radius**2
        return float(np.linalg.norm(np.cross(self.edge1, self.edge2))) * (0.5 if self.shape == "triangle" else 1.0)

    @property
    def normal(self) -> np.ndarray:
        """(3,) unit normal of a flat light's front; 0 for a sphere."""
        across = np.cross(self.edge1, self.edge2)
        return across if self.shape == "sphere" else across / np.linalg.norm(across)
