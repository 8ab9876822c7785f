"""Regions of space for users: `Aabb`, `Obb` and `Frustum`, in float64 and in the scene's coordinates.

    region = Frustum(eye=(0, 0, 3), forward=(0, 0, -1), fov_x=60, fov_y=40, near=0, far=10)
    region.contains(points)             # bool per point
    region.intersects(low, high)        # bool per box: do they overlap?
    region.encloses(low, high)          # bool per box: is all of it inside?
    region.box                          # the axis-aligned box around the region

A region is converted to the one shape that kernels know (`wrt.kernels.influence.region_tests`). That shape includes the
axis-aligned box around the region, which is tested first: what Falcone calls an AABB for OBB (section 5.3.3), for every kind of
region.

**Margin.** Conservative queries widen a region: `struct(center, margin)` moves each face outward by the margin.

References: falcone-2024 (section 5.3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp

from wrt.builders.influence.influence_area import frame_of
from wrt.kernels.influence import region_tests as kernel
from wrt.kernels.runtime.launch import launch
from wrt.kernels.validation import convert_fields

Vector = tuple[float, float, float]

ORIGIN = np.zeros(3)

PARALLEL = 1e-6
"""Sine of the angle between two directions below which they count as parallel."""


@dataclass(frozen=True)
class Frame:
    """A region as a stack of rectangles (`wrt.kernels.influence.region_tests`), in the scene's coordinates.

    Attributes:
        origin: (3,) the point of the axis at depth 0.
        axes: (3, 3), rows right, up and forward: orthogonal unit vectors.
        near, far: least and greatest depth.
        half: (2,) half sizes along right and up at depth 0.
        slope: (2,) growth of these per unit of depth.
    """

    origin: np.ndarray
    axes: np.ndarray
    near: float
    far: float
    half: np.ndarray
    slope: np.ndarray

    def widened(self, margin: float) -> Frame:
        """The frame with each face moved outward by a distance."""
        half = self.half + margin * np.sqrt(1.0 + self.slope**2)
        return Frame(self.origin, self.axes, self.near - margin, self.far + margin, half, self.slope)

    @property
    def corners(self) -> np.ndarray:
        """(8, 3) corners of the near rectangle, then of the far one."""
        signs = np.array([(x, y) for y in (-1.0, 1.0) for x in (-1.0, 1.0)])
        depths = np.repeat([self.near, self.far], 4)[:, None]
        across = np.tile(signs, (2, 1)) * (self.half + depths * self.slope)
        return self.origin + np.concatenate([across, depths], axis=1) @ self.axes

    def struct(self, center: np.ndarray) -> kernel.Region:
        """The frame for kernels, relative to a point."""
        corners = self.corners - center
        slack = 2.0**-46 * np.abs(corners).max()
        region = kernel.Region()
        region.origin = wp.vec3d(*(self.origin - center))
        region.right, region.up, region.forward = (wp.vec3d(*axis) for axis in self.axes)
        region.near, region.far = self.near, self.far
        region.width, region.height = self.half
        region.widening, region.heightening = self.slope
        region.low, region.high = wp.vec3d(*(corners.min(axis=0) - slack)), wp.vec3d(*(corners.max(axis=0) + slack))
        return region


class Region:
    """Queries of all regions. Points and boxes are float64, in the scene's coordinates. Regions include their surface."""

    def _make_frame(self) -> Frame:
        raise NotImplementedError

    @cached_property
    def frame(self) -> Frame:
        """The region as a stack of rectangles."""
        return self._make_frame()

    @cached_property
    def corners(self) -> np.ndarray:
        """(8, 3) float64."""
        return self.frame.corners

    @cached_property
    def box(self) -> np.ndarray:
        """(2, 3) float64: lower and upper corner of the axis-aligned box around the region."""
        return np.array([self.corners.min(axis=0), self.corners.max(axis=0)])

    def contains(self, points: Any) -> np.ndarray:
        """Which points are inside: (...) bool for (..., 3) points. NaN is outside.

        Raises:
            ValueError: the last dimension is not 3.
        """
        return contain_points([self], points)[..., 0]

    def intersects(self, low: Any, high: Any) -> np.ndarray:
        """Which boxes overlap the region: (...) bool for lower and upper corners (..., 3).

        A box that touches the region, within 64 roundings in float64, overlaps it. An empty box, low > high, does not.

        Raises:
            ValueError: the last dimension is not 3, or the shapes do not broadcast.
        """
        return classify_boxes([self.struct()], low, high)[..., 0] != kernel.DISJOINT

    def encloses(self, low: Any, high: Any) -> np.ndarray:
        """Which boxes lie entirely in the region; arguments as in `intersects`."""
        return classify_boxes([self.struct()], low, high)[..., 0] == kernel.ENCLOSED

    def struct(self, center: Any = ORIGIN, margin: float = 0.0) -> kernel.Region:
        """The region for kernels, relative to a point, each face moved outward by a distance."""
        frame = self.frame.widened(margin) if margin else self.frame
        return frame.struct(np.asarray(center, dtype=np.float64))


