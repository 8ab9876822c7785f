"""No ray passes between triangles that share an edge or a vertex."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from support.bodies import BODIES, feature_points, winding_number
from support.hits import assert_same_hits

import wrt
from wrt.kernels.triangle import TRIANGLE_TESTS

WATERTIGHT = [name for name, test in TRIANGLE_TESTS.items() if test.watertight]


@pytest.mark.parametrize("triangle_test", WATERTIGHT)
@pytest.mark.parametrize("body", BODIES)
def test_rays_from_inside_hit(body, triangle_test, device):
    """Whatever the origin inside a closed convex body, a ray at any vertex or edge does not leave it unseen."""
    mesh = BODIES[body]
    scene = wrt.Scene(mesh, device=device)
    points = feature_points(mesh)
    rng = np.random.default_rng(3)
    inside = mesh.triangles_center.mean(axis=0) + 0.4 * (mesh.vertices[rng.integers(0, len(mesh.vertices), 30)])
    origins = np.repeat(inside, len(points), axis=0)
    directions = np.tile(points, (len(inside), 1)) - origins
    hits = scene.intersect(origins.astype(np.float32), directions.astype(np.float32), triangle_test=triangle_test)
    assert hits.is_hit.all(), f"{(~hits.is_hit).sum()} of {len(origins)} rays leak"


@pytest.mark.parametrize("triangle_test", WATERTIGHT)
def test_close_to_a_large_floor(triangle_test):
    """A story: a box test that absorbs only its own rounding lost rays at axis-aligned edges of triangles a thousand times
    larger than the distance to them, where the test's shear rounds by more than the hit's own magnitude."""
    n = 4
    steps = np.linspace(-1000.0, 1000.0, n + 1)
    x, y = np.meshgrid(steps, steps, indexing="ij")
    vertices = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    corner = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    faces = np.concatenate([corner[:, None] + [0, 1, n + 2], corner[:, None] + [0, n + 2, n + 1]])
    mesh = wrt.TriangleMesh(vertices, faces)
    scene = wrt.Scene(mesh, device="cpu")
    rng = np.random.default_rng(0)
    count = 200_000
    on_edge = np.zeros((count, 3))
    on_edge[:, 0] = rng.choice(steps[1:-1], count)
    on_edge[:, 1] = rng.uniform(-900, 900, count)
    on_edge[: count // 2] = on_edge[: count // 2, [1, 0, 2]]  # edges along both axes
    origins = on_edge + rng.normal(size=(count, 3)) * 10.0 ** rng.uniform(-3, 1, (count, 1))
    origins[:, 2] = np.abs(origins[:, 2]) + 1e-4
    directions = on_edge - origins
    hits = scene.intersect(origins.astype(np.float32), directions.astype(np.float32), triangle_test=triangle_test)
    assert hits.is_hit.all(), f"{(~hits.is_hit).sum()} rays fall through the floor"


@pytest.mark.parametrize("triangle_test", WATERTIGHT)
def test_bunny_does_not_leak(bunny, triangle_test):
    """Rays from outside through every vertex and edge midpoint, aimed from the centre of the box outwards."""
    scene = wrt.Scene(bunny, device="cpu")
    surface = bunny.to_trimesh()
    inside = surface.bounds.mean(axis=0)[None]
    assert winding_number(surface.triangles - inside) == pytest.approx(1.0)
    points = np.concatenate([surface.vertices, surface.vertices[surface.edges_unique].mean(axis=1)])
    hits = scene.intersect(inside[0].astype(np.float32), (points - inside).astype(np.float32), triangle_test=triangle_test)
    assert hits.is_hit.all()


def crossings(scene: wrt.Scene, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Number of distinct t at which a ray meets the surface, by tracing on from just behind each hit."""
    count = np.zeros(len(origins), dtype=int)
    t_min = np.zeros(len(origins), dtype=np.float32)
    for _ in range(6):
        hits = scene.intersect(origins, directions, t_min=t_min)
        count += hits.is_hit
        t_min = np.where(hits.is_hit, np.nextafter(hits.t, np.float32(np.inf)), np.finfo(np.float32).max).astype(np.float32)
    return count


def test_two_crossings_of_a_convex_body():
    """Through interior points of faces a convex body is crossed exactly twice: once in, once out."""
    mesh = BODIES["ellipsoid"]
    scene = wrt.Scene(mesh, device="cpu")
    rng = np.random.default_rng(5)
    weights = rng.dirichlet((4, 4, 4), len(mesh.faces))
    targets = (mesh.triangles * weights[:, :, None]).sum(axis=1)
    origins = (targets + 20 * rng.normal(size=targets.shape)).astype(np.float32)
    inwards = np.einsum("ij,ij->i", targets - origins, mesh.face_normals) < 0
    counts = crossings(scene, origins, (targets - origins).astype(np.float32))
    assert inwards.any()
    assert (counts == 2).all()


def test_corners_of_instances():
    """A ray at a corner of a mesh that fills its box meets the instance's box, too, as rounded as it comes from afar."""
    box, far = wrt.TriangleMesh.from_trimesh(trimesh.creation.box()), trimesh.transformations.translation_matrix([50, 0, 0])
    scene, rng = wrt.Scene([wrt.Instance(box), wrt.Instance(box, far)], device="cpu"), np.random.default_rng(0)
    origins = rng.normal(size=(4000, 3)).astype(np.float32) * np.float32(1e3)
    origins[:, 0] = -np.abs(origins[:, 0])  # the other instance is on the other side
    directions = (box.vertices[rng.integers(0, 8, 4000)] - origins).astype(np.float32)
    expected = wrt.Scene(box, device="cpu").intersect(origins, directions, traversal="brute")
    assert expected.is_hit.mean() > 0.9
    assert_same_hits(scene.intersect(origins, directions, traversal="single"), expected)
