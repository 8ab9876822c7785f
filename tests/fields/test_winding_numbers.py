"""Winding numbers by clusters: against solid angles in float64 and closed forms, within their bound, on every kind of scene."""

from __future__ import annotations

import gc
import weakref

import numpy as np
import pytest
import trimesh
import warp as wp
from support.bodies import winding_number as by_solid_angles
from support.open_surfaces import surfaces

import wrt
from wrt.analysis.winding_clusters import farthest_share, levels_of, winding_tree
from wrt.kernels.fields.cluster_moments import MOMENTS, RADIUS

POINTS = np.random.default_rng(0).uniform(-1.6, 1.6, (250, 3))


def exact(mesh: wrt.TriangleMesh, points: np.ndarray = POINTS) -> np.ndarray:
    """Sums of solid angles in float64."""
    corners = np.asarray(mesh.vertices)[mesh.faces].astype(np.float64)
    return np.array([by_solid_angles(corners - point) for point in points])


def covered(mesh: wrt.TriangleMesh, points: np.ndarray = POINTS) -> np.ndarray:
    """The sum of A / (4 pi R^2) over the triangles, by which the bound is stated."""
    corners = np.asarray(mesh.vertices)[mesh.faces].astype(np.float64)
    areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    away = np.linalg.norm(corners.mean(axis=1) - points[:, None], axis=2)
    return (areas / (4.0 * np.pi * away**2)).sum(axis=1)


@pytest.mark.parametrize("name", ["sphere", "30% missing", "half turned over", "two scans", "noise"])
def test_within_the_bound(name):
    """Errors are below the bound, and far below it; the smaller the accuracy, the smaller they are; 0 is exact."""
    mesh = surfaces()[name].mesh
    scene, expected, bound, means = wrt.Scene(mesh, device="cpu"), exact(mesh), covered(mesh), []
    for accuracy in (0.1, 0.5, 2.0):
        error = np.abs(wrt.analysis.winding_number(scene, POINTS, accuracy=accuracy) - expected)
        assert (error <= accuracy * bound + 1e-5).all()
        means.append(error.mean())
    assert means[0] < 1e-4, "a lost moment of the second or the third order makes it five times as large"
    assert means == sorted(means)
    np.testing.assert_allclose(wrt.analysis.winding_number(scene, POINTS, accuracy=0), expected, atol=1e-9)


@pytest.mark.width
@pytest.mark.parametrize("tree", ["bvh", "kdtree", wrt.Bvh(width=4), wrt.KdTree(builder="lazy")], ids=str)
def test_every_tree(tree, device):
    """Also trees that list triangles in several leaves, or are not built yet; Warp in, Warp out."""
    mesh = surfaces()["5% missing"].mesh
    scene = wrt.Scene(mesh, tree, device=device)
    found = wrt.analysis.winding_number(scene, wp.array(POINTS, dtype=wp.vec3d, device=scene.device))
    assert isinstance(found, wp.array)
    np.testing.assert_allclose(found.numpy(), exact(mesh), atol=2e-3)


def test_whole_numbers():
    """1 in a body, 0 outside, -1 in one that is inside out, 2 in both of two; one point; far from 0."""
    sphere = trimesh.creation.icosphere(3)
    scene = wrt.Scene(sphere, device="cpu")
    assert wrt.analysis.winding_number(scene, [0.1, 0.2, 0.0]) == pytest.approx(1.0, abs=2e-3)
    assert wrt.analysis.winding_number(scene, [3.0, 0.2, 0.0]) == pytest.approx(0.0, abs=2e-3)
    turned = wrt.TriangleMesh(sphere.vertices, sphere.faces[:, ::-1])
    assert wrt.analysis.winding_number(wrt.Scene(turned, device="cpu"), [0.1, 0.2, 0.0]) == pytest.approx(-1.0, abs=2e-3)
    both = wrt.Scene([sphere, sphere.copy().apply_translation([1.0, 0.0, 0.0])], device="cpu")
    np.testing.assert_allclose(
        wrt.analysis.winding_number(both, [[0.5, 0, 0], [-0.5, 0, 0], [1.5, 0, 0]]), [2, 1, 1], atol=1e-3
    )
    offset = np.array([5e5, 5.2e6, 300.0])
    far = wrt.Scene(wrt.TriangleMesh(sphere.vertices + offset, sphere.faces), device="cpu")
    np.testing.assert_allclose(wrt.analysis.winding_number(far, POINTS + offset), exact(sphere), atol=2e-3)