@dataclass(frozen=True)
class Aabb(Region):
    """An axis-aligned box.

    Attributes:
        low, high: (3,) its lower and upper corner; finite, low <= high.

    Raises:
        ValueError: a corner is no finite point, or low is above high.
    """

    low: Vector
    high: Vector

    def __post_init__(self) -> None:
        low, high = _set_vectors(self, "low", "high")
        if any(a > b for a, b in zip(low, high, strict=True)):
            raise ValueError(f"low {low} is above high {high}; pass the lower corner first")

    def _make_frame(self) -> Frame:
        low, high = np.array(self.low), np.array(self.high)
        half = (high - low) / 2
        return Frame((low + high) / 2, np.eye(3), -half[2], half[2], half[:2], np.zeros(2))


@dataclass(frozen=True, kw_only=True)
class Obb(Region):
    """An oriented box.

    Attributes:
        center: (3,) its centre.
        half_size: (3,) distances from the centre to the faces along right, up and forward; not negative.
        forward: (3,) direction, of any length.
        up: (3,) upward direction, of any length, not parallel to `forward`; None for z, or for y if `forward` is along z. The
            box's own up is the component orthogonal to `forward`; right is forward x up.

    Raises:
        ValueError: a value is not finite or out of its range, or two directions are parallel.
    """

    center: Vector
    half_size: Vector
    forward: Vector
    up: Vector | None = None

    def __post_init__(self) -> None:
        _, half, _ = _set_vectors(self, "center", "half_size", "forward")
        if min(half) < 0.0:
            raise ValueError(f"half_size is {half}; it must not be negative")
        object.__setattr__(self, "up", check_up(self.forward, self.up))

    def _make_frame(self) -> Frame:
        half = np.array(self.half_size)
        return Frame(np.array(self.center), frame_of(self.forward, self.up), -half[2], half[2], half[:2], np.zeros(2))


@dataclass(frozen=True, kw_only=True)
class Frustum(Region):
    """A truncated pyramid: the points that a pinhole camera sees between two depths.

    Attributes:
        eye: (3,) the apex.
        forward: (3,) direction of the axis, of any length.
        fov_x, fov_y: angles between opposite side faces along right and up, in degrees, in (0, 180).
        near, far: depths along the axis of its ends, 0 <= near < far; with near 0 the eye belongs to it.
        up: as in `Obb`.

    Raises:
        ValueError: as in `Obb`; or an angle is out of its range; or not 0 <= near < far.
    """

    eye: Vector
    forward: Vector
    fov_x: float
    fov_y: float
    near: float
    far: float
    up: Vector | None = None

    def __post_init__(self) -> None:
        _set_vectors(self, "eye", "forward")
        convert_fields(self)
        object.__setattr__(self, "up", check_up(self.forward, self.up))
        for name in ("fov_x", "fov_y"):
            if not 0.0 < getattr(self, name) < 180.0:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be between 0 and 180 degrees")
        if not 0.0 <= self.near < self.far < float("inf"):
            raise ValueError(f"near is {self.near} and far {self.far}; they must be 0 <= near < far, and finite")

    def _make_frame(self) -> Frame:
        slope = np.tan(np.radians([self.fov_x, self.fov_y]) / 2)
        return Frame(np.array(self.eye), frame_of(self.forward, self.up), self.near, self.far, np.zeros(2), slope)


