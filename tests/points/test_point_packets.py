"""Points that follow each other in space, which begin together or walk in packets: the bits of brute force."""

from __future__ import annotations

import numpy as np
import pytest
from support.meshes import SCENES
from support.point_oracles import answers, brute_force, points_around

import wrt
from wrt.query.points.closest_point import closest_point

TREES = {"native": "bvh", "4 wide": wrt.Bvh(width=4), "16 wide": wrt.Bvh(width=16)}


def check_packets(scene: wrt.Scene, points: np.ndarray, max_distance: float | np.ndarray = np.inf) -> None:
    """Asserts that points in the order given have the bits of brute force."""
    found = answers(closest_point(scene.state, points, max_distance, in_order=True))
    for name, values in brute_force(scene, points, max_distance).items():
        np.testing.assert_array_equal(found[name], values, err_msg=name)


@pytest.mark.width
@pytest.mark.parametrize("tree", TREES)
@pytest.mark.parametrize("name", ["random_triangles", "needles", "degenerate", "grid"])
def test_as_by_brute_force(name, tree):
    """Packets that are full or not, of points near each other and far apart, and triangles that need float64."""
    mesh = SCENES[name]()
    scene = wrt.Scene(mesh, TREES[tree], device="cpu")
    scattered = points_around(mesh, 700)
    for count in (1, 15, 33, 700):
        check_packets(scene, scattered[:count])
    for spread in (0.02, 0.0005):  # sparse and dense beside the triangles
        near = scattered[:40, None] + np.linspace(0.0, spread, 67)[:, None] * np.ones(3)
        check_packets(scene, near.reshape(-1, 3).astype(np.float32))


def test_limits():
    """Points that find nothing beside others, and a greatest distance for each."""
    mesh = SCENES["random_triangles"]()
    scene, points = wrt.Scene(mesh, device="cpu"), points_around(mesh, 500)
    size, rng = float(np.ptp(mesh.bounds, axis=0).max()), np.random.default_rng(3)
    most = (size * rng.choice([0.0, 0.01, 0.1, np.inf], 500)).astype(np.float32)
    check_packets(scene, points, most)
    check_packets(scene, points, 0.02 * size)
    points[::7, 1], points[20:60] = np.nan, np.inf
    check_packets(scene, points)
    dense = (points[61] + np.linspace(0.0, 1e-3, 200)[:, None]).astype(np.float32)
    dense[::11, 2], dense[5::16] = np.nan, np.inf
    check_packets(scene, dense)
    check_packets(scene, dense, np.where(np.arange(200) % 3, np.inf, 1e-3 * size).astype(np.float32))
    found = closest_point(scene.state, points, in_order=True)
    assert (found.primitive_id[20:60] == -1).all()
    assert np.isinf(found.distance[::7]).all()


def test_instances():
    """Points are searched one by one."""
    mesh = SCENES["random_triangles"]()
    placed = wrt.Scene([wrt.Instance(mesh, np.eye(4))], device="cpu")
    points = points_around(mesh, 100)
    found, expected = closest_point(placed.state, points, in_order=True), placed.closest_point(points)
    np.testing.assert_array_equal(found.primitive_id, expected.primitive_id)