def test_instances():
    """Moved, mirrored and stretched ones count, hidden ones do not; an update is followed."""
    sphere = wrt.TriangleMesh(np.asarray(trimesh.creation.icosphere(2).vertices), trimesh.creation.icosphere(2).faces)
    mirrored = np.diag([-1.0, 1.0, 2.0, 1.0])
    mirrored[0, 3] = 1.5
    aside = np.eye(4)
    aside[1, 3] = 5.0
    scene = wrt.Scene([wrt.Instance(sphere), wrt.Instance(sphere, mirrored), wrt.Instance(sphere, aside, mask=0)], device="cpu")
    points = [[0, 0, 0], [1.5, 0, 1.5], [0, 5, 0], [0.75, 0, 0]]
    np.testing.assert_allclose(wrt.analysis.winding_number(scene, points), [1, 1, 0, 2], atol=1e-3)
    np.testing.assert_allclose(wrt.analysis.winding_number(scene, points, accuracy=0), [1, 1, 0, 2], atol=1e-6)
    scene.update(0, transform=aside)
    np.testing.assert_allclose(wrt.analysis.winding_number(scene, points), [0, 1, 1, 1], atol=1e-3)


def test_points_without_a_number():
    """NaN and infinity, and none at all; neighbours in the batch have theirs, sorted or not."""
    scene = wrt.Scene(trimesh.creation.box((1, 1, 1)), device="cpu")
    bad = np.array([[np.nan, 0, 0], [0, np.inf, 0], [0, 0, 0.2], [0, 0, 9.0]] * 500)
    for accuracy in (0, 0.5):
        found = wrt.analysis.winding_number(scene, bad, accuracy=accuracy)
        assert np.isnan(found.reshape(-1, 4)[:, :2]).all()
        np.testing.assert_allclose(found.reshape(-1, 4)[:, 2:], [[1.0, 0.0]] * 500, atol=1e-5)
    assert wrt.analysis.winding_number(scene, np.empty((0, 3))).shape == (0,)
    assert wrt.analysis.winding_number(scene, np.zeros((3, 2, 3), np.float32)).dtype == np.float32


@pytest.mark.parametrize("scale", [1e-12, 1e-6, 1e6, 1e10])
def test_large_and_small_scenes(scale):
    """Numbers do not depend on the unit of length, though float32 does not hold the powers of lengths that they are made of."""
    mesh = surfaces()["30% missing"].mesh
    scaled = wrt.Scene(wrt.TriangleMesh(mesh.vertices * scale, mesh.faces), device="cpu")
    expected = wrt.analysis.winding_number(wrt.Scene(mesh, device="cpu"), POINTS)
    np.testing.assert_allclose(wrt.analysis.winding_number(scaled, POINTS * scale), expected, atol=2e-3)


def test_near_the_center_and_far_away():
    """Points so near to the scene's centre, where unused lanes are, or so far that powers of the distance are out of range."""
    scene = wrt.Scene(trimesh.creation.icosphere(3), device="cpu")
    near = np.outer([0.0, 1e-40, 1e-21, 6e-17, 1e-13, 1e-10], [1.0, 0.5, -0.3])
    np.testing.assert_allclose(wrt.analysis.winding_number(scene, near), 1.0, atol=2e-3)
    far = np.outer([1e4, 1e7, 1e9, 1e13, 1e18, 1e30], [1.0, 0.5, -0.3])
    np.testing.assert_allclose(wrt.analysis.winding_number(scene, far), 0.0, atol=1e-6)