def check_up(forward: Vector, up: Any) -> Vector:
    """The vector `up`, or a default for `forward`.

    Raises:
        ValueError: `forward` or `up` is zero or not finite, or they are parallel.
    """
    length = np.linalg.norm(forward)
    if not length > 0.0:
        raise ValueError(f"forward is {forward}; pass a nonzero vector")
    if up is None:
        return (0.0, 0.0, 1.0) if abs(forward[2]) < 0.9 * length else (0.0, 1.0, 0.0)
    up = as_vector("up", up)
    if not np.linalg.norm(np.cross(forward, up)) > PARALLEL * length * np.linalg.norm(up):
        raise ValueError(f"up {up} is zero or parallel to forward {forward}; pass another vector")
    return up


def as_vector(name: str, value: Any) -> Vector:
    """Three finite numbers.

    Raises:
        ValueError: the value is anything else.
    """
    array = np.asarray(value)
    if array.shape != (3,) or array.dtype.kind not in "fiu" or not np.isfinite(array).all():
        raise ValueError(f"{name} is {value!r}; it must be three finite numbers, such as (0, 0, 1)")
    return tuple(array.astype(np.float64).tolist())


def contain_points(regions: Sequence[Region], points: Any) -> np.ndarray:
    """(..., regions) bool for (..., 3) points: whether each point is in each region."""
    points = _as_points("points", points)
    inside = wp.empty((points.size // 3, len(regions)), dtype=wp.bool, device="cpu")
    flat = wp.array(points.reshape(-1, 3), dtype=wp.vec3d, device="cpu")
    structs = wp.array([region.struct() for region in regions], dtype=kernel.Region, device="cpu")
    launch(kernel.contain_points, len(flat), [structs, flat, inside], device=inside.device, chunk=1024)
    return inside.numpy().reshape(*points.shape[:-1], len(regions))


def classify_boxes(regions: Sequence[kernel.Region], low: Any, high: Any) -> np.ndarray:
    """(..., regions) uint8 `wrt.kernels.influence.region_tests.DISJOINT`, `INTERSECTING` or `ENCLOSED` for the corners
    (..., 3) of boxes."""
    low, high = np.broadcast_arrays(_as_points("low", low), _as_points("high", high))
    corners = [wp.array(np.ascontiguousarray(a.reshape(-1, 3).T), dtype=wp.float64, device="cpu") for a in (low, high)]
    count = low.size // 3
    result = wp.empty((count, len(regions)), dtype=wp.uint8, device="cpu")
    structs = wp.array(list(regions), dtype=kernel.Region, device="cpu")
    launch(kernel.classify_boxes, count, [structs, *corners, result], device=result.device, chunk=256)
    return result.numpy().reshape(*low.shape[:-1], len(regions))


def _set_vectors(region: Region, *names: str) -> list[Vector]:
    """Converts attributes of a frozen region to tuples of three finite numbers, and returns them."""
    vectors = [as_vector(name, getattr(region, name)) for name in names]
    for name, vector in zip(names, vectors, strict=True):
        object.__setattr__(region, name, vector)
    return vectors


def _as_points(name: str, points: Any) -> np.ndarray:
    points = np.asarray(points, dtype=np.float64)
    if points.ndim == 0 or points.shape[-1] != 3:
        raise ValueError(f"{name} must have shape (..., 3), not {points.shape}")
    return points
