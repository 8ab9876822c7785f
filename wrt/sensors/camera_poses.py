"""Poses of cameras, (4, 4) from the optical frame (x to the right, y down, z forward) to the world, from other conventions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from wrt.imaging.view_frames import check_pose
from wrt.sensors.checks import check_matrix, check_real

if TYPE_CHECKING:
    from wrt.array_types import ArrayLike

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
"""From the optical frame to OpenGL's, whose y points up and whose z points backward; and back."""


def pose_from_opengl(pose: ArrayLike) -> np.ndarray:
    """The pose of a camera of OpenGL, glTF, trimesh or Blender, which looks along -z, with y up.

        images = camera.capture(scene, wrt.sensors.pose_from_opengl(np.array(blender_camera.matrix_world)))

    Args:
        pose: (4, 4) from the camera to the world, without scale: the inverse of a view matrix, `matrix_world` in Blender.

    Returns:
        (4, 4) float64, from the optical frame to the world.

    Raises:
        TypeError, ValueError: not such a matrix.
    """
    return check_pose("pose", pose) @ FLIP


def pose_from_extrinsics(extrinsics: ArrayLike) -> np.ndarray:
    """The pose of a camera, from its optical frame to the world, of OpenCV's extrinsics, which map the world to that frame.

    Args:
        extrinsics: (4, 4), or (3, 4) without the last row.

    Returns:
        (4, 4) float64.

    Raises:
        TypeError, ValueError: not such a matrix.
    """
    matrix = check_real("extrinsics", extrinsics)
    if matrix.shape == (3, 4):
        matrix = np.vstack([matrix, [0.0, 0.0, 0.0, 1.0]])
    check_matrix("extrinsics", check_real("extrinsics", matrix, (4, 4)))
    return np.linalg.inv(matrix)


def _no_view(forward: np.ndarray, up: np.ndarray) -> str:
    """Why there is no pose, and what to do."""
    if not forward.any():
        return "there is no view: position and target are the same point; move one of them"
    if not up.any():
        return "up is zero; pass the direction that points up in the image, such as up=(0, 0, 1)"
    other = "(0, 1, 0)" if abs(forward[1]) < 0.9 * np.linalg.norm(forward) else "(1, 0, 0)"
    return f"up is parallel to the view, as for a camera that looks straight down; pass another direction, such as up={other}"


def look_at(position: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 0.0, 1.0)) -> np.ndarray:
    """The pose of a camera's optical frame at a position, with the target on its axis.

    Args:
        position, target: (3,) points in the world.
        up: (3,) the direction that points up in the image. A camera that looks straight down or up needs another one than z,
            such as (0, 1, 0), for north at the top of a map.

    Returns:
        (4, 4) float64.

    Raises:
        TypeError, ValueError: wrong shapes, the same point twice, or `up` parallel to the view.
    """
    position, target, up = (check_real(name, v, (3,)) for name, v in (("position", position), ("target", target), ("up", up)))
    forward = target - position
    right = np.cross(forward, up)
    if np.linalg.norm(right) <= 1e-9 * np.linalg.norm(forward) * np.linalg.norm(up):
        raise ValueError(_no_view(forward, up))
    forward, right = forward / np.linalg.norm(forward), right / np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = right, np.cross(forward, right), forward, position
    return pose
