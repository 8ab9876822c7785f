"""`wrt.compat.RayMeshIntersector` in the place of trimesh's: the same types, the same answers where those are right, and
beyond."""

from __future__ import annotations

import copy
import importlib
import pickle

import numpy as np
import pytest
import trimesh
from trimesh.ray import ray_triangle

import wrt

BODIES = {
    "box": trimesh.creation.box(),
    "sphere": trimesh.creation.icosphere(subdivisions=2),
    "torus": trimesh.creation.torus(1.0, 0.4),
}


def ball_and_broken_ball() -> trimesh.Trimesh:
    """A sphere with a hole, and a whole one inside it."""
    shell = trimesh.creation.icosphere(subdivisions=2, radius=3.0)
    shell.update_faces(np.arange(len(shell.faces)) > 5)
    return trimesh.util.concatenate([shell, trimesh.creation.icosphere(subdivisions=2)])


def rays_around(mesh: trimesh.Trimesh, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Rays from a sphere around the mesh to points of its box, float64, unit directions."""
    rng = np.random.default_rng(seed)
    origins = trimesh.unitize(rng.normal(size=(count, 3))) * mesh.scale * 1.5 + mesh.bounds.mean(axis=0)
    return origins, trimesh.unitize(rng.uniform(*mesh.bounds, (count, 3)) - origins)


def swapped(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """A copy whose rays are answered by wrt."""
    mesh = mesh.copy()
    mesh.ray = wrt.compat.RayMeshIntersector(mesh)
    return mesh


@pytest.mark.parametrize("body", BODIES)
def test_same_answers_as_trimesh(body):
    pytest.importorskip("rtree")
    mesh = BODIES[body]
    ours, theirs = wrt.compat.RayMeshIntersector(mesh), ray_triangle.RayMeshIntersector(mesh)
    origins, directions = rays_around(mesh, 200)
    for locations in (False, True):
        got = ours.intersects_id(origins, directions, return_locations=locations)
        expected = theirs.intersects_id(origins, directions, return_locations=locations)
        assert len(got) == len(expected) == 2 + locations
        assert [part.dtype for part in got] == [part.dtype for part in expected]
        assert [part.shape for part in got] == [part.shape for part in expected]
        order, theirs_order = np.lexsort(got[:2]), np.lexsort(expected[:2])
        np.testing.assert_array_equal(got[0][order], expected[0][theirs_order])
        np.testing.assert_array_equal(got[1][order], expected[1][theirs_order])
    np.testing.assert_allclose(got[2][order], expected[2][theirs_order], atol=1e-12)
    points, index_ray, index_tri = ours.intersects_location(origins, directions)
    np.testing.assert_array_equal(points, got[2])
    np.testing.assert_array_equal(index_ray, got[1])
    np.testing.assert_array_equal(index_tri, got[0])
    first, first_expected = ours.intersects_first(origins, directions), theirs.intersects_first(origins, directions)
    np.testing.assert_array_equal(first, first_expected)
    assert first.dtype == first_expected.dtype
    np.testing.assert_array_equal(ours.intersects_any(origins, directions), theirs.intersects_any(origins, directions))
    points = np.random.default_rng(1).uniform(*mesh.bounds, (200, 3))
    np.testing.assert_array_equal(ours.contains_points(points), theirs.contains_points(points))


def test_rows_come_ray_by_ray_nearest_first():
    mesh = BODIES["torus"]
    origins, directions = rays_around(mesh, 500)
    points, index_ray, _ = wrt.compat.RayMeshIntersector(mesh).intersects_location(origins, directions)
    distance = np.linalg.norm(points - origins[index_ray], axis=1)
    same = index_ray[1:] == index_ray[:-1]
    assert (np.diff(index_ray) >= 0).all()
    assert same.any()
    assert (np.diff(distance)[same] > 0).all()


def test_first_hits_and_bounds():
    mesh = BODIES["torus"]
    ray = wrt.compat.RayMeshIntersector(mesh)
    origins, directions = rays_around(mesh, 500)
    first = ray.intersects_first(origins, directions)
    index_tri, index_ray = ray.intersects_id(origins, directions, multiple_hits=False)
    np.testing.assert_array_equal(index_ray, np.flatnonzero(first >= 0))
    np.testing.assert_array_equal(index_tri, first[index_ray])
    points, by_location, _ = ray.intersects_location(origins, directions, multiple_hits=False)
    np.testing.assert_array_equal(by_location, index_ray)
    _, every, all_points = ray.intersects_id(origins, directions, return_locations=True)
    np.testing.assert_allclose(points, all_points[np.unique(every, return_index=True)[1]], atol=1e-12)
    _, two = ray.intersects_id(origins, directions, max_hits=2)
    assert np.bincount(every).max() == 4
    np.testing.assert_array_equal(np.bincount(two), np.minimum(np.bincount(every), 2))
    for bad, error in ((0, ValueError), (1.5, TypeError)):
        with pytest.raises(error, match="max_hits"):
            ray.intersects_id(origins, directions, multiple_hits=False, max_hits=bad)


def test_empty_answers():
    """Of rays that miss, of no rays, and of a mesh without faces."""
    away, sky = np.full((4, 3), 5.0), np.ones((4, 3))
    for mesh, origins, directions in (
        (BODIES["box"], away, sky),
        (BODIES["box"], np.zeros((0, 3)), np.zeros((0, 3))),
        (trimesh.Trimesh(), away, sky),
    ):
        ray = wrt.compat.RayMeshIntersector(mesh)
        for several in (True, False):
            index_tri, index_ray, points = ray.intersects_id(origins, directions, multiple_hits=several, return_locations=True)
            assert index_tri.shape == index_ray.shape == (0,)
            assert index_tri.dtype == index_ray.dtype == np.int64
            assert points.shape == (0, 3)
            assert points.dtype == np.float64
        np.testing.assert_array_equal(ray.intersects_first(origins, directions), np.full(len(origins), -1))
        assert ray.intersects_any(origins, directions).shape == (len(origins),)
        assert not ray.intersects_any(origins, directions).any()
        assert not ray.contains_points(origins).any()


@pytest.mark.parametrize("body", BODIES)
def test_rays_at_vertices_and_edges(body):
    """From outside, a ray at a vertex of a closed mesh hits it, and crosses it an even number of times."""
    mesh = BODIES[body]
    ray = wrt.compat.RayMeshIntersector(mesh)
    targets = np.concatenate([mesh.vertices, mesh.vertices[mesh.edges_unique].mean(axis=1)])
    center = mesh.bounds.mean(axis=0)
    origins = center + (targets - center) * 3.0
    inwards = targets - origins
    if body != "torus":
        assert ray.intersects_any(origins, inwards).all()
        assert (ray.intersects_first(origins, inwards) >= 0).all()
    _, index_ray = ray.intersects_id(origins, inwards)
    counts = np.bincount(index_ray, minlength=len(origins))
    assert (counts % 2 == 0).all()
    if body != "torus":
        assert (counts == 2).all()


def test_every_hit_of_a_box():
    """Grids of axis-parallel rays through a box, two hits each, on the planes of its faces."""
    mesh = BODIES["box"]
    ray = wrt.compat.RayMeshIntersector(mesh)
    steps = np.linspace(-0.5, 0.5, 9)[1:-1]
    grid = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    for axis in range(3):
        origins = np.insert(grid, axis, -2.0, axis=1)
        directions = np.tile(np.eye(3)[axis], (len(grid), 1))
        points, index_ray, index_tri = ray.intersects_location(origins, directions)
        np.testing.assert_array_equal(index_ray, np.repeat(np.arange(len(grid)), 2))
        np.testing.assert_allclose(points[:, axis], np.tile([-0.5, 0.5], len(grid)), atol=1e-15)
        np.testing.assert_allclose(np.abs(mesh.face_normals[index_tri, axis]), 1.0)


def test_contains_points():
    sphere = swapped(BODIES["sphere"])
    points = np.random.default_rng(0).uniform(-1.2, 1.2, (2000, 3))
    radius = np.linalg.norm(points, axis=1)
    inside = sphere.contains(points)  # through mesh.ray
    assert inside[radius < 0.95].all()
    assert not inside[radius > 1.0].any()
    assert sphere.contains([[0.0, 0.0, 0.0]]).tolist() == [True]
    broken = swapped(ball_and_broken_ball())
    points *= 3.0
    radius = np.linalg.norm(points, axis=1)
    between = (radius > 1.05) & (radius < 2.0)
    assert broken.ray.contains_points(points)[between].mean() > 0.95
    assert not broken.ray.contains_points(points)[radius > 3.0].any()
    assert not broken.ray.contains_points(points)[radius < 0.9].any()


def test_what_trimesh_computes_with_rays():
    """Wall thickness, through `mesh.ray`."""
    pytest.importorskip("rtree")
    mesh, plain = swapped(BODIES["sphere"]), BODIES["sphere"].copy()
    plain.ray = ray_triangle.RayMeshIntersector(plain)
    points = mesh.triangles_center[::7]
    inwards = -mesh.face_normals[::7]
    reached, expected = (trimesh.proximity.longest_ray(body, points, inwards) for body in (mesh, plain))
    assert (reached > 1.0).all()
    np.testing.assert_allclose(reached, expected, atol=1e-6)


def test_follows_the_mesh():
    mesh = swapped(BODIES["box"])
    origin, down = np.array([[0.1, 0.2, 9.0]]), np.array([[0.0, 0.0, -1.0]])
    first = mesh.ray.scene
    assert mesh.ray.intersects_location(origin, down)[0][0, 2] == pytest.approx(0.5)
    assert mesh.ray.scene is first
    mesh.apply_translation([0.0, 0.0, 2.0])
    assert mesh.ray.scene is not first
    assert mesh.ray.intersects_location(origin, down)[0][0, 2] == pytest.approx(2.5)
    mesh.vertices[:, 2] += 1.0  # in place
    assert mesh.ray.intersects_location(origin, down)[0][0, 2] == pytest.approx(3.5)
    mesh.update_faces(np.zeros(len(mesh.faces), dtype=bool))
    assert not mesh.ray.intersects_any(origin, down).any()


def test_pickles_and_copies():
    mesh = swapped(BODIES["sphere"])
    origins, directions = rays_around(mesh, 50)
    expected = mesh.ray.intersects_first(origins, directions)
    thawed = pickle.loads(pickle.dumps(mesh))
    assert isinstance(thawed.ray, wrt.compat.RayMeshIntersector)
    assert thawed.ray.mesh is thawed
    np.testing.assert_array_equal(thawed.ray.intersects_first(origins, directions), expected)
    for twin in (copy.copy(mesh.ray), copy.deepcopy(mesh.ray)):
        assert twin.mesh is mesh
        np.testing.assert_array_equal(twin.intersects_first(origins, directions), expected)
    options = wrt.compat.RayMeshIntersector(mesh, accelerator="kdtree", num_threads=1)
    twin = pickle.loads(pickle.dumps(options))
    assert twin.scene.accelerator.kind == "kdtree"
    assert twin.scene.num_threads == 1


def test_far_from_the_origin():
    """Float64 locations of float64 meshes: nothing is lost at ten million."""
    mesh = BODIES["sphere"].copy()
    mesh.apply_translation([1e7, -1e7, 1e7])
    origins, directions = rays_around(mesh, 300)
    points, index_ray, index_tri = wrt.compat.RayMeshIntersector(mesh).intersects_location(origins, directions)
    assert len(index_ray) > 300
    to_plane = np.einsum("ij,ij->i", points - mesh.triangles[index_tri, 0], mesh.face_normals[index_tri])
    np.testing.assert_allclose(to_plane, 0.0, atol=1e-8)
    along = points - origins[index_ray]
    np.testing.assert_allclose(np.cross(along, directions[index_ray]), 0.0, atol=1e-7)


def test_grazing_locations():
    """Almost in a face's plane, the weights say where a hit lies: in the triangle."""
    mesh = BODIES["box"]
    origins = np.array([[-3.0, 0.1, 0.5 + 1e-6]])
    directions = np.array([[1.0, 0.0, -3.3e-7]])
    points, _, index_tri = wrt.compat.RayMeshIntersector(mesh).intersects_location(origins, directions)
    assert len(points)
    low, high = mesh.triangles[index_tri].min(axis=1), mesh.triangles[index_tri].max(axis=1)
    assert ((points >= low - 1e-5) & (points <= high + 1e-5)).all()


def test_bad_rays_miss():
    ray = wrt.compat.RayMeshIntersector(BODIES["box"])
    origins = np.array([[0, 0, -2.0], [np.nan, 0, -2], [0, 0, -2]])
    directions = np.array([[0, 0, 1.0], [0, 0, 1], [0, 0, 0]])
    assert (ray.intersects_first(origins, directions) >= 0).tolist() == [True, False, False]
    assert set(ray.intersects_id(origins, directions)[1]) == {0}


def test_bad_arguments():
    ray = wrt.compat.RayMeshIntersector(BODIES["box"])
    with pytest.raises(TypeError, match=r"trimesh\.Trimesh"):
        wrt.compat.RayMeshIntersector("box.ply")
    with pytest.raises(ValueError, match="same shape"):
        ray.intersects_first(np.zeros((2, 3)), np.ones((3, 3)))
    with pytest.raises(ValueError, match="ray_origins must have shape"):
        ray.intersects_any([0.0, 0, 0], [0.0, 0, 1])
    with pytest.raises(ValueError, match="ray_directions must"):
        ray.intersects_id(np.zeros((2, 3)), [[0, 0, 1], [0, 0]])
    with pytest.raises(TypeError, match="real numbers"):
        ray.intersects_id(np.zeros((2, 3)), np.zeros((2, 3), dtype=complex))
    with pytest.raises(ValueError, match="points must have shape"):
        ray.contains_points(np.zeros(3))
    assert ray.intersects_first([[0, 0, -2]], [[0, 0, 1]])[0] >= 0  # lists of integers do


@pytest.mark.parametrize("primitive", [trimesh.primitives.Sphere, trimesh.primitives.Box, trimesh.primitives.Cylinder])
def test_in_the_place_of_the_class(primitive, monkeypatch):
    """trimesh makes the intersector of a primitive before it has faces, which was a TypeError."""
    module = importlib.import_module("trimesh.ray.ray_pyembree") if trimesh.ray.has_embree else ray_triangle
    monkeypatch.setattr(module, "RayMeshIntersector", wrt.compat.RayMeshIntersector)
    mesh = primitive()
    assert isinstance(mesh.ray, wrt.compat.RayMeshIntersector)
    plain = wrt.compat.RayMeshIntersector(trimesh.Trimesh(mesh.vertices, mesh.faces, process=False))
    rays = rays_around(mesh, 100)
    np.testing.assert_array_equal(mesh.ray.intersects_first(*rays), plain.intersects_first(*rays))
    assert mesh.contains([mesh.center_mass]).all()


def test_no_mesh_is_refused():
    with pytest.raises(TypeError, match=r"must be a trimesh\.Trimesh, not Scene"):
        wrt.compat.RayMeshIntersector(trimesh.Scene())
