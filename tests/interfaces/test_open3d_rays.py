"""`wrt.compat.RaycastingScene` in the place of Open3D's: the same keys, shapes, types and answers."""

from __future__ import annotations

import pickle
from typing import ClassVar

import numpy as np
import pytest
import trimesh
from support.open3d_scene import PARTS, SPHERE

import wrt

METHODS = {
    "INVALID_ID",
    "add_triangles",
    "cast_rays",
    "compute_closest_points",
    "compute_distance",
    "compute_occupancy",
    "compute_signed_distance",
    "count_intersections",
    "create_rays_pinhole",
    "list_intersections",
    "test_occlusions",
}
"""What the documentation of Open3D 0.20 lists."""


def test_all_methods_are_here(scene):
    assert set(dir(scene)) >= METHODS
    with pytest.raises(AttributeError, match=r"^'RaycastingScene' object has no attribute 'nothing'$"):
        _ = scene.nothing


def test_the_peer_has_no_more_methods(open3d):
    assert {name for name in dir(open3d.t.geometry.RaycastingScene) if not name.startswith("_")} <= METHODS


def test_results_are_read_as_tensors(scene):
    """What programs call on Open3D's results works, and other methods of tensors are an error that says what to do."""
    rays = scene.create_rays_pinhole(60, [0, 0, 0], [0, 0, -4], [0, 1, 0], 8, 6).numpy()
    assert type(rays) is np.ndarray
    hits = scene.cast_rays(rays)
    found = hits["t_hit"].isfinite()
    assert found.any()
    np.testing.assert_array_equal(found, ~hits["t_hit"].isinf())
    assert not hits["t_hit"].isnan().any()
    points = rays[found][:, :3] + rays[found][:, 3:] * hits["t_hit"][found].reshape((-1, 1))
    assert np.abs(scene.compute_distance(points).cpu().numpy()).max() < 1e-5
    assert type(scene.compute_signed_distance([0.0, 0.0, 0.0]).numpy()) is np.ndarray
    with pytest.raises(AttributeError, match=r"has no 'to_legacy'; open3d.core.Tensor\(result\)"):
        hits["t_hit"].to_legacy()
    assert pickle.loads(pickle.dumps(hits["t_hit"])).numpy().dtype == np.float32


def some_rays(*shape: int) -> np.ndarray:
    """Rays from around towards points near the middle, (*shape, 6) float32; some miss."""
    rng = np.random.default_rng(5)
    origins = 4.0 * trimesh.unitize(rng.normal(size=(int(np.prod(shape)), 3))).reshape(*shape, 3)
    targets = rng.uniform(-1.6, 1.6, (*shape, 3))
    return np.concatenate([origins, targets - origins], axis=-1).astype(np.float32)


def assert_same_kind(got: dict[str, np.ndarray], expected: dict) -> None:
    """Keys, shapes and types."""
    kinds = [
        {key: (value.shape, value.dtype) for key, value in answer.items()}
        for answer in (got, {key: value.numpy() for key, value in expected.items()})
    ]
    assert kinds[0] == kinds[1]


@pytest.mark.parametrize("shape", [(400,), (20, 30), (1, 2, 3)])
def test_cast_rays(scene, theirs, shape):
    rays = some_rays(*shape)
    got, expected = scene.cast_rays(rays), theirs.cast_rays(rays)
    assert_same_kind(got, expected)
    expected = {key: value.numpy() for key, value in expected.items()}
    for name in ("geometry_ids", "primitive_ids"):
        np.testing.assert_array_equal(got[name], expected[name])
    for name in ("t_hit", "primitive_uvs", "primitive_normals"):
        np.testing.assert_allclose(got[name], expected[name], atol=2e-4)
    if shape == (400,):
        assert {0, 1, wrt.compat.RaycastingScene.INVALID_ID} == set(got["geometry_ids"].tolist())


def test_invalid_id(open3d):
    assert open3d.t.geometry.RaycastingScene.INVALID_ID == wrt.compat.RaycastingScene.INVALID_ID


def test_occlusions_and_counts(scene, theirs):
    rays = some_rays(20, 30)
    for tnear, tfar in ((0.0, np.inf), (0.9, np.inf), (0.0, 0.7), (0.8, 1.0)):
        got, expected = scene.test_occlusions(rays, tnear, tfar), theirs.test_occlusions(rays, tnear, tfar).numpy()
        np.testing.assert_array_equal(got, expected)
        assert got.dtype == expected.dtype
    got, expected = scene.count_intersections(rays), theirs.count_intersections(rays).numpy()
    np.testing.assert_array_equal(got, expected)
    assert got.dtype == expected.dtype


