"""Few points in NumPy arrays go by a kept launch: the same answers, to the bit, whatever was asked before."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import warp as wp

import wrt
from wrt import scenes

CENTER = np.array([300.0, 0.0, 1.0])


def body(center):
    """A teapot around a point."""
    mesh = scenes.build("teapot", level=3, ground=False)
    low, high = mesh.bounds
    return wrt.TriangleMesh((mesh.vertices - (low + high) / 2) / (high - low).max() * 2.0 + center, mesh.faces)


@pytest.fixture(scope="module", params=["bvh", "kdtree"])
def scene(request):
    return wrt.Scene(body(CENTER), device="cpu", accelerator=request.param)


def some_points(count, dtype, seed=0):
    points = np.random.default_rng(seed).uniform(-2.0, 2.0, (count, 3)) + CENTER
    if count > 3:
        points[1], points[2, 0] = np.nan, np.inf
    return points.astype(dtype)


def by_warp(scene, points, **options):
    """The same from a Warp array, which is never taken for few points."""
    kind = wp.vec3d if points.dtype == np.float64 else wp.vec3
    return scene.closest_point(wp.array(points.reshape(-1, 3), dtype=kind, device="cpu"), **options)


def assert_same(found, expected, shape):
    for name in ("distance", "position", "primitive_id", "geometry_id", "uv", "normal", "feature"):
        values = getattr(found, name)
        assert isinstance(values, np.ndarray), name
        assert values.shape[: len(shape)] == shape, name
        np.testing.assert_array_equal(values.reshape(-1), getattr(expected, name).numpy().reshape(-1), err_msg=name)
        assert values.dtype == getattr(expected, name).numpy().dtype


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("shape", [(), (1,), (5,), (2, 7), (1000,)])
def test_answers(scene, shape, dtype):
    points = some_points(int(np.prod(shape)), dtype).reshape(*shape, 3)
    for options in ({}, {"max_distance": 0.6}, {"max_distance": 1e300}):
        assert_same(scene.closest_point(points, **options), by_warp(scene, points, **options), shape)
    assert len(scene.state.cache.few_points) == 1


LAYOUTS = {
    "every other": lambda points: np.repeat(points, 2, axis=0)[::2],
    "by columns": np.asfortranarray,
    "columns backwards": lambda points: points[:, ::-1].copy()[:, ::-1],
    "backwards": lambda points: points[::-1].copy()[::-1],
    "of a wider table": lambda points: np.tile(points, 2)[:, :3],
}


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_layouts_of_points(scene, layout, dtype):
    points = some_points(20, dtype)
    given = LAYOUTS[layout](points)
    np.testing.assert_array_equal(given, points)
    assert_same(scene.closest_point(given), by_warp(scene, points), (20,))


def test_answers_are_kept(scene):
    """A later call writes to memory of its own."""
    first, points = scene.closest_point(some_points(9, np.float64)), some_points(9, np.float64, seed=1)
    before = {name: getattr(first, name).copy() for name in ("distance", "primitive_id", "feature")}
    scene.closest_point(points)
    for name, values in before.items():
        np.testing.assert_array_equal(getattr(first, name), values)


def test_callers_at_once(scene):
    points = [some_points(50, np.float64, seed) for seed in range(12)]
    expected = [by_warp(scene, one).distance.numpy() for one in points]
    with ThreadPoolExecutor(4) as executor:
        found = list(executor.map(lambda one: scene.closest_point(one).distance, points * 5))
    for number, one in enumerate(found):
        np.testing.assert_array_equal(one, expected[number % len(points)])


def test_a_scene_that_moves():
    mesh = body(0.0)
    scene, points, way = wrt.Scene(mesh, device="cpu"), some_points(6, np.float64) - CENTER, np.array([5.0, 0.0, 0.0])
    before = scene.closest_point(points).distance
    scene.update(0, vertices=mesh.vertices + way)
    after = scene.closest_point(points + way)
    np.testing.assert_allclose(after.distance, before, rtol=1e-5)
    assert_same(after, by_warp(scene, points + way), (6,))


@pytest.mark.parametrize("most", [-1.0, float("nan")])
def test_refusals(scene, most):
    with pytest.raises(ValueError, match="max_distance must be 0 or more"):
        scene.closest_point(some_points(2, np.float64), max_distance=most)
    with pytest.raises(ValueError, match="points"):
        scene.closest_point(np.zeros((2, 4)))
