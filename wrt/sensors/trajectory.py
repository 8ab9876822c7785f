"""Trajectories: poses of sensors and bodies over time."""

from __future__ import annotations

from functools import cached_property
from math import sqrt
from typing import TYPE_CHECKING, Any, TypeAlias, overload

import numpy as np
import warp as wp

from wrt.engine.memory import keep_alive
from wrt.engine.rays.rays import as_vectors
from wrt.kernels.runtime.argument_packing import blank
from wrt.kernels.runtime.launch import as_device, launch, refuse_capture
from wrt.kernels.validation import first_bad
from wrt.meshes.instance import rotation_matrices
from wrt.sensors.checks import SAME_STRETCH, as_time, check_matrix, check_real, is_rigid

if TYPE_CHECKING:
    from wrt.array_types import ArrayLike, Numbers, NumpyLike
    from wrt.kernels.sensors.pose_paths import PosePath

IDENTITY = np.eye(3)
IDENTITY.setflags(write=False)

MIN_BY_KERNEL = 128
"""Sensors in a scene on the CPU from which a kernel reads their matrices; NumPy has one thread."""

Pose: TypeAlias = "ArrayLike | Trajectory"
"""Where a sensor is: at rest, many at rest, or over time."""


class Trajectory:
    """Poses at given times. Between them, positions are interpolated linearly and rotations by slerp.

        path = wrt.sensors.Trajectory([0.0, 0.1], [[0, 0, 1.8], [1, 0, 1.8]])  # 10 m/s along x

    A pose maps the moving frame to the world: p -> rotation p + position.

    Args:
        times: (K,) seconds, ascending, K >= 1. A trajectory of one pose is at rest at all times.
        positions: (K, 3).
        rotations: (K, 4) quaternions x, y, z, w, of any length but 0; None for none. Between two keys, the shorter way is
            taken.
        stretch: (3, 3) scale and shear of a body, applied before the rotation; None for none. A sensor has none.

    Attributes:
        times: (K,) float64, read-only.
        positions: (K, 3) float64, read-only.
        rotations: (K, 4) float64 unit quaternions, read-only.
        stretch: (3, 3) float64, read-only.

    Raises:
        TypeError: an argument does not hold real numbers.
        ValueError: wrong shapes, numbers that are not finite, times that do not ascend, or a quaternion of length 0.
    """

    def __init__(
        self, times: ArrayLike, positions: ArrayLike, rotations: ArrayLike | None = None, *, stretch: ArrayLike | None = None
    ) -> None:
        self.times = check_real("times", times, (None,))
        count = len(self.times)
        if count == 0:
            raise ValueError("times is empty; pass at least one time")
        if bad := first_bad(np.diff(self.times, prepend=-np.inf) <= 0.0, self.times):
            raise ValueError(f"times must ascend, but times{bad}; sort the poses by time and leave doubles out")
        self.positions = check_real("positions", positions, (count, 3))
        given = (
            np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)) if rotations is None else check_real("rotations", rotations, (count, 4))
        )
        lengths = np.linalg.norm(given, axis=1, keepdims=True)
        if bad := first_bad(lengths[:, 0] == 0.0, given):
            raise ValueError(f"rotations{bad}, a quaternion of length 0; the one without a rotation is (0, 0, 0, 1)")
        unit = given / lengths
        flips = np.where((unit[1:] * unit[:-1]).sum(axis=1) < 0.0, -1.0, 1.0)
        unit[1:] *= np.cumprod(flips)[:, None]
        self.rotations = unit
        self.stretch = np.eye(3) if stretch is None else check_real("stretch", stretch, (3, 3))
        for array in (self.times, self.positions, self.rotations, self.stretch):
            array.setflags(write=False)
        self._paths: dict[str, PosePath] = {}

    def __repr__(self) -> str:
        return f"Trajectory({len(self.times)} poses, {self.times[0]:g} to {self.times[-1]:g} s)"

    @classmethod
    def from_matrices(cls, times: ArrayLike, matrices: ArrayLike) -> Trajectory:
        """A trajectory through (K, 4, 4) poses or transforms of a body, such as those of `wrt.Instance`.

        Args:
            times: (K,) seconds, ascending.
            matrices: (K, 4, 4) affine maps that differ in rotation and translation only: scale, shear and mirroring are the
                same in all of them.

        Raises:
            TypeError, ValueError: as the class; a matrix that is singular or not affine; matrices of different scale.
        """
        matrices = check_real("matrices", matrices, (None, 4, 4))
        for matrix in matrices:
            check_matrix("matrices", matrix)
        linear = matrices[:, :3, :3]
        left, _, right = np.linalg.svd(linear)
        sign = np.sign(np.linalg.det(left @ right))
        left[:, :, 2] *= sign[:, None]
        turns = left @ right
        stretches = np.swapaxes(turns, 1, 2) @ linear
        if len(matrices) and not np.abs(stretches - stretches[0]).max() <= SAME_STRETCH * np.abs(stretches[0]).max():
            raise ValueError("matrices have different scales or shears; a body on a trajectory is moved and turned only")
        rigid = len(matrices) == 0 or np.abs(stretches[0] - np.eye(3)).max() <= SAME_STRETCH
        return cls(times, matrices[:, :3, 3], quaternions(turns), stretch=None if rigid else stretches[0])

    @classmethod
    def at_rest(cls, matrix: np.ndarray, rows: list[list[float]]) -> Trajectory:
        """The trajectory at rest at a pose, which was checked (`is_rigid`); rows: the numbers of the matrix (4, 4)."""
        path = object.__new__(cls)
        path.times, path.positions, path.rotations = np.zeros(1), matrix[None, :3, 3].copy(), np.array([quaternion(rows)])
        path.stretch, path._paths = IDENTITY, {}
        for array in (path.times, path.positions, path.rotations):
            array.setflags(write=False)
        return path

    @property
    def is_rigid(self) -> bool:
        """Whether poses only move and turn."""
        return self.stretch is IDENTITY or bool((self.stretch == IDENTITY).all())

    @property
    def is_still(self) -> bool:
        """Whether there is one pose only."""
        return len(self.times) == 1

    @cached_property
    def key(self) -> bytes:
        """Of the poses, if they are at rest: equal for equal poses only."""
        return self.positions.tobytes() + self.rotations.tobytes()

    @cached_property
    def matrices(self) -> np.ndarray:
        """(K, 4, 4) float64, the transforms at the times of the keys."""
        return self._matrices(self.positions, self.rotations)

    def at(self, times: Numbers) -> np.ndarray:
        """The transforms at some times: (..., 4, 4) float64, from the moving frame, stretch included, to the world.

        Args:
            times: (...) seconds.

        Raises:
            TypeError: times are not real numbers.
            ValueError: a time beyond the trajectory.
        """
        times = check_real("times", times)
        self.check_covers(times.min(initial=np.inf), times.max(initial=-np.inf))
        positions, rotations, _, _ = self._evaluate(times.ravel())
        return self._matrices(positions, rotations).reshape(*times.shape, 4, 4)

    def velocities(self, times: Numbers) -> tuple[np.ndarray, np.ndarray]:
        """Velocity of the frame's origin and angular velocity, both (..., 3) float64 in the world, a second.

        Args:
            times: (...) seconds. At a key, that after the key; at the last one, that before.

        Raises:
            TypeError, ValueError: as `at`.
        """
        times = check_real("times", times)
        self.check_covers(times.min(initial=np.inf), times.max(initial=-np.inf))
        found = self._evaluate(times.ravel())[2:]
        return tuple(values.reshape(*times.shape, 3) for values in found)  # type: ignore[return-value]

    def states(self, times: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        """What `at` and `velocities` give, at (N,) times that the trajectory covers."""
        positions, rotations, *velocities = self._evaluate(times)
        return self._matrices(positions, rotations), velocities

    def check_covers(self, begin: float, end: float, what: str = "times") -> None:
        """Refuses times beyond the keys.

        Args:
            begin, end: earliest and latest time.
            what: whose times they are, for the message.

        Raises:
            ValueError: a time is beyond the keys, and there are several.
        """
        slack = 1e-9 * max(1.0, abs(self.times[0]), abs(self.times[-1]))
        if not self.is_still and begin <= end and (begin < self.times[0] - slack or end > self.times[-1] + slack):
            raise ValueError(
                f"{what} are {begin:g} to {end:g} s, but the trajectory has poses from {self.times[0]:g} to "
                f"{self.times[-1]:g} s; add poses, or choose another time"
            )

    def path(self, device: wp.Device) -> PosePath:
        """The poses for kernels on a device; copied once."""
        if device.alias not in self._paths:
            if self.is_still:
                from wrt.kernels.sensors.pose_paths import PosePath

                path = blank(PosePath)
                path.position, path.rotation = wp.vec3d(*self.positions[0].tolist()), wp.quatd(*self.rotations[0].tolist())
            else:
                path = pose_path(self.times, self.positions, self.rotations, device)
            self._paths[device.alias] = path
        return self._paths[device.alias]

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickles hold the poses only."""
        return _unpickled, (self.times, self.positions, self.rotations, self.stretch)

    def _evaluate(self, times: np.ndarray) -> list[np.ndarray]:
        from wrt.kernels.sensors.pose_paths import poses_at

        device = wp.get_device("cpu")
        refuse_capture("evaluating a trajectory", device)
        times = np.clip(times, self.times[0], self.times[-1])  # rounding at the ends
        wanted = wp.array(times, dtype=wp.float64, device=device)
        types = (wp.vec3d, wp.quatd, wp.vec3d, wp.vec3d)
        found = [wp.empty(len(times), dtype=dtype, device=device) for dtype in types]
        launch(poses_at, len(times), [self.path(device), wanted, *found], device=device, chunk=4096)
        return [values.numpy() for values in found]

    def _matrices(self, positions: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        matrices = np.zeros((len(positions), 4, 4))
        matrices[:, :3, :3] = rotation_matrices(rotations) @ self.stretch
        matrices[:, :3, 3], matrices[:, 3, 3] = positions, 1.0
        return matrices


def _unpickled(times: np.ndarray, positions: np.ndarray, rotations: np.ndarray, stretch: np.ndarray) -> Trajectory:
    return Trajectory(times, positions, rotations, stretch=stretch)


class StillPoses:
    """Poses of many sensors at rest, which measure in one call.

    Args:
        poses: (..., 4, 4) real numbers.
        device: of the scene; None if it is not known.

    Attributes:
        poses: (..., 4, 4) float64, from each sensor's frame to the world.
        shape: their leading shape.

    Raises:
        TypeError, ValueError: not such matrices, or one that does more than move and turn.
    """

    is_still = True

    def __init__(self, poses: Any, device: wp.Device | None = None) -> None:
        self.poses = check_real("pose", poses)
        if self.poses.ndim < 3 or self.poses.shape[-2:] != (4, 4) or not self.poses.size:
            raise ValueError(f"pose must be one matrix (4, 4) or many of them, (..., 4, 4), not of shape {self.poses.shape}")
        self.shape = self.poses.shape[:-2]
        self._paths: dict[str, PosePath] = {}
        if device is None or not device.is_cpu or device.is_capturing or len(self) < MIN_BY_KERNEL:
            rigid = are_rigid(self.poses)
        else:
            rigid, self._paths[device.alias] = taken(self.poses, device)
        if not rigid.all():
            raise ValueError(f"pose {int(rigid.argmin())} does more than move and turn; sensors have no scale")

    def __reduce__(self) -> tuple[Any, ...]:
        return StillPoses, (self.poses,)  # without what is kept for a device

    def __len__(self) -> int:
        """Number of sensors."""
        return int(np.prod(self.shape))

    @cached_property
    def key(self) -> bytes:
        """Of the poses: equal for equal poses only."""
        return self.poses.tobytes()

    def check_covers(self, begin: float, end: float, what: str = "times") -> None:
        """Poses at rest cover all times."""

    def path(self, device: wp.Device) -> PosePath:
        """The poses for kernels on a device; copied once."""
        flat, known = self.poses.reshape(-1, 4, 4), self._paths
        if device.alias not in known:
            known[device.alias] = pose_path(np.zeros(1), flat[:, :3, 3], quaternions(flat[:, :3, :3]), device)
        return known[device.alias]


def are_rigid(poses: np.ndarray) -> np.ndarray:
    """(N,) whether each of (..., 4, 4) finite matrices moves and turns only, up to rounding."""
    rows = np.ascontiguousarray(poses.reshape(-1, 16).T).reshape(4, 4, -1)  # long rows are computed faster
    x, y, z = rows[:3, :3]
    rigid = (rows[3] == np.array([[0.0], [0.0], [0.0], [1.0]])).all(axis=0)
    for one, other, wanted in ((x, x, 1.0), (y, y, 1.0), (z, z, 1.0), (x, y, 0.0), (x, z, 0.0), (y, z, 0.0)):
        rigid &= np.abs((one * other).sum(axis=0) - wanted) <= 1e-6
    return rigid & ((x * np.cross(y, z, axis=0)).sum(axis=0) > 0.0)


def taken(poses: np.ndarray, cpu: wp.Device) -> tuple[np.ndarray, PosePath]:
    """`are_rigid` of (..., 4, 4) matrices, and the poses for kernels on the CPU: by a kernel, the same numbers."""
    from wrt.kernels.sensors.pose_paths import PosePath, take_matrices

    given, path = wp.array(poses.reshape(-1, 4, 4), dtype=wp.mat44d, device=cpu, copy=False), PosePath()
    rigid, path.times = np.empty(len(given), dtype=bool), wp.zeros(1, dtype=wp.float64, device=cpu)
    path.positions, path.rotations = (wp.empty(len(given), dtype=dtype, device=cpu) for dtype in (wp.vec3d, wp.quatd))
    launch(take_matrices, len(given), [given, path, wp.array(rigid, dtype=wp.bool, device=cpu, copy=False)], device=cpu)
    return rigid, path


def pose_path(times: np.ndarray, positions: np.ndarray, rotations: np.ndarray, device: wp.Device) -> PosePath:
    """Poses for kernels: one array, and so one copy to the device."""
    from wrt.kernels.sensors.pose_paths import PosePath

    parts = [np.ravel(values) for values in (rotations, positions, times)]
    block, path, begin = wp.array(np.concatenate(parts), dtype=wp.float64, device=device), PosePath(), 0
    for name, dtype, values in zip(("rotations", "positions", "times"), (wp.quatd, wp.vec3d, wp.float64), parts, strict=True):
        count = len(values) * 8 // wp.types.type_size_in_bytes(dtype)
        view = wp.array(ptr=block.ptr + 8 * begin, dtype=dtype, shape=count, device=device)
        setattr(path, name, keep_alive(view, block))
        begin += len(values)
    return path


def as_trajectory(pose: Any, name: str = "pose") -> Trajectory:
    """The trajectory of a sensor: as given, or at rest at a (4, 4) pose.

    Raises:
        TypeError, ValueError: neither a trajectory nor a rigid pose.
    """
    if not isinstance(pose, Trajectory):
        matrix = check_real(name, pose, (4, 4))
        rows = matrix.tolist()
        if is_rigid(rows):
            return Trajectory.at_rest(matrix, rows)
        pose = Trajectory.from_matrices([0.0], matrix[None])
    if not pose.is_rigid:
        raise ValueError(
            f"{name} must move and turn the sensor only, without scale, shear or mirroring, not by {pose.stretch.tolist()}"
        )
    return pose


@overload
def deskew(points: NumpyLike, times: Numbers, trajectory: Trajectory | StillPoses, time: float) -> np.ndarray: ...
@overload
def deskew(points: wp.array, times: Numbers, trajectory: Trajectory | StillPoses, time: float) -> wp.array: ...
def deskew(points: Any, times: Numbers, trajectory: Trajectory | StillPoses, time: float) -> Any:
    """Points that were measured one after the other, as if the sensor had measured all of them at one time.

    Each point is transformed to the world by the sensor's pose at its own time, and from there to the sensor's frame at `time`.

    Args:
        points: (..., 3) in the sensor's frame, each at its own time; NaN stays NaN.
        times: (...) seconds on the trajectory's clock; the shape broadcasts to that of the points.
        trajectory: of the sensor, as known or as estimated.
        time: the one time.

    Returns:
        (..., 3) float64: a NumPy array, or a Warp array of vec3d if the points were one.

    Raises:
        TypeError, ValueError: an argument of a wrong type or shape, or a time beyond the trajectory.
    """
    from wrt.kernels.sensors.pose_paths import points_to_frame, points_to_world

    device = points.device if isinstance(points, wp.array) else as_device("cpu")
    refuse_capture("deskew", device)
    time = as_time(time)
    is_warp, points = isinstance(points, wp.array), as_vectors(points, "points", device)
    shape = points.shape if is_warp else points.shape[:-1]
    wanted = check_real("times", times.numpy() if isinstance(times, wp.array) else times)
    wanted = np.ascontiguousarray(np.broadcast_to(wanted, shape)).ravel()
    earliest, latest = wanted.min(initial=time), wanted.max(initial=time)
    trajectory.check_covers(float(earliest), float(latest))
    flat = points.flatten() if is_warp else wp.array(points.reshape(-1, 3), dtype=wp.vec3d, device=device)
    if flat.dtype is not wp.vec3d:
        narrow, flat = flat, wp.empty(len(flat), dtype=wp.vec3d, device=device)
        wp.utils.array_cast(narrow, flat)
    moved, path = wp.empty_like(flat), trajectory.path(device)
    launch(points_to_world, len(flat), [path, wp.array(wanted, dtype=wp.float64, device=device), flat, moved], device=device)
    out = wp.empty_like(flat)
    launch(points_to_frame, len(flat), [path, wp.float64(time), moved, out], device=device)
    return out.reshape(shape) if is_warp else out.numpy().reshape(*shape, 3)


def quaternion(rows: list[list[float]]) -> list[float]:
    """One of `quaternions`, the same numbers, of a matrix whose linear part is a rotation."""
    trace = rows[0][0] + rows[1][1] + rows[2][2]
    squares = [rows[0][0], rows[1][1], rows[2][2], trace]
    largest = squares.index(max(squares))
    if largest == 3:
        found = [rows[2][1] - rows[1][2], rows[0][2] - rows[2][0], rows[1][0] - rows[0][1], 1.0 + trace]
    else:
        i, j, k = largest, (largest + 1) % 3, (largest + 2) % 3
        found = [0.0, 0.0, 0.0, rows[k][j] - rows[j][k]]
        found[i] = 1.0 + rows[i][i] - rows[j][j] - rows[k][k]
        found[j], found[k] = rows[j][i] + rows[i][j], rows[k][i] + rows[i][k]
    x, y, z, w = found
    length = sqrt(x * x + y * y + z * z + w * w)
    return [x / length, y / length, z / length, w / length]


def quaternions(rotations: np.ndarray) -> np.ndarray:
    """(K, 4) unit quaternions x, y, z, w of (K, 3, 3) rotation matrices.

    The largest of the four components is computed first, from the diagonal, so that nothing small is divided by.
    """
    trace = np.trace(rotations, axis1=1, axis2=2)
    squares = np.concatenate([np.diagonal(rotations, axis1=1, axis2=2), trace[:, None]], axis=1)
    found = np.empty((len(rotations), 4))
    largest = squares.argmax(axis=1)
    for i in range(4):
        rows = np.flatnonzero(largest == i)
        matrix = np.moveaxis(rotations[rows], 0, 2)
        if i == 3:
            turned = matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]
            found[rows] = np.stack([*turned, 1.0 + trace[rows]], axis=1)
        else:
            j, k = (i + 1) % 3, (i + 2) % 3
            found[rows, i] = 1.0 + matrix[i, i] - matrix[j, j] - matrix[k, k]
            found[rows, j], found[rows, k] = matrix[j, i] + matrix[i, j], matrix[k, i] + matrix[i, k]
            found[rows, 3] = matrix[k, j] - matrix[j, k]
    return found / np.linalg.norm(found, axis=1, keepdims=True)
