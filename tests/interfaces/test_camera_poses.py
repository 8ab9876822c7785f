"""Poses of other libraries, and the two cameras: a known point lands on the known pixel, and both see the same."""

from __future__ import annotations

import numpy as np
import pytest
from support.meshes import SCENES

import wrt

TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
PLACE = np.array([3.0, -2.0, 5.0])


def pose_of(turn: np.ndarray = TURN, place: np.ndarray = PLACE) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, place
    return pose


def pixel_of(camera: wrt.PinholeCamera | wrt.OrthographicCamera, point: np.ndarray) -> tuple[int, int]:
    """(row, column) of the pixel whose ray passes nearest to a point in front of the camera."""
    rays = camera.rays()
    origins, directions = np.broadcast_arrays(rays.origins, rays.directions.astype(np.float64))
    beside = np.linalg.norm(np.cross(point - origins, directions), axis=-1)
    row, column = np.unravel_index(beside.argmin(), beside.shape)
    assert (point - origins)[row, column] @ directions[row, column] > 0.0
    assert beside[row, column] < 1e-5, "no ray passes through the point: pixels are not where they should be"
    return int(row), int(column)


IN_FRONT = {"from_opengl": (1.5, 0.5, -1.0), "from_opencv": (1.5, -0.5, 1.0)}
"""The centre of pixel (row 0, column 3) of an image of 4 x 2 pixels with 90 degrees from top to bottom: half the height is one
unit at distance 1, so pixels are one unit wide. It is to the right and above the axis."""


@pytest.mark.parametrize("made", IN_FRONT)
@pytest.mark.parametrize("kind", [wrt.PinholeCamera, wrt.OrthographicCamera])
def test_a_known_point_lands_on_the_known_pixel(made, kind):
    pose = pose_of()
    options = {"fov": 90.0} if kind is wrt.PinholeCamera else {"view_height": 2.0}
    camera = getattr(kind, made)(4, 2, pose, **options)
    assert type(camera) is kind
    assert pixel_of(camera, (pose @ [*IN_FRONT[made], 1.0])[:3]) == (0, 3)
    opposite = np.array(IN_FRONT[made]) * [-1.0, -1.0, 1.0]
    assert pixel_of(camera, (pose @ [*opposite, 1.0])[:3]) == (1, 0)


