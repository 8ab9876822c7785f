"""Lidars: a pattern of beams and what the receiver detects of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.engine.facts.query_kinds import AUTO
from wrt.kernels.runtime.launch import as_device, kept, launch, use_threads
from wrt.kernels.validation import as_bool, as_int, convert_fields
from wrt.sensors.checks import as_time, check_at_least, check_real, check_scene
from wrt.sensors.fired_rays import fire, spread_on
from wrt.sensors.lidar_pattern import LidarPattern
from wrt.sensors.lidar_presets import LIDARS
from wrt.sensors.lidar_scan import LidarScan
from wrt.sensors.outputs.hit_outputs import as_layers
from wrt.sensors.outputs.measured_returns import MeasuredReturns, no_noise
from wrt.sensors.placed.device_poses import DevicePoses, as_poses
from wrt.sensors.placed.values_on_devices import refuse_captured_scan, refuse_host_values, stays_on
from wrt.sensors.time_slices import (
    Bodies,
    SensorRays,
    as_motions,
    check_slices,
    for_each_ray,
    labelled,
    labels_on,
    no_order,
    slice_error,
    trace_slices,
)
from wrt.sensors.trajectory import Trajectory
from wrt.tables import lookup

if TYPE_CHECKING:
    from wrt.array_types import ArrayLike, Numbers
    from wrt.clouds.point_cloud import PointCloud
    from wrt.engine.plan.plan import Plan
    from wrt.kernels.sensors.lidar_beams import Beams
    from wrt.kernels.sensors.lidar_returns import Detector, Noise
    from wrt.scene.scene import Scene
    from wrt.sensors.time_slices import TracedSlice
    from wrt.sensors.trajectory import Pose

KEEP = {"strongest": 0, "first": 1, "last": 2}
"""Which returns of a beam are kept, and their numbers in `wrt.kernels.sensors.lidar_returns`."""

WHITE = np.ones(1)
"""The reflectance of surfaces that absorb nothing."""

MAX_KEPT = 64
"""Detectors of different reflectances that are kept."""

MAX_BUNDLE = 256
MAX_RETURNS = 16


@dataclass(frozen=True, kw_only=True)
class Lidar:
    """A laser scanner: `scan` traces its beams through a scene and returns a `LidarScan`.

        lidar = wrt.sensors.Lidar.preset("ouster_os1_64")
        scan = lidar.scan(scene, pose)
        scan.range, scan.position, scan.intensity, scan.instance_id

    The intensity of a return is relative: 1 for a surface of reflectance 1 at `reference_range`, met at a right angle, that
    fills the beam. It is reflectance x cos(angle of incidence) x (reference_range / range)^range_exponent x
    exp(-2 extinction range) (`wrt.kernels.sensors.lidar_returns`).

    Attributes:
        pattern: the beams.
        min_range: least range that is detected; a surface nearer than that blocks the beam and returns nothing.
        max_range: greatest range.
        divergence: full angle of a beam, in radians.
        bundle: rays per beam, spread evenly over its disk of directions (Vogel's spiral); 1 for the axis alone.
        range_resolution: rays of a bundle whose ranges differ by more than this belong to different returns.
        returns: number of returns kept per beam.
        keep: "strongest", "first" or "last": which returns are kept, and in which order.
        range_exponent: exponent of the range law: 2 for surfaces wider than the beam; 0 for receivers that compensate.
        reference_range: range at which the factor of the range law is 1.
        extinction: of the air, per metre.
        threshold: least intensity that is detected.
        range_noise: standard deviation of ranges, in metres.
        angle_noise: standard deviation of the reported direction along each of two axes, in radians.
        dropout: share of the returns that are lost, in [0, 1).

    Raises:
        TypeError: a value of a wrong type.
        ValueError: a value out of range, or an unknown name.

    References: vogel-1979.
    """

    pattern: LidarPattern
    min_range: float = 0.0
    max_range: float = np.inf
    divergence: float = 0.0
    bundle: int = 1
    range_resolution: float = 0.5
    returns: int = 1
    keep: str = "strongest"
    range_exponent: float = 2.0
    reference_range: float = 10.0
    extinction: float = 0.0
    threshold: float = 0.0
    range_noise: float = 0.0
    angle_noise: float = 0.0
    dropout: float = 0.0

    def __post_init__(self) -> None:
        if not isinstance(self.pattern, LidarPattern):
            raise TypeError(f"pattern must be a wrt.sensors.LidarPattern, not {type(self.pattern).__name__}")
        convert_fields(self)
        for name in ("min_range", "divergence", "range_resolution", "range_exponent", "extinction", "threshold"):
            check_at_least(name, getattr(self, name), 0.0, np.pi if name == "divergence" else np.inf)
        for name in ("range_noise", "angle_noise"):
            check_at_least(name, getattr(self, name), 0.0)
        check_at_least("dropout", self.dropout, 0.0, 1.0)
        check_at_least("reference_range", self.reference_range, float(np.finfo(np.float32).tiny))
        for name, maximum in (("bundle", MAX_BUNDLE), ("returns", MAX_RETURNS)):
            as_int(name, getattr(self, name), 1, maximum)
        if not self.max_range > self.min_range:
            raise ValueError(f"max_range is {self.max_range}; it must be above min_range, {self.min_range}")
        lookup(KEEP, self.keep, "keep")

    @classmethod
    def preset(cls, name: str, **options: Any) -> Lidar:
        """A lidar by its data sheet: a key of `wrt.sensors.LIDARS`, which names the sheets.

        Args:
            name: such as "velodyne_vlp16", "velodyne_hdl32e", "ouster_os1_64", "ouster_os1_128", "robosense_m1" or
                "livox_mid40".
            options: of that lidar's entry, such as `rate`; and attributes of this class, which replace the sheet's.
                Thresholds of sheets hold for the default range law; choose another one together with a threshold.

        Raises:
            TypeError, ValueError: an unknown name or option, or a value out of range.
        """
        return cls(**lookup(LIDARS, name, "name").attributes(**options))

    def __getstate__(self) -> dict[str, Any]:
        """Pickles leave out what is kept for a device."""
        return {name: value for name, value in vars(self).items() if name != "_detectors"}

    def replace(self, **changes: Any) -> Lidar:
        """This lidar with other values of some attributes.

        Raises:
            TypeError, ValueError: as the class.
        """
        return replace(self, **changes)

    def scan(
        self,
        scene: Scene | PointCloud,
        pose: Pose,
        *,
        time: float = 0.0,
        motions: Mapping[int, Trajectory] | None = None,
        slices: int = 1,
        reflectance: Numbers = 1.0,
        mask: Numbers | None = None,
        environment: Numbers | None = None,
        traversal: str | Plan = "auto",
        labels: ArrayLike | None = None,
        seed: int | wp.array | None = None,
        layers: Sequence[str] | None = None,
        to_warp: bool | None = None,
    ) -> LidarScan:
        """Traces one scan. Every beam starts at the pose of the sensor at its own firing time.

        Args:
            scene: a `wrt.Scene`, or a `PointCloud`, which counts as one mesh. It is not changed, whatever moves.
            pose: (4, 4) from the sensor's frame to the world, or a `Trajectory` over the time of the scan; or (..., 4, 4) of
                many sensors at rest, which measure in one call; or a Warp array (...) of `wp.transform` on the scene's device,
                whose values are not checked.
            time: start of the scan, on the clock of the trajectories.
            motions: trajectories of instances, by their index. Their transforms in the scene are replaced.
            slices: number of time slices; instances stand still within a slice, where they are in the middle of it.
                `LidarScan.motion_error` bounds the error in position. 1 for instances that stand still during the scan.
            reflectance: of all surfaces, or (I,) of each instance (of each mesh, in a scene without instances; of each point
                of a `PointCloud`); >= 0.
            mask, environment: as in `wrt.Scene.intersect`, one number, or one for each of many sensors: which instances they
                see.
            traversal: as in `wrt.Scene.intersect`.
            labels: (I,) integers >= 0, the semantic class of each instance (of each mesh, in a scene without instances).
            seed: of the noise, 0 to 2^64 - 1; the same seed gives the same noise, so pass another one for each
                scan. A Warp array (1,) of uint64 on the scene's device holds the seed of this scan, and then that of the next,
                greater by one. None: no noise.
            layers: names of the layers that will be read, such as ("range", "instance_id"): range, intensity, point, position,
                instance_id, geometry_id, primitive_id, semantic_id, normal, radial_velocity. None for all. NumPy arrays are
                computed when they are first read, Warp arrays at once.
            to_warp: whether layers are Warp arrays on the scene's device instead of NumPy arrays; None: if the pattern or the
                poses are.

        **Graphs.** A scan can be captured in a graph if its results are Warp arrays: each launch measures from where poses and
        instances are then. Make the same scan once before. Poses that change, masks and environments of many sensors, labels
        and reflectances are Warp arrays, too, and so is a seed, unless each launch shall have the same noise.

        Raises:
            TypeError: an argument of a wrong type.
            ValueError: an argument out of range, a trajectory that does not cover the scan, motions in a scene without
                instances, or arrays on another device.
            RuntimeError: a graph is being captured, which cannot repeat the scan.
        """
        from wrt.query.api import Queries

        check_scene(scene)
        path, chosen = as_poses(pose, scene.device), as_layers(layers, MeasuredReturns.KINDS)
        to_warp = self.pattern.is_warp or isinstance(path, DevicePoses) if to_warp is None else as_bool("to_warp", to_warp)
        refuse_captured_scan(scene.device, path, motions, to_warp)
        time = as_time(time)
        span = self.pattern.span
        begin, end = time + span[0], time + span[1]
        path.check_covers(begin, end, "the times of the scan")
        detector, noise = self.detector(scene.device, as_reflectance(reflectance, scene)), as_noise(self, seed, scene.device)
        motions = as_motions(motions, scene, begin, end)
        sensors = getattr(path, "shape", ())
        slices = check_slices(slices)
        order, parts = self.pattern.cut(sensors, slices if motions else 1)
        parts = [part.later(time) for part in parts]
        seen_by, device, count = {"mask": mask, "environment": environment}, scene.device, prod(sensors)
        each = for_each_ray(seen_by, sensors, len(self.pattern), self.bundle, order, device)
        beams, shape = self.device_beams(device, order, time), (*sensors, *self.pattern.shape)
        with use_threads(scene.num_threads):
            relative = not motions and traversal == AUTO and type(scene).intersect is Queries.intersect
            counts = count, len(self.pattern) * self.bundle, self.pattern.offsets is None
            key = None if order is not None or self.pattern.is_warp else (self.pattern, self.bundle, self.divergence)
            fired = fire(beams, path, device, counts, scene.state.center if relative else None, key)
            rays = SensorRays(*fired, self.bundle, shape, self.max_range, traversal, each, relative)
            found = list(trace_slices(copy(scene), rays, Bodies(motions, parts), parts))
            given = (beams, path.path(device), noise, detector), (count * len(self.pattern), self.returns, self.bundle)
            if scene.state.tangents is not None and len(detector.reflectance) > 1:
                reflect_by_point(found[0], detector)
            made = MeasuredReturns(found, *given, labels_on(labels, scene), scene.num_threads)
        error = slice_error(motions, scene, parts)
        return LidarScan(self.pattern, made, self.returns, path, time, error, to_warp, chosen)

    def device_beams(self, device: wp.Device, order: np.ndarray | None, time: float) -> Beams:
        """The beams, for kernels.

        Args:
            device: where they are read.
            order: in which they are traced, the numbers of beams; None for that of the pattern.
            time: of the first beam, in seconds.
        """
        from wrt.kernels.runtime.argument_packing import copied
        from wrt.kernels.sensors.lidar_beams import Beams

        known = self.pattern.structs
        if device.alias not in known:
            beams = Beams()
            beams.directions, beams.offsets, beams.times = self.pattern.arrays_on(device)
            beams.order = no_order(device.alias)
            known[device.alias] = beams
        beams = copied(known[device.alias])
        if order is not None:
            beams.order = wp.array(order, dtype=int, device=device)
        beams.spread = spread_on(self.bundle, self.divergence if self.bundle > 1 else 0.0, device.alias)
        beams.start = wp.float64(time)
        return beams

    def detector(self, device: wp.Device, reflectance: np.ndarray | wp.array) -> Detector:
        """What the receiver detects, for kernels.

        Args:
            device: where it is read.
            reflectance: of each instance, or one for all.
        """
        from wrt.kernels.sensors.lidar_returns import Detector

        alone = float(reflectance[0]) if isinstance(reflectance, np.ndarray) and len(reflectance) == 1 else None
        if (known := self._detectors.get((device.alias, alone))) is not None:
            return known
        detector = Detector()
        detector.min_range, detector.max_range = self.min_range, self.max_range
        detector.resolution, detector.exponent = self.range_resolution, self.range_exponent
        detector.reference_range, detector.extinction = self.reference_range, self.extinction
        detector.threshold, detector.returns, detector.keep = self.threshold, self.returns, KEEP[self.keep]
        if isinstance(reflectance, wp.array):
            detector.reflectance = reflectance
        elif alone is None:
            detector.reflectance = wp.array(reflectance, dtype=float, device=device)
        else:
            detector.reflectance = one_reflectance(alone, device.alias)
            if len(self._detectors) >= MAX_KEPT:
                self._detectors.clear()
            self._detectors[device.alias, alone] = detector
        return detector

    @cached_property
    def _detectors(self) -> dict[tuple[str, float], Detector]:
        """Those of surfaces that are all alike, by device and reflectance; kernels only read them."""
        return {}


@lru_cache(maxsize=64)
def one_reflectance(value: float, device: str) -> wp.array:
    """(1,) reflectance of all surfaces; kept."""
    with kept(as_device(device)):
        return wp.array([value], dtype=float, device=device)


def as_reflectance(reflectance: Any, scene: Scene | PointCloud) -> np.ndarray | wp.array:
    """(1,) or (I,) float64; a Warp array (I,) of float32 on the scene's device stays, and its values are not checked.

    Raises:
        TypeError: not real numbers.
        ValueError: another length, or a negative value.
    """
    if type(reflectance) is float and reflectance == 1.0:  # the default, and every scan asks
        return WHITE
    is_cloud = scene.state.tangents is not None
    count, what = (len(scene), "points") if is_cloud else (labelled(scene), "instances")  # type: ignore[arg-type]
    if stays_on(scene.device, reflectance, wp.float32, (count,)):
        return reflectance
    refuse_host_values("reflectance", reflectance, wp.float32, scene.device)
    values = np.atleast_1d(check_real("reflectance", reflectance))
    if values.shape not in ((1,), (count,)):
        raise ValueError(
            f"reflectance has the shape {np.shape(reflectance)}; pass one number, or one for each of {count} {what}"
        )
    if values.min() < 0.0:
        raise ValueError(f"reflectance must not be negative, but its smallest value is {values.min()}")
    return values


def reflect_by_point(found: TracedSlice, detector: Detector) -> None:
    """Makes the reflectance of each point that of each hit: to the receiver, every hit of a cloud is a geometry of its own."""
    point, mesh, device = found.traced.primitive.numpy(), found.surface[1], detector.reflectance.device
    mesh.geometry_first = wp.array(np.arange(len(point) + 1), dtype=int, device=device)
    detector.reflectance = wp.array(detector.reflectance.numpy()[np.maximum(point, 0)], dtype=float, device=device)


def as_noise(lidar: Lidar, seed: Any, device: wp.Device) -> Noise:
    """The noise for kernels; none without a seed. One on the device is taken, and the next number left there.

    Raises:
        TypeError: the seed is not a whole number.
        ValueError: it is out of range.
    """
    from wrt.kernels.sensors.lidar_returns import Noise, take_seed

    if seed is None:
        return no_noise()
    noise = Noise()
    noise.range, noise.angle, noise.dropout = lidar.range_noise, lidar.angle_noise, lidar.dropout  # type: ignore[assignment]
    if isinstance(seed, wp.array):
        if seed.dtype is not wp.uint64 or seed.shape != (1,) or seed.device != device:
            found = f"{seed.shape} of {seed.dtype.__name__} on {seed.device}"
            raise ValueError(f"seed must be a number, or a Warp array (1,) of uint64 on {device}, not {found}")
        noise.taken = wp.empty(1, dtype=wp.uint64, device=device)
        launch(take_seed, 1, [seed, noise.taken], device=device)
        return noise
    seed = as_int("seed", seed, 0, (1 << 64) - 1)
    noise.key = wp.vec2ui(seed & 0xFFFFFFFF, seed >> 32)
    return noise
