"""Closest points: brute force with the same bits on every tree, float64, closed forms, ties, limits, and what is refused."""

from __future__ import annotations

import pickle
import subprocess
import sys

import numpy as np
import pytest
import trimesh
import warp as wp
from support.known_areas import described
from support.meshes import SCENES
from support.point_oracles import answers, brute_force, points_around, true_distances

import wrt

TREES = {
    "bvh": "bvh",
    "kdtree": "kdtree",
    "2 wide": wrt.Bvh(width=2),
    "4 wide": wrt.Bvh(width=4),
    "16 wide": wrt.Bvh(width=16),
    "clipped": wrt.KdTree(split_clipping=True),
    "lazy": wrt.KdTree(builder="lazy"),
}


def check_same(scene: wrt.Scene, points: np.ndarray, max_distance: float | np.ndarray = np.inf) -> None:
    """Asserts that the scene's tree gives the bits of brute force."""
    found, expected = answers(scene.closest_point(points, max_distance=max_distance)), brute_force(scene, points, max_distance)
    for name, values in expected.items():
        np.testing.assert_array_equal(found[name], values, err_msg=name)


@pytest.mark.parametrize("tree", ["bvh", "kdtree"])
@pytest.mark.parametrize("name", SCENES)
def test_as_by_brute_force(name, tree, device):
    """Every test scene: bits of distances, triangles, weights and features; points far, near, and on vertices and faces."""
    mesh = SCENES[name]()
    check_same(wrt.Scene(mesh, tree, device=device), points_around(mesh, 2000))


@pytest.mark.width
@pytest.mark.parametrize("tree", [*TREES, "spatial splits"])
@pytest.mark.parametrize("name", ["random_triangles", "needles"])
def test_every_tree(name, tree):
    """Other widths, trees that list a triangle in several leaves, and one that is built where rays visit it."""
    mesh = SCENES[name]()
    scene = wrt.Scene(mesh, described(mesh) if tree == "spatial splits" else TREES[tree], device="cpu")
    assert scene.state.shares_leaves == (tree == "spatial splits" and name == "random_triangles")
    for count in (1, 31, 33, 1500):
        check_same(scene, points_around(mesh, count))


@pytest.mark.parametrize("scale", [1e-12, 1e-4, 1.0, 1e8])
@pytest.mark.parametrize("tree", ["bvh", "kdtree"])
def test_scales(tree, scale):
    """Triangles whose areas have no square in float32, or one that loses digits."""
    mesh = SCENES["random_triangles"]()
    scaled = wrt.TriangleMesh((mesh.vertices * scale).astype(np.float32), mesh.faces)
    scene, points = wrt.Scene(scaled, tree, device="cpu"), points_around(scaled, 1200)
    check_same(scene, points)
    found = scene.closest_point(points)
    size = np.ptp(scaled.bounds, axis=0).max()
    np.testing.assert_allclose(found.distance, true_distances(scaled, points), rtol=1e-5, atol=1e-5 * size)


@pytest.mark.parametrize("name", ["teapot", "random_triangles", "degenerate", "needles", "grid"])
def test_against_float64(name, device):
    """Distances, and positions at these distances that are on their triangles."""
    mesh = SCENES[name]()
    points = points_around(mesh, 1500).astype(np.float64)
    found, size = wrt.Scene(mesh, device=device).closest_point(points), np.ptp(mesh.bounds, axis=0).max()
    expected = true_distances(mesh, points)
    np.testing.assert_allclose(found.distance, expected, rtol=2e-6, atol=4e-6 * size)
    np.testing.assert_allclose(np.linalg.norm(found.position - points, axis=1), expected, rtol=2e-6, atol=4e-6 * size)
    assert found.uv.min() >= 0.0
    assert found.uv.sum(axis=1).max() <= 1.0
    u, v = found.uv.T.astype(np.float64)
    corners = mesh.vertices[mesh.faces[found.primitive_id]].astype(np.float64)
    on = np.einsum("nij,in->nj", corners, np.stack([1.0 - u - v, u, v]))
    np.testing.assert_allclose(found.position, on, atol=1e-6 * size)


