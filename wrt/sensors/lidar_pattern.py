"""Patterns of a lidar's beams: where each points, where it starts and when it is fired."""

from __future__ import annotations

from functools import cached_property
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.kernels.runtime.launch import kept
from wrt.kernels.validation import as_bool, as_float, as_int, host_array
from wrt.sensors.checks import as_integers, check_at_least, check_real

if TYPE_CHECKING:
    from wrt.array_types import ArrayLike, Numbers
    from wrt.kernels.sensors.lidar_beams import Beams
    from wrt.sensors.time_slices import Slice

UNIT_TOLERANCE = 1e-3

MAX_CUTS = 4
"""Divisions into time slices that are kept."""


class LidarPattern:
    """The beams of one scan, in the sensor's frame: x forward, y left, z up, in metres and seconds.

    Any pattern is arrays. `spinning`, `raster` and `rosette` make common ones.

    Args:
        directions: (..., 3) unit vectors. A leading shape (rings, columns) makes range images of the results, and lets rays be
            traced in packets.
        times: (...) firing time of each beam after the start of the scan, in seconds; broadcasts. None: all at the start.
        rings: (...) integers of 32 bits, the laser or row of each beam; broadcasts. None: the index along the first axis.
        offsets: (..., 3) start of each beam relative to the sensor's origin; broadcasts. None: at the origin.

    Directions and offsets may be Warp arrays of vec3 on the scene's device; results are then Warp arrays.

    Attributes:
        shape: the leading shape (...).
        directions: as given, float32.
        times: (...) float64, read-only.
        rings: (...) int32, read-only.
        offsets: as given, float32; None if there are none.

    Raises:
        TypeError: an argument of a wrong type.
        ValueError: wrong shapes, numbers that are not finite, rings that are not whole numbers of 32 bits, directions that are
            not unit vectors.
    """

    def __init__(
        self,
        directions: ArrayLike,
        times: ArrayLike | None = None,
        rings: ArrayLike | None = None,
        offsets: ArrayLike | None = None,
    ) -> None:
        self.is_warp = isinstance(directions, wp.array)
        self.directions = self._vectors("directions", directions)
        self.shape = self.directions.shape if self.is_warp else self.directions.shape[:-1]
        if not self.shape or 0 in self.shape:
            found = self.directions.shape
            raise ValueError(f"directions must have shape (..., 3) with at least one beam and one leading axis, not {found}")
        self.times = self._spread("times", np.zeros(()) if times is None else times, np.float64)
        default = np.arange(self.shape[0]).reshape(-1, *(1,) * (len(self.shape) - 1))
        self.rings = self._spread("rings", default if rings is None else rings, np.int32)
        self.offsets = None if offsets is None else self._vectors("offsets", offsets)
        if self.offsets is not None and not self.is_warp:
            self.offsets = np.ascontiguousarray(np.broadcast_to(self.offsets, (*self.shape, 3)))
        if not self.is_warp:
            lengths = np.linalg.norm(self.directions, axis=-1)
            if np.abs(lengths - 1.0).max() > UNIT_TOLERANCE:
                raise ValueError(
                    f"directions must be unit vectors, but have lengths from {lengths.min():g} to {lengths.max():g}"
                )
        self.structs: dict[str, Beams] = {}  # by device
        self._cuts: dict[tuple[tuple[int, ...], int], tuple[np.ndarray | None, list[Slice]]] = {}
        self._on_device: dict[str, tuple[wp.array, wp.array, wp.array]] = {}
        self._order: np.ndarray = np.zeros(0, dtype=np.int32)

    def __getstate__(self) -> dict[str, Any]:
        """Pickles leave out what is kept for a device."""
        return vars(self) | {"structs": {}, "_cuts": {}, "_on_device": {}}

    def __repr__(self) -> str:
        return f"LidarPattern(shape={self.shape}, {1e3 * self.duration:g} ms)"

    def __len__(self) -> int:
        """Number of beams."""
        return prod(self.shape)

    @cached_property
    def span(self) -> tuple[float, float]:
        """Firing times of the first and the last beam, in seconds."""
        return float(self.times.min()), float(self.times.max())

    @cached_property
    def has_wide_rings(self) -> bool:
        """Whether some rings are not from 0 to 65535."""
        return bool(self.rings.size) and (self.rings.min() < 0 or self.rings.max() > np.iinfo(np.uint16).max)

    def cut(self, sensors: tuple[int, ...], slices: int) -> tuple[np.ndarray | None, list[Slice]]:
        """The order in which beams are traced, and the slices of a scan that starts at 0, as of
        `wrt.sensors.time_slices.cut_slices`; the last few are kept.

        Args:
            sensors: leading shape of the sensors.
            slices: number of time slices.
        """
        from wrt.sensors.time_slices import cut_slices

        key = sensors, slices
        if key not in self._cuts:
            if len(self._cuts) >= MAX_CUTS:
                self._cuts.clear()
            self._cuts[key] = cut_slices(np.broadcast_to(self.times, (*sensors, *self.shape)), self.span, 0.0, slices)
        return self._cuts[key]

    def order_of_returns(self, kept: int) -> np.ndarray:
        """(beams kept,) int32: the returns of a scan in order of time; the last one is kept.

        Args:
            kept: returns of each beam.
        """
        if len(self._order) != len(self) * kept:
            beams: np.ndarray = np.argsort(self.times.ravel(), kind="stable").astype(np.int32)
            self._order = (kept * beams[:, None] + np.arange(kept, dtype=np.int32)).ravel()
        return self._order

    @property
    def duration(self) -> float:
        """Time from the first to the last beam, in seconds."""
        return self.span[1] - self.span[0]

    @classmethod
    def spinning(
        cls,
        elevations: ArrayLike,
        columns: int,
        *,
        rate: float = 10.0,
        azimuth_offsets: Numbers = 0.0,
        firing_times: Numbers = 0.0,
        rings: ArrayLike | None = None,
        clockwise: bool = True,
        radius: float = 0.0,
    ) -> LidarPattern:
        """A scanner that turns about z: (rings, columns) beams. Column 0 points forward when the scan starts.

        Args:
            elevations: (R,) angle of each laser above the horizon, in degrees.
            columns: firings of each laser in one turn.
            rate: turns a second.
            azimuth_offsets: (R,) or one angle, in degrees, by which a laser points to the left of the column's azimuth.
            firing_times: (R,) or one, seconds after the column's start at which a laser fires; the head turns meanwhile.
            rings: (R,) number of each laser; None for 0 to R - 1.
            clockwise: whether the head turns clockwise seen from above.
            radius: distance of the start of beams from the axis, in metres.

        Raises:
            TypeError, ValueError: as the class; a number out of range.
        """
        heights = np.radians(check_real("elevations", elevations, (None,)))[:, None]
        columns, clockwise = as_int("columns", columns, 1), as_bool("clockwise", clockwise)
        rate = check_at_least("rate", rate, 1e-6)
        radius = check_at_least("radius", radius, 0.0)
        times = np.arange(columns) / (columns * rate) + np.reshape(check_real("firing_times", firing_times), (-1, 1))
        times = np.broadcast_to(times, (len(heights), columns))
        encoder = (-2.0 if clockwise else 2.0) * np.pi * rate * times
        azimuth = encoder + np.reshape(np.radians(check_real("azimuth_offsets", azimuth_offsets)), (-1, 1))
        flat = np.cos(heights)
        directions = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), 0.0 * azimuth + np.sin(heights)], axis=-1)
        offsets = None if radius == 0.0 else radius * np.stack([np.cos(encoder), np.sin(encoder), 0.0 * encoder], axis=-1)
        return cls(directions, times, None if rings is None else host_array("rings", rings).reshape(-1, 1), offsets)

    @classmethod
    def raster(
        cls, rows: int, columns: int, *, horizontal: float, vertical: float, rate: float = 10.0, tilt: float = 0.0
    ) -> LidarPattern:
        """A solid-state scanner that draws rows from left to right, one below the other: (rows, columns) beams.

        Args:
            rows, columns: number of beams.
            horizontal, vertical: field of view from the first to the last beam, in degrees.
            rate: frames a second, over which the beams are fired evenly.
            tilt: elevation of the middle, in degrees.

        Raises:
            TypeError, ValueError: a number out of range.
        """
        rows, columns = as_int("rows", rows, 1), as_int("columns", columns, 1)
        horizontal = check_at_least("horizontal", horizontal, 0.0, 360.0)
        vertical = check_at_least("vertical", vertical, 0.0, 180.0)
        rate, tilt = check_at_least("rate", rate, 1e-6), as_float("tilt", tilt, finite=True)
        azimuth = np.radians(np.linspace(horizontal / 2, -horizontal / 2, columns))
        elevation = np.radians(tilt + np.linspace(vertical / 2, -vertical / 2, rows))[:, None]
        flat = np.cos(elevation)
        directions = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), 0.0 * azimuth + np.sin(elevation)], axis=-1)
        return cls(directions, np.arange(rows * columns).reshape(rows, columns) / (rows * columns * rate))

    @classmethod
    def rosette(
        cls, count: int, *, half_angle: float, speeds: tuple[float, float], point_rate: float, first: int = 0
    ) -> LidarPattern:
        """The rosette that two turning wedge prisms (Risley prisms) of equal strength draw: (count,) beams about x.

        Each prism deflects the beam by half of `half_angle`, to first order; the deflections add up. Unless the speeds have a
        short common period, the pattern does not repeat: choose `first` to go on where another pattern ended.

        Args:
            count: number of beams.
            half_angle: largest angle of a beam to the x axis, in degrees.
            speeds: turns a minute of the two prisms; of opposite sign if they turn against each other.
            point_rate: beams a second.
            first: number of the first beam since the prisms started together.

        Raises:
            TypeError, ValueError: a number out of range.
        """
        count, first = as_int("count", count, 1), as_int("first", first, 0)
        half_angle = np.radians(check_at_least("half_angle", half_angle, 0.0, 90.0))
        point_rate = check_at_least("point_rate", point_rate, 1e-6)
        turns = 2.0 * np.pi / 60.0 * check_real("speeds", speeds, (2,))
        phases = turns[:, None] * (first + np.arange(count)) / point_rate
        left, up = half_angle / 2 * np.cos(phases).sum(axis=0), half_angle / 2 * np.sin(phases).sum(axis=0)
        angle = np.hypot(left, up)
        across = np.sinc(angle / np.pi)  # sin(angle) / angle
        directions = np.stack([np.cos(angle), across * left, across * up], axis=-1)
        return cls(directions, np.arange(count) / point_rate, np.zeros(count, dtype=np.int32))

    def arrays_on(self, device: wp.Device) -> tuple[wp.array, wp.array, wp.array]:
        """Directions, offsets and times as flat arrays on a device, copied once; offsets (0,) if there are none.

        Raises:
            ValueError: the pattern's Warp arrays are on another device.
        """
        if device.alias not in self._on_device:
            with kept(device):
                offsets = (
                    wp.empty(0, dtype=wp.vec3, device=device) if self.offsets is None else self._flat(self.offsets, device)
                )
                times = wp.array(self.times.ravel(), dtype=wp.float64, device=device)
                self._on_device[device.alias] = self._flat(self.directions, device), offsets, times
        return self._on_device[device.alias]

    def _flat(self, values: Any, device: wp.Device) -> wp.array:
        if not isinstance(values, wp.array):
            return wp.array(values.reshape(-1, 3), dtype=wp.vec3, device=device)
        if values.device != device:
            raise ValueError(f"the pattern is on {values.device}, the scene on {device}; copy it there")
        return values.flatten()

    def _vectors(self, name: str, values: Any) -> Any:
        if isinstance(values, wp.array):
            if values.dtype is not wp.vec3:
                raise TypeError(f"{name} must be a Warp array of vec3, not of {values.dtype.__name__}")
            if name != "directions" and (not self.is_warp or values.shape != self.shape):
                where = self.shape if self.is_warp else "a NumPy array"
                raise ValueError(f"{name} of shape {values.shape} must be as the directions, which are {where}")
            return values.contiguous()
        if name != "directions" and self.is_warp:
            raise TypeError(f"{name} must be a Warp array of vec3, as the directions are, not {type(values).__name__}")
        values = check_real(name, values)
        if values.shape[-1:] != (3,):
            raise ValueError(f"{name} must have shape (..., 3), not {values.shape}")
        return np.ascontiguousarray(values, dtype=np.float32)

    def _spread(self, name: str, values: Any, dtype: type) -> np.ndarray:
        values = values.numpy() if isinstance(values, wp.array) else values
        array = check_real(name, values)
        array = as_integers(name, array, dtype) if dtype is np.int32 else array
        try:
            array = np.array(np.broadcast_to(array, self.shape), dtype=dtype, order="C")
        except ValueError:
            raise ValueError(f"{name} has the shape {array.shape}, which does not broadcast to {self.shape}") from None
        array.setflags(write=False)
        return array
