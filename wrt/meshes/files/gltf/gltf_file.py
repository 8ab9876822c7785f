"""glTF: all meshes of the default scene as one, in the scene's coordinates."""

from __future__ import annotations

import numpy as np

from wrt.materials.material import Material
from wrt.materials.mesh_materials import MeshMaterials, joined_materials
from wrt.meshes.files.gltf.document import Document
from wrt.meshes.files.gltf.gltf_materials import GltfMaterials
from wrt.meshes.files.gltf.nodes import PlacedMesh, placed_meshes, skinned
from wrt.meshes.files.gltf.primitives import Part, mesh_parts
from wrt.meshes.files.mesh_source import FileMesh, MeshSource
from wrt.meshes.up_axis import stated_up

__all__ = ["read_gltf"]

MAX_TRIANGLES = 1 << 27
"""Triangles of all nodes together: a small file may place a mesh many times."""


def read_gltf(data: bytes, source: MeshSource) -> FileMesh:
    """Reads a file.

    Raises:
        ValueError: it is no glTF 2.0, requires what is not supported, is broken, or has no triangles.
    """
    document = Document(data, source)
    materials = None if source.materials is False else GltfMaterials(document)
    known: dict[str, list[Part]] = {}
    vertices: list[np.ndarray] = []
    faces: list[np.ndarray] = []
    looks: list[MeshMaterials | None] = []
    triangles = begin = 0
    everything = placed_meshes(document)
    up = _stated_up(everything)
    for placed in everything:
        key = f"{placed.mesh!r} {placed.weights!r}"
        if key not in known:
            known[key] = mesh_parts(document, placed.mesh, placed.weights, materials)
        for part in known[key]:
            points = part.vertices
            matrices = placed.matrices
            if placed.joints is not None:
                points, matrices = skinned(document, points, part.attributes, placed.joints), np.eye(4)[None]
            triangles += len(part.faces) * len(matrices)
            if triangles > MAX_TRIANGLES:
                raise ValueError(
                    f"its nodes place more than {MAX_TRIANGLES:,} triangles; load it with trimesh.load and pass the scene to "
                    "wrt.Scene, which shares meshes"
                )
            for matrix in matrices:
                mirrors = np.linalg.det(matrix[:3, :3]) < 0.0
                vertices.append(points if (matrix == np.eye(4)).all() else points @ matrix[:3, :3].T + matrix[:3, 3])
                faces.append((part.faces[:, [0, 2, 1]] if mirrors else part.faces) + begin)
                looks.append(part.materials.mirrored() if mirrors and part.materials is not None else part.materials)
                begin += len(points)
    if not faces:
        raise ValueError("no triangles in it: its default scene has no mesh of triangles (points and lines do not count)")
    mesh = FileMesh(np.concatenate(vertices), np.concatenate(faces), up=up)
    mesh.materials = joined_materials(looks, [len(one) for one in faces], Material())
    return mesh


def _stated_up(placed: list[PlacedMesh]) -> tuple[float, ...] | None:
    """The upward direction that `wrt.TriangleMesh.save` stated, whose turn is then undone; None if there is none."""
    extras = placed[0].extras if len(placed) == 1 else None
    given = extras.get("up") if isinstance(extras, dict) else None
    if not isinstance(given, list) or len(given) != 3:
        return None
    up = stated_up(["up " + " ".join(map(str, given))])
    if up is not None:
        placed[0].matrices = np.eye(4)[None]
    return up
