"""Cameras: images of planes, rolling shutters, ids and misses."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from test_lenses import LENSES
from test_lidar import wall

import wrt
from wrt.sensors import BrownConrady, Camera, Equirectangular, Trajectory, look_at, pose_from_extrinsics

FORWARD = look_at([0.0, 0, 0], [1.0, 0, 0])  # along the world's x; y is left in the world, z up


@pytest.fixture(scope="module")
def scene():
    """A wall at 10 m, half of it behind another one at 6 m; both instances."""
    return wrt.Scene([wrt.Instance(wall(10.0, -100.0, 100.0)), wrt.Instance(wall(6.0, 0.0, 50.0))], device="cpu")


def test_frames():
    """x right, y down, z forward."""
    np.testing.assert_allclose(FORWARD[:3, :3], np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]).T, atol=1e-15)
    extrinsics = np.linalg.inv(look_at([1.0, 2, 3], [4.0, 2, 5]))
    np.testing.assert_allclose(pose_from_extrinsics(extrinsics), look_at([1.0, 2, 3], [4.0, 2, 5]), atol=1e-14)
    np.testing.assert_allclose(pose_from_extrinsics(extrinsics[:3]), look_at([1.0, 2, 3], [4.0, 2, 5]), atol=1e-14)


def test_depth_and_distance(scene):
    """Of a wall across the axis: the depth is constant, the distance that of the ray; ids and labels are the wall's."""
    camera = Camera(64, 48, BrownConrady(60.0, 60.0, 31.5, 23.5))
    images = camera.capture(scene, FORWARD, labels=[7, 9])
    left = np.arange(64) < 32  # y > 0
    expected = np.broadcast_to(np.where(left, 6.0, 10.0), (48, 64))
    np.testing.assert_allclose(images.depth, expected, rtol=1e-6)
    _, rays = camera.lens.unproject(np.stack(np.meshgrid(np.arange(64.0), np.arange(48.0)), axis=-1))
    np.testing.assert_allclose(images.distance, expected / rays[..., 2], rtol=1e-6)
    np.testing.assert_array_equal(images.instance_id, np.broadcast_to(np.where(left, 1, 0), (48, 64)))
    np.testing.assert_array_equal(images.semantic_id, np.broadcast_to(np.where(left, 9, 7), (48, 64)))
    np.testing.assert_allclose(np.abs(images.normal), np.broadcast_to([1, 0, 0], (48, 64, 3)), atol=1e-6)
    np.testing.assert_allclose(np.abs(images.camera_normal), np.broadcast_to([0, 0, 1], (48, 64, 3)), atol=1e-6)
    np.testing.assert_allclose(camera.lens.project(images.position @ FORWARD[:3, :3])[0, :, 0], np.arange(64), atol=1e-4)


@pytest.mark.parametrize("name", LENSES)
def test_every_lens_sees_the_scene(device, name):
    """Positions in the image, projected by the same lens, are at their pixels."""
    scene = wrt.Scene(wrt.scenes.build("atrium", detail=1), device=device)
    lens = Equirectangular(80, 60) if name == "equirectangular" else LENSES[name]
    camera, pose = Camera(80, 60, lens), look_at([-4.0, 1.0, 1.8], [0.0, 0.0, 1.5])
    images = camera.capture(scene, pose)
    seen = np.isfinite(images.distance)
    assert seen.mean() > 0.5
    local = (images.position - pose[:3, 3]) @ pose[:3, :3]
    pixels = np.stack(np.meshgrid(np.arange(80.0), np.arange(60.0)), axis=-1)
    np.testing.assert_allclose(camera.lens.project(local)[seen], pixels[seen], atol=2e-3)
    np.testing.assert_allclose(images.depth[seen], local[..., 2][seen], atol=1e-4)
    rotated = images.normal @ pose[:3, :3].astype(np.float32)
    np.testing.assert_allclose(images.camera_normal, rotated, atol=1e-5)
    as_warp = camera.capture(scene, pose, to_warp=True)
    assert isinstance(as_warp.depth, wp.array)
    np.testing.assert_array_equal(as_warp.depth.numpy(), images.depth)


def test_misses(scene):
    images = Camera(8, 6, BrownConrady(60.0, 60.0, 3.5, 2.5)).capture(scene, look_at([0, 0, 0], [-1, 0, 0]), miss=-1.0)
    assert (images.distance == -1.0).all()
    assert (images.depth == -1.0).all()
    assert np.isnan(images.position).all()
    assert (images.instance_id == -1).all()
    assert (images.semantic_id == -1).all()
    assert (images.normal == 0).all()


def test_rolling_shutter(scene):
    """A camera that drives towards a wall sees each row from its own position."""
    camera = Camera(16, 50, BrownConrady(60.0, 60.0, 7.5, 24.5), line_delay=1e-3)
    path = Trajectory.from_matrices([0.0, 0.1], [FORWARD, look_at([1.0, 0, 0], [2.0, 0, 0])])
    images = camera.capture(scene, path, time=0.02)
    np.testing.assert_allclose(images.time, 0.02 + 1e-3 * np.arange(50))
    expected = np.where(np.arange(16) < 8, 6.0, 10.0) - 10.0 * images.time[:, None]
    np.testing.assert_allclose(images.depth, expected, rtol=1e-5)
    with pytest.raises(ValueError, match="the times of the image"):
        camera.capture(scene, path, time=0.06)


def test_rolling_shutter_of_a_moving_wall(scene):
    """In slices of rows: the depth is that of the wall at the middle of each row's slice, and bounded."""
    camera = Camera(16, 50, BrownConrady(60.0, 60.0, 7.5, 24.5), line_delay=1e-3)
    motions = {1: Trajectory([0.0, 1.0], [[0.0, 0, 0], [5.0, 0, 0]])}
    images = camera.capture(scene, FORWARD, motions=motions, slices=7)
    error = np.abs(images.depth[:, :8] - (6.0 + 5.0 * images.time[:, None]))
    assert 0 < error.max() <= images.motion_error + 1e-5
    assert images.motion_error == pytest.approx(5.0 * 0.049 / 7 / 2)
    np.testing.assert_allclose(images.depth[:, 8:], 10.0, rtol=1e-6)


LENS = BrownConrady(60.0, 60.0, 7.5, 24.5)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda scene: Camera(0, 5, LENS), ValueError, "width"),
        (lambda scene: Camera(5.5, 5, LENS), TypeError, "width"),
        (lambda scene: Camera(5, 5, "pinhole"), TypeError, "lens"),
        (lambda scene: Camera(5, 5, LENS).capture(scene, FORWARD, labels=[1]), ValueError, "labels"),
        (lambda scene: Camera(5, 5, LENS).capture(scene, FORWARD, labels=[0.5, 1]), TypeError, "labels"),
        (lambda scene: Camera(5, 5, LENS).capture(scene, 2 * FORWARD), ValueError, "last row"),
        (lambda scene: look_at([0, 0, 0], [0, 0, 1]), ValueError, "parallel"),
        (lambda scene: pose_from_extrinsics(np.eye(3)), ValueError, "extrinsics"),
    ],
)
def test_wrong_arguments(scene, call, error, message):
    with pytest.raises(error, match=message):
        call(scene)
