"""Scenes whose trees are built while rays are traced, and hits that are held against brute force."""

from __future__ import annotations

import numpy as np

import wrt


def random_rays(mesh: wrt.TriangleMesh, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """From anywhere in the mesh's box to anywhere in it."""
    rng = np.random.default_rng(seed)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    origins, targets = low + (high - low) * rng.random((2, count, 3))
    return origins, targets - origins


def lazy_scene(meshes, hierarchy: str, **options) -> wrt.Scene:
    return wrt.Scene(meshes, wrt.KdTree(builder="lazy", hierarchy=hierarchy), device="cpu", **options)


def assert_brute(scene: wrt.Scene, origins: np.ndarray, directions: np.ndarray) -> None:
    """Hits of a scene, bit by bit those of brute force."""
    hits, brute = (scene.intersect(origins, directions, traversal=name) for name in ("single", "brute"))
    assert 0.02 < brute.is_hit.mean() < 1.0
    for name in ("t", "primitive_id", "uv"):
        np.testing.assert_array_equal(getattr(hits, name), getattr(brute, name))
