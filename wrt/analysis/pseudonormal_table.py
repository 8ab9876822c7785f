"""The pseudonormals of a scene's vertices and edges: made by the first query that needs them, and cached.

Vertices that coincide exactly are one, so that meshes of separate triangles have the same normals.

References: baerentzen-aanaes-2005.
"""

from __future__ import annotations

import math
import threading
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np
import warp as wp

from wrt.kernels.fields.distance_signs import Pseudonormals
from wrt.meshes.mesh_measures import first_of_equal_points, normals_and_areas

if TYPE_CHECKING:
    from wrt.engine.facts.scene_state import SceneState
    from wrt.meshes.mesh import TriangleMesh

_known: WeakKeyDictionary[SceneState, Pseudonormals] = WeakKeyDictionary()
_lock = threading.Lock()


def pseudonormals_of(scene: SceneState) -> Pseudonormals:
    """The pseudonormals of a scene, whose triangles are numbered as through the scene."""
    with _lock:
        if scene not in _known:
            _known[scene] = make_pseudonormals(scene.flattened(), scene.center, scene.device)
        return _known[scene]


def make_pseudonormals(mesh: TriangleMesh, center: np.ndarray, device: wp.Device) -> Pseudonormals:
    """The pseudonormals of a mesh, and its triangles relative to a centre."""
    of_vertex, of_edge = vertex_normals(mesh.vertices, mesh.faces), edge_normals(mesh.vertices, mesh.faces)
    made = Pseudonormals()
    made.vertices = wp.array((mesh.vertices.astype(np.float64) - center).astype(np.float32), dtype=wp.vec3, device=device)
    farthest = float(np.abs(made.vertices.numpy()).max(initial=0.0))
    made.scale = math.ldexp(1.0, min(1 - math.frexp(farthest)[1], 126))
    made.faces = wp.array(mesh.faces, dtype=wp.vec3i, device=device)
    made.of_vertex = wp.array(of_vertex.astype(np.float32), dtype=wp.vec3, device=device)
    made.of_edge = wp.array(of_edge.astype(np.float32), dtype=wp.vec3, device=device)
    return made


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V, 3) float64 sums of the unit normals of the triangles at each vertex, each times its angle there."""
    same, (normals, _) = first_of_equal_points(vertices), normals_and_areas(vertices, faces)
    corners, sums = vertices[faces].astype(np.float64), np.zeros((len(vertices), 3))
    for k in range(3):
        one, other = corners[:, (k + 1) % 3] - corners[:, k], corners[:, (k + 2) % 3] - corners[:, k]
        sine, cosine = np.linalg.norm(np.cross(one, other), axis=1), (one * other).sum(axis=1)
        weighted = np.arctan2(sine, cosine)[:, None] * normals
        for axis in range(3):
            sums[:, axis] += np.bincount(same[faces[:, k]], weighted[:, axis], len(vertices))
    return sums[same]


def edge_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F, 3, 3) float64 sums of the unit normals of all triangles at the edges behind each corner of each triangle."""
    ends = first_of_equal_points(vertices)[faces]
    pairs = np.sort(np.stack([ends, np.roll(ends, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    _, edge = np.unique(pairs[:, 0] * len(vertices) + pairs[:, 1], return_inverse=True)
    normals = np.repeat(normals_and_areas(vertices, faces)[0], 3, axis=0)
    sums = np.stack([np.bincount(edge, normals[:, axis]) for axis in range(3)], axis=1)
    return sums[edge].reshape(-1, 3, 3)
