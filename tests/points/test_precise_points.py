"""Closest points in float64: brute force, instances, limits, ties, forms, and what is refused."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import trimesh
import warp as wp
from support.instance_maps import maps
from support.meshes import SCENES
from support.point_oracles import points_around, squares

import wrt

UTM = np.array([5.1e5, 5.2e6, 310.0])
"""Where float32 has steps of half a metre."""


def brute_force(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(N, F) distances of triangles (F, 3, 3), in extended precision."""
    wide, found = corners.astype(np.longdouble), np.empty((len(points), len(corners)))
    for i, point in enumerate(points.astype(np.longdouble)):
        found[i] = np.sqrt(squares(wide - point))
    return found


def check_exact(found: wrt.results.PreciseClosestPoints, corners: np.ndarray, points: np.ndarray, least: float = 0.0) -> None:
    """Asserts that distances and positions are those of brute force, to `least` and the rounding of float64.

    Args:
        found: what is checked.
        corners: (F, 3, 3) float64, in the scene's coordinates.
        points: (N, 3) float64.
        least: greatest error of coordinates that were mapped.
    """
    distance = brute_force(corners, points)
    reach = np.abs(corners[None] - points[:, None, None]).sum(axis=-1).max(axis=(1, 2))
    slack = 16 * 2.0**-53 * (reach + np.abs(points).max()) + least
    for each in (found.distance, found.position, found.uv, found.normal):
        assert each.dtype == np.float64
    assert (np.abs(found.distance - distance.min(axis=1)) <= slack).all()
    assert (np.abs(np.linalg.norm(found.position - points, axis=1) - found.distance) <= slack).all()
    first = np.asarray(found.batch.primitive.numpy())
    assert (distance[np.arange(len(points)), first] <= distance.min(axis=1) + slack).all()


@pytest.mark.parametrize("tree", ["bvh", "kdtree"])
@pytest.mark.parametrize("name", ["teapot", "random_triangles", "needles", "degenerate", "grid"])
def test_brute_force(name, tree, device):
    """Vertices and points that float32 rounds, near 0 and at UTM coordinates."""
    mesh, rng = SCENES[name](), np.random.default_rng(5)
    chosen = mesh.faces[rng.permutation(mesh.triangle_count)[:400]]
    vertices = mesh.vertices.astype(np.float64) * np.pi / 3.0
    points = points_around(mesh, 1100).astype(np.float64) * np.pi / 3.0
    for offset in (np.zeros(3), UTM):
        moved = wrt.TriangleMesh(vertices + offset, chosen)
        found = wrt.Scene(moved, tree, device=device).closest_point(points[::4] + offset, precise=True)
        check_exact(found, moved.vertices[chosen], points[::4] + offset)


def test_instances(device):
    """Moved, turned, mirrored and scaled; masks; both trees alike."""
    mesh = SCENES["random_triangles"]()
    few = wrt.TriangleMesh(mesh.vertices.astype(np.float64) * np.pi, mesh.faces[:80])
    size, found = float(np.ptp(few.bounds, axis=0).max()), []
    placed = [wrt.Instance(few, matrix, mask=1 << number) for number, matrix in enumerate(maps(size))]
    for tree in ("bvh", "kdtree"):
        scene = wrt.Scene(placed, tree, device=device)
        flat = scene.flattened()
        points = points_around(flat, 1100).astype(np.float64)
        found.append(scene.closest_point(points, precise=True))
        few_seen = scene.closest_point(points, precise=True, mask=0b101)
        assert set(few_seen.instance_id) == {0, 2}
    for name in ("distance", "uv", "feature", "primitive_id", "position", "normal"):
        np.testing.assert_array_equal(getattr(found[0], name), getattr(found[1], name))
    assert set(found[0].instance_id) == set(range(5))
    check_exact(found[0], flat.vertices[flat.faces], points, 1e-14 * np.ptp(flat.bounds, axis=0).max())


def test_what_float32_cannot_tell():
    """Of two planes at the same distance in float32, the nearer one; of equal ones, the first; the limit is in float64."""
    square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=np.float64)
    for apart, expected in ((1e-9, 1), (-1e-9, 0), (0.0, 0)):
        planes = [wrt.TriangleMesh(square + np.array([0, 0, z]), [[0, 1, 2], [0, 2, 3]]) for z in (0.0, apart)]
        found = wrt.Scene(planes, device="cpu").closest_point([[0.5, 0.25, 1.0]], precise=True)
        assert (found.geometry_id[0], found.primitive_id[0], found.feature[0]) == (expected, 0, 2)
        assert found.distance[0] == 1.0 - max(apart, 0.0)
    scene = wrt.Scene(wrt.TriangleMesh(square, [[0, 1, 2], [0, 2, 3]]), device="cpu")
    point, exact = [[0.25, 0.5, 0.1]], 0.1
    assert scene.closest_point(point, precise=True, max_distance=exact).is_hit[0]
    missed = scene.closest_point(np.repeat(point, 2, axis=0), precise=True, max_distance=[exact, np.nextafter(exact, 0.0)])
    assert missed.is_hit.tolist() == [True, False]
    assert (missed.distance[1], missed.feature[1], missed.primitive_id[1]) == (np.inf, -1, -1)
    assert np.isnan(missed.position[1]).all()
    bad = scene.closest_point([[np.nan, 0, 0], [0, np.inf, 0], [0, 0, 2.0]], precise=True)
    assert bad.is_hit.tolist() == [False, False, True]