def test_a_box(device):
    """Closed form of a box: distance, position, normal, feature."""
    box = trimesh.creation.box((2.0, 4.0, 6.0))
    rng = np.random.default_rng(2)
    points = rng.uniform(-6, 6, (40, 50, 3))
    half = np.array([1.0, 2.0, 3.0])
    nearest, room = np.clip(points, -half, half), half - np.abs(points)
    inside, axis = (room > 0).all(axis=-1), room.argmin(axis=-1)
    at_side = np.where(np.arange(3) == axis[..., None], np.copysign(half, points), points)
    nearest = np.where(inside[..., None], at_side, nearest)
    found = wrt.Scene(box, device=device).closest_point(points)
    assert (found.shape, found.distance.shape, found.distance.dtype) == ((40, 50), (40, 50), np.float32)
    apart = np.linalg.norm(found.position - nearest, axis=-1)
    assert (apart < 1e-5 + 5e-4 * found.distance).all()  # what differs less has the same distance in float32
    assert np.mean(apart < 1e-5) > 0.99
    np.testing.assert_allclose(found.distance, np.linalg.norm(points - nearest, axis=-1), rtol=2e-6)
    outside = (np.abs(points) > half).sum(axis=-1)
    np.testing.assert_array_equal(found.feature[outside == 3], 0)
    np.testing.assert_array_equal(found.feature[outside == 2], 1)
    at_face = ((outside == 1) | inside) & (apart < 1e-5)
    assert (found.feature[at_face] >= 1).all()
    along = np.where(inside, axis, (np.abs(points) - half).argmax(axis=-1))
    np.testing.assert_array_equal(np.abs(found.normal[at_face]).argmax(axis=-1), along[at_face])


def test_a_sphere_and_a_torus(device):
    """Fine meshes of round bodies: within their deviation from the body."""
    rng = np.random.default_rng(3)
    points = rng.uniform(-2, 2, (3000, 3))
    sphere = wrt.Scene(trimesh.creation.icosphere(5), device=device).closest_point(points)
    np.testing.assert_allclose(sphere.distance, np.abs(np.linalg.norm(points, axis=1) - 1.0), atol=1.2e-3)
    torus = trimesh.creation.torus(1.0, 0.4, major_sections=256, minor_sections=128)
    ring = np.hypot(np.linalg.norm(points[:, :2], axis=1) - 1.0, points[:, 2])
    found = wrt.Scene(torus, device=device).closest_point(points)
    np.testing.assert_allclose(found.distance, np.abs(ring - 0.4), atol=1.2e-3)


def test_ties(device):
    """At a vertex, at an edge and between equal triangles, the smallest geometry, then the smallest triangle."""
    sphere = trimesh.creation.icosphere(3)
    vertices = np.asarray(sphere.vertices, dtype=np.float32)
    faces = np.asarray(sphere.faces)
    meshes = [wrt.TriangleMesh(vertices, faces), wrt.TriangleMesh(vertices, faces[::-1])]
    for tree in ("bvh", "kdtree"):
        found = wrt.Scene(meshes, tree, device=device).closest_point(vertices)
        first = np.array([np.flatnonzero((faces == number).any(axis=1))[0] for number in range(len(vertices))])
        np.testing.assert_array_equal(found.distance, 0.0)
        np.testing.assert_array_equal(found.geometry_id, 0)
        np.testing.assert_array_equal(found.primitive_id, first)
        np.testing.assert_array_equal(found.feature, 0)
        np.testing.assert_array_equal(found.position, vertices)
        away = wrt.Scene(meshes, tree, device=device).closest_point(vertices * np.float32(3.0))
        np.testing.assert_array_equal(away.primitive_id, first)
        np.testing.assert_array_equal(away.feature, 0)
    roof = wrt.TriangleMesh(np.float32([[0, 0, 0], [4, 0, 0], [2, 3, -1], [2, -3, -1]]), [[0, 3, 1], [1, 2, 0]])
    along = np.stack([np.linspace(0.1, 3.9, 77), np.zeros(77), np.linspace(0.01, 5, 77)], axis=1).astype(np.float32)
    found = wrt.Scene(roof, device=device).closest_point(along)
    np.testing.assert_array_equal(found.primitive_id, 0)
    np.testing.assert_array_equal(found.feature, 1)
    np.testing.assert_allclose(found.distance, along[:, 2], rtol=2e-6)


