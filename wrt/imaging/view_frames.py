"""Frames of cameras: axes from directions, poses that callers pass, and the view that shows all of a mesh."""

from __future__ import annotations

from typing import Any

import numpy as np

from wrt.kernels.validation import as_numbers

_SINE_OF_PARALLEL = 1e-6
FRAMED, CELLS = 100_000, 64
"""Points of a cloud from which a camera frames cells in their place, and cells along an axis."""

_RIGID = 1e-4
"""By how much products of axes may differ from 1 and 0: poses in files are float32, or text of few digits."""


def check_pose(name: str, pose: Any) -> np.ndarray:
    """Returns a rigid (4, 4) float64; raises a TypeError or ValueError that names the argument otherwise."""
    matrix = as_numbers(name, pose, (4, 4))
    turn = matrix[:3, :3]
    if not np.array_equal(matrix[3], [0.0, 0.0, 0.0, 1.0]):
        raise ValueError(f"{name} has the last row {matrix[3].tolist()}; it must be [0, 0, 0, 1]: was it transposed?")
    if np.abs(turn.T @ turn - np.eye(3)).max() > _RIGID or np.linalg.det(turn) < 0.0:
        raise ValueError(f"{name} must rotate and move the camera only, without scale, shear or mirroring")
    return matrix


def frame_of(sight: np.ndarray, up: np.ndarray) -> tuple[np.ndarray, ...]:
    """Unit vectors forward, right and up of a camera with this viewing direction."""
    length = np.linalg.norm(sight)
    if length == 0.0:
        raise ValueError(
            "there is no viewing direction: position and look_at are the same point, or towards is zero; change one"
        )
    forward = sight / length
    right = np.cross(forward, _unit_up(up))
    sine = np.linalg.norm(right)
    if sine < _SINE_OF_PARALLEL:
        other = "(0, 1, 0)" if abs(forward[1]) < 0.9 else "(0, 0, 1)"
        raise ValueError(f"up is parallel to the viewing direction; choose another direction, such as {other}")
    right /= sine
    return forward, right, np.cross(right, forward)


def _unit_up(up: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(up)
    if length == 0.0:
        raise ValueError("up is zero; give a direction, such as (0, 0, 1)")
    return up / length


def default_view(up: np.ndarray) -> np.ndarray:
    """Viewing direction from the front, slightly from the right and above."""
    upward = _unit_up(up)
    front = np.array([0.0, -1.0, 0.0]) if abs(upward[1]) < 0.9 else np.array([0.0, 0.0, np.sign(upward[1])])
    front = front - (front @ upward) * upward
    front /= np.linalg.norm(front)
    right = np.cross(upward, front)
    return -(0.85 * front + 0.4 * right + 0.4 * upward)


def corners_of(geometry: Any) -> tuple[np.ndarray, np.ndarray]:
    """Vertices of all triangles, or corners of boxes around points, relative to the centre of their bounding box, and that
    centre."""
    if is_cloud(geometry):
        points, center, radius, _ = geometry.state.arrays()
        return _box_corners(points.astype(np.float64), radius if radius.ndim == 2 else radius[:, None]), center
    meshes = getattr(geometry, "meshes", (geometry,))
    if not all(hasattr(mesh, "vertices") and hasattr(mesh, "faces") for mesh in meshes):
        raise TypeError(f"geometry must be a wrt.TriangleMesh or a wrt.Scene, or a point cloud, not {type(geometry).__name__}")
    points = []
    for mesh in meshes:
        used = np.zeros(len(mesh.vertices), dtype=bool)
        used[mesh.faces] = True
        points.append(np.asarray(mesh.vertices[used], dtype=np.float64))
    joined = np.concatenate(points)
    center = joined.min(axis=0) / 2 + joined.max(axis=0) / 2
    return joined - center, center


def _box_corners(points: np.ndarray, half: np.ndarray) -> np.ndarray:
    """(M, 3) corners of boxes around (N, 3) points, half of whose edges are given.

    Of many points, those of the cells of a grid that have some, as much wider as the widest box.
    """
    if len(points) > FRAMED:
        low, size = points.min(axis=0), np.maximum(np.ptp(points, axis=0), 1e-30) / CELLS
        used, cells = np.zeros((CELLS,) * 3, dtype=bool), np.minimum((points - low) / size, CELLS - 1).astype(int)
        used[tuple(cells.T)] = True
        points, half = low + (np.argwhere(used) + 0.5) * size, half.max(axis=0) + 0.5 * size
    signs = np.stack(np.meshgrid([-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0]), axis=-1).reshape(-1, 3)
    return np.concatenate([points + sign * half for sign in signs])


def is_cloud(geometry: Any) -> bool:
    """Whether it is a `wrt.sensors.PointCloud`."""
    return getattr(getattr(geometry, "state", None), "tangents", None) is not None


def nearest_view(points: np.ndarray, axes: tuple[np.ndarray, ...], tangents: tuple[float, float]) -> np.ndarray:
    """The nearest position from which all points are inside the image, with equal margins on opposite sides.

    A point at (x, y, depth z) is inside the right edge of a camera at (x0, y0, z0) if x - x0 <= tangent (z - z0), and so
    on: each edge bounds x0 or y0, and z0, by the extreme of x -+ tangent z over the points.
    """
    depth = points @ axes[2]
    across, back = [], []
    for axis, tangent in zip(axes[:2], tangents, strict=True):
        along = points @ axis
        high, low = (along - tangent * depth).max(), (-along - tangent * depth).max()
        across.append((high - low) / 2)
        back.append(-(high + low) / (2 * tangent))
    nearest = depth.min() - 1e-3 * max(np.ptp(points, axis=0).max(), np.finfo(np.float64).tiny)
    return across[0] * axes[0] + across[1] * axes[1] + min(*back, nearest) * axes[2]