def test_forms():
    """One point, none, Warp arrays, float32 points, lazy trees, pickles; masses of equal distances."""
    sphere = trimesh.creation.icosphere(3)
    scene = wrt.Scene(sphere, wrt.KdTree(builder="lazy"), device="cpu")
    points = points_around(wrt.TriangleMesh(sphere.vertices, sphere.faces), 1100)
    found = scene.closest_point(points, precise=True)
    assert found.distance.dtype == np.float64
    assert isinstance(found, wrt.results.PreciseClosestPoints)
    assert (scene.closest_point(points[5], precise=True).distance, found.shape) == (found.distance[5], (1100,))
    assert scene.closest_point(np.empty((0, 3)), precise=True).position.shape == (0, 3)
    native = scene.closest_point(wp.array(points, dtype=wp.vec3, device="cpu"), precise=True)
    assert (native.distance.dtype, native.position.dtype, native.uv.dtype) == (wp.float64, wp.vec3d, wp.vec2d)
    np.testing.assert_array_equal(native.position.numpy(), found.position)
    again = pickle.loads(pickle.dumps(pickle.loads(pickle.dumps(found))))
    for name in ("distance", "t", "feature", "position", "normal", "uv", "primitive_id"):
        np.testing.assert_array_equal(getattr(again, name), getattr(found, name))
    middle = scene.closest_point(np.zeros((64, 3)), precise=True)
    corners = np.asarray(sphere.triangles)
    np.testing.assert_allclose(middle.distance, brute_force(corners, np.zeros((1, 3))).min(), rtol=1e-15)


@pytest.mark.parametrize(("tree", "placed"), [("bvh", False), ("kdtree", True)])
def test_some_nearest(tree, placed, device):
    """The k nearest triangles are the first of brute force, sorted; the first is that without k; missing ones are none."""
    mesh = SCENES["random_triangles"]()
    few = wrt.TriangleMesh(mesh.vertices.astype(np.float64) * np.pi, mesh.faces[:80])
    size = float(np.ptp(few.bounds, axis=0).max())
    given = [wrt.Instance(few, matrix) for matrix in maps(size)] if placed else few
    scene, k = wrt.Scene(given, tree, device=device), 7
    flat = scene.flattened() if placed else few
    points = points_around(flat, 300).astype(np.float64)
    found, one = scene.closest_point(points, k=k, precise=True), scene.closest_point(points, precise=True)
    assert found.shape == (300, k)
    for name in ("distance", "primitive_id", "instance_id", "uv", "position", "normal", "feature"):
        np.testing.assert_array_equal(getattr(found, name)[:, 0], getattr(one, name))
    corners = flat.vertices[flat.faces].astype(np.float64)
    distance, number = brute_force(corners, points), found.batch.primitive.numpy().reshape(-1, k)
    slack = 1e-13 * size
    np.testing.assert_allclose(found.distance, np.sort(distance, axis=1)[:, :k], rtol=0, atol=slack)
    np.testing.assert_allclose(np.take_along_axis(distance, number, axis=1), found.distance, rtol=0, atol=slack)
    assert all(len(set(row)) == k for row in number)
    assert (np.diff(found.distance, axis=1) >= 0.0).all()
    tied = np.diff(found.distance, axis=1) == 0.0
    assert (np.diff(number, axis=1)[tied] > 0).all()
    np.testing.assert_allclose(np.linalg.norm(found.position - points[:, None], axis=2), found.distance, atol=slack)
    near = np.median(found.distance[:, 2])
    limited = scene.closest_point(points, k=k, max_distance=near, precise=True)
    kept = found.distance <= near
    np.testing.assert_array_equal(limited.primitive_id, np.where(kept, found.primitive_id, -1))
    np.testing.assert_array_equal(limited.distance, np.where(kept, found.distance, np.inf))
    assert not limited.uv[~kept].any()
    assert (limited.feature[~kept] == -1).all()
    with pytest.raises(ValueError, match="k is 0; it must be from 1 to 1024"):
        scene.closest_point(points, k=0, precise=True)


def test_refused():
    scene = wrt.Scene(trimesh.creation.box((1, 1, 1)), device="cpu")
    with pytest.raises(ValueError, match="precise=True takes no counters"):
        scene.closest_point(np.zeros((2, 3)), precise=True, counters=True)
