"""Meshes whose vertices were moved on a CUDA device, and are copied to the host only when something there asks for them."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import warp as wp

from wrt.builders.triangle_boxes import corner_bounds
from wrt.engine.rays.rays import as_vectors
from wrt.kernels.layout.mesh_placement import make_shift
from wrt.kernels.query.hit_attributes import SceneMesh
from wrt.kernels.runtime.launch import launch, specialise
from wrt.meshes.mesh import TriangleMesh
from wrt.meshes.mesh_arrays import frozen

CUDA = 2
"""The number of CUDA devices in DLPack."""


def vertices_on(device: wp.Device, vertices: Any, count: int) -> wp.array | None:
    """(V,) vec3, a copy on the device of vertices that are there already; None if they are not, or not `count` in float32."""
    if isinstance(vertices, np.ndarray) or not device.is_cuda:
        return None
    if not isinstance(vertices, wp.array):
        kind = getattr(vertices, "__dlpack_device__", None)
        if kind is None or int(kind()[0]) != CUDA or kind()[1] != device.ordinal:
            return None
        vertices = as_vectors(vertices, "vertices", device)
    elif vertices.device != device:
        return None
    if vertices.dtype is wp.float32 and vertices.ndim == 2 and vertices.shape[1] == 3:
        vertices = vertices.contiguous().view(wp.vec3f)
    return wp.clone(vertices) if vertices.dtype is wp.vec3f and vertices.shape == (count,) else None


class MeshOnDevice(TriangleMesh):
    """A mesh of the faces, name and materials of another one, with vertices on a device.

    Args:
        mesh: the other mesh.
        points: (V,) vec3, its own.
        bounds: (2, 3) float64, of all triangles.
    """

    def __init__(self, mesh: TriangleMesh, points: wp.array, bounds: np.ndarray) -> None:
        self._faces, self.name, self._up, self._materials = mesh.faces, mesh.name, mesh.up, mesh.materials
        self._points = points
        self.__dict__ |= {"referenced": mesh.referenced, "bounds": frozen(bounds)}

    @cached_property
    def _vertices(self) -> np.ndarray:  # type: ignore[override]  # in place of the constructor's
        return frozen(self._points.numpy())

    @property
    def vertex_count(self) -> int:
        """V, including vertices that no triangle uses."""
        return len(self._points)


def move_on_device(mesh: TriangleMesh, points: wp.array, placed: SceneMesh) -> tuple[MeshOnDevice, np.ndarray, SceneMesh]:
    """A mesh with new vertices, which stay where they are.

    Args:
        mesh: before.
        points: (V,) vec3 on the device.
        placed: the mesh in its scene, of which it is the only one.

    Returns:
        The mesh, its centre as (3,) float64, and the mesh relative to it.

    Raises:
        ValueError: a vertex of a triangle is NaN or infinite.
    """
    device = points.device
    bounds = np.array(corner_bounds(points, placed.faces), dtype=np.float64)
    center = 0.5 * bounds[0] + 0.5 * bounds[1]
    moved = SceneMesh()
    moved.vertices = wp.empty(len(points), dtype=wp.vec3, device=device)
    moved.faces, moved.geometry_first = placed.faces, placed.geometry_first
    moved.center = wp.vec3d(*map(float, center))
    launch(specialise(make_shift, wp.vec3), len(points), [moved.center, points, moved.vertices], device=device)
    return MeshOnDevice(mesh, points, bounds), center, moved
