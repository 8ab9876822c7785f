"""Packets whose rays meet several triangles of one block: each ray takes them one after the other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.hits import assert_same_hits, brute_force
from support.selection import slow

import wrt

pytestmark = pytest.mark.width

SHEETS = 40
"""Sheets of two triangles each, above one another: more than any block has triangles."""


@pytest.fixture(scope="module")
def sheets() -> wrt.TriangleMesh:
    """Sheets that face up and down in turns, as close together as they are shuffled; some are there twice."""
    rng = np.random.default_rng(3)
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    heights = rng.permutation(np.repeat(np.arange(SHEETS) * 1e-3, np.where(np.arange(SHEETS) % 5, 1, 2)))
    vertices = [np.column_stack([square + rng.normal(scale=0.1, size=(4, 2)), np.full(4, height)]) for height in heights]
    up, down = [[0, 1, 2], [0, 2, 3]], [[0, 2, 1], [0, 3, 2]]
    faces = [4 * k + np.array(up if k % 2 else down) for k in range(len(heights))]
    return wrt.TriangleMesh(np.concatenate(vertices).astype(np.float32), np.concatenate(faces))


def rays_to(mesh: wrt.TriangleMesh, kind: str) -> wrt.Rays:
    """1,536 rays: a view from above; rays to a point below; rays from many points, along three main axes."""
    rng = np.random.default_rng(4)
    x, y = np.meshgrid(np.linspace(-1.2, 1.2, 48), np.linspace(-1.2, 1.2, 32))
    aims = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]).astype(np.float32)
    if kind == "view":
        eye = np.float32([0.2, -0.1, 2.0])
        return wrt.Rays(eye, aims - eye)
    if kind == "light":
        origins = aims + np.float32([0.1, 0.2, 0.5])
        return wrt.Rays(origins, np.float32([0.3, 0.2, -1.5]) - origins, 0.0, 1.0)
    origins = aims + np.float32([0.0, 0.0, 0.02]) + rng.normal(scale=0.02, size=aims.shape).astype(np.float32)
    slant = np.repeat([[3.0, 0.5, -0.2], [0.4, 3.0, -0.3], [0.2, 0.3, -1.0]], aims.shape[0] // 3, axis=0)
    return wrt.Rays(origins, slant.astype(np.float32))


@pytest.mark.parametrize("kind", ["view", "light", "slant"])
@pytest.mark.parametrize("vectors", [4, *slow(1)])
def test_all_triangles_of_a_ray_count(sheets, kind, vectors, device):
    scene, rays = wrt.Scene(sheets, "bvh", device=device), rays_to(sheets, kind)
    counts = scene.count(rays)
    assert (counts >= 10).mean() > 0.2, "rays meet many triangles"
    assert counts.min() < 10, "others do not"
    plan = scene.explain(rays, traversal="packet")
    plan = replace(plan, packet=vectors * plan.width)
    assert_same_hits(scene.intersect(rays, traversal=plan), brute_force(scene, rays))
    dark = scene.explain(rays, query="any", traversal="packet")
    dark = replace(dark, packet=vectors * dark.width)
    np.testing.assert_array_equal(scene.occluded(rays, traversal=dark), brute_force(scene, rays).is_hit)


def test_back_faces_are_passed(sheets, device):
    """Of the triangles of a ray, those that show their back are no hits; later ones are."""
    scene, rays = wrt.Scene(sheets, "bvh", device=device), rays_to(sheets, "view")
    hits = scene.intersect(rays, traversal="multi_frusta", cull_backfaces=True)
    assert_same_hits(hits, scene.intersect(rays, traversal="brute", cull_backfaces=True))
    assert (hits.primitive_id != brute_force(scene, rays).primitive_id).mean() > 0.1, "the first triangle is often a back"