def test_max_distance(device):
    """The limit is included; it may be one for each point; with it, brute force gives the same bits."""
    mesh = wrt.TriangleMesh(np.float32([[0, 0, 0], [1, 0, 0], [0, 1, 0]]), [[0, 1, 2]])
    scene = wrt.Scene(mesh, device=device)
    point = np.float32([[0.25, 0.25, 0.5]])
    assert scene.closest_point(point, max_distance=0.5).distance == 0.5
    missed = scene.closest_point(point, max_distance=np.nextafter(np.float32(0.5), np.float32(0)))
    assert (missed.distance[0], missed.primitive_id[0], missed.feature[0], missed.is_hit[0]) == (np.inf, -1, -1, False)
    assert np.isnan(missed.position).all()
    assert (missed.uv == 0).all()
    each = scene.closest_point(np.repeat(point, 4, axis=0), max_distance=[0.0, 0.49, 0.5, np.inf])
    assert each.is_hit.tolist() == [False, False, True, True]
    assert scene.closest_point([[0.25, 0.25, 0.0]], max_distance=0.0).is_hit.all()
    teapot, rng = SCENES["teapot"](), np.random.default_rng(1)
    points, size = points_around(teapot, 1500), np.ptp(teapot.bounds, axis=0).max()
    for tree in ("bvh", "kdtree"):
        for most in (0.02 * size, (0.2 * size * rng.random(1500)).astype(np.float32)):
            check_same(wrt.Scene(teapot, tree, device=device), points, most)


def test_points_without_an_answer(device):
    """NaN, infinity, and points whose squared distance no float32 holds; their neighbours in the batch are answered."""
    scene = wrt.Scene(trimesh.creation.box((1, 1, 1)), device=device)
    bad = [[np.nan, 0, 0], [0, np.inf, 0], [0, 0, -np.inf], [1e30, 0, 0], [3e38, 3e38, 3e38], [0, 0, 2.0], [1e18, 0, 0]]
    found = scene.closest_point(np.array(bad * 300))
    np.testing.assert_array_equal(found.is_hit, ([False] * 5 + [True] * 2) * 300)
    assert np.isnan(found.position[0]).all()
    assert (found.distance[5], found.distance[0]) == (1.5, np.inf)


def test_degenerate_triangles():
    """A segment, a point, three vertices on a line in each order, and a needle that has an area."""
    a, b, c = np.float32([0, 0, 0]), np.float32([3, 0, 0]), np.float32([1, 0, 0])
    points = np.float32([[1.0, 2.0, 0.0], [-3.0, 4.0, 0.0], [4.0, 0.0, 0.0], [2.5, 0.0, 0.25]])
    along = np.clip(points[:, 0], 0, 3)
    expected = np.hypot(points[:, 0] - along, np.linalg.norm(points[:, 1:], axis=1))
    for corners in (
        [a, b, c],
        [b, c, a],
        [c, a, b],
        [a, c, b],
        [a, b, b],
        [a, a, b],
        [b, a, b],
        [a, b, c + np.float32([0, 1e-20, 0])],
    ):
        found = wrt.Scene(wrt.TriangleMesh(np.array(corners), [[0, 1, 2]]), device="cpu").closest_point(points)
        np.testing.assert_allclose(found.distance, expected, rtol=1e-6)
        assert (found.feature < 2).all() or corners[2][1] > 0
    found = wrt.Scene(wrt.TriangleMesh(np.array([b, b, b]), [[0, 1, 2]]), device="cpu").closest_point(points)
    np.testing.assert_allclose(found.distance, np.linalg.norm(points - b, axis=1), rtol=1e-6)
    np.testing.assert_array_equal(found.feature, 0)


def test_far_from_zero():
    """float64 points at UTM coordinates: as near zero, to float32 relative to the scene's centre."""
    sphere, offset = trimesh.creation.icosphere(3), np.array([5e5, 5.2e6, 300.0])
    points = np.random.default_rng(4).uniform(-2, 2, (500, 3))
    here = wrt.Scene(sphere, device="cpu").closest_point(points)
    there = wrt.Scene(wrt.TriangleMesh(sphere.vertices + offset, sphere.faces), device="cpu").closest_point(points + offset)
    np.testing.assert_allclose(there.distance, here.distance, atol=1e-6)
    np.testing.assert_allclose(there.position - offset, here.position, atol=2e-4)  # at ridges, either side
    assert there.position.dtype == np.float64


