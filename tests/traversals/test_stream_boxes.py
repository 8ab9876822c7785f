"""Streams of short rays, which are told apart by the boxes around them, against brute force."""

from __future__ import annotations

import numpy as np
import pytest
from support.hits import mixed_rays
from support.meshes import SCENES

import wrt

pytestmark = pytest.mark.width


def assert_same_answers(scene: wrt.Scene, rays: wrt.Rays) -> float:
    """Occlusion and counts of streams, as of every ninth ray by brute force and of all by single rays; returns the share of the
    rays that hit."""
    given, count = (rays.origins, rays.directions, rays.t_min, rays.t_max), len(rays.directions)
    some = wrt.Rays(*(part[::9] if np.shape(part)[:1] == (count,) else part for part in given))
    for ask in (scene.occluded, scene.count):
        found = ask(rays, traversal="stream")
        np.testing.assert_array_equal(found[::9], ask(some, traversal="brute"))
        np.testing.assert_array_equal(found, ask(rays, traversal="single"))
    return float(np.mean(found > 0))


def points_on(mesh: wrt.TriangleMesh, triangles: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A point of each of these triangles, (N, 3) float64."""
    weights = rng.dirichlet(np.ones(3), len(triangles))
    return np.einsum("nk,nkc->nc", weights, mesh.vertices[mesh.faces[triangles]])


@pytest.mark.parametrize(("length", "offset"), [(0.05, 0.0), (0.3, 30000.0), (np.inf, 0.0)])
def test_short_and_long_rays(length, offset, device):
    """From surfaces, 64 rays from one place, some of them far from everything; ranges of their own; one origin; bad rays; a
    scene far from the origin."""
    mesh = SCENES["atrium"]()
    mesh = wrt.TriangleMesh(mesh.vertices + np.float32(offset), mesh.faces)
    scene = wrt.Scene(mesh, device=device)
    rng = np.random.default_rng(1)
    size = float(np.linalg.norm(mesh.bounds[1] - mesh.bounds[0]))
    number = np.repeat(rng.integers(0, mesh.triangle_count, 60), 64)
    origins = points_on(mesh, number, rng) + 1e-3 * size
    directions = rng.normal(size=origins.shape)
    origins[np.arange(len(number)) // 64 % 3 == 1] += 0.4 * size
    origins[::97], directions[::89] = np.nan, 0.0
    origins, directions = origins.astype(np.float32), directions.astype(np.float32)
    reach = np.full(len(number), length * size, np.float32)
    reach[::7] *= 0.5
    reach[::91] = 0.0
    odd = mixed_rays(mesh, 1000)
    for rays in (
        wrt.Rays(origins, directions, 0.0, length * size),
        wrt.Rays(origins[:-3], directions[:-3], np.zeros_like(reach)[:-3], reach[:-3]),
        wrt.Rays(origins[5], directions, 0.0, length * size),
        wrt.Rays(odd[0], odd[1], 0.0, length * size),
    ):
        assert assert_same_answers(scene, rays) > 0.0


@pytest.mark.parametrize("far", [1.0, 300.0])
def test_rays_that_end_on_a_triangle(far, device):
    """Where rounding decides: ends on, before and behind triangles, half of them on the ground, which is flat; from near and
    from far. Every other ray reaches nothing, so that boxes are compared."""
    mesh = SCENES["atrium"]()
    scene = wrt.Scene(mesh, device=device)
    rng = np.random.default_rng(2)
    size = float(np.linalg.norm(mesh.bounds[1] - mesh.bounds[0]))
    corners = mesh.vertices[mesh.faces][..., 2]
    ground = np.flatnonzero((corners == corners.min()).all(axis=1))
    triangles = rng.integers(0, mesh.triangle_count, 6000)
    triangles[::2] = rng.choice(ground, 3000)
    ends = points_on(mesh, triangles, rng)
    directions = rng.normal(size=ends.shape)
    directions[::5] = np.eye(3)[rng.integers(0, 3, len(ends[::5]))]
    lengths = far * size * rng.uniform(0.001, 0.05, (len(ends), 1))
    origins = (ends - lengths * directions).astype(np.float32)
    directions = directions.astype(np.float32)
    along = np.abs(directions).argmax(axis=1)[:, None]
    reach = (np.take_along_axis(ends - origins, along, 1) / np.take_along_axis(directions, along, 1)).astype(np.float32)[:, 0]
    reach *= np.float32(1.0) + rng.integers(-2, 3, len(reach)).astype(np.float32) * np.float32(2.0**-23)
    apart = [np.repeat(x, 2, axis=0) for x in (origins, directions, np.maximum(reach, 0.0))]
    apart[0][::2] = mesh.bounds[1] + size
    apart[2][::2] = 0.01 * size
    rays = wrt.Rays(apart[0], apart[1], np.zeros(len(apart[2]), np.float32), apart[2])
    assert assert_same_answers(scene, rays) > 0.15
