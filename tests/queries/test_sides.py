"""Which side of a surface is meant: `Hits.faces`, `Hits.spawn(side=)`, and points on triangles that no ray found.

By the recipes of the guides, a panel with the sun behind it counted as lit, and a slope of 45 degrees as seeing all of the sky.
"""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
import warp as wp

import wrt

TILT = np.radians(60)
UTM = np.array([5e5, 5e6, 0.0])
NORMAL = np.array([0, -np.sin(TILT), np.cos(TILT)])


def panel(is_flipped=False):
    """A square of two triangles that faces up and south."""
    east = np.array([1.0, 0, 0])
    along = np.cross(NORMAL, east)
    corners = np.array([-east - along, east - along, east + along, along - east]) / 2
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return wrt.TriangleMesh(corners, faces[:, ::-1] if is_flipped else faces)


def spread(directions, hits):
    return np.broadcast_to(np.float32(directions).reshape(-1, *[1] * len(hits.shape), 3), (len(directions), *hits.shape, 3))


SUNS = np.array([[0, -0.8, 0.6], [0, 0.95, 0.31], [0.4, -0.5, 0.7], [0, 0.5, 0.86], [0, 0.5, 0.87]])
"""In front, behind, in front, and barely behind and in front: the panel's plane is at z = 0.866 for y = 0.5."""


def test_the_recipe_of_a_panel(device):
    """A sun behind a panel does not shine on it, although a ray towards it leaves the back freely."""
    scene = wrt.Scene(panel(), device=device)
    places = scene.intersect([[2 * NORMAL]], -NORMAL)
    towards = spread(SUNS, places)
    assert not scene.occluded(places.spawn(towards), towards).any()
    lit = places.faces(towards) & ~scene.occluded(places.spawn(towards), towards)
    np.testing.assert_array_equal(lit[:, 0, 0], [True, False, True, False, True])


def test_the_recipe_of_windings_that_are_not_trusted():
    for is_flipped in (False, True):
        scene = wrt.Scene(panel(is_flipped))
        places = scene.intersect([2 * NORMAL], -NORMAL)
        towards = spread(SUNS[:3], places)
        seen = places.faces(towards) == places.faces(NORMAL)
        np.testing.assert_array_equal((seen & ~scene.occluded(places.spawn(towards), towards))[:, 0], [True, False, True])


def test_faces_is_the_sign_of_the_cosine(device):
    """For many triangles, in instances that mirror, too; misses face nothing."""
    ball = trimesh.creation.icosphere(2)
    mesh = wrt.TriangleMesh(ball.vertices, ball.faces)
    mirror = np.diag([1.0, 1, -2, 1])
    for scene in (wrt.Scene(mesh, device=device), wrt.Scene([wrt.Instance(mesh, mirror)], device=device)):
        rng = np.random.default_rng(0)
        origins = 3 * rng.normal(size=(500, 3))
        hits = scene.intersect(origins, rng.uniform(-1.2, 1.2, (500, 3)) - origins)
        directions = rng.normal(size=(4, 500, 3)).astype(np.float32)
        faces, cosine = hits.faces(directions), (hits.normal * directions).sum(axis=-1)
        assert faces.dtype == bool
        assert faces.shape == (4, 500)
        np.testing.assert_array_equal(faces, (cosine > 0) & hits.is_hit)
        assert faces[:, hits.is_hit].any()
        assert not hits.is_hit.all()
        assert hits.faces(hits.normal)[hits.is_hit].all()
        assert not hits.faces(-hits.normal).any()
        assert not hits.faces(np.zeros(3)).any()
        assert not hits.faces(np.full(3, np.nan)).any()


def test_faces_of_warp_arrays(device):
    scene = wrt.Scene(panel(), device=device)
    rays = wp.array(np.float32([2 * NORMAL] * 2), dtype=wp.vec3, device=device)
    hits = scene.intersect(rays, wp.array(np.float32([-NORMAL] * 2), dtype=wp.vec3, device=device))
    faces = hits.faces(wp.array(np.float32([NORMAL, -NORMAL]), dtype=wp.vec3, device=device))
    assert isinstance(faces, wp.array)
    assert faces.numpy().tolist() == [True, False]


def test_sides_of_spawn(device):
    """From a given side, rays to the other one pass through the triangle, and so meet it: "not lit" without a mask."""
    scene = wrt.Scene(panel(), device=device)
    rng = np.random.default_rng(1)
    hits = scene.points_on(rng.integers(0, 2, 2000), rng.dirichlet([0.4] * 3, 2000)[:, 1:])
    directions = rng.normal(size=(2000, 3)).astype(np.float32)
    front = hits.faces(directions)
    by_side = {side: hits.spawn(directions, side=side) for side in ("direction", "front", "back")}
    above = {side: ((origins - hits.position) * NORMAL).sum(axis=-1) for side, origins in by_side.items()}
    assert (above["front"] > 0).all()
    assert (above["back"] < 0).all()
    np.testing.assert_array_equal(above["direction"] > 0, front)
    np.testing.assert_array_equal(by_side["front"][front], by_side["direction"][front])
    np.testing.assert_array_equal(by_side["back"][~front], by_side["direction"][~front])
    slope = np.abs((directions * NORMAL).sum(axis=-1)) / np.linalg.norm(directions, axis=-1)
    clear = slope > 1e-3
    assert clear.sum() > 1900
    np.testing.assert_array_equal(scene.occluded(by_side["front"], directions)[clear], ~front[clear])
    np.testing.assert_array_equal(scene.occluded(by_side["back"], directions)[clear], front[clear])
    with pytest.raises(ValueError, match="side 'up' is unknown; choose from direction, front, back"):
        hits.spawn(directions, side="up")
    with pytest.raises(TypeError, match="side must be a name"):
        hits.spawn(directions, side=1)


