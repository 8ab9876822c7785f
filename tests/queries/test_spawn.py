"""Rays that leave surfaces: they do not meet their own triangle, and do not jump across the next one."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
import warp as wp
from support.bodies import BODIES, PLACES, placed

import wrt


def leave(scene: wrt.Scene, body: trimesh.Trimesh, count: int, grazing: float, seed: int = 0):
    """Hits all over a body's surface, many of them near edges and vertices; directions to both sides, many of them grazing."""
    rng = np.random.default_rng(seed)
    mesh = scene.meshes[0]
    weights = rng.dirichlet((0.4, 0.4, 0.4), count)
    chosen = rng.choice(len(body.faces), count, p=body.area_faces / body.area)
    targets = (mesh.vertices[mesh.faces[chosen]] * weights[:, :, None]).sum(axis=1)
    origins = targets + mesh.extent * rng.normal(size=(count, 3))
    hits = scene.intersect(origins, targets - origins)
    normals = hits.normal.astype(np.float64)
    tangents = np.cross(normals, rng.normal(size=(count, 3)))
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True) + 1e-30
    slope = 10.0 ** rng.uniform(np.log10(grazing), 1, count) * rng.choice([-1.0, 1.0], count)
    return hits, (tangents + slope[:, None] * normals).astype(np.float32)


def exact_sides(scene: wrt.Scene, hits: wrt.Hits, directions: np.ndarray) -> np.ndarray:
    """Component of directions along the normals of the triangles as the device has them, in float64."""
    vertices = scene.state.device_mesh.vertices.numpy().astype(np.float64)
    a, b, c = vertices[scene.state.device_mesh.faces.numpy()[hits.primitive_id]].transpose(1, 0, 2)
    return (np.cross(b - a, c - a) * directions).sum(axis=1)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("body", ["icosphere", "box", "turned box", "slab", "cylinder", "ellipsoid"])
def test_convex_bodies(body, place, device):
    """Outwards nothing is hit, inwards another triangle, at angles from a thousand millionth of a radian on."""
    scene = wrt.Scene(placed(BODIES[body], place), device=device)
    hits, directions = leave(scene, BODIES[body], 20_000, 1e-9)
    there = hits.is_hit
    assert there.mean() > 0.99
    origins = hits.spawn(directions)
    assert origins.dtype == np.float64
    again = scene.intersect(origins, directions)
    side = exact_sides(scene, hits, directions)
    own = there & (again.primitive_id == hits.primitive_id)
    assert not own.any(), f"{own.sum()} rays meet their own triangle"
    outwards = there & (side > 1e-12 * np.abs(side).max())  # nearer to 0, float64 has its own opinion of the sign
    assert outwards.any()
    assert not again.is_hit[outwards].any(), f"{again.is_hit[outwards].sum()} rays meet a convex body from outside"
    inwards = there & (side < -1e-3 * np.abs(side).max())
    assert inwards.any()
    assert again.is_hit[inwards].all()
    np.testing.assert_array_equal(again.is_hit, scene.occluded(origins, directions))


@pytest.mark.parametrize("place", PLACES)
def test_a_point_on_the_surface_alone_would_not_do(place):
    """What the offset is for: without it, many rays meet their own triangle."""
    scene = wrt.Scene(placed(BODIES["turned box"], place))
    hits, directions = leave(scene, BODIES["turned box"], 20_000, 1e-9)
    again = scene.intersect(hits.position, directions)
    assert (hits.is_hit & (again.primitive_id == hits.primitive_id)).mean() > 0.01


