"""Closest points inside own kernels: the bits of batch queries; and their gradients: finite differences of float64 searches."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
import warp as wp
from support.meshes import SCENES
from support.point_oracles import points_around
from support.ptx import FUSIBLE, compile_to_ptx

import wrt
from wrt.kernels.points.device_points import add_point_search
from wrt.kernels.query.device_functions import instances_handle_type


@wrt.device.kernel
def ask_points(
    first: int,
    scene: wrt.device.SceneHandle,
    points: wp.array(dtype=wp.vec3),
    most: wp.array(dtype=float),
    found: wp.array(dtype=wrt.device.Hit),
    positions: wp.array(dtype=wp.vec3d),
):
    """Item: a point."""
    i = first + wp.tid()
    hit = wrt.device.closest_point(scene, points[i], most[i])
    found[i] = hit
    positions[i] = wrt.device.position(scene, hit)


def scenes_of(device: str) -> dict[str, wrt.Scene]:
    mesh = SCENES["random_triangles"]()
    turned = [wrt.Instance(mesh, np.diag([s, s, s, 1.0]), mask=m) for s, m in ((1.0, 1), (0.5, 2), (2.0, 4))]
    return {
        "bvh": wrt.Scene(mesh, device=device),
        "instances": wrt.Scene(turned, device=device),
    }


@pytest.mark.parametrize("kind", ["bvh", "instances"])
def test_as_batch_queries(kind, device):
    """Every point alone, without what its neighbours found; NaN, an infinity and limits of which some are negative."""
    scene, rng = scenes_of(device)[kind], np.random.default_rng(3)
    points = points_around(SCENES["random_triangles"](), 1200)
    points[::100] = np.nan
    points[1::100, 1] = np.inf
    most = rng.uniform(0.0, 5.0, 1200).astype(np.float32)
    most[::7] = np.inf
    given = [wp.array(points, dtype=wp.vec3, device=device), wp.array(most, dtype=float, device=device)]
    found, positions = wp.zeros(1200, dtype=wrt.device.Hit, device=device), wp.zeros(1200, dtype=wp.vec3d, device=device)
    sight = {"mask": 5} if kind == "instances" else {}
    inputs = [scene.handle(**sight), *given, found, positions]
    wrt.device.launch(ask_points, 1200, inputs, device=device)
    hits, expected = found.numpy(), scene.closest_point(points.astype(np.float64), max_distance=most, **sight)
    for name in ("primitive_id", "geometry_id", "instance_id", "uv"):
        np.testing.assert_array_equal(hits[name], getattr(expected, name))
    np.testing.assert_array_equal(hits["t"], expected.distance)
    np.testing.assert_array_equal(positions.numpy(), expected.position)
    assert 0 < expected.is_hit.sum() < 1188
    given[1].fill_(-1.0)
    wrt.device.launch(ask_points, 1200, inputs, device=device)
    assert (found.numpy()["primitive_id"] == -1).all()


def test_compiles_for_cuda(tmp_path, monkeypatch):
    """As a scene of instances on CUDA asks for it; nothing of it could be fused."""
    monkeypatch.setattr(wp.config, "optimization_level", 1)
    handle = instances_handle_type("bvh", 2, 24)
    add_point_search(handle, "bvh", 2, True)
    kernel = wrt.device.kernel(ask_points.func)
    empty = [wp.empty(0, dtype=dtype, device="cpu") for dtype in (wp.vec3, float, wrt.device.Hit, wp.vec3d)]
    kernel.add_overload(kernel.infer_argument_types([0, handle(), *empty]))
    text = compile_to_ptx(kernel.module, tmp_path)
    assert ".entry" in text
    assert not FUSIBLE.search(text)


def test_kernels_with_gradients_are_refused():
    @wp.kernel
    def careless(scene: wrt.device.SceneHandle, points: wp.array(dtype=wp.vec3), out: wp.array(dtype=float)):
        out[wp.tid()] = wrt.device.closest_point(scene, points[wp.tid()], 1.0).t

    scene = wrt.Scene(trimesh.creation.box((1, 1, 1)), device="cpu")
    point, out = wp.zeros(1, dtype=wp.vec3, device="cpu"), wp.zeros(1, dtype=float, device="cpu")
    with pytest.raises(ValueError, match=r"@wrt\.device\.kernel"):
        wp.launch(careless, 1, inputs=[scene.handle(), point, out], device="cpu")


def gradients(scene: wrt.Scene, found: wrt.results.ClosestPoints, points: np.ndarray, vertices: np.ndarray, row: np.ndarray):
    """Gradients of the sum of distances and of row . position, with respect to points and vertices."""
    given = wp.array(points, dtype=wp.vec3d, device="cpu", requires_grad=True)
    corners = wp.array(vertices, dtype=wp.vec3d, device="cpu", requires_grad=True)
    results = []
    for seeded in ("distance", "position"):
        tape = wp.Tape()
        with tape:
            near = wrt.device.differentiable_points(scene, found, given, corners)
        values = getattr(near, seeded)
        seed = np.ones(values.shape) if seeded == "distance" else np.broadcast_to(row, (*values.shape, 3))
        tape.backward(grads={values: wp.array(np.ascontiguousarray(seed), dtype=values.dtype, device="cpu")})
        results.append((given.grad.numpy().copy(), corners.grad.numpy().copy()))
        tape.zero()
    return near, results


def test_gradients():
    """Distances and positions: central differences with fixed triangles and features; the value is that of the search."""
    box = trimesh.creation.box((1.0, 2.0, 3.0))
    vertices = np.asarray(box.vertices, dtype=np.float64) + 0.01 * np.random.default_rng(1).normal(size=(8, 3))
    mesh = wrt.TriangleMesh(vertices, box.faces)
    rng = np.random.default_rng(2)
    points = rng.uniform(-3, 3, (60, 3))
    scene, row = wrt.Scene(mesh, device="cpu"), np.array([0.3, -1.0, 0.7])
    found = scene.closest_point(points)
    assert set(found.feature) == {0, 1, 2}
    near, results = gradients(scene, found, points, vertices, row)
    np.testing.assert_allclose(near.distance.numpy(), found.distance, atol=1e-5)
    np.testing.assert_allclose(near.position.numpy(), found.position, atol=1e-5)
    away = (points - near.position.numpy()) / near.distance.numpy()[:, None]
    np.testing.assert_allclose(results[0][0], away, atol=1e-9)

    def values(at: np.ndarray, corners: np.ndarray) -> tuple[float, float]:
        plain = wrt.device.differentiable_points(scene, found, at, corners)
        return float(plain.distance.numpy().sum()), float((plain.position.numpy() @ row).sum())

    step = 1e-5
    for which, given in ((0, points), (1, vertices)):
        for index in [(0, 0), (3, 1), (5, 2), (7, 0)]:
            moved = [given.copy(), given.copy()]
            moved[0][index] += step
            moved[1][index] -= step
            ends = [values(each, vertices) if which == 0 else values(points, each) for each in moved]
            for loss in (0, 1):
                difference = (ends[0][loss] - ends[1][loss]) / (2 * step)
                assert abs(difference - results[loss][which][index]) < 1e-6


def test_gradients_of_lists_and_of_nothing():
    """With k, gradients of a point are summed over its triangles; a distance of 0 and a point without an answer give none."""
    scene = wrt.Scene(trimesh.creation.box((2.0, 2.0, 2.0)), device="cpu")
    points = np.array([[0.1, 0.2, 5.0], [1.0, 0.3, 0.2], [np.nan, 0.0, 0.0]])
    found = scene.closest_point(points, k=2)
    near, results = gradients(scene, found, points, scene.state.exact_vertices.numpy(), np.zeros(3))
    assert near.distance.shape == (3, 2)
    np.testing.assert_allclose(near.distance.numpy()[:2], found.distance[:2], atol=1e-6)
    assert np.isinf(near.distance.numpy()[2]).all()
    points_grad, vertices_grad = results[0]
    assert points_grad[0][2] > 1.0
    np.testing.assert_array_equal(points_grad[2], 0.0)
    assert np.isfinite(points_grad).all()
    assert np.isfinite(vertices_grad).all()
    narrow = wrt.device.differentiable_points(scene, scene.closest_point([0.0, 0.0, 3.0]), np.float32([0, 0, 3]))
    assert narrow.distance.dtype is wp.float32
    np.testing.assert_array_equal(narrow.distance.numpy(), [2.0])
    other = wrt.Scene(trimesh.creation.box((1, 1, 1)), device="cpu")
    with pytest.raises(ValueError, match="another scene"):
        wrt.device.differentiable_points(other, found, points)
    with pytest.raises(ValueError, match="leading shape"):
        wrt.device.differentiable_points(scene, found, points[:2])
    with pytest.raises(ValueError, match="pass all vertices"):
        wrt.device.differentiable_points(scene, found, points, np.zeros((3, 3)))
    asked = wp.array(points, dtype=wp.vec3d, device="cpu", requires_grad=True)
    with wp.Tape(), pytest.raises(ValueError, match=r"closest_point has no gradients.*wrt\.device\.differentiable_points"):
        scene.closest_point(asked)
    placed = wrt.Scene([wrt.Instance(trimesh.creation.box((1, 1, 1)))], device="cpu")
    with pytest.raises(ValueError, match="without instances"):
        wrt.device.differentiable_points(placed, placed.closest_point(points), points)
