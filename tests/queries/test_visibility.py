"""`Scene.visible`: open segments between points, on surfaces too."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
import warp as wp
from support.bodies import BODIES, PLACES, placed
from support.meshes import SCENES

import wrt
from wrt.query.points import visibility


def on_surface(mesh: wrt.TriangleMesh, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Points on triangles, some of them on edges and at vertices, and the triangles."""
    rng = np.random.default_rng(seed)
    weights = rng.dirichlet((1, 1, 1), count)
    weights[: count // 4, 2] = 0.0
    weights[: count // 8] = [1.0, 0.0, 0.0]
    weights /= weights.sum(axis=1, keepdims=True)
    chosen = rng.integers(0, mesh.triangle_count, count)
    return (mesh.vertices[mesh.faces[chosen]] * weights[:, :, None]).sum(axis=1), chosen


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("body", ["icosphere", "turned box", "slab", "ellipsoid"])
def test_convex_body(body, place, dtype):
    """A point of a convex body is seen from in front of its face; through the body nothing is, within it everything."""
    mesh = placed(BODIES[body], place)
    scene = wrt.Scene(mesh)
    points, faces = on_surface(mesh, 300)
    outside = points + mesh.face_normals[faces] * mesh.extent
    outside += 0.2 * mesh.extent * np.random.default_rng(1).uniform(-1, 1, outside.shape)
    assert scene.visible(points.astype(dtype), outside.astype(dtype)).all()
    assert scene.visible(outside.astype(dtype), points.astype(dtype)).all()
    # across the body all inner segments are free, and those that go on beyond are not
    across = scene.visible(points[:, None].astype(dtype), points[None].astype(dtype))
    assert across.shape == (300, 300)
    assert across.all()
    middle = mesh.center
    beyond = middle + 5.0 * (middle - points)
    assert not scene.visible(outside, (middle + 3.0 * (middle - outside))).any()
    assert not scene.visible(middle + 5.0 * (points - middle), beyond).any()


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("name", ["teapot", "wood", "needles"])
def test_who_is_seen_sees(name, dtype):
    """Of 300,000 pairs on surfaces, up to 12 saw each other one way only: the rays there and back passed edges differently."""
    mesh = SCENES[name]()
    scene = wrt.Scene(mesh, device="cpu")
    a, b = (on_surface(mesh, 60000, seed)[0].astype(dtype) for seed in (1, 2))
    there, back = scene.visible(a, b), scene.visible(b, a)
    np.testing.assert_array_equal(there, back)
    assert 0.05 < there.mean() < 0.95
    matrix = scene.visible(a[:300, None], a[None, :300])
    np.testing.assert_array_equal(matrix, matrix.T)


def test_matrix_against_float64():
    """A soup of triangles, and points in space: every pair as float64 has it."""
    mesh = wrt.scenes.build("random_triangles", count=60, size=0.5, seed=2)
    rng = np.random.default_rng(3)
    a, b = rng.random((50, 3)), rng.random((70, 3))
    p, q, r = (mesh.vertices[mesh.faces[:, k]].astype(np.float64) for k in range(3))
    expected, clear = np.ones((50, 70), dtype=bool), np.ones((50, 70), dtype=bool)
    for i in range(50):
        for j in range(70):
            d = b[j] - a[i]
            volumes = np.stack(
                [np.cross(r - a[i], q - a[i]) @ d, np.cross(p - a[i], r - a[i]) @ d, np.cross(q - a[i], p - a[i]) @ d]
            )
            normal = np.cross(q - p, r - p)
            t = ((p - a[i]) * normal).sum(axis=1) / (normal @ d)
            inside = (volumes > 0).all(axis=0) | (volumes < 0).all(axis=0)
            expected[i, j] = not (inside & (t > 0) & (t < 1)).any()
            clear[i, j] = np.abs(volumes).min() > 1e-6 and np.abs(t[inside]).min(initial=1) > 1e-4
            clear[i, j] &= np.abs(t[inside] - 1).min(initial=1) > 1e-4
    got = wrt.Scene(mesh).visible(a[:, None], b[None])
    assert 0.2 < expected.mean() < 0.8
    assert clear.mean() > 0.9
    np.testing.assert_array_equal(got[clear], expected[clear])


def test_a_wall_between_surfaces():
    """Floor and ceiling see each other but for a plate between them; the plate's own points see both."""
    plate = trimesh.creation.box(extents=(1, 1, 1e-3))
    planes = [trimesh.creation.box(extents=(4, 4, 0.1)).apply_translation([0, 0, z]) for z in (-1.05, 1.05)]
    scene = wrt.Scene([*planes, plate])
    rng = np.random.default_rng(0)
    x = rng.uniform(-2, 2, (400, 2))
    floor, ceiling = np.insert(x, 2, -1.0, axis=1), np.insert(x, 2, 1.0, axis=1)
    through = (np.abs(x) < 0.49).all(axis=1)
    past = (np.abs(x) > 0.51).any(axis=1)
    for a, b in ((floor, ceiling), (ceiling.astype(np.float32), floor.astype(np.float32))):
        seen = scene.visible(a, b)
        assert not seen[through].any()
        assert seen[past].all()
    on_plate = np.insert(x[through], 2, 5e-4, axis=1)
    assert scene.visible(on_plate, ceiling[through]).all()
    assert not scene.visible(on_plate, floor[through]).any()  # its other side is in the way
    assert scene.visible(floor[:, None], floor[None]).all()  # in one plane


def test_shapes_and_bad_points(monkeypatch, device):
    monkeypatch.setattr(visibility, "BLOCK", 7)
    scene = wrt.Scene(BODIES["icosphere"], device=device)
    points = np.array([[0, 0, 2.0], [0, 0, -2], [2, 0, 0], [np.nan, 0, 0], [np.inf, 0, 0]])
    matrix = scene.visible(points[:, None], points)
    expected = np.zeros((5, 5), dtype=bool)
    expected[:3, :3] = [[True, False, True], [False, True, True], [True, True, True]]
    expected[0, 2] = expected[2, 0] = expected[1, 2] = expected[2, 1] = True
    np.testing.assert_array_equal(matrix, expected)
    assert scene.visible([0, 0, 2], [0, 0, 3]).shape == ()
    assert scene.visible(np.zeros((0, 3)), [0, 0, 3]).shape == (0,)
    on_device = scene.visible(wp.array(points[:3].astype(np.float32), dtype=wp.vec3, device=device), [0, 0, 2])
    assert isinstance(on_device, wp.array)
    np.testing.assert_array_equal(on_device.numpy(), expected[:3, 0])


def test_bad_arguments():
    scene = wrt.Scene(BODIES["box"])
    with pytest.raises(ValueError, match=r"points_b must have shape"):
        scene.visible(np.zeros((3, 3)), np.zeros((3, 2)))
    with pytest.raises(ValueError, match="broadcast"):
        scene.visible(np.zeros((3, 3)), np.zeros((4, 3)))
    with pytest.raises(TypeError, match="real numbers"):
        scene.visible(np.zeros((3, 3)), np.array([["a", "b", "c"]]))