@pytest.mark.parametrize("place", PLACES)
def test_no_jump_across_the_next_wall(place):
    """Of three parallel walls, two millionths of their size apart, rays from the middle one meet the others."""
    corner = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
    walls = np.concatenate([corner + np.array([0, 0, gap]) for gap in (-2e-6, 0.0, 2e-6)])
    faces = np.concatenate([np.array([[0, 1, 2], [0, 2, 3]]) + 4 * wall for wall in range(3)])
    turn = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3])[:3, :3] if place in ("tiny", "one") else np.eye(3)
    scene = wrt.Scene(placed(trimesh.Trimesh(walls @ turn.T, faces, process=False), place))
    rng = np.random.default_rng(1)
    scale, shift = PLACES[place]
    points = (rng.uniform(-0.3, 0.3, (5000, 3)) * [1, 1, 0]) @ turn.T * scale + [shift, -shift, shift / 3]
    normal = turn[:, 2]
    hits = scene.intersect(points + 1e-6 * scale * normal, -normal)
    assert set(hits.primitive_id // 2) == {1}
    for side, expected in ((1.0, 2), (-1.0, 0)):
        directions = np.column_stack([rng.uniform(-3, 3, (5000, 2)), np.full(5000, side)]) @ turn.T
        again = scene.intersect(hits.spawn(directions), directions)
        assert set(again.primitive_id // 2) == {expected}


def test_shapes(device):
    scene = wrt.Scene(BODIES["icosphere"], device=device)
    origins = np.float32([[[0, 0, 3], [0.1, 0, 3], [9, 9, 9]], [[0.3, 0, 3], [0, 0.2, 3], [0, 0, 3]]])
    hits = scene.intersect(origins, np.float32([0, 0, -1]))
    up = hits.spawn([0, 0, 1])
    assert up.shape == (2, 3, 3)
    assert np.isnan(up[0, 2]).all()
    assert (up[..., 2][hits.is_hit] > hits.position[..., 2][hits.is_hit]).all()
    np.testing.assert_allclose(up[hits.is_hit], hits.position[hits.is_hit], atol=1e-5)
    several = hits.spawn(np.broadcast_to(np.float64([0, 0, 1]), (4, 2, 3, 3)))
    np.testing.assert_array_equal(several, np.broadcast_to(up, (4, 2, 3, 3)))
    np.testing.assert_array_equal(hits.spawn(np.broadcast_to(np.float64([0, 0, 1]), (5, 1, 1, 3)))[3], up)
    assert hits.spawn([0, 0, -1])[0, 0, 2] < hits.position[0, 0, 2]
    assert not scene.occluded(up, [0, 0, 1]).any()
    on_device = wp.array(np.broadcast_to(np.float32([0, 0, 1]), (2, 3, 3)), dtype=wp.vec3, device=device)
    assert isinstance(hits.spawn(on_device), wp.array)
    np.testing.assert_array_equal(hits.spawn(on_device).numpy(), up)
    one = scene.intersect([0, 0, 3], [0, 0, -1])
    assert one.spawn([1, 0, 0]).shape == (3,)
    assert one.spawn([[1, 0, 0], [0, 0, 1]]).shape == (2, 3)
    assert scene.intersect(np.zeros((0, 3)), [0, 0, 1]).spawn([0, 0, 1]).shape == (0, 3)


def test_bad_arguments():
    hits = wrt.Scene(BODIES["box"]).intersect(np.zeros((2, 3)), [0, 0, 1])
    with pytest.raises(ValueError, match="broadcast"):
        hits.spawn(np.zeros((5, 3)))
    with pytest.raises(ValueError, match=r"shape \(\.\.\., 3\)"):
        hits.spawn(np.zeros((2, 2)))
    with pytest.raises(TypeError, match="real numbers"):
        hits.spawn(np.zeros((2, 3), dtype=bool))


def test_degenerate_triangles():
    """From a triangle without area there is a way out too."""
    mesh = wrt.TriangleMesh([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]])
    hits = wrt.Scene(mesh).intersect([0.5, 0, 1], [0, 0, -1])
    origins = hits.spawn([0, 0, 1])
    assert np.isfinite(origins).all() if hits.is_hit else np.isnan(origins).all()
