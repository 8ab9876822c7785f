"""The solids that the built-in scenes are assembled from.

Most are sheets: lattices of points, rows by columns, whose quads are split into two triangles. A curved patch, the side of
a tube, a surface of revolution and a plane are sheets. N sheets are one array with one more axis, so that ten thousand
branches need no Python loop.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from wrt.kernels.validation import as_float, as_int
from wrt.meshes.mesh import TriangleMesh

__all__ = ["boxes", "check_count", "check_positive", "copies", "lathe", "plane", "sheets", "without_collapsed"]


def check_count(name: str, value: Any, minimum: int = 1, maximum: int = 2**31 - 1) -> int:
    """Returns a whole number from `minimum` to `maximum`, or raises a TypeError or ValueError that names the argument."""
    value = as_int(name, value, minimum)
    if value > maximum:
        raise ValueError(f"{name} is {value}; it must be at most {maximum}")
    return value


def check_positive(name: str, value: Any, maximum: float = np.inf) -> float:
    """Returns a finite number in (0, maximum], or raises a ValueError that names the argument."""
    value = as_float(name, value)
    if not (0.0 < value <= maximum and np.isfinite(value)):
        limit = f" and at most {maximum:g}" if np.isfinite(maximum) else ""
        raise ValueError(f"{name} must be positive{limit}, got {value!r}")
    return value


def sheets(points: np.ndarray) -> TriangleMesh:
    """Triangulates lattices of points.

    Args:
        points: (..., R, C, 3) lattices of R x C points; leading axes are separate sheets.

    Returns:
        2 (R - 1) (C - 1) triangles for each sheet. Normals point along (next row) x (next column).
    """
    rows, columns = points.shape[-3:-1]
    corner = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]
    one_sheet = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    vertices = points.reshape(-1, 3)
    starts = np.arange(0, len(vertices), rows * columns)
    return TriangleMesh(vertices, (one_sheet + starts[:, None, None]).reshape(-1, 3))


def plane(low: tuple[float, float], high: tuple[float, float], z: float = 0.0, cells: int = 1) -> TriangleMesh:
    """A horizontal rectangle of cells x cells quads that faces up."""
    x, y = (np.linspace(low[axis], high[axis], cells + 1) for axis in (0, 1))
    grid_x, grid_y = np.meshgrid(x, y, indexing="ij")
    return sheets(np.stack([grid_x, grid_y, np.full_like(grid_x, z)], axis=-1))


def boxes(low: ArrayLike, high: ArrayLike) -> TriangleMesh:
    """Closed axis-parallel boxes, 12 triangles each; (3,) or (N, 3) lowest and highest corners."""
    low, high = np.broadcast_arrays(np.atleast_2d(low).astype(float), np.atleast_2d(high).astype(float))
    bits = (np.arange(8)[:, None] >> np.arange(3)) & 1  # corner i: high x if bit 0 is set, high y if bit 1, ...
    vertices = np.where(bits == 1, high[:, None, :], low[:, None, :]).reshape(-1, 3)
    quads = np.array([[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]])
    faces = quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    return TriangleMesh(vertices, (faces + 8 * np.arange(len(low))[:, None, None]).reshape(-1, 3))


def lathe(profile: Any, segments: int) -> TriangleMesh:
    """The surface of revolution of a profile about the z axis.

    Args:
        profile: (R, 2) radius and height; from bottom to top for normals that point outward.
        segments: corners of the circle, >= 3.
    """
    radius, height = np.asarray(profile, dtype=float).T
    angle = np.linspace(0.0, 2.0 * np.pi, segments + 1)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    circle[-1] = circle[0]
    points = np.empty((len(radius), segments + 1, 3))
    points[..., :2] = radius[:, None, None] * circle
    points[..., 2] = height[:, None]
    return without_collapsed(sheets(points[:, ::-1]).welded())


def copies(mesh: TriangleMesh, offsets: Any) -> TriangleMesh:
    """Copies of the mesh at each of the (N, 3) offsets."""
    offsets = np.atleast_2d(offsets)
    vertices = (mesh.vertices + offsets[:, None, :]).reshape(-1, 3)
    starts = mesh.vertex_count * np.arange(len(offsets))
    return TriangleMesh(vertices, (mesh.faces + starts[:, None, None]).reshape(-1, 3))


def with_caps(mesh: TriangleMesh) -> TriangleMesh:
    """The mesh with a fan of triangles in each of its holes, around the mean of the corners at the rim.

    mesh: with welded vertices, no two of whose holes share a vertex.
    """
    edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]]).tolist()
    known = {(a, b) for a, b in edges}
    after = {b: a for a, b in known if (b, a) not in known}  # a fan runs along the rim in the other direction
    points, fans = [], []
    while after:
        rim = [next(iter(after))]
        while (corner := after.pop(rim[-1])) != rim[0]:
            rim.append(corner)
        center = mesh.vertex_count + len(points)
        points.append(mesh.vertices[rim].mean(axis=0))
        fans += [(center, a, b) for a, b in zip(rim, [*rim[1:], rim[0]], strict=True)]
    return TriangleMesh(np.concatenate([mesh.vertices, points]), np.concatenate([mesh.faces, fans]), name=mesh.name)


def without_collapsed(mesh: TriangleMesh) -> TriangleMesh:
    """Drops triangles without area, as where a side of a sheet shrinks to a point."""
    return TriangleMesh(mesh.vertices, mesh.faces[mesh.face_normals.any(axis=1)], name=mesh.name)
