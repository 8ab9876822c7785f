"""Time slices: instances that move during a scan, moved in steps.

**Problem.** Every beam has its own time, and a tree over moving instances would have to be another one for each beam.

**Method.** The time of a scan is cut into S equal slices. In the middle of each, all moving instances are placed by their
trajectories, the upper tree is built over their boxes, and the beams of the slice are traced. The sensor itself moves exactly,
beam by beam.

**Error.** Within a slice of duration d, a point of an instance is displaced by at most d / 2 times its speed, which is at most
|velocity| + |angular velocity| x (its distance from the moving frame's origin). The bound is halved when slices are doubled.
It is 0 for instances at rest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.meshes.placement import check_index
from wrt.sensors.trajectory import Trajectory

if TYPE_CHECKING:
    from wrt.kernels.sensors.lidar_returns import Motions
    from wrt.query.api import Queries

MAX_SLICES = 4096


@dataclass(frozen=True)
class Slice:
    """Neighbours in the order of tracing that are traced at one time.

    Attributes:
        begin, end: places of the first ray, and after the last.
        time: at which instances are placed; None for a scan without moving instances.
        duration: of the slice, in seconds.
        shape: leading shape of its rays; None for that of all rays.
    """

    begin: int
    end: int
    time: float | None
    duration: float
    shape: tuple[int, ...] | None


class Bodies:
    """Instances that move: their transforms and velocities in all slices.

    Args:
        motions: trajectories of instances, by their index.
        parts: the slices.
    """

    def __init__(self, motions: Mapping[int, Trajectory], parts: Sequence[Slice]) -> None:
        self.chosen, self._number = list(motions), {id(part): number for number, part in enumerate(parts)}
        if not motions:
            return
        times = np.array([part.time for part in parts])
        self._transforms = np.stack([body.at(times) for body in motions.values()], axis=1)
        velocities = [body.velocities(times) for body in motions.values()]
        self._velocities = np.swapaxes(np.array(velocities), 0, 2)  # slice, kind, body

    def place(self, scene: Any, part: Slice) -> Motions:
        """Moves the instances of a scene to where they are at the time of a slice; returns their velocities."""
        from wrt.kernels.sensors.lidar_returns import Motions

        motions = Motions()
        if not self.chosen:
            return motions
        number, device = self._number[id(part)], scene.device
        scene.update(self.chosen, transform=self._transforms[number])
        state = np.zeros((3, len(scene.instances), 3))
        state[0, self.chosen] = self._transforms[number][:, :3, 3]
        state[1:, self.chosen] = self._velocities[number]
        motions.pivot, motions.velocity, motions.spin = (wp.array(values, dtype=wp.vec3d, device=device) for values in state)
        return motions


def as_motions(motions: Any, scene: Queries, begin: float, end: float) -> Mapping[int, Trajectory]:
    """Checked trajectories of instances over a time.

    Raises:
        TypeError: not a mapping from indices to trajectories.
        ValueError: no such instance, or a trajectory that does not cover the time.
    """
    if not motions:
        return {}
    if not isinstance(motions, Mapping):
        raise TypeError(f"motions must be a dict from indices of instances to trajectories, not {type(motions).__name__}")
    if not scene.instances:
        raise ValueError("motions need instances, and this scene has none; put moving meshes into wrt.Instance")
    for number, body in motions.items():
        check_index(number, len(scene.instances), "instance")
        if not isinstance(body, Trajectory):
            raise TypeError(f"motions[{number}] must be a wrt.sensors.Trajectory, not {type(body).__name__}")
        body.check_covers(begin, end, f"motions[{number}]: the times of the scan")
    return motions


def cut_slices(times: np.ndarray, start: float, slices: int) -> tuple[np.ndarray | None, list[Slice]]:
    """The order in which rays are traced (None for that of their numbers), and the slices.

    Args:
        times: (...) seconds of each ray after `start`.
        start: time of the scan's start.
        slices: number of slices; those without a ray are left out.

    Raises:
        TypeError: `slices` is not a whole number.
        ValueError: it is out of range.
    """
    if isinstance(slices, bool) or not isinstance(slices, (int, np.integer)):
        raise TypeError(f"slices must be a whole number, not {type(slices).__name__}")
    if not 1 <= slices <= MAX_SLICES:
        raise ValueError(f"slices is {slices}; it must be from 1 to {MAX_SLICES}")
    begin, duration = float(times.min()), float(np.ptp(times))
    if slices == 1 or duration == 0.0:
        return None, [Slice(0, times.size, start + begin + duration / 2, duration, None)]
    number = np.minimum((times - begin) / duration * slices, slices - 1).astype(np.int64)
    rows = number.reshape(len(times), -1)
    flat = number.ravel()
    order = np.argsort(flat, kind="stable")
    ends = np.cumsum(np.bincount(flat, minlength=slices))
    length, parts = duration / slices, []
    for which, end in enumerate(ends):
        first = int(ends[which - 1]) if which else 0
        if end > first:
            in_rows = (rows == which).sum(axis=1)
            in_rows = in_rows[in_rows > 0]
            even = times.ndim > 1 and (in_rows == in_rows[0]).all()
            shape = (len(in_rows), int(in_rows[0])) if even else (int(end) - first,)
            parts.append(Slice(first, int(end), start + begin + (which + 0.5) * length, length, shape))
    return order.astype(np.int32), parts


def slice_error(bodies: Mapping[int, Trajectory], scene: Queries, parts: Sequence[Slice]) -> float:
    """Bound on the distance between where a point of an instance is and where it was traced, in units of length."""
    worst = 0.0
    for number, body in bodies.items():
        if body.is_still:
            continue
        low, high = scene.instances[number].mesh.bounds
        corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1)
        reach = float(np.linalg.norm(body.stretch @ corners, axis=0).max())
        duration = max(part.duration for part in parts)
        first = parts[0].time - parts[0].duration / 2
        last = parts[-1].time + parts[-1].duration / 2
        keys = np.concatenate([[first], body.times[(body.times > first) & (body.times < last)]])
        velocity, spin = body.velocities(np.clip(keys, body.times[0], body.times[-1]))
        speed = np.linalg.norm(velocity, axis=1) + reach * np.linalg.norm(spin, axis=1)
        worst = max(worst, float(speed.max()) * duration / 2)
    return worst
