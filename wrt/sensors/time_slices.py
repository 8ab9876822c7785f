"""Time slices: instances that move during a scan, moved in steps.

**Problem.** Every beam has its own time, and a tree over moving instances would have to be another one for each beam.

**Method.** The time of a scan is cut into S equal slices. In the middle of each, all moving instances are placed by their
trajectories. One upper tree has the instances of all slices, and each beam sees those of its slice (`wrt.scene.sliced_state`).
The sensor itself moves exactly, beam by beam.

**Error.** Within a slice of duration d, a point of an instance is displaced by at most d / 2 times its speed, which is at most
|velocity| + |angular velocity| x (its distance from the moving frame's origin). The bound is halved when slices are doubled.
It is 0 for instances at rest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import warp as wp

from wrt.engine.executor import answer_relative
from wrt.engine.facts.query_kinds import AUTO, CLOSEST, QUERIES
from wrt.engine.rays.device_rays import relative_rays
from wrt.instances.instance_boxes import on_device
from wrt.kernels.runtime.argument_packing import blank
from wrt.kernels.runtime.launch import as_device, kept
from wrt.kernels.validation import as_int, as_real_array
from wrt.meshes.placement import check_index
from wrt.sensors.placed.values_on_devices import refuse_host_values, repeated, stays_on
from wrt.sensors.trajectory import Trajectory

if TYPE_CHECKING:
    from wrt.clouds.point_cloud import PointCloud
    from wrt.engine.device_hits import DeviceHits
    from wrt.kernels.query.hit_attributes import SceneMesh
    from wrt.kernels.sensors.lidar_returns import Motions, Traced
    from wrt.scene.scene import Scene

MAX_SLICES = 4096

MAX_TOGETHER = 1 << 17
"""Largest number of instances of all slices together that are traced at once: each takes 184 bytes of a table."""


KEPT_BYTES = 1 << 16
"""Size of labels up to which those of the last few scans are kept."""


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

    def later(self, start: float) -> Slice:
        """The same slice of a scan that begins later."""
        return Slice(self.begin, self.end, None if self.time is None else self.time + start, self.duration, self.shape)


class Bodies:
    """Instances that move: their transforms and velocities in all slices.

    Args:
        motions: trajectories of instances, by their index.
        parts: the slices.
    """

    def __init__(self, motions: Mapping[int, Trajectory], parts: Sequence[Slice]) -> None:
        self.chosen = list(motions)
        if not motions:
            return
        times = np.array([part.time for part in parts])
        found = [body.states(times) for body in motions.values()]
        self.transforms = np.stack([transforms for transforms, _ in found], axis=1)
        self._velocities = np.swapaxes(np.array([velocities for _, velocities in found]), 0, 2)  # slice, kind, body

    def motions(self, number: int, instances: int, device: wp.Device) -> Motions:
        """The velocities of all instances in a slice."""
        from wrt.kernels.sensors.lidar_returns import Motions

        if not self.chosen:
            return no_motions()
        motions, state = Motions(), np.zeros((3, instances, 3))
        state[0, self.chosen] = self.transforms[number][:, :3, 3]
        state[1:, self.chosen] = self._velocities[number]
        motions.pivot, motions.velocity, motions.spin = (on_device(values, wp.vec3d, device) for values in state)
        return motions


@dataclass(frozen=True)
class SensorRays:
    """Rays of all sensors, in the order in which they are traced.

    Attributes:
        origins: (N,) vec3d, or (1,) if all rays share it.
        directions: (N,) vec3.
        bundle: neighbours that belong to a beam.
        shape: leading shape of all beams, in the order of their numbers.
        t_max: end of their range.
        traversal: as in `wrt.Scene.intersect`.
        each: masks and environments: a number, or a Warp array (N,).
        is_relative: whether origins are vec3, relative to the scene's centre. Then "auto" traces all rays at once.
    """

    origins: wp.array
    directions: wp.array
    bundle: int
    shape: tuple[int, ...]
    t_max: float
    traversal: Any
    each: Mapping[str, Any]
    is_relative: bool = False

    def hits(self, scene: Scene | PointCloud, begin: int, end: int, shape: tuple[int, ...], **each: Any) -> DeviceHits:
        """The closest hits of the rays of some beams in a leading shape."""
        shape, rays = (*shape, *((self.bundle,) if self.bundle > 1 else ())), (begin * self.bundle, end * self.bundle)
        own = {n: part_of(v, *rays).reshape(shape) if isinstance(v, wp.array) else v for n, v in {**self.each, **each}.items()}
        if self.is_relative:
            state = scene.state
            given = self.origins, self.directions, self.t_max, shape, state.device, state.center
            query = QUERIES[CLOSEST]._replace(**own) if own else QUERIES[CLOSEST]
            return answer_relative(state, relative_rays(*given), query)
        origins = self.origins if self.origins.size == 1 else part_of(self.origins, *rays).reshape(shape)
        if not (isinstance(self.traversal, str) and self.traversal == AUTO):  # few options are checked in less time
            own["traversal"] = self.traversal
        directions = part_of(self.directions, *rays).reshape(shape)
        return scene.intersect(origins, directions, 0.0, self.t_max, **own).batch


def part_of(values: wp.array, begin: int, end: int) -> wp.array:
    """A part of a flat array; the array itself if that is all of it, for which Warp would make a new one."""
    return values if begin == 0 and end == len(values) else values[begin:end]


class TracedSlice(NamedTuple):
    """What describes the hits of the beams of a slice.

    Attributes:
        part: the slice.
        traced: the hits.
        uvs: makes the weights of the second and third vertex of the triangles that were hit; only some sensors need them.
        origins: of the rays, (1,) if all share it.
        mesh: the triangles as they were for these beams.
        surface: the hits and the triangles by which normals are known; of a cloud's points others than `traced` and `mesh`.
        motions: velocities of instances.
    """

    part: Slice
    traced: Traced
    uvs: Callable[[], wp.array]
    origins: wp.array
    mesh: SceneMesh
    surface: tuple[Traced, SceneMesh]
    motions: Motions


def trace_slices(scene: Scene | PointCloud, rays: SensorRays, bodies: Bodies, parts: Sequence[Slice]) -> Iterator[TracedSlice]:
    """Traces the rays of all slices.

    All at once, if there are several slices: time slices are environments then (`wrt.scene.sliced_state`). In a scene that has
    environments, or with more than `MAX_TOGETHER` instances in all slices, one slice after the other: the upper tree gets new
    boxes for each.

    Args:
        scene: is moved; a copy of the caller's scene.
        rays: all rays.
        bodies: the instances that move.
        parts: the slices.

    Raises:
        ValueError: options that a point cloud does not have.
    """
    from wrt.kernels.sensors.lidar_returns import Traced
    from wrt.scene.sliced_state import slice_mesh, sliced

    if scene.state.tangents is not None and (rays.each or rays.traversal != AUTO):
        raise ValueError("mask, environment and traversal are for a wrt.Scene; of a point cloud, leave them out")
    count, device, together, found = len(scene.state.instances), scene.device, False, None
    few = len(parts) * count <= MAX_TOGETHER
    if bodies.chosen and len(parts) > 1 and few and (scene.state.instances.environments < 0).all():
        together = rays.each.get("environment") is None
    if together:
        scene.state = sliced(scene.state, bodies.chosen, bodies.transforms)  # type: ignore[arg-type]
        lengths = [(part.end - part.begin) * rays.bundle for part in parts]
        numbers = wp.array(np.repeat(np.arange(len(parts), dtype=np.int32), lengths), dtype=int, device=device)
        shapes = {part.shape[1] if part.shape and len(part.shape) == 2 else 0 for part in parts}
        total, columns = parts[-1].end, shapes.pop() if len(shapes) == 1 else 0
        shape = (total // columns, columns) if columns else (total,)
        found = rays.hits(scene, 0, total, shape, environment=numbers)
    for number, part in enumerate(parts):
        own = part.begin * rays.bundle, part.end * rays.bundle
        if together:
            hits, within, mesh = found, own, slice_mesh(scene.state, number)  # type: ignore[arg-type]
        else:
            if bodies.chosen:
                scene.update(bodies.chosen, transform=bodies.transforms[number])  # type: ignore[call-arg]
            hits = rays.hits(scene, part.begin, part.end, part.shape or rays.shape)
            within, mesh = (0, hits.count), scene.state.device_mesh
        traced = blank(Traced)
        traced.place, traced.directions = part.begin, part_of(rays.directions, *own)
        if within == (0, hits.count):
            hits.point_to(traced, ("t", "primitive"))
        else:
            traced.t, traced.primitive = part_of(hits.t, *within), part_of(hits.primitive, *within)
        origins = rays.origins if rays.origins.size == 1 else part_of(rays.origins, *own)
        uvs = partial(uvs_of, hits, *within)
        surface = (traced, mesh) if scene.state.tangents is None else tangent_hits(traced, hits, scene.state.tangents)
        yield TracedSlice(part, traced, uvs, origins, mesh, surface, bodies.motions(number, count, device))


def tangent_hits(traced: Traced, hits: DeviceHits, tangents: Callable[[DeviceHits], Any]) -> tuple[Traced, SceneMesh]:
    """All hits of a cloud, as those of triangles (`SceneState.tangents`)."""
    from wrt.kernels.sensors.lidar_returns import Traced

    mesh, number, _ = tangents(hits)
    traced.primitive = hits.primitive  # for `wrt.sensors.lidar.reflect_by_point`
    other = Traced()
    other.place, other.directions, other.t, other.primitive = traced.place, traced.directions, hits.t, number
    return other, mesh


def uvs_of(hits: DeviceHits, begin: int, end: int) -> wp.array:
    """Weights of the second and third vertex, of a part of the hits."""
    return part_of(hits.uv, begin, end)


@cache
def no_motions() -> Motions:
    """Of instances that are all at rest."""
    from wrt.kernels.sensors.lidar_returns import Motions

    return Motions()


@lru_cache
def no_vectors(device: str, dtype: type = wp.vec3) -> wp.array:
    """(0,) vectors."""
    return wp.empty(0, dtype=dtype, device=device)


@lru_cache
def no_order(device: str) -> wp.array:
    """(0,) the order of rays that are traced in the order of their numbers."""
    return wp.empty(0, dtype=int, device=device)


LIMITS = {"mask": (0, (1 << 32) - 1, wp.uint32), "environment": (-1, (1 << 31) - 1, wp.int32)}
"""Least and greatest value, and type on the device, of what each sensor has."""


def for_each_ray(
    given: Mapping[str, Any], sensors: tuple[int, ...], beams: int, bundle: int, order: np.ndarray | None, device: wp.Device
) -> dict[str, Any]:
    """What callers gave for each sensor, for each ray: a number or a Warp array; what is None is left out.

    Args:
        given: by the name of the argument: None, a number, or integers that broadcast to the shape of the sensors. Warp arrays
            of that shape on the device, uint32 or int32, stay there, and their values are not checked.
        sensors: leading shape of the sensors.
        beams: of a sensor.
        bundle: rays of a beam.
        order: in which beams are traced.
        device: of the arrays.

    Raises:
        TypeError: not integers.
        ValueError: out of range, or another shape.
    """
    found: dict[str, Any] = {}
    for name, values in given.items():
        if values is None:
            continue
        minimum, maximum, dtype = LIMITS[name]
        if order is None and stays_on(device, values, dtype, sensors):
            found[name] = repeated(values, beams * bundle)
            continue
        refuse_host_values(name, values, dtype, device)
        array = as_real_array(name, values)
        if array.dtype.kind not in "iu":
            raise TypeError(f"{name} must hold integers, not {array.dtype}")
        if array.size and (array.min() < minimum or array.max() > maximum):
            raise ValueError(f"{name} must be from {minimum} to {maximum}, but ranges from {array.min()} to {array.max()}")
        if array.ndim == 0:
            found[name] = int(array)
            continue
        try:
            flat = np.broadcast_to(array, sensors).ravel()
        except ValueError:
            raise ValueError(
                f"{name} has the shape {array.shape}; pass one number, or one for each sensor, in the shape {sensors}"
            ) from None
        flat = flat.astype(np.uint32 if dtype is wp.uint32 else np.int32)
        if order is None:
            found[name] = repeated(wp.array(flat, dtype=dtype, device=device), beams * bundle)
        else:
            found[name] = wp.array(np.repeat(np.repeat(flat, beams)[order], bundle), dtype=dtype, device=device)
    return found


def labelled(scene: Scene | PointCloud) -> int:
    """Number of instances, or of meshes in a scene without instances; 1 for a cloud."""
    return max(len(scene.state.instances) or len(scene.meshes), 1)


def labels_on(labels: Any, scene: Scene | PointCloud) -> wp.array:
    """(I,) int32 on the scene's device, or (0,) for none; a Warp array of them there stays, and its values are not checked.

    Raises:
        TypeError: not integers.
        ValueError: another number of labels, or a negative one.
    """
    if labels is None:
        return no_order(scene.device.alias)
    count = labelled(scene)
    if stays_on(scene.device, labels, wp.int32, (count,)):
        return labels
    refuse_host_values("labels", labels, wp.int32, scene.device)
    values = as_real_array("labels", labels)
    if values.nbytes <= KEPT_BYTES:
        return _kept_labels(values.tobytes(), values.dtype.str, values.shape, count, scene.device.alias)
    return on_device(checked_labels(values, count), wp.int32, scene.device)


def checked_labels(values: np.ndarray, count: int) -> np.ndarray:
    """Labels as int32; errors as in `labels_on`."""
    if values.dtype.kind not in "iu":
        raise TypeError(f"labels must hold integers, not {values.dtype}")
    if values.shape != (count,) or values.min() < 0 or values.max() >= 1 << 31:
        raise ValueError(
            f"labels must be {count} numbers from 0 to 2**31 - 1, one for each instance, not {values.tolist()!r:.80}"
        )
    return values.astype(np.int32)


@lru_cache(maxsize=16)
def _kept_labels(data: bytes, kind: str, shape: tuple[int, ...], count: int, device: str) -> wp.array:
    """Labels of a few instances, whose check takes longer than to find them; kept for the next scan."""
    values = checked_labels(np.frombuffer(data, dtype=kind).reshape(shape), count)
    with kept(as_device(device)):
        return wp.array(values, dtype=wp.int32, device=device)


def as_motions(motions: Any, scene: Scene | PointCloud, begin: float, end: float) -> Mapping[int, Trajectory]:
    """Checked trajectories of instances over a time.

    Raises:
        TypeError: not a mapping from indices to trajectories.
        ValueError: no such instance, or a trajectory that does not cover the time.
    """
    if not motions:
        return {}
    if not isinstance(motions, Mapping):
        raise TypeError(f"motions must be a dict from indices of instances to trajectories, not {type(motions).__name__}")
    if not scene.state.instances:
        raise ValueError("motions need instances, and this scene has none; put moving meshes into wrt.Instance")
    for number, body in motions.items():
        check_index(number, len(scene.state.instances), "instance")
        if not isinstance(body, Trajectory):
            raise TypeError(f"motions[{number}] must be a wrt.sensors.Trajectory, not {type(body).__name__}")
        body.check_covers(begin, end, f"motions[{number}]: the times of the scan")
    return motions


def check_slices(slices: Any) -> int:
    """The number of slices.

    Raises:
        TypeError: it is not a whole number.
        ValueError: it is out of range.
    """
    return as_int("slices", slices, 1, MAX_SLICES)


def cut_slices(
    times: np.ndarray, span: tuple[float, float], start: float, slices: int
) -> tuple[np.ndarray | None, list[Slice]]:
    """The order in which rays are traced (None for that of their numbers), and the slices.

    Args:
        times: (...) seconds of each ray after `start`.
        span: the least and the greatest of them.
        start: time of the scan's start.
        slices: number of slices; those without a ray are left out.

    Raises:
        TypeError, ValueError: as `check_slices`.
    """
    slices = check_slices(slices)
    begin, duration = span[0], span[1] - span[0]
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


def slice_error(bodies: Mapping[int, Trajectory], scene: Scene | PointCloud, parts: Sequence[Slice]) -> float:
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
