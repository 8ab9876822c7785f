"""Scans of a lidar: what was measured, and where it was in the world."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from wrt.kernels.validation import as_bool
from wrt.sensors.outputs.hit_outputs import HitOutputs
from wrt.sensors.outputs.row_tables import Field, as_host, coordinates, row_table
from wrt.sensors.trajectory import StillPoses, Trajectory, deskew
from wrt.tables import lookup

if TYPE_CHECKING:
    from collections.abc import Sequence

    from wrt.sensors.lidar_pattern import LidarPattern
    from wrt.sensors.outputs.measured_returns import MeasuredReturns

POINT_TYPE = np.dtype(
    [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("intensity", "<f4"),
        ("ring", "<u2"),
        ("time", "<f4"),
        ("return_number", "u1"),
        ("instance_id", "<i4"),
    ]
)
"""What `LidarScan.to_structured` gives for each return: coordinates, intensity, ring, seconds after the start of the scan,
place among the beam's returns from 0 up, and the instance. Fields are wider where these do not hold the numbers."""

LONG_TIME = 16.0
"""Seconds up to which float32 holds times to a microsecond."""


class LidarScan(HitOutputs):
    """What a `Lidar` measured in one scan.

    Arrays have the pattern's leading shape (...), or (..., R) if the lidar keeps R > 1 returns; those of many sensors have the
    leading shape of their poses before it. They are NumPy arrays, each computed when it is first read, or Warp arrays on the
    scene's device, if the pattern is made of these or `to_warp` says so. Reading a layer that was not among those that
    `Lidar.scan` was asked for raises a ValueError.

    Attributes:
        range: float32 distance along the beam, with noise; inf for a miss.
        intensity: float32, without noise; 0 for a miss (`Lidar`).
        point: (..., 3) float64 in the sensor's frame at the time of the beam, as a sensor reports it, with noise; NaN for a
            miss.
        position: (..., 3) float64, the same point in the world, by the true pose at the time of the beam; NaN for a miss.
        normal: (..., 3) float32 of the surface in the world, by the winding of its triangle; 0 for a miss.
        instance_id: int32, index of the instance, or of the mesh in a scene without instances; -1 for a miss.
        geometry_id: int32, index of the mesh; -1 for a miss.
        primitive_id: int32, index of the triangle within its mesh; -1 for a miss.
        semantic_id: int32, the label of the instance; -1 for a miss, and without labels.
        radial_velocity: float32, the rate in metres a second at which the distance between the start of the beam and the point
            of the surface grows, from the motions of both; NaN for a miss.
        time: (...) float64 NumPy array, time of each beam on the clock of the trajectories.
        ring: (...) int32 NumPy array.
        trajectory: of the sensor; of many, their `StillPoses`.
        start: time of the scan's start.
        motion_error: bound on the displacement of surfaces by time slices, in metres; 0 if no instance moved
            (`wrt.sensors.time_slices`).
    """

    def __init__(
        self,
        pattern: LidarPattern,
        layers: MeasuredReturns,
        kept: int,
        trajectory: Trajectory | StillPoses,
        start: float,
        motion_error: float,
        to_warp: bool,
        chosen: Sequence[str] | None,
    ) -> None:
        self.pattern, self.trajectory, self.start, self.motion_error = pattern, trajectory, start, motion_error
        self._kept, self._beams = kept, (*getattr(trajectory, "shape", ()), *pattern.shape)
        super().__init__(layers, self._beams if kept == 1 else (*self._beams, kept), to_warp, chosen)

    @cached_property
    def range(self) -> Any:
        values = self._out("range")
        if self._to_warp or self._layers.arrays.keys() >= set(self._chosen):
            return values
        return values.copy()  # layers that are made later are made of it, whatever callers write to theirs

    @cached_property
    def intensity(self) -> Any:
        return self._out("intensity")

    @cached_property
    def point(self) -> Any:
        return self._out("point")

    @cached_property
    def radial_velocity(self) -> Any:
        return self._out("radial_velocity")

    @cached_property
    def time(self) -> np.ndarray:
        return np.broadcast_to(self.start + self.pattern.times, self._beams)

    @property
    def ring(self) -> np.ndarray:
        return np.broadcast_to(self.pattern.rings, self._beams)

    def deskewed(self, time: float | None = None, trajectory: Trajectory | None = None) -> Any:
        """The points as if all had been measured at one time: (..., 3) float64 in the sensor's frame at that time.

        Args:
            time: that time; None for the start of the scan.
            trajectory: the sensor's motion as somebody estimated it; None for the true one.

        Raises:
            ValueError: a time beyond the trajectory.
        """
        if trajectory is None and isinstance(self.trajectory, StillPoses):
            return self.point
        times = self.time if self._kept == 1 else self.time[..., None]
        return deskew(self.point, times, trajectory or self.trajectory, self.start if time is None else time)

    def to_structured(self, frame: str = "sensor", organized: bool = False) -> np.ndarray:
        """All returns, without misses: (N,) structured array of `wrt.sensors.POINT_TYPE`, sensor by sensor, in order of time.

        Some fields are wider: coordinates of the world are float64, as float32 would move points that are far from 0; rings are
        int32 if some are not from 0 to 65535, and times float64 if some are 16 s or more after the start. A scan with labels
        has a field more: semantic_id (int32).

        Args:
            frame: "sensor": coordinates as measured, each at the time of its beam; "world"; or "start": without the motion of
                the sensor, in its frame at the start of the scan.
            organized: whether to give all returns in the shape of the scan, misses included, whose coordinates are NaN.

        Raises:
            TypeError: `organized` is no bool.
            ValueError: an unknown frame.
        """
        choices = {"sensor": lambda: self.point, "world": lambda: self.position, "start": self.deskewed}
        kept, layers, organized, pattern = self._kept, self._layers, as_bool("organized", organized), self.pattern
        read, place = lookup(choices, frame, "frame"), "position" if frame == "world" else "point"
        ids = ("instance", "semantic") if len(layers.labels) else ("instance",)
        self._make_ready((place, "intensity", *ids))
        fields = [
            coordinates(read(), "<f8" if frame == "world" else "<f4"),
            Field(("intensity",), "<f4", as_host(self.intensity).ravel()),
            Field(("ring",), "<i4" if pattern.has_wide_rings else "<u2", pattern.rings.ravel(), kept),
            Field(("time",), "<f8" if max(map(abs, pattern.span)) >= LONG_TIME else "<f4", pattern.times.ravel(), kept),
            Field(("return_number",), "u1", np.arange(kept, dtype=np.uint8)),
            *(Field((f"{name}_id",), "<i4", as_host(getattr(self, f"{name}_id")).ravel()) for name in ids),
        ]
        if organized:
            return row_table(fields, None, layers.count, None, layers.num_threads).reshape(self.shape)
        order = pattern.order_of_returns(kept)
        return row_table(fields, fields[5].values, layers.count, (order, len(order)), layers.num_threads)
