"""Closest points in scenes of instances: float64 on the flattened scene, ties, masks, and the same bits from both trees."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from support.instance_maps import MIRRORED, maps
from support.meshes import SCENES
from support.point_oracles import answers, points_around, squares, true_distances

import wrt


@pytest.mark.parametrize("name", ["teapot", "random_triangles"])
def test_against_the_flattened_scene(name, device):
    """Distances by float64; positions at these distances; triangles by their corners; both trees alike."""
    mesh, other = SCENES[name](), SCENES["degenerate"]()
    size = float(np.ptp(mesh.bounds, axis=0).max())
    placed = [(mesh if number % 2 == 0 else other, matrix) for number, matrix in enumerate(maps(size))]
    found = {}
    for tree in ("bvh", "kdtree"):
        scene = wrt.Scene([wrt.Instance(own, matrix) for own, matrix in placed], tree, device=device)
        flat = scene.flattened()
        points = points_around(flat, 400).astype(np.float64)
        found[tree] = scene.closest_point(points)
    one = found["bvh"]
    for attribute, values in answers(one).items():
        np.testing.assert_array_equal(getattr(found["kdtree"], attribute), values)
    expected, extent = true_distances(flat, points), np.ptp(flat.bounds, axis=0).max()
    np.testing.assert_allclose(one.distance, expected, rtol=3e-6, atol=4e-6 * extent)
    np.testing.assert_allclose(np.linalg.norm(one.position - points, axis=1), expected, rtol=3e-6, atol=4e-6 * extent)
    assert set(one.instance_id) == set(range(5))
    np.testing.assert_array_equal(one.geometry_id, one.instance_id % 2)
    u, v = one.uv.T.astype(np.float64)
    corners = np.empty((400, 3, 3))
    for number, (own, matrix) in enumerate(placed):
        chosen = one.instance_id == number
        local = own.vertices[own.faces[one.primitive_id[chosen]]].astype(np.float64)
        corners[chosen] = local @ matrix[:3, :3].T + matrix[:3, 3]
    on = np.einsum("nij,in->nj", corners, np.stack([1.0 - u - v, u, v]))
    np.testing.assert_allclose(one.position, on, atol=1e-5 * extent)


def test_ties_masks_and_limits(device):
    """Equal instances: the first that is seen. The limit is that of the scene, included, whatever the scale."""
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    double = np.diag([2.0, 2.0, 2.0, 1.0])
    points = np.random.default_rng(0).uniform(-3, 3, (1100, 3))
    plain = wrt.Scene(box.copy().apply_scale(2.0), device=device).closest_point(points)
    for masks, expected in (((1, 1, 1), 0), ((0, 1, 1), 1), ((0, 0, 1), 2)):
        scene = wrt.Scene([wrt.Instance(box, double, mask=mask) for mask in masks], device=device)
        found = scene.closest_point(points)
        assert (found.instance_id == expected).all()
        np.testing.assert_array_equal(found.distance, plain.distance)
    point = np.array([[0.25, 0.25, 1.5]])
    assert scene.closest_point(point, max_distance=0.5).distance == 0.5
    assert not scene.closest_point(point, max_distance=np.nextafter(np.float32(0.5), np.float32(0))).is_hit
    assert scene.closest_point([[np.nan, 0, 0], [0, 0, 5]]).is_hit.tolist() == [False, True]
    hidden = wrt.Scene([wrt.Instance(box, mask=0), wrt.Instance(box, np.diag([1.0, 2.0, 1.0, 1.0]), mask=0)], device=device)
    missed = hidden.closest_point(points)
    assert not missed.is_hit.any()
    assert (missed.feature == -1).all()


def test_normals_and_moves(device):
    """A mirrored body has its normals outside; instances that move are found where they are."""
    sphere = trimesh.creation.icosphere(3)
    mirrored = MIRRORED.copy()
    mirrored[0, 3] = 4.0
    scene = wrt.Scene([wrt.Instance(sphere), wrt.Instance(sphere, mirrored)], device=device)
    around = np.random.default_rng(1).normal(size=(300, 3))
    around *= 1.5 / np.linalg.norm(around, axis=1, keepdims=True)
    for number, middle in enumerate(([0.0, 0.0, 0.0], [4.0, 0.0, 0.0])):
        found = scene.closest_point(around + middle)
        assert (found.instance_id == number).all()
        assert ((found.normal * around).sum(axis=1) > 1.4).all()
    mirrored[0, 3] = 40.0
    scene.update(1, transform=mirrored)
    found = scene.closest_point([40.0, 0.0, 3.0])
    assert found.instance_id == 1
    assert abs(found.distance - 2.0) < 0.01


def many_instances() -> tuple[list[wrt.Instance], np.ndarray]:
    """120 boxes and spheres, turned, mirrored and scaled, of masks 1, 2 and 4 and environments 0, 1 and all; points around."""
    rng = np.random.default_rng(12)
    shapes = [trimesh.creation.box((1.0, 1.0, 1.0)), trimesh.creation.icosphere(1)]
    instances = []
    for number in range(120):
        turn = np.eye(4)
        turn[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0] * 10.0 ** rng.uniform(-1, 0.3)
        turn[:3, 3] = rng.uniform(-10, 10, 3)
        seen = {"mask": 1 << number % 3, "environment": (-1, 0, 1)[number // 40]}
        instances.append(wrt.Instance(shapes[number % 2], turn, **seen))
    return instances, rng.uniform(-12, 12, (1100, 3))


@pytest.mark.parametrize("tree", ["bvh", "kdtree"])
def test_many_instances(tree):
    """Against float64 over those that each point sees: the nearest, some, and all within a radius."""
    instances, points = many_instances()
    scene = wrt.Scene(instances, tree, device="cpu")
    rng = np.random.default_rng(5)
    masks, environments = rng.integers(1, 8, 1100), rng.integers(-1, 3, 1100)
    found = scene.closest_point(points, mask=masks, environment=environments)
    some = scene.closest_point(points, k=4, mask=masks, environment=environments)
    near = scene.within(points, 2.0, mask=masks, environment=environments)
    flat = scene.flattened()
    corners = flat.vertices[flat.faces]
    owner = np.repeat(np.arange(120), [len(instance.mesh.faces) for instance in instances])
    own_mask, own_environment = (np.array([getattr(each, key) for each in instances]) for key in ("mask", "environment"))
    for i in range(80):
        sees = (own_mask & masks[i] != 0) & ((environments[i] == -1) | np.isin(own_environment, (-1, environments[i])))
        true = np.where(sees[owner], np.sqrt(squares(corners - points[i])), np.inf)
        least = np.sort(true)[:4]
        assert abs(found.distance[i] - least[0]) < 1e-5
        np.testing.assert_allclose(some.distance[i], least, atol=1e-5)
        assert sees[found.instance_id[i]]
        rows = slice(near.offsets[i], near.offsets[i + 1])
        assert abs(near.count[i] - (true <= 2.0).sum()) <= ((true > 2.0 - 1e-5) & (true < 2.0 + 1e-5)).sum()
        assert sees[near.instance_id[rows]].all()
        assert (np.diff(near.distance[rows]) >= 0).all()
    for name in ("distance", "primitive_id", "instance_id", "uv", "feature"):
        np.testing.assert_array_equal(getattr(some, name)[:, 0], getattr(found, name))
    np.testing.assert_allclose(np.linalg.norm(near.position - points[near.point_id], axis=1), near.distance, atol=2e-5)
    plain = scene.closest_point(points)
    np.testing.assert_array_equal(plain.distance, scene.closest_point(points, mask=7, environment=-1).distance)
    one_by_one = np.stack([wrt.Scene([each], tree, device="cpu").closest_point(points[:50]).distance for each in instances[:9]])
    together = wrt.Scene(instances[:9], tree, device="cpu").closest_point(points[:50])
    np.testing.assert_allclose(together.distance, one_by_one.min(axis=0), rtol=1e-6)