def test_the_same_point_in_the_pixels_of_sensors():
    """Whose centres are whole numbers: column 3, row 0."""
    sensor, pose = wrt.sensors.Camera.from_camera(wrt.PinholeCamera.from_opencv(4, 2, pose_of(), fov=90.0))
    np.testing.assert_allclose(sensor.lens.project(np.array(IN_FRONT["from_opencv"])), [3.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(pose, pose_of(), atol=1e-15)
    sensor, _ = wrt.sensors.Camera.from_camera(wrt.OrthographicCamera.from_opencv(4, 2, pose_of(), view_height=2.0))
    np.testing.assert_allclose(sensor.lens.project(np.array(IN_FRONT["from_opencv"])), [3.0, 0.0], atol=1e-12)


def test_poses_of_opengl_for_sensors():
    pose = wrt.sensors.pose_from_opengl(pose_of())
    lens = wrt.sensors.BrownConrady(1.0, 1.0, 1.5, 0.5)
    there = np.linalg.inv(pose) @ pose_of() @ [*IN_FRONT["from_opengl"], 1.0]
    np.testing.assert_allclose(lens.project(there[:3]), [3.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(pose, wrt.PinholeCamera.from_opengl(4, 2, pose_of()).pose, atol=1e-15)


def test_conventions_meet_the_constructor():
    """A camera placed by look_at, and the same one by its pose in each convention."""
    camera = wrt.PinholeCamera(7, 5, fov=40.0, position=(1, 2, 3), look_at=(4, -1, 2), up=(0, 0.3, 1))
    by_hand = np.eye(4)
    by_hand[:3, :3], by_hand[:3, 3] = np.stack([camera.right, camera.up, -camera.forward], axis=1), (1, 2, 3)
    for again in (
        wrt.PinholeCamera.from_opencv(7, 5, camera.pose, fov=40.0),
        wrt.PinholeCamera.from_opengl(7, 5, by_hand, fov=40.0),
    ):
        np.testing.assert_allclose(again.rays().directions, camera.rays().directions, atol=1e-7)
        np.testing.assert_array_equal(again.position, camera.position)
    np.testing.assert_allclose(camera.pose, wrt.sensors.look_at((1, 2, 3), (4, -1, 2), (0, 0.3, 1)), atol=1e-15)


@pytest.mark.parametrize("size", [(8, 4), (4, 8)])
def test_blender_measures_the_longer_side(size):
    """A point at the middle of the right edge, or of the upper edge, is at half the angle, whichever side is longer."""
    width, height = size
    camera = wrt.PinholeCamera.from_blender(width, height, np.eye(4), angle=2 * np.arctan(0.5))
    tangent = np.tan(np.radians(camera.fov) / 2)
    assert max(tangent, tangent * width / height) == pytest.approx(0.5)
    flat = wrt.OrthographicCamera.from_blender(width, height, np.eye(4), ortho_scale=6.0)
    assert max(flat.view_height, flat.view_height * width / height) == pytest.approx(6.0)
    np.testing.assert_allclose(camera.forward, [0, 0, -1])
    np.testing.assert_allclose(camera.up, [0, 1, 0])


def test_far_from_the_origin():
    """A pose keeps its directions where the position is large."""
    camera = wrt.PinholeCamera.from_opencv(4, 2, pose_of(place=np.array([4.5e5, 5.4e6, 1e9])))
    np.testing.assert_allclose(camera.pose[:3, :3], TURN, atol=1e-15)


@pytest.mark.parametrize("kind", ["pinhole", "orthographic"])
def test_both_cameras_see_the_same(kind):
    mesh = SCENES["teapot"]()
    scene = wrt.Scene(mesh, device="cpu")
    camera = wrt.PinholeCamera.framing(mesh, 33, 20, fov=30.0)
    if kind == "orthographic":
        camera = wrt.OrthographicCamera.from_opencv(33, 20, camera.pose, view_height=0.7 * mesh.extent)
    sensor, pose = wrt.sensors.Camera.from_camera(camera)
    hits, images = scene.intersect(camera.rays()), sensor.capture(scene, pose)
    assert 80 < hits.is_hit.sum() < 600
    same = hits.primitive_id == images.primitive_id
    assert same.mean() > 0.99, "rays are rounded in another order; a few meet the neighbour at an edge"
    np.testing.assert_allclose(images.distance[same], hits.t[same], rtol=1e-5)
    again = sensor.to_camera(pose)
    assert type(again) is type(camera)
    np.testing.assert_allclose(again.rays().directions, camera.rays().directions, atol=1e-6)
    np.testing.assert_allclose(again.rays().origins, camera.rays().origins, atol=1e-9)


def test_bad_poses():
    turned = pose_of()
    for pose, said in (
        (np.eye(3), r"pose has the shape \(3, 3\); it must be \(4, 4\)"),
        (np.full((4, 4), np.nan), r"pose\[0, 0\] is nan"),
        (turned.T, r"last row .*it must be \[0, 0, 0, 1\]: was it transposed"),
        (np.diag([2.0, 2.0, 2.0, 1.0]), "without scale, shear or mirroring"),
        (np.diag([1.0, 1.0, -1.0, 1.0]), "without scale, shear or mirroring"),
    ):
        for made in (wrt.PinholeCamera.from_opengl, wrt.PinholeCamera.from_opencv):
            with pytest.raises(ValueError, match=said):
                made(4, 2, pose)
        with pytest.raises(ValueError, match=said):
            wrt.sensors.pose_from_opengl(pose)
    with pytest.raises(TypeError, match="look_at is in the pose; leave it out"):
        wrt.PinholeCamera.from_opengl(4, 2, turned, look_at=(0, 0, 0))
    with pytest.raises(TypeError, match="unexpected keyword argument 'fow'"):
        wrt.PinholeCamera.from_opengl(4, 2, turned, fow=30.0)
    with pytest.raises(ValueError, match=r"angle is 3\.5; .* between 0 and pi"):
        wrt.PinholeCamera.from_blender(4, 2, turned, angle=3.5)
    with pytest.raises(ValueError, match="ortho_scale is 0; "):
        wrt.OrthographicCamera.from_blender(4, 2, turned, ortho_scale=0.0)


def test_views_that_pinhole_cameras_do_not_have():
    of = wrt.sensors.BrownConrady
    for lens, delay, said in (
        (of(10, 10, 1.5, 0.5, (0.1, 0, 0, 0)), 0.0, "distortion or skew"),
        (of(10, 10, 1.5, 0.5, skew=0.1), 0.0, "distortion or skew"),
        (of(10, 11, 1.5, 0.5), 0.0, "pixels of a wrt.PinholeCamera are square"),
        (of(10, 10, 2.0, 1.0), 0.0, r"passes through the centre, \(1.5, 0.5\)"),
        (of(10, 10, 1.5, 0.5), 1e-5, "line_delay is 1e-05"),
        (wrt.sensors.KannalaBrandt(10, 10, 1.5, 0.5), 0.0, "a lens of KannalaBrandt has no wrt.PinholeCamera"),
    ):
        with pytest.raises(ValueError, match=said):
            wrt.sensors.Camera(4, 2, lens, delay).to_camera(pose_of())
    with pytest.raises(TypeError, match=r"must be a wrt\.PinholeCamera or a wrt\.OrthographicCamera, not str"):
        wrt.sensors.Camera.from_camera("camera")