# -- points on triangles -------------------------------------------------------------------------------------------------


def test_points_on_are_hits(device):
    """Of weights, of points, of centroids; with the attributes of a hit."""
    ball = trimesh.creation.icosphere(2)
    scene = wrt.Scene(wrt.TriangleMesh(ball.vertices + UTM, ball.faces), device=device)
    rng = np.random.default_rng(2)
    face, weights = rng.integers(0, 320, (10, 30)), rng.dirichlet([1.0] * 3, (10, 30))
    points = (scene.meshes[0].vertices[ball.faces[face]] * weights[..., None]).sum(axis=-2)
    for hits in (scene.points_on(face, weights[..., 1:]), scene.points_on(face, points=points)):
        assert hits.shape == (10, 30)
        assert hits.is_hit.all()
        assert (hits.t == 0).all()
        assert hits.plan is None
        np.testing.assert_array_equal(hits.primitive_id, face)
        assert (hits.geometry_id == 0).all()
        np.testing.assert_allclose(hits.position, points, atol=3e-7)
        np.testing.assert_allclose(hits.normal, ball.face_normals[face], atol=2e-6)
        outwards = hits.spawn(hits.normal)
        assert not scene.occluded(outwards, hits.normal).any()
        assert scene.occluded(hits.spawn(-hits.normal), -hits.normal).all()
    np.testing.assert_allclose(
        scene.points_on(np.arange(320)).position, scene.meshes[0].vertices[ball.faces].mean(axis=1), atol=3e-7
    )
    some = scene.points_on([-1, 3])
    assert some.is_hit.tolist() == [False, True]
    assert np.isnan(some.spawn([0, 0, 1.0])[0]).all()
    assert np.isinf(some.t[0])


def test_points_near_a_triangle_move_to_it():
    """The nearest point of the triangle, over its inside, its edges and its corners."""
    corners = np.array([[0.0, 0, 0], [10, 0, 0], [0, 5, 0]])
    scene = wrt.Scene(wrt.TriangleMesh(corners, [[0, 1, 2]]))
    given = {(2, 1, 4e-3): (2, 1, 0), (3, -5e-3, 0): (3, 0, 0), (-3e-3, -4e-3, 1e-3): (0, 0, 0), (10.005, 0, 0): (10, 0, 0)}
    given |= {(-2e-3, 2, 0): (0, 2, 0), (4.001, 3.002, 5e-3): (4, 3, 0)}
    hits = scene.points_on(0, points=np.array(list(given), dtype=float))
    np.testing.assert_allclose(hits.position, np.array(list(given.values()), dtype=float), atol=1e-6)


def test_points_on_instances():
    mesh = wrt.TriangleMesh(*(lambda body: (body.vertices, body.faces))(trimesh.creation.icosphere(1)))
    moved = np.diag([3.0, 1, -1, 1])
    moved[:3, 3] = [10, 20, 30]
    scene = wrt.Scene([wrt.Instance(mesh), wrt.Instance(mesh, moved)])
    hits = scene.points_on(np.arange(80)[:, None], instance_id=[0, 1])
    centroids = mesh.vertices[mesh.faces].mean(axis=1)
    assert hits.shape == (80, 2)
    assert (hits.instance_id == [0, 1]).all()
    assert (hits.primitive_id[:, 1] == np.arange(80)).all()
    np.testing.assert_allclose(hits.position[:, 0], centroids, atol=1e-5)
    np.testing.assert_allclose(hits.position[:, 1], centroids @ moved[:3, :3].T + moved[:3, 3], atol=1e-5)
    assert not scene.occluded(hits.spawn(hits.normal), hits.normal)[:, 0].all()


def test_points_on_refuses(device):
    mesh = panel()
    scene = wrt.Scene(mesh, device=device)
    refused = [
        (TypeError, "primitive_id must hold integers", ([0.0],), {}),
        (TypeError, "primitive_id must hold integers", (["a"],), {}),
        (ValueError, r"primitive_id\[1\] is 2", ([0, 2],), {}),
        (ValueError, "primitive_id is -2", (-2,), {}),
        (ValueError, r"instance_id\[0\] is 1", (0,), {"instance_id": [1]}),
        (TypeError, "pass one of them", (0, [0.1, 0.1]), {"points": [0.0, 0, 0]}),
        (ValueError, r"uv must have shape \(..., 2\)", (0, [0.1, 0.1, 0.1]), {}),
        (ValueError, r"uv\[0\] is .*outside of its triangle", (0, [0.6, 0.6]), {}),
        (ValueError, r"uv\[0\] is .*outside of its triangle", (0, [-0.1, 0.6]), {}),
        (ValueError, r"uv\[0\] is .*outside of its triangle", (0, [np.nan, 0.6]), {}),
        (TypeError, "uv must hold real numbers", (0, ["a", "b"]), {}),
        (ValueError, "1 points are not on their triangles", ([0, 0],), {"points": [[0.0, 0, 0], 0.01 * NORMAL]}),
        (ValueError, "1 points are not on their triangles", (0,), {"points": [np.nan, 0.0, 0.0]}),
        (ValueError, "do not broadcast", ([0, 0, 0], [[0.1, 0.1]] * 2), {}),
    ]
    for error, message, arguments, named in refused:
        with pytest.raises(error, match=message):
            scene.points_on(*arguments, **named)
    with pytest.raises(ValueError, match="2 meshes; say with instance_id"):
        wrt.Scene([mesh, mesh], device=device).points_on(0)
