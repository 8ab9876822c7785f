"""Closed bodies, points on their vertices and edges, and winding numbers."""

from __future__ import annotations

import numpy as np
import trimesh

import wrt


def rotated(mesh: trimesh.Trimesh, seed: int) -> trimesh.Trimesh:
    mesh = mesh.copy()
    mesh.apply_transform(trimesh.transformations.random_rotation_matrix(np.random.default_rng(seed).random(3)))
    return mesh


BODIES = {
    "icosphere": trimesh.creation.icosphere(subdivisions=3),
    "box": trimesh.creation.box(extents=(1, 2, 3)),
    "turned box": rotated(trimesh.creation.box(extents=(1, 2, 3)), 1),
    "slab": trimesh.creation.box(extents=(100, 100, 0.01)),
    "turned needle": rotated(trimesh.creation.box(extents=(0.01, 0.01, 100)), 2),
    "cylinder": trimesh.creation.cylinder(radius=1, height=2, sections=64),
    "ellipsoid": None,
}

BODIES["ellipsoid"] = rotated(BODIES["icosphere"].copy().apply_scale((1, 0.3, 5)), 3)


def feature_points(mesh: trimesh.Trimesh) -> np.ndarray:
    """Vertices, edge midpoints and points at thirds of edges, of the float32 mesh."""
    a, b = mesh.vertices[mesh.edges_unique[:, 0]], mesh.vertices[mesh.edges_unique[:, 1]]
    return np.concatenate([mesh.vertices, (a + b) / 2, a + (b - a) / 3, b + (a - b) / 3])


def winding_number(triangles: np.ndarray) -> float:
    """How often a closed surface (F, 3, 3) surrounds the origin: its solid angle over 4 pi (van Oosterom, Strackee 1983)."""
    a, b, c = triangles.transpose(1, 0, 2)
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    dots = (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
    angles = 2 * np.arctan2((a * np.cross(b, c)).sum(1), la * lb * lc + dots)
    return float(angles.sum() / (4 * np.pi))


PLACES = {"tiny": (1e-4, 0.0), "one": (1.0, 0.0), "huge": (1e8, 0.0), "far": (1.0, 1e7)}


def placed(mesh: trimesh.Trimesh, place: str) -> wrt.TriangleMesh:
    """The mesh scaled, then moved away from the origin."""
    scale, shift = PLACES[place]
    return wrt.TriangleMesh(mesh.vertices * scale + [shift, -shift, shift / 3], mesh.faces)
