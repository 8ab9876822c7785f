"""Rays of every kind, and hits that are held against brute force to the bit."""

from __future__ import annotations

import numpy as np

import wrt


def mixed_rays(mesh: wrt.TriangleMesh, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Rays of every kind, float32: inside and outside, at vertices and edges, axis-parallel, in planes of faces, bad ones."""
    rng = np.random.default_rng(seed)
    low, high = mesh.bounds
    size = high - low + 1e-6
    origins = rng.uniform(low - 0.3 * size, high + 0.3 * size, (count, 3))
    targets = rng.uniform(low, high, (count, 3))
    corners = mesh.vertices[mesh.faces[rng.integers(0, mesh.triangle_count, count)]]
    kind = rng.integers(0, 8, count)
    targets[kind == 1] = corners[kind == 1, 0]
    targets[kind == 2] = (corners[kind == 2, 0] + corners[kind == 2, 1]) / 2
    targets[kind == 3] = corners[kind == 3].mean(axis=1)
    directions = targets - origins
    axes = np.eye(3)[rng.integers(0, 3, count)] * rng.choice([-1.0, 1.0], (count, 1))
    directions[kind == 4] = axes[kind == 4] * size.max()
    origins[kind == 5] = corners[kind == 5, 0] - 0.7 * (axes * size)[kind == 5]
    directions[kind == 5] = (axes * size)[kind == 5]
    origins[kind == 6] = corners[kind == 6, 1]
    directions[kind == 7] = (corners[:, 1] - corners[:, 0])[kind == 7]
    origins[kind == 7] = (corners[:, 0] - 0.4 * (corners[:, 1] - corners[:, 0]))[kind == 7]
    origins, directions = origins.astype(np.float32), directions.astype(np.float32)
    bad = rng.integers(0, 40, count)
    for code, value in enumerate((np.nan, np.inf, -np.inf)):
        origins[bad == code, code] = value
        directions[bad == code + 3, code] = value
    directions[bad == 6] = 0.0
    return origins, directions


_BRUTE_FORCE: dict[tuple, wrt.Hits] = {}


def brute_force(scene: wrt.Scene, rays: wrt.Rays, **options: str) -> wrt.Hits:
    """Closest hits by brute force, worked out once for the same triangles, rays and options, whatever the scene's tree."""
    arrays = [mesh.vertices for mesh in scene.meshes] + [mesh.faces for mesh in scene.meshes]
    arrays += [rays.origins, rays.directions, rays.t_min, rays.t_max]
    key = (*(hash(np.asarray(a).tobytes()) for a in arrays), str(scene.device), *options.items())
    if key not in _BRUTE_FORCE:
        _BRUTE_FORCE[key] = scene.intersect(rays, traversal="brute", **options)
    return _BRUTE_FORCE[key]


def assert_same_hits(hits: wrt.Hits, expected: wrt.Hits) -> None:
    """Equal to the bit."""
    np.testing.assert_array_equal(hits.primitive_id, expected.primitive_id)
    np.testing.assert_array_equal(hits.geometry_id, expected.geometry_id)
    np.testing.assert_array_equal(hits.t.view(np.int32), expected.t.view(np.int32))
    np.testing.assert_array_equal(hits.uv.view(np.int32), expected.uv.view(np.int32))