def test_moments_of_a_node():
    """The radius of each child reaches its farthest vertex and not much farther; lanes add up to the surface."""
    scene = wrt.Scene(surfaces()["torus"].mesh, device="cpu")
    tree = winding_tree(scene.state)
    rows = tree.moments.numpy().reshape(-1, int(MOMENTS), scene.state.width)
    used = rows[0, int(RADIUS)] >= 0
    assert used.sum() > 1
    assert (rows[0, int(RADIUS), used] < 1.4).all()
    np.testing.assert_allclose(rows[0, 3:6].sum(axis=1), 0.0, atol=1e-4)
    child = scene.state.tree.struct().child.numpy().reshape(-1, scene.state.width)
    levels = levels_of(child)
    assert sum(count for _, count in levels) == len(child)
    assert winding_tree(scene.state) is tree


@pytest.mark.parametrize("scale", [2.0**-30, 2.0**23, 2.0**33])
def test_powers_of_large_and_small_coordinates(scale):
    """Numbers do not depend on the size of the scene, to the bit for powers of two; far away, they are 0."""
    mesh = surfaces()["torus"].mesh
    expected = wrt.analysis.winding_number(wrt.Scene(mesh, device="cpu"), POINTS)
    scene = wrt.Scene(wrt.TriangleMesh(mesh.vertices * scale, mesh.faces), device="cpu")
    np.testing.assert_array_equal(wrt.analysis.winding_number(scene, POINTS * scale), expected)
    far = np.array([[1e12 * scale, 0.0, 0.0], [0.0, -1e37, 0.0], [1e30, 1e30, 1e30]])
    np.testing.assert_array_equal(wrt.analysis.winding_number(scene, far), 0.0)


def test_clusters_are_as_far_as_the_bound_says():
    for accuracy in (1e-3, 0.5, 4.0):
        q = farthest_share(accuracy)
        assert 4.0 * q**3 / (1.0 - q) ** 2 == pytest.approx(accuracy)
    assert farthest_share(1e-200) > 0.0  # nothing is far, and its inverse is a number


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"accuracy": -1.0}, ValueError, "accuracy must be 0 for exact sums"),
        ({"accuracy": np.inf}, ValueError, "accuracy must be finite|accuracy is inf|finite"),
        ({"accuracy": "low"}, TypeError, "accuracy"),
    ],
)
def test_what_is_refused(options, error, message):
    scene = wrt.Scene(trimesh.creation.box((1, 1, 1)), device="cpu")
    with pytest.raises(error, match=message):
        wrt.analysis.winding_number(scene, [0.0, 0.0, 0.0], **options)
    with pytest.raises(ValueError, match=r"points must have shape"):
        wrt.analysis.winding_number(scene, [0.0, 0.0])
    hidden = wrt.Scene([wrt.Instance(trimesh.creation.box((1, 1, 1)), mask=0)], device="cpu")
    with pytest.raises(ValueError, match="all instances have mask 0"):
        wrt.analysis.winding_number(hidden, [0.0, 0.0, 0.0])


@pytest.mark.parametrize("tree", ["bvh", "kdtree"])
def test_scenes_are_let_go(tree):
    """What is kept of a scene ends with it."""
    scene = wrt.Scene(trimesh.creation.box((1, 1, 1)), tree, device="cpu")
    wrt.analysis.winding_number(scene, [0.0, 0.0, 0.0])
    wrt.analysis.signed_distance(scene, [0.0, 0.0, 0.0], sign="pseudonormal")
    state = weakref.ref(scene.state)
    del scene
    gc.collect()
    assert state() is None


@pytest.mark.parametrize("power", [-60, -46, 30])
def test_tiny_and_huge_scenes(power):
    """Those of the same scene of size 1, to the bit: products of three lengths neither vanish nor overflow."""
    mesh, points = trimesh.creation.icosphere(2), np.random.default_rng(0).uniform(-1.3, 1.3, (500, 3)).astype(np.float32)
    vertices, scale = mesh.vertices.astype(np.float32), np.float32(2.0**power)
    expected = wrt.analysis.winding_number(wrt.Scene(wrt.TriangleMesh(vertices, mesh.faces), device="cpu"), points)
    assert expected.min() < 0.1 < 0.9 < expected.max()
    scene = wrt.Scene(wrt.TriangleMesh(vertices * scale, mesh.faces), device="cpu")
    np.testing.assert_array_equal(wrt.analysis.winding_number(scene, points * scale), expected)
