"""What vertices know, at hits: values, texture coordinates, smooth normals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import warp as wp

from wrt.kernels.runtime.launch import launch
from wrt.kernels.shading import normals
from wrt.kernels.validation import host_array
from wrt.meshes.mesh import TriangleMesh
from wrt.meshes.placement import join_meshes

_corner_normals: WeakKeyDictionary[TriangleMesh, dict[tuple[str, float], wp.array]] = WeakKeyDictionary()


def corner_table(meshes: tuple[TriangleMesh, ...], values: Any) -> tuple[np.ndarray, np.ndarray]:
    """Rows of values, and for each triangle the rows of its corners.

    Args:
        meshes: of the scene.
        values: (V, ...) for a scene of one mesh, or one array for each mesh.

    Returns:
        (N, ...) float32, and (F, 3) int32.

    Raises:
        TypeError: values that are no real numbers.
        ValueError: another number of arrays or rows.
    """
    if len(meshes) == 1 and not (isinstance(values, list | tuple) and len(values) == 1 and np.ndim(values[0]) > 0):
        values = [values]
    if not isinstance(values, Sequence) or len(values) != len(meshes):
        raise ValueError(f"vertex_values must be a sequence of {len(meshes)} arrays, one for each mesh of the scene")
    arrays = []
    for number, (mesh, given) in enumerate(zip(meshes, values, strict=True)):
        array = host_array("vertex_values", given)
        if array.dtype.kind not in "fiub":
            raise TypeError(f"vertex_values must hold real numbers, not {array.dtype}")
        if array.ndim == 0 or len(array) != mesh.vertex_count:
            raise ValueError(
                f"vertex_values of mesh {number} have the shape {array.shape}; they need a row for each of its "
                f"{mesh.vertex_count} vertices"
            )
        arrays.append(array.astype(np.float32))
    if len({array.shape[1:] for array in arrays}) > 1:
        raise ValueError(f"vertex_values have rows of different shapes: {[array.shape[1:] for array in arrays]}")
    _, faces, _ = join_meshes(meshes)
    return np.concatenate(arrays), np.ascontiguousarray(faces, dtype=np.int32)


def corner_coordinates(meshes: tuple[TriangleMesh, ...]) -> np.ndarray:
    """(F, 3, 2) float32 texture coordinates of the materials; 0 for meshes without.

    Raises:
        ValueError: no mesh has any.
    """
    found = [None if mesh.materials is None else mesh.materials.corner_uv for mesh in meshes]
    if all(one is None for one in found):
        raise ValueError("no mesh of the scene has texture coordinates; give them with mesh.with_materials(..., uv=...)")
    zeros = (np.zeros((mesh.triangle_count, 3, 2), dtype=np.float32) for mesh in meshes)
    return np.concatenate([zero if one is None else one for one, zero in zip(found, zeros, strict=True)])


def corner_normals_of(meshes: tuple[TriangleMesh, ...], crease_angle: float, device: wp.Device) -> wp.array:
    """(3 F,) vec3: smooth unit normals of all corners, shared meshes once, in their own space; kept with the meshes."""
    parts = []
    for mesh in meshes:
        made = _corner_normals.setdefault(mesh, {})
        key = device.alias, crease_angle
        if key not in made:
            made[key] = _make_corner_normals(mesh, crease_angle, device)
        parts.append(made[key])
    return joined(parts)


def _make_corner_normals(mesh: TriangleMesh, crease_angle: float, device: wp.Device) -> wp.array:
    vertices = wp.array((mesh.vertices - mesh.center).astype(np.float32), dtype=wp.vec3, device=device)
    faces = wp.array(mesh.faces, dtype=wp.vec3i, device=device)
    return smooth_corner_normals(vertices, faces, (mesh,), crease_angle)


def smooth_corner_normals(
    vertices: wp.array, faces: wp.array, meshes: tuple[TriangleMesh, ...], crease_angle: float
) -> wp.array:
    """(3 F,) vec3: smooth unit normals of all corners.

    Args:
        vertices: (V,) vec3.
        faces: (F,) vec3i, of all meshes; different meshes share no points.
        meshes: the same before, whose points are welded.
        crease_angle: degrees between triangles from which an edge is sharp.
    """
    count, device = len(faces), vertices.device
    flat = wp.empty(count, dtype=wp.vec3, device=device)
    angles = wp.empty(3 * count, dtype=float, device=device)
    result = wp.empty(3 * count, dtype=wp.vec3, device=device)
    launch(normals.face_normals_and_angles, count, [vertices, faces, flat, angles], device=device)
    inputs = [_corners_around(meshes, device), flat, angles, float(np.cos(np.radians(crease_angle))), result]
    launch(normals.smooth_corner_normals, 3 * count, inputs, device=device)
    return result


def _corners_around(meshes: tuple[TriangleMesh, ...], device: wp.Device) -> normals.VertexCorners:
    """The triangle corners that meet at each point."""
    corners, points = [], 0
    for mesh in meshes:
        welded = mesh.welded()
        corners.append(welded.faces.ravel() + points)
        points += welded.vertex_count
    vertex = np.concatenate(corners).astype(np.int32)
    start = np.concatenate([[0], np.cumsum(np.bincount(vertex, minlength=points))])
    around = normals.VertexCorners()
    around.vertex, around.start, around.corner = (
        wp.array(values.astype(np.int32), dtype=int, device=device)
        for values in (vertex, start, np.argsort(vertex, kind="stable"))
    )
    return around


def joined(parts: list[wp.array]) -> wp.array:
    """Flat arrays one after the other, on their device."""
    if len(parts) == 1:
        return parts[0]
    result = wp.empty(sum(map(len, parts)), dtype=parts[0].dtype, device=parts[0].device)
    begin = 0
    for part in parts:
        wp.copy(result, part, dest_offset=begin)
        begin += len(part)
    return result
