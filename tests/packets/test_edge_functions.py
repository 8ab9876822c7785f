"""Packets of rays through one point, on edges and vertices of triangles so small that rounding decides what they hit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.hits import assert_same_hits, brute_force
from support.selection import slow

import wrt

pytestmark = pytest.mark.width

SIDE = 60
"""Cells along an edge of the patch."""


def patch(cell: float, seed: int) -> wrt.TriangleMesh:
    """A bumpy patch of small triangles, and one triangle far below, which makes rounding errors large."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(SIDE + 1) * cell, np.arange(SIDE + 1) * cell, indexing="ij")
    points = np.stack([x, y, rng.uniform(-0.3, 0.3, x.shape) * cell], axis=-1).reshape(-1, 3)
    corner = (np.arange(SIDE)[:, None] * (SIDE + 1) + np.arange(SIDE)).reshape(-1)
    cells = [[0, SIDE + 1, 1], [1, SIDE + 1, SIDE + 2]]
    faces = (corner[:, None, None] + np.array(cells)).reshape(-1, 3)
    far = np.array([[-4.0, -4.0, -5.0], [4.0, -4.0, -5.0], [0.0, 4.0, -5.0]])
    faces = np.concatenate([faces, len(points) + np.array([[0, 1, 2]])])
    return wrt.TriangleMesh(np.concatenate([points, far]).astype(np.float32), faces)


def targets(mesh: wrt.TriangleMesh, rng: np.random.Generator, count: int) -> np.ndarray:
    """(64 count, 3): runs of 64 neighbouring points: vertices, points of edges, and points a little beside them."""
    vertices = mesh.vertices[: (SIDE + 1) ** 2].reshape(SIDE + 1, SIDE + 1, 3).astype(np.float64)
    i, j = rng.integers(0, SIDE - 4, (2, count, 1)) + rng.integers(0, 4, (2, count, 64))
    ends = vertices[i, j], vertices[i + 1, j + rng.integers(0, 2, i.shape)]
    along = rng.choice([0.0, 0.5, 1.0, 0.3], i.shape)[..., None]
    points = ends[0] * (1.0 - along) + ends[1] * along
    beside = rng.choice([0.0, 1e-7, 1e-6, 1e-5], i.shape)[..., None] * rng.normal(size=points.shape)
    return (points + beside).reshape(-1, 3)


@pytest.mark.parametrize("culling", ["transient_frustum", *slow("interval", "vertex")])
@pytest.mark.parametrize("cell", [1e-2, 3e-4, 2e-5])
def test_no_hit_is_lost_on_an_edge(cell, culling, device):
    mesh, rng = patch(cell, 5), np.random.default_rng(6)
    scene = wrt.Scene(mesh, "bvh", device=device)
    aims = targets(mesh, rng, 40)
    for point in ([0.3, 0.2, 3.0], [2.0, 0.1, 0.4]):
        rays = wrt.Rays(np.float32(point), (aims - np.float32(point)).astype(np.float32))
        expected = brute_force(scene, rays)
        assert (expected.primitive_id < 2 * SIDE**2)[expected.is_hit].mean() > 0.3
        plan = scene.explain(rays, traversal="packet")
        plan = replace(plan, packet=4 * plan.width, culling=culling)
        assert_same_hits(scene.intersect(rays, traversal=plan), expected)


@pytest.mark.parametrize("cell", [1e-2, 3e-4, 2e-5])
def test_no_occluder_is_lost_on_an_edge(cell, device):
    """Rays from below the patch to a light above it."""
    mesh, rng = patch(cell, 7), np.random.default_rng(8)
    scene = wrt.Scene(mesh, "bvh", device=device)
    light, aims = np.array([0.4, -0.3, 2.5]), targets(mesh, rng, 40)
    origins = (light + (aims - light) * 1.2).astype(np.float32)
    rays = wrt.Rays(origins, (light - origins).astype(np.float32), 0.0, 1.0)
    dark = brute_force(scene, rays).is_hit
    assert dark.mean() > 0.3
    plan = scene.explain(rays, query="any", traversal="packet")
    np.testing.assert_array_equal(scene.occluded(rays, traversal=replace(plan, packet=4 * plan.width)), dark)
