"""Cameras: images of planes, rolling shutters, ids and misses."""

from __future__ import annotations

import pickle
from copy import copy, deepcopy

import numpy as np
import pytest
import warp as wp
from support.lenses import LENSES
from support.sensed_scenes import wall

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
        (lambda scene: Camera(5, 5, LENS).capture("mesh.ply", FORWARD), TypeError, "scene must be a wrt.Scene .*not str"),
        (lambda scene: look_at([0, 0, 0], [0, 0, 1]), ValueError, r"straight down; pass another.*up=\(0, 1, 0\)"),
        (lambda scene: look_at([0, 0, 0], [0, 2, 0], up=[0, 1, 0]), ValueError, r"up=\(1, 0, 0\)"),
        (lambda scene: look_at([0, 0, 0], [0, 0, 0]), ValueError, "same point"),
        (lambda scene: look_at([0, 0, 0], [0, 1, 0], up=[0, 0, 0]), ValueError, "up is zero"),
        (lambda scene: pose_from_extrinsics(np.eye(3)), ValueError, "extrinsics"),
    ],
)
def test_wrong_arguments(scene, call, error, message):
    with pytest.raises(error, match=message):
        call(scene)


@pytest.fixture(scope="module")
def moving():
    """A coloured box that moves and turns before a wall, and a camera that drives and turns; both known over 0.3 s."""
    import trimesh

    box = trimesh.creation.box((2.0, 2.0, 2.0))
    placed = [np.eye(4), trimesh.transformations.rotation_matrix(0.4, (0, 0, 1))]
    placed[0][:3, 3], placed[1][:3, 3] = (6.0, 0.5, 0.0), (6.5, -0.5, 0.3)
    members = [wrt.Instance(wall(10.0, -100.0, 100.0)), wrt.Instance(wrt.TriangleMesh(box.vertices, box.faces), placed[0])]
    body = Trajectory.from_matrices([0.0, 0.3], placed)
    drive = Trajectory.from_matrices([0.0, 0.3], [FORWARD, look_at([0.5, 0.2, 0.1], [3.0, 0.5, 0.1])])
    return wrt.Scene(members, device="cpu"), body, drive


def expected_flow(images: wrt.sensors.CameraImages, body: Trajectory, drive: Trajectory, seconds: float) -> np.ndarray:
    """Of a camera with a global shutter, by NumPy and the lens."""
    there = body.at(images.start + seconds) @ np.linalg.inv(body.at(images.start))
    carried = images.position @ there[:3, :3].T + there[:3, 3]
    points = np.where((images.instance_id == 1)[..., None], carried, images.position)
    pose = drive.at(images.start + seconds)
    columns, rows = np.meshgrid(np.arange(images.camera.width), np.arange(images.camera.height))
    return images.camera.lens.project((points - pose[:3, 3]) @ pose[:3, :3]) - np.stack([columns, rows], axis=-1)


def test_flow(moving):
    """Forward and backward, with a lens; of bodies that move and of a camera that does."""
    scene, body, drive = moving
    camera = Camera(64, 48, BrownConrady(60.0, 60.0, 31.5, 23.5, distortion=(-0.1, 0.01, 1e-3, -1e-3)))
    for time, seconds in ((0.0, 0.2), (0.2, -0.1)):
        images = camera.capture(scene, drive, time=time, motions={1: body}, flow=seconds)
        assert images.flow.shape == (48, 64, 2)
        assert set(np.unique(images.instance_id)) >= {0, 1}
        np.testing.assert_allclose(images.flow, expected_flow(images, body, drive, seconds), atol=1e-4)
        assert np.abs(images.flow[images.instance_id == 1]).max() > 0.5
    with pytest.raises(ValueError, match="the times of the flow"):
        camera.capture(scene, drive, flow=0.4)
    with pytest.raises(ValueError, match="flow is 0"):
        camera.capture(scene, drive, flow=0.0)


