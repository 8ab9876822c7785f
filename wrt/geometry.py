"""What a scene is made of: meshes as they were given, and all of them in one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from wrt.instances import members_of
from wrt.kernels.hits import SceneMesh
from wrt.mesh import TriangleMesh, extremes


@dataclass(frozen=True)
class PlacedMeshes:
    """All meshes of a scene in one, relative to their centre.

    Attributes:
        first: (meshes + 1,) each mesh's first triangle, and their number.
        center: (3,) float64.
        vertices: (V,) vec3 on the CPU.
        faces: (F,) vec3i on the CPU.
        mesh: the same on the scene's device; its box is still to be filled in.
    """

    first: np.ndarray
    center: np.ndarray
    vertices: wp.array
    faces: wp.array
    mesh: SceneMesh

    def fill_in(self, low: wp.vec3, high: wp.vec3) -> SceneMesh:
        """The mesh with its box."""
        self.mesh.low, self.mesh.high = wp.vec3(*low), wp.vec3(*high)
        return self.mesh


def place_meshes(meshes: tuple[TriangleMesh, ...], device: wp.Device) -> PlacedMeshes:
    """Joins meshes, moves them to their centre in float64, and takes them to a device in float32."""
    vertices, faces, first = join_meshes(meshes)
    low, high = extremes(vertices)
    center = (low.astype(np.float64) + high) / 2
    host_vertices = wp.array((vertices - center).astype(np.float32), dtype=wp.vec3, device="cpu", copy=False)
    host_faces = wp.array(faces, dtype=wp.vec3i, device="cpu", copy=False)
    mesh = SceneMesh()
    mesh.vertices, mesh.faces = host_vertices.to(device), host_faces.to(device)
    mesh.center = wp.vec3d(*map(float, center))
    mesh.geometry_first = wp.array(first, dtype=int, device=device)
    return PlacedMeshes(first, center, host_vertices, host_faces, mesh)


def as_meshes(geometry: Any) -> tuple[TriangleMesh, ...]:
    """The meshes of what a scene was given, in order.

    Raises:
        TypeError: something that is no mesh.
        ValueError: an empty sequence, or one that contains itself.
    """
    if isinstance(geometry, TriangleMesh):
        return (geometry,)
    if isinstance(geometry, Sequence) and not isinstance(geometry, (str, bytes)):
        if not (members := members_of(geometry)):
            raise ValueError("geometry is an empty sequence; pass at least one mesh")
        return tuple(mesh for member in members for mesh in as_meshes(member))
    if hasattr(geometry, "to_geometry") or hasattr(geometry, "faces"):
        return (TriangleMesh.from_trimesh(geometry),)
    raise TypeError(
        f"geometry must be a wrt.TriangleMesh, a trimesh object or a sequence of them, not {type(geometry).__name__}; "
        "make a mesh of a file with wrt.TriangleMesh.load(path)"
    )


def check_index(index: Any, count: int, what: str) -> int:
    """An index of a mesh or instance, 0 to count - 1.

    Raises:
        TypeError: not an int.
        ValueError: there is none of that index.
    """
    if isinstance(index, (bool, np.bool_)) or not isinstance(index, (int, np.integer)):
        raise TypeError(f"index must be an int, not {type(index).__name__}")
    if not 0 <= index < count:
        raise ValueError(f"index is {index}, but the scene's {what} indices go from 0 to {count - 1}")
    return int(index)


def moved_mesh(mesh: TriangleMesh, vertices: Any) -> TriangleMesh:
    """The mesh with its vertices elsewhere; its faces are shared.

    Raises:
        TypeError: vertices are missing, or no real numbers.
        ValueError: another number of vertices, NaN or infinite ones.
    """
    if vertices is None:
        raise TypeError("vertices is missing; pass an array of as many points as the mesh has vertices")
    points = np.asarray(vertices)
    if points.ndim and len(points) != mesh.vertex_count:
        raise ValueError(
            f"vertices has {len(points)} points, but the mesh has {mesh.vertex_count}; for other triangles, make a new scene"
        )
    return TriangleMesh(points, mesh.faces, name=mesh.name)


def join_meshes(meshes: tuple[TriangleMesh, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, faces and each mesh's first triangle, of all meshes in one."""
    counts = np.cumsum([0] + [mesh.triangle_count for mesh in meshes])
    if len(meshes) == 1:
        return meshes[0].vertices, meshes[0].faces, counts
    offsets = np.cumsum([0] + [mesh.vertex_count for mesh in meshes])
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    faces = np.concatenate([mesh.faces + offset for mesh, offset in zip(meshes, offsets[:-1], strict=True)])
    return vertices, faces.astype(np.int32), counts