@pytest.mark.parametrize("shape", [(300,), (10, 20)])
def test_list_intersections(scene, theirs, shape):
    rays = some_rays(*shape)
    got, expected = scene.list_intersections(rays), theirs.list_intersections(rays)
    assert_same_kind(got, expected)
    expected = {key: value.numpy() for key, value in expected.items()}
    np.testing.assert_array_equal(got["ray_splits"], expected["ray_splits"])
    np.testing.assert_array_equal(got["ray_ids"], expected["ray_ids"])
    orders = [np.lexsort((lists["primitive_ids"], lists["geometry_ids"], lists["ray_ids"])) for lists in (got, expected)]
    for name in ("geometry_ids", "primitive_ids", "t_hit", "primitive_uvs"):
        np.testing.assert_allclose(got[name][orders[0]], expected[name][orders[1]], atol=2e-4)
    inside_a_ray = np.diff(got["ray_ids"].astype(int)) == 0
    assert (np.diff(got["t_hit"])[inside_a_ray] >= 0).all()


def test_list_intersections_gives_points_on_the_rays(scene):
    """The two ways to a point that Open3D's manual shows: by weights and along the ray."""
    rays = some_rays(200)
    lists = scene.list_intersections(rays)
    corners = np.stack(
        [PARTS[g][0][PARTS[g][1][f]] for g, f in zip(lists["geometry_ids"], lists["primitive_ids"], strict=True)]
    )
    u, v = lists["primitive_uvs"].T[:, :, None]
    points = (1 - u - v) * corners[:, 0] + u * corners[:, 1] + v * corners[:, 2]
    chosen = rays[lists["ray_ids"]]
    np.testing.assert_allclose(points, chosen[:, :3] + lists["t_hit"][:, None] * chosen[:, 3:], atol=1e-5)


def test_create_rays_pinhole(open3d):
    peer = open3d.t.geometry.RaycastingScene.create_rays_pinhole
    view = {"fov_deg": 50.0, "center": [0.1, 0.2, 0.3], "eye": [1.0, 2.0, -3.0], "up": [0.1, 1.0, 0.2]}
    sizes = {"width_px": 7, "height_px": 5}
    got = wrt.compat.RaycastingScene.create_rays_pinhole(**view, **sizes)
    expected = peer(**view, **sizes).numpy()
    np.testing.assert_allclose(got, expected, atol=1e-6)
    assert got.dtype == expected.dtype
    intrinsic = np.array([[50.0, 0.5, 3.0], [0.0, 60.0, 2.0], [0.0, 0.0, 1.0]])
    extrinsic = trimesh.transformations.random_rotation_matrix(np.array([0.3, 0.6, 0.2]))
    extrinsic[:3, 3] = [1.0, -2.0, 3.0]
    got = wrt.compat.RaycastingScene.create_rays_pinhole(intrinsic, extrinsic, 7, 5)
    expected = peer(open3d.core.Tensor(intrinsic), open3d.core.Tensor(extrinsic), 7, 5).numpy()
    np.testing.assert_allclose(got, expected, atol=1e-6)


def test_pictures():
    """The middle of a picture sees what the camera looks at, without Open3D too."""
    scene = wrt.compat.RaycastingScene()
    scene.add_triangles(SPHERE)
    rays = scene.create_rays_pinhole(fov_deg=40, center=[0, 0, 0], eye=[0, -4, 0], up=[0, 0, 1], width_px=21, height_px=11)
    t = scene.cast_rays(rays)["t_hit"]
    assert t[5, 10] == pytest.approx(3.0, abs=0.02)
    assert np.isinf(t[:, 0]).all()
    assert rays[10, 10, 5] > rays[0, 10, 5]  # rows grow towards up


def test_meshes_of_every_kind(open3d):
    vertices, faces = PARTS[0]
    tensors = open3d.t.geometry.TriangleMesh(open3d.core.Tensor(vertices), open3d.core.Tensor(faces))
    scene = wrt.compat.RaycastingScene()
    ids = [scene.add_triangles(mesh) for mesh in (tensors, SPHERE, wrt.TriangleMesh(vertices, faces))]
    ids.append(scene.add_triangles(tensors.vertex.positions, triangle_indices=tensors.triangle.indices))
    ids.append(scene.add_triangles(mesh=SPHERE))
    assert ids == [0, 1, 2, 3, 4]
    counts = scene.count_intersections(open3d.core.Tensor(some_rays(50)))
    assert set(counts.tolist()) == {0, 10}