def test_flow_in_slices_and_of_many_cameras(moving):
    """A rolling shutter: each row is compared with the same time later. Cameras at rest, one call."""
    scene, body, _ = moving
    camera = Camera(32, 40, BrownConrady(30.0, 30.0, 15.5, 19.5), line_delay=1e-3)
    images = camera.capture(scene, FORWARD, motions={1: body}, slices=5, flow=0.1)
    speed = np.diff(body.positions, axis=0)[0] / 0.3
    box = images.instance_id == 1
    assert box.sum() > 20
    spin = body.velocities(0.0)[1]
    centre = body.positions[0] + speed * images.time[:, None]
    arm = images.position - centre[:, None]
    shift = 0.1 * (speed + np.cross(spin, arm))
    later = camera.lens.project((images.position + shift) @ FORWARD[:3, :3])
    columns, rows = np.meshgrid(np.arange(32), np.arange(40))
    np.testing.assert_allclose(images.flow[box], (later - np.stack([columns, rows], axis=-1))[box], atol=0.3)
    assert np.abs(images.flow[images.instance_id == 0]).max() < 1e-4
    pair = Camera(32, 40, camera.lens).capture(scene, np.stack([FORWARD, FORWARD]), motions={1: body}, flow=0.1, albedo=True)
    assert pair.flow.shape == (2, 40, 32, 2)
    assert pair.albedo.shape == (2, 40, 32, 3)
    np.testing.assert_array_equal(pair.flow[0], pair.flow[1])


def test_albedo(moving):
    """The materials' colours, whatever the light; 0 where nothing is."""
    scene, body, drive = moving
    camera = Camera(32, 24, BrownConrady(30.0, 30.0, 15.5, 11.5))
    materials = [wrt.Material(color=(0.2, 0.4, 0.6)), wrt.Material(color=(0.9, 0.1, 0.3))]
    images = camera.capture(scene, drive, motions={1: body}, albedo=True, materials=materials)
    expected = np.array([(0.0, 0.0, 0.0), (0.2, 0.4, 0.6), (0.9, 0.1, 0.3)], dtype=np.float32)[images.instance_id + 1]
    np.testing.assert_allclose(images.albedo, expected, atol=1e-6)
    assert camera.capture(scene, FORWARD).albedo is None
    assert camera.capture(scene, FORWARD).flow is None
    with pytest.raises(ValueError, match="albedo=True"):
        camera.capture(scene, FORWARD, materials=materials)
    one_level = wrt.Scene(scene.flattened(), device="cpu")
    colours = camera.capture(one_level, FORWARD, albedo=True, materials=materials[1])
    seen = colours.geometry_id == 0
    assert seen.any()
    np.testing.assert_allclose(colours.albedo[seen], np.broadcast_to(materials[1].color, (seen.sum(), 3)), atol=1e-6)


def test_colour(moving):
    """A picture by an integrator sees what the other images see: through the lens, at the time, and black without a ray."""
    scene, body, drive = moving
    lens = wrt.sensors.KannalaBrandt(20.0, 20.0, 31.5, 23.5, max_angle=0.9)
    camera = Camera(64, 48, lens, line_delay=1e-3)
    picture = camera.render(scene, drive, motions={1: body}, samples=1, lights=[wrt.lights.Sky(1.0)], depth=2, sampler="random")
    images = camera.capture(scene, drive)
    still = (picture.layers["instance_id"] == 0) & (images.instance_id == 0)
    assert still.sum() > 500
    np.testing.assert_allclose(picture.layers["depth"][still], images.distance[still], rtol=1e-5)
    assert (picture.layers["instance_id"] == 1).sum() > 20
    _, rays = lens.unproject(np.stack(np.meshgrid(np.arange(64.0), np.arange(48.0)), axis=-1))
    outside = np.isnan(rays[..., 0])
    assert outside.sum() > 100
    assert (picture.linear[outside] == 0.0).all()
    assert np.isfinite(picture.linear).all()
    assert picture.linear[still].max() > 0.0
    with pytest.raises(ValueError, match="the times of the image"):
        camera.render(scene, drive, time=0.28)


def test_layers_that_were_chosen(scene):
    """Chosen layers are those of an image of all, whether they are read as NumPy arrays or made at once as Warp arrays."""
    camera = Camera(64, 48, BrownConrady(60.0, 60.0, 31.5, 23.5))
    every = camera.capture(scene, FORWARD, labels=[7, 9])
    chosen = {"layers": ("depth", "instance_id"), "labels": [7, 9]}
    for images in (camera.capture(scene, FORWARD, **chosen), camera.capture(scene, FORWARD, **chosen, to_warp=True)):
        for name in chosen["layers"]:
            found = getattr(images, name)
            np.testing.assert_array_equal(found.numpy() if isinstance(found, wp.array) else found, getattr(every, name))
        with pytest.raises(ValueError, match=r"normal is none of the layers.*layers=\(\.\.\., 'normal'\)"):
            _ = images.normal
        with pytest.raises(ValueError, match="primitive_id is none of the layers"):
            _ = images.primitive_id


