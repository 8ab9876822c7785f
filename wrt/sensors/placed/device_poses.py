"""Poses of sensors that are on the scene's device, where they are read when kernels run: in a graph, at each launch."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.kernels.runtime.launch import launch, specialise
from wrt.kernels.validation import host_array
from wrt.meshes.instance import rotation_matrices
from wrt.sensors.trajectory import StillPoses, Trajectory, as_trajectory, quaternions

if TYPE_CHECKING:
    from wrt.kernels.sensors.pose_paths import PosePath

TRANSFORMS = (wp.transformf, wp.transformd)
"""Types of arrays of poses that stay where they are."""


class DevicePoses(StillPoses):
    """Poses of many sensors at rest in a Warp array. Kernels of a scan copy them, so that later changes are not seen.

    What host code checks of other poses is not checked: a sensor whose pose is not finite, or whose quaternion is 0, sees
    nothing.

    Args:
        given: (...) `wp.transform` or `wp.transformd`, with quaternions of any length.
        mount: (4, 4) rigid, from the sensor's frame to that of the poses; None if they are those of the sensor.

    Attributes:
        shape: the leading shape (...).
    """

    key = None  # type: ignore[assignment]  # poses are not known on the host, so rays are not kept

    def __init__(self, given: wp.array, mount: np.ndarray | None = None) -> None:
        self.given, self.mount, self.shape = given, mount, given.shape
        self._paths: dict[str, PosePath] = {}

    @cached_property
    def poses(self) -> np.ndarray:  # type: ignore[override]  # those of the base are given
        """(..., 4, 4) float64, copied from the device."""
        path, matrices = self.path(self.given.device), np.zeros((len(self), 4, 4))
        matrices[:, :3, :3], matrices[:, :3, 3] = rotation_matrices(path.rotations.numpy()), path.positions.numpy()
        matrices[:, 3, 3] = 1.0
        return matrices.reshape(*self.shape, 4, 4)

    def path(self, device: wp.Device) -> PosePath:
        """The poses for kernels on a device, as they are when the first of these calls is carried out.

        Raises:
            ValueError: they are on another device.
        """
        if device != self.given.device:
            raise ValueError(f"pose is on {self.given.device}, the scene on {device}; copy it there")
        if device.alias not in self._paths:
            self._paths[device.alias] = self._taken(device)
        return self._paths[device.alias]

    def _taken(self, device: wp.Device) -> PosePath:
        from wrt.kernels.sensors.pose_paths import PosePath, make_take_poses

        mount, path, flat = np.eye(4) if self.mount is None else self.mount, PosePath(), self.given.flatten()
        path.positions = wp.empty(flat.size, dtype=wp.vec3d, device=device)
        path.rotations = wp.empty(flat.size, dtype=wp.quatd, device=device)
        path.times = wp.empty(1, dtype=wp.float64, device=device)
        inputs = [flat, wp.vec3d(*mount[:3, 3].tolist()), wp.quatd(*quaternions(mount[None, :3, :3])[0].tolist()), path]
        launch(specialise(make_take_poses, flat.dtype), flat.size, inputs, device=device, chunk=1024)
        return path

    def on(self, mount: np.ndarray) -> DevicePoses:
        """Those of a sensor that is mounted on bodies with these poses."""
        return DevicePoses(self.given, mount if self.mount is None else self.mount @ mount)

    def __reduce__(self) -> tuple[Any, ...]:
        return StillPoses, (self.poses,)


def as_poses(pose: Any, device: wp.Device | None = None) -> Trajectory | StillPoses:
    """The poses of a sensor, or of many, in a scene on a device (None if that is not known).

    Raises:
        TypeError, ValueError: as `as_trajectory` and `StillPoses`; an empty Warp array.
    """
    if isinstance(pose, wp.array) and pose.dtype in TRANSFORMS:
        if not pose.size:
            raise ValueError(f"pose has the shape {pose.shape}; pass at least one transform")
        return DevicePoses(pose)
    if isinstance(pose, DevicePoses):
        return pose
    pose = pose if isinstance(pose, Trajectory) else host_array("pose", pose)
    return StillPoses(pose, device) if isinstance(pose, np.ndarray) and pose.ndim > 2 else as_trajectory(pose)