def test_forms(device):
    """One point, none, Warp in and Warp out, float32 and float64, threads, and an update."""
    mesh = SCENES["teapot"]()
    scene, points = wrt.Scene(mesh, device=device), points_around(mesh, 1200)
    one, all_found = scene.closest_point(points[7]), scene.closest_point(points)
    assert one.distance.shape == ()
    assert (one.distance, one.primitive_id) == (all_found.distance[7], all_found.primitive_id[7])
    assert scene.closest_point(np.empty((0, 3))).distance.shape == (0,)
    native = scene.closest_point(wp.array(points.reshape(30, 40, 3), dtype=wp.vec3, device=device))
    assert isinstance(native.distance, wp.array)
    assert native.feature.shape == native.distance.shape == (30, 40)
    for name, values in answers(all_found).items():
        np.testing.assert_array_equal(getattr(native, name).numpy().reshape(values.shape), values)
    single = wrt.Scene(mesh, device=device, num_threads=1).closest_point(points)
    np.testing.assert_array_equal(single.distance, all_found.distance)
    assert all_found.position.dtype == np.float32
    assert scene.closest_point(points.astype(np.float64)).position.dtype == np.float64
    scene.update(0, vertices=mesh.vertices * np.float32(2.0))
    check_same(scene, points)


def test_as_hits():
    """What hits have: interpolated values, origins of rays, pickles."""
    mesh = SCENES["teapot"]()
    points = points_around(mesh, 300)
    found = wrt.Scene(mesh, device="cpu").closest_point(points, max_distance=np.ptp(mesh.bounds, axis=0).max() / 8)
    assert 0.1 < found.is_hit.mean() < 0.9
    np.testing.assert_allclose(
        found.interpolate(mesh.vertices)[found.is_hit], found.position[found.is_hit], rtol=1e-5, atol=1e-4
    )
    assert np.isfinite(found.spawn(np.float32([0, 0, 1]))[found.is_hit]).all()
    other = pickle.loads(pickle.dumps(pickle.loads(pickle.dumps(found))))
    for name in ("distance", "feature", "position", "normal", "primitive_id", "geometry_id"):
        np.testing.assert_array_equal(getattr(other, name), getattr(found, name))
    assert repr(found) == "ClosestPoints(shape=(300,))"


REFUSED = {
    "negative": (lambda scene: scene.closest_point(np.zeros((2, 3)), max_distance=-1.0), "max_distance must be 0 or more"),
    "NaN": (lambda scene: scene.closest_point(np.zeros((2, 3)), max_distance=[1.0, np.nan]), "max_distance must be 0 or more"),
    "shape": (lambda scene: scene.closest_point(np.zeros((2, 3)), max_distance=[1.0, 2.0, 3.0]), "does not broadcast"),
    "points": (lambda scene: scene.closest_point(np.zeros((2, 2))), r"points must have shape \(..., 3\)"),
    "instances": (
        lambda scene: wrt.Scene(wrt.Instance(scene.meshes[0], np.diag([1, 1, 2, 1])), device="cpu").closest_point(np.zeros(3)),
        r"instance 0 is not; use wrt.Scene\(scene.flattened\(\)\)",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused(case):
    call, message = REFUSED[case]
    with pytest.raises(ValueError, match=message):
        call(wrt.Scene(trimesh.creation.box((1, 1, 1)), device="cpu"))


LOADED = """
import numpy as np, wrt
from wrt.kernels.runtime import launch
scene = wrt.Scene(wrt.TriangleMesh(np.random.default_rng(0).random((3000, 3)), np.arange(3000).reshape(-1, 3)), device="cpu")
before = {kernel.key for kernel, _ in launch._loaded}
scene.closest_point(np.random.default_rng(0).random((3000, 3))).distance
print(*(key.split("__")[-1] for key in {kernel.key for kernel, _ in launch._loaded} - before))
"""


def test_no_kernel_of_rays_is_compiled():
    run = subprocess.run([sys.executable, "-c", LOADED], capture_output=True, text=True, check=True)
    loaded = run.stdout.split()
    assert "nearest_triangles" in loaded
    assert set(loaded) <= {"nearest_triangles", "shift_vertices", "find_cells", "pack_records"}