@pytest.mark.parametrize(
    ("layers", "error", "message"),
    [
        ("depth", TypeError, r"layers=\('depth',\)"),
        (["deep"], ValueError, "'deep' is unknown.*semantic_id"),
        (3, TypeError, "int"),
    ],
)
def test_wrong_layers(scene, layers, error, message):
    with pytest.raises(error, match=message):
        Camera(8, 6, LENS).capture(scene, FORWARD, layers=layers)


def test_layers_do_not_change_with_the_scene():
    """What is read late is what was seen."""
    scene = wrt.Scene([wrt.Instance(wall(10.0, -100.0, 100.0))], device="cpu")
    camera = Camera(8, 6, LENS)
    images, again = camera.capture(scene, FORWARD), camera.capture(scene, FORWARD)
    before = images.position, images.normal, images.depth
    scene.update([0], transform=np.diag([0.5, 1.0, 1.0, 1.0])[None])
    for found, expected in zip((again.position, again.normal, again.depth), before, strict=True):
        np.testing.assert_array_equal(found, expected)
    assert np.isfinite(before[2]).all()
    np.testing.assert_array_less(camera.capture(scene, FORWARD).depth, before[2])


def test_images_are_pickled(scene):
    """With all layers that can be read, before or after they were read; a shallow copy makes none."""
    camera = Camera(8, 6, LENS)
    given = {"labels": [7, 9], "albedo": True, "flow": 0.1}
    images, other = camera.capture(scene, FORWARD, **given), camera.capture(scene, FORWARD, **given)
    table, every = images.to_structured(), images.to_structured(organized=True)
    for again in (
        pickle.loads(pickle.dumps(other)),
        pickle.loads(pickle.dumps(pickle.loads(pickle.dumps(images)))),
        deepcopy(images),
    ):
        np.testing.assert_array_equal(again.to_structured(), table)
        assert again.to_structured(organized=True).tobytes() == every.tobytes()
        for name in ("distance", "position", "normal", "camera_normal", "primitive_id", "albedo", "flow", "time"):
            np.testing.assert_array_equal(getattr(again, name), getattr(images, name))
    few = pickle.loads(pickle.dumps(camera.capture(scene, FORWARD, layers=("depth",))))
    np.testing.assert_array_equal(few.depth, images.depth)
    with pytest.raises(ValueError, match="normal is none of the layers"):
        _ = few.normal
    on_device = camera.capture(scene, FORWARD, layers=("depth",), to_warp=True)
    assert copy(on_device).depth.shape == (6, 8)
    with pytest.raises(TypeError, match=r"CameraImages of Warp arrays cannot be pickled; .*numpy"):
        pickle.dumps(on_device)


def test_rays_of_a_camera_at_rest(scene):
    """The third image takes the rays of the second; another pose, camera or number of cameras has its own."""
    for camera in (Camera(16, 12, LENS), Camera(16, 12, BrownConrady(50.0, 60.0, 7.5, 24.5), line_delay=1e-3)):
        poses = [FORWARD, look_at([1.0, 0, 0], [2.0, 0.1, 0])]
        first = [camera.capture(scene, pose).depth for pose in poses]
        for _ in range(3):
            for pose, depth in zip(poses, first, strict=True):
                np.testing.assert_array_equal(camera.capture(scene, pose).depth, depth)
            np.testing.assert_array_equal(camera.capture(scene, np.array(poses)).depth, first)


def test_table_of_pixels(scene):
    """Rows are the pixels that see a surface; an organized table has all."""
    camera = Camera(64, 48, BrownConrady(60.0, 60.0, 31.5, 23.5))
    images = camera.capture(scene, look_at([0.0, 0, 0], [0.3, 1.0, 0]), labels=[7, 9], miss=-1.0)
    seen = images.instance_id >= 0
    assert 0.1 < seen.mean() < 0.9
    table, every = images.to_structured(), images.to_structured(organized=True)
    assert table.dtype.names == ("x", "y", "z", "depth", "row", "column", "instance_id", "semantic_id")
    np.testing.assert_array_equal(np.stack([table["row"], table["column"]], axis=1), np.argwhere(seen))
    np.testing.assert_array_equal(np.stack([table[name] for name in "xyz"], axis=1), images.position[seen])
    np.testing.assert_array_equal(table["depth"], images.depth[seen])
    np.testing.assert_array_equal(table["semantic_id"], images.semantic_id[seen])
    assert every.shape == (48, 64)
    np.testing.assert_array_equal(every[seen], table)
    assert np.isnan(every["x"][~seen]).all()
    assert "semantic_id" not in camera.capture(scene, FORWARD).to_structured().dtype.names
