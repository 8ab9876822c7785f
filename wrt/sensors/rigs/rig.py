"""Rigs: sensors of different kinds that are mounted on one body and measure in one call."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import count, repeat
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.kernels.validation import as_int
from wrt.sensors.checks import as_time
from wrt.sensors.image_sensor import Camera
from wrt.sensors.lidar import Lidar
from wrt.sensors.placed.device_poses import DevicePoses, as_poses
from wrt.sensors.trajectory import StillPoses, Trajectory, as_trajectory
from wrt.tables import lookup

if TYPE_CHECKING:
    from wrt.array_types import ArrayLike
    from wrt.clouds.point_cloud import PointCloud
    from wrt.scene.scene import Scene
    from wrt.sensors.lidar_scan import LidarScan
    from wrt.sensors.outputs.captured_images import CameraImages
    from wrt.sensors.trajectory import Pose

ARC_ERROR = 1e-6
"""Largest distance, in units of length, between a mounted sensor's arc and the chords that it moves along."""

MAX_CHORDS = 4096
"""Chords of an arc between two key poses."""


class Rig:
    """Sensors on one body: `measure` takes the body's pose, and all of them see the same scene.

        rig = wrt.sensors.Rig({"roof": (lidar, on_roof), "front": (camera, in_front)})
        seen = rig.measure(scene, pose, labels=labels, seed=step, each={"front": {"layers": ("depth",)}})
        seen["roof"].range, seen["front"].depth

    Results are those of `Lidar.scan` and `Camera.capture`, bit for bit.

    Args:
        sensors: by name, each a `Lidar` or a `Camera` and its mount: (4, 4) from the sensor's frame to the body's.

    Attributes:
        sensors: the sensors by name.
        mounts: (4, 4) float64 of each, by name.

    Raises:
        TypeError: not a mapping of such pairs.
        ValueError: no sensor, or a mount that does more than move and turn.
    """

    def __init__(self, sensors: Mapping[str, tuple[Lidar | Camera, ArrayLike]]) -> None:
        if not isinstance(sensors, Mapping):
            raise TypeError(f"sensors must be a dict from names to pairs of a sensor and its mount, not {sensors!r:.60}")
        if not sensors:
            raise ValueError("sensors is empty; pass at least one, such as {'roof': (lidar, mount)}")
        self.sensors: dict[str, Lidar | Camera] = {}
        self.mounts: dict[str, np.ndarray] = {}
        for name, pair in sensors.items():
            if not isinstance(pair, tuple) or len(pair) != 2 or not isinstance(pair[0], Lidar | Camera):
                raise TypeError(f"sensors[{name!r}] must be a pair of a Lidar or Camera and its mount (4, 4), not {pair!r:.60}")
            self.sensors[name] = pair[0]
            self.mounts[name] = as_trajectory(pair[1], f"the mount of sensors[{name!r}]").matrices[0]

    def __repr__(self) -> str:
        return f"Rig({', '.join(f'{name}: {type(sensor).__name__}' for name, sensor in self.sensors.items())})"

    def measure(
        self,
        scene: Scene | PointCloud,
        pose: Pose,
        *,
        time: float = 0.0,
        seed: int | wp.array | None = None,
        each: Mapping[str, Mapping[str, Any]] | None = None,
        **common: Any,
    ) -> dict[str, LidarScan | CameraImages]:
        """Lets all sensors measure.

        Args:
            scene: as in `Lidar.scan`.
            pose: (4, 4) from the body's frame to the world, (..., 4, 4) of many bodies at rest that have such a rig, a Warp
                array (...) of `wp.transform` of such bodies, or the body's `Trajectory`. Where that turns, a sensor beside the
                body's origin moves along chords of its arc, none further than 1e-6 units of length from it.
            time: at which all begin, on the clock of the trajectories.
            seed: of the noise of the first lidar; each following one has the next number. A Warp array as in `Lidar.scan`, too.
                None: no noise.
            each: options of single sensors by name, such as `layers`, `reflectance` or another `time`.
            common: options of all, such as `labels`, `motions`, `slices`, `mask` and `environment`.

        Returns:
            By name, a `LidarScan` or `CameraImages`.

        Raises:
            TypeError: an option that a sensor does not have, or an argument of a wrong type.
            ValueError: an unknown name of a sensor, or an argument out of range.
        """
        path, time, each = as_poses(pose), as_time(time), {} if each is None else each
        for name in each:
            lookup(self.sensors, name, "each")
        seeds: Iterator[Any] | None = None
        if isinstance(seed, wp.array):
            seeds = repeat(seed)  # each scan leaves the next number
        elif seed is not None:
            seeds = (number % (1 << 64) for number in count(as_int("seed", seed, 0, (1 << 64) - 1)))
        found: dict[str, LidarScan | CameraImages] = {}
        for name, sensor in self.sensors.items():
            options = {"time": time, **common, **each.get(name, {})}
            placed = mounted(path, self.mounts[name])
            if isinstance(sensor, Lidar):
                if seeds is not None:
                    options = {"seed": next(seeds), **options}
                found[name] = sensor.scan(scene, placed, **options)
            else:
                found[name] = sensor.capture(scene, placed, **options)
        return found


def mounted(path: Trajectory | StillPoses, mount: np.ndarray) -> Any:
    """The poses of a sensor on a body.

    Args:
        path: the body's.
        mount: (4, 4) from the sensor's frame to the body's.
    """
    if isinstance(path, DevicePoses):
        return path.on(mount)
    if isinstance(path, StillPoses):
        return path.poses @ mount
    if path.is_still:
        return path.matrices[0] @ mount
    times = path.times
    arm, between = np.linalg.norm(mount[:3, 3]), np.abs((path.rotations[1:] * path.rotations[:-1]).sum(axis=1))
    turns = 2.0 * np.arccos(np.minimum(between, 1.0))
    pieces = np.ceil(turns * np.sqrt(arm / (8.0 * ARC_ERROR)))  # a chord of the angle a is arm a^2 / 8 away from its arc
    pieces = np.clip(pieces, 1, MAX_CHORDS).astype(np.int64)
    steps = np.repeat(np.diff(times) / pieces, pieces)
    number = np.arange(pieces.sum()) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    keys = np.unique(np.append(np.repeat(times[:-1], pieces) + number * steps, times[-1]))
    return Trajectory.from_matrices(keys, path.at(keys) @ mount)