def test_geometry_is_added_between_queries(scene):
    own = wrt.compat.RaycastingScene(nthreads=1)
    rays = some_rays(300)
    own.add_triangles(*PARTS[0])
    before = own.cast_rays(rays)
    assert own.scene is own.scene
    own.add_triangles(*PARTS[1])
    after, expected = own.cast_rays(rays, nthreads=2), scene.cast_rays(rays)
    assert (after["t_hit"] <= before["t_hit"]).all()
    thawed = pickle.loads(pickle.dumps(own)).cast_rays(rays)
    for name in expected:
        np.testing.assert_array_equal(after[name], expected[name])
        np.testing.assert_array_equal(thawed[name], expected[name])


def test_an_empty_scene(open3d):
    ours, peer, rays = wrt.compat.RaycastingScene(), open3d.t.geometry.RaycastingScene(), some_rays(3, 4)
    for name in ("cast_rays", "list_intersections"):
        got, expected = getattr(ours, name)(rays), getattr(peer, name)(rays)
        assert_same_kind(got, expected)
        for key in got:
            np.testing.assert_array_equal(got[key], expected[key].numpy())
    assert not ours.test_occlusions(rays).any()
    assert not ours.count_intersections(rays).any()
    assert ours.test_occlusions(rays).shape == ours.count_intersections(rays).shape == (3, 4)


def test_arrays_are_copied():
    vertices, faces = PARTS[0][0].copy(), PARTS[0][1]
    scene = wrt.compat.RaycastingScene()
    scene.add_triangles(vertices, faces)
    vertices += 100.0
    assert scene.test_occlusions([[0, 0, -3, 0, 0, 1]]).tolist() == [True]


def test_bad_rays_miss(scene):
    rays = np.tile(np.float32([0, 0, -3, 0, 0, 1]), (3, 1))
    rays[1, 0], rays[2, 5] = np.nan, 0.0
    assert (scene.cast_rays(rays)["primitive_ids"] == scene.INVALID_ID).tolist() == [False, True, True]
    assert (scene.count_intersections(rays) > 0).tolist() == [True, False, False]


def test_bad_arguments(scene):
    with pytest.raises(ValueError, match=r"\(\.\.\., 6\)"):
        scene.cast_rays(np.zeros((4, 5)))
    with pytest.raises(TypeError, match="real numbers"):
        scene.count_intersections(np.zeros((4, 6), dtype=bool))
    with pytest.raises(TypeError, match="add_triangles"):
        scene.add_triangles()
    with pytest.raises(TypeError, match="mesh must be"):
        scene.add_triangles("bunny.ply")
    with pytest.raises(ValueError, match="faces"):
        scene.add_triangles(np.zeros((3, 3)), np.array([[0, 1, 3]]))
    with pytest.raises(ValueError, match="nthreads"):
        scene.cast_rays(np.zeros((4, 6)), nthreads=-1)
    pinhole = scene.create_rays_pinhole
    with pytest.raises(TypeError, match="fov_deg, center, eye"):
        pinhole(60)
    with pytest.raises(ValueError, match="intrinsic_matrix"):
        pinhole(np.zeros((3, 3)), np.eye(4), 4, 4)
    with pytest.raises(ValueError, match="extrinsic_matrix"):
        pinhole(np.eye(3), np.eye(3), 4, 4)
    with pytest.raises(ValueError, match="width_px"):
        pinhole(np.eye(3), np.eye(4), 0, 4)
    with pytest.raises(ValueError, match="parallel"):
        pinhole(60, [0, 0, 0], [0, 0, 1], [0, 0, 1], 4, 4)
    with pytest.raises(ValueError, match="fov_deg"):
        pinhole(180, [0, 0, 0], [0, 0, 1], [0, 1, 0], 4, 4)


def test_errors_name_arguments(scene):
    """Those that callers pass, and none of those inside."""
    vertices, faces = PARTS[0]
    for given in (
        {"vertices": vertices, "triangles": faces},
        {"triangle_mesh": SPHERE},
        {"mesh": SPHERE, "triangle_indices": faces},
    ):
        with pytest.raises(TypeError, match=r"^pass add_triangles\(mesh\) or add_triangles\(vertex_positions, triangle_ind"):
            scene.add_triangles(**given)
    with pytest.raises(TypeError, match=r"^pass add_triangles"):
        scene.add_triangles(vertices, vertex_positions=faces)
    with pytest.raises(ValueError, match=r"^tnear is -1\.0"):
        scene.test_occlusions(np.zeros((1, 6)), tnear=-1.0)


class EmptyMesh:
    """What an Open3D tensor mesh without geometry has."""

    vertex: ClassVar[dict[str, np.ndarray]] = {}
    triangle: ClassVar[dict[str, np.ndarray]] = {}


def test_a_tensor_mesh_without_geometry(scene):
    with pytest.raises(ValueError, match="no vertex positions"):
        scene.add_triangles(EmptyMesh())
