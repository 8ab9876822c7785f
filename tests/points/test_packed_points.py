"""Points through nodes of 64 bytes, as on CUDA: the bits of brute force. The CPU takes the same steps, a point an item."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from support.meshes import SCENES
from support.point_oracles import answers, brute_force, points_around

import wrt
from wrt.query.points import closest_point as search

TREE = wrt.Bvh(width=2, max_leaf_triangles=2)


@pytest.fixture(autouse=True)
def packed_nodes(monkeypatch):
    """Scenes of width 2 are searched on every device as on CUDA."""
    monkeypatch.setattr(search, "has_packed_nodes", lambda scene: scene.width == TREE.width)


def assert_same(found: dict[str, np.ndarray], expected: dict[str, np.ndarray]) -> None:
    """Equal to the bit."""
    for name, values in expected.items():
        np.testing.assert_array_equal(found[name], values, err_msg=name)


@pytest.mark.parametrize("name", ["random_triangles", "needles", "degenerate"])
def test_nearest(name, device):
    """By persistent threads: points near and far, on vertices and faces, and some that find nothing."""
    mesh = SCENES[name]()
    scene = wrt.Scene(mesh, TREE, device=device)
    for count, most in ((1, np.inf), (33, np.inf), (2000, np.inf), (2000, 0.05 * float(np.ptp(mesh.bounds)))):
        points = points_around(mesh, count)
        points[1::7] = np.nan
        assert_same(answers(scene.closest_point(points, max_distance=most)), brute_force(scene, points, most))


def test_kept_launches(device):
    """Many points in Warp arrays: of other lengths, types and limits than in the call before."""
    mesh = SCENES["random_triangles"]()
    scene = wrt.Scene(mesh, TREE, device=device)
    for count, most, dtype in ((2000, np.inf, np.float32), (1100, 0.1, np.float32), (2300, np.inf, np.float64)):
        points = points_around(mesh, count).astype(dtype)
        points[3::9] = np.inf
        given = wp.array(points, dtype=wp.vec3 if dtype is np.float32 else wp.vec3d, device=device)
        found = scene.closest_point(given, max_distance=float(most))
        known = answers(wrt.Scene(mesh, wrt.Bvh(width=4), device="cpu").closest_point(points, max_distance=most))
        assert_same({name: values.numpy() for name, values in answers(found).items()}, known)
        assert len(scene.state.cache.point_searches.items()) == 1 + (dtype is np.float64)
    rows = scene.closest_point(wp.array(points[:2000].reshape(40, 50, 3), dtype=wp.float64, device=device))
    assert rows.distance.shape == (40, 50)


def test_one_triangle(device):
    """The root has an unused child, whose box is met by nothing and whose leaf has nothing."""
    mesh = wrt.TriangleMesh(np.eye(3), np.array([[0, 1, 2]]))
    points = points_around(mesh, 100)
    points[0], points[1] = 3e19, np.inf
    scene = wrt.Scene(mesh, TREE, device=device)
    found = answers(scene.closest_point(points))
    assert_same(found, brute_force(scene, points))
    assert (found["primitive_id"] == -1).sum() == 2


def points_and_ways(device: str) -> tuple[np.ndarray, list[wrt.Scene]]:
    """Points, and scenes of the same triangles in packed nodes and in wide ones."""
    mesh = SCENES["random_triangles"]()
    return points_around(mesh, 300), [wrt.Scene(mesh, TREE, device=device), wrt.Scene(mesh, wrt.Bvh(width=4), device="cpu")]


def test_lists(device):
    """The same as through wide nodes."""
    points, ways = points_and_ways(device)
    some, expected = (answers(scene.closest_point(points, k=5)) for scene in ways)
    assert_same(some, expected)
    near, expected = (scene.within(points, 0.1) for scene in ways)
    np.testing.assert_array_equal(near.offsets, expected.offsets)
    np.testing.assert_array_equal(near.primitive_id, expected.primitive_id)


@pytest.mark.slow
def test_counters_and_float64(device):
    """What else is searched: the same as through wide nodes."""
    points, ways = points_and_ways(device)
    precise, expected = (scene.closest_point(points, precise=True) for scene in ways)
    np.testing.assert_array_equal(precise.distance, expected.distance)
    counted = ways[0].closest_point(points, counters=True).counters
    assert all((counted[name] > 0).all() for name in ("nodes", "leaves", "triangles"))


@pytest.mark.slow
def test_instances(device):
    """Meshes in packed nodes below the boxes of instances; masks choose."""
    mesh = SCENES["random_triangles"]()
    turn = np.diag([-2.0, 2.0, 2.0, 1.0])
    turn[:3, 3] = 3.0, 0.0, 1.0
    placed = [wrt.Instance(mesh, mask=1), wrt.Instance(mesh, turn, mask=2)]
    points = np.concatenate([points_around(mesh, 300), points_around(mesh, 300) @ turn[:3, :3] + turn[:3, 3]]).astype(
        np.float32
    )
    ways = [wrt.Scene(placed, TREE, device=device), wrt.Scene(placed, wrt.Bvh(width=4), device="cpu")]
    masks = np.tile([1, 2, 3], 200)
    for options in ({}, {"mask": masks}, {"k": 3}):
        found, expected = (answers(scene.closest_point(points, **options)) for scene in ways)
        assert_same(found, expected)
