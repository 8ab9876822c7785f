"""Cameras against closed forms."""

import numpy as np
import pytest
from click.testing import CliRunner

import wrt
from wrt.cli import main
from wrt.imaging.cameras import pixel_offset
from wrt.imaging.integrators import rendering_call
from wrt.scenes import random_triangles

ORIGIN = (0.0, 0.0, 0.0)


def forward_camera(width=4, height=2, **options):
    """At the origin, looking along +y, z up: x is to the right."""
    return wrt.PinholeCamera(width, height, position=ORIGIN, look_at=(0, 5, 0), **options)


def unit(v):
    v = np.asarray(v, dtype=float)
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def test_pinhole_rays_go_through_the_centres_of_the_pixels():
    rays = forward_camera(4, 2, fov=90).rays()
    assert rays.shape == (2, 4)
    assert rays.directions.shape == (2, 4, 3)
    assert rays.directions.dtype == np.float32
    for row, z in enumerate((0.5, -0.5)):
        for column, x in enumerate((-1.5, -0.5, 0.5, 1.5)):
            np.testing.assert_allclose(rays.directions[row, column], unit((x, 1.0, z)), atol=1e-7)


def test_pinhole_shares_one_origin_in_float64():
    position = (1e7 + 0.1, -2e7 - 0.2, 0.3)
    rays = wrt.PinholeCamera(5, 3, position=position, look_at=ORIGIN).rays()
    assert rays.origins.shape == (1, 1, 3)
    assert rays.origins.dtype == np.float64
    assert tuple(rays.origins[0, 0]) == position


def test_odd_pictures_look_at_the_point_in_the_middle():
    position, target = np.array([3.0, -2.0, 5.0]), np.array([-1.0, 4.0, 2.0])
    rays = wrt.PinholeCamera(7, 5, position=position, look_at=target, up=(0.3, 0.1, 2.0)).rays()
    np.testing.assert_allclose(rays.directions[2, 3], unit(target - position), atol=1e-7)


@pytest.mark.parametrize("fov", [1e-3, 10.0, 45.0, 170.0])
def test_fov_is_the_vertical_angle_between_the_edges(fov):
    height = 1001
    directions = forward_camera(3, height, fov=fov).rays().directions[:, 1].astype(float)
    tangents = directions[:, 2] / directions[:, 1]
    expected = np.tan(np.radians(fov) / 2) * (1 - (2 * np.arange(height) + 1) / height)
    np.testing.assert_allclose(tangents, expected, rtol=1e-5, atol=1e-6 * np.tan(np.radians(fov) / 2))


def test_up_is_upward_whatever_its_length():
    one = wrt.PinholeCamera(3, 3, position=ORIGIN, look_at=(1, 1, 0), up=(0, 1e-30, 1e-30)).rays().directions
    other = wrt.PinholeCamera(3, 3, position=ORIGIN, look_at=(1, 1, 0), up=(0, 5, 5)).rays().directions
    np.testing.assert_allclose(one, other, atol=1e-7)
    assert one[0, 1] @ [0, 1, 1] > one[2, 1] @ [0, 1, 1]


def test_far_from_the_origin_rays_meet_what_they_aim_at():
    """A metre-sized triangle grid 10,000 km away: each pixel's hit is where the plane's equation says."""
    far = np.array([1.0e7, -2.0e7, 5.0e6])
    corners = np.array([[-1.0, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]]) + far
    scene = wrt.Scene(wrt.TriangleMesh(corners, [[0, 1, 2], [0, 2, 3]]))
    position = far + np.array([0.0, -2.0, 0.0])
    camera = wrt.PinholeCamera(9, 9, fov=40, position=position, look_at=far)
    rays = camera.rays()
    hits = scene.intersect(rays)
    directions = rays.directions.astype(float)
    expected = position + directions * (2.0 / directions[..., 1:2])
    assert hits.is_hit.all()
    np.testing.assert_allclose(hits.position, expected, atol=1e-6)


def test_orthographic_rays_are_parallel_and_cover_the_height():
    camera = wrt.OrthographicCamera(6, 4, view_height=2.0, position=(10, 20, 30), look_at=(10, 25, 30))
    rays = camera.rays()
    assert rays.shape == (4, 6)
    assert rays.directions.shape == (1, 1, 3)
    np.testing.assert_allclose(rays.directions[0, 0], (0, 1, 0), atol=1e-7)
    assert rays.origins.dtype == np.float64
    np.testing.assert_allclose(rays.origins[..., 0], np.tile(10 + (np.arange(6) - 2.5) * 0.5, (4, 1)))
    np.testing.assert_allclose(rays.origins[..., 2], np.tile(30 + (1.5 - np.arange(4))[:, None] * 0.5, (1, 6)))
    np.testing.assert_array_equal(rays.origins[..., 1], 20.0)


def test_a_picture_of_one_pixel():
    for camera in (forward_camera(1, 1), wrt.OrthographicCamera(1, 1, view_height=1, position=ORIGIN, look_at=(0, 5, 0))):
        rays = camera.rays()
        assert rays.shape == (1, 1)
        np.testing.assert_allclose(np.broadcast_to(rays.directions, (1, 1, 3))[0, 0], (0, 1, 0), atol=1e-7)


@pytest.mark.parametrize("samples", [2, 3, 4, 7, 16, 64])
def test_samples_are_stratified_and_reproducible(samples):
    points = np.array([pixel_offset(s, samples, 0) for s in range(samples)])
    assert ((points >= 0) & (points < 1)).all()
    assert sorted((points[:, 0] * samples).astype(int)) == list(range(samples))
    rows = 2 ** (samples - 1).bit_length()
    assert len(set((points[:, 1] * rows).astype(int))) == samples
    shifted = np.array([pixel_offset(s, samples, 7) for s in range(samples)])
    assert ((shifted >= 0) & (shifted < 1)).all()
    assert not np.allclose(points, shifted)
    np.testing.assert_array_equal(shifted, [pixel_offset(s, samples, 7) for s in range(samples)])


def test_samples_stay_within_their_pixels():
    camera = wrt.OrthographicCamera(8, 8, view_height=8, position=ORIGIN, look_at=(0, 5, 0))
    centers = camera.rays().origins
    for sample in range(4):
        moved = camera.rays(sample, 4, seed=3).origins - centers
        assert np.abs(moved).max() <= 0.5
        assert np.ptp(moved, axis=(0, 1)).max() < 1e-12
    np.testing.assert_array_equal(camera.rays(0, 1, seed=9).origins, centers)


@pytest.mark.parametrize("fov", [20.0, 60.0, 120.0])
@pytest.mark.parametrize(("width", "height"), [(64, 64), (120, 40), (30, 90)])
@pytest.mark.parametrize("up", [(0, 0, 1), (0, 1, 0), (1, 1, 1)])
def test_framing_shows_everything_and_fills_the_picture(fov, width, height, up):
    mesh = random_triangles(50, seed=3).transformed(np.diag([5.0, 2.0, 1.0, 1.0]) + np.array([[0, 0, 0, 1e5]] * 3 + [[0] * 4]))
    camera = wrt.PinholeCamera.framing(mesh, width, height, fov=fov, up=up)
    relative = mesh.vertices - camera.position
    depth = relative @ camera.forward
    tangent = np.tan(np.radians(fov) / 2)
    x = relative @ camera.right / depth / (tangent * width / height)
    y = relative @ camera.up / depth / tangent
    assert depth.min() > 0
    largest = max(np.abs(x).max(), np.abs(y).max())
    assert 0.94 < largest <= 0.9501


def test_framing_takes_a_scene_and_a_direction():
    mesh = random_triangles(20)
    one = wrt.PinholeCamera.framing(mesh, 10, 10, towards=(0, 1, 0))
    other = wrt.PinholeCamera.framing(wrt.Scene(mesh), 10, 10, towards=(0, 1, 0))
    np.testing.assert_array_equal(one.position, other.position)
    np.testing.assert_allclose(one.forward, (0, 1, 0))
    with pytest.raises(TypeError, match=r"wrt\.TriangleMesh or a wrt\.Scene"):
        wrt.PinholeCamera.framing([1, 2], 10, 10)


@pytest.mark.parametrize("suffix", ["ply", "obj", "off", "glb", "stl"])
def test_framing_and_wrt_render_agree_on_the_upward_direction(tmp_path, monkeypatch, suffix):
    """`framing` took z for every file, and `wrt render` y for most: scans were shown from above or in front."""
    path, seen = tmp_path / f"model.{suffix}", []

    def fake(scene, camera, **options):
        seen.append(camera)
        return ambient(scene, camera, samples=1, ambient_samples=2)

    ambient = rendering_call.AmbientRendering
    monkeypatch.setattr(rendering_call, "AmbientRendering", fake)
    random_triangles(20).save(path)
    arguments = ["render", path, "-o", tmp_path / "a.png", "--width", 30, "--height", 20, "--device", "cpu"]
    assert CliRunner().invoke(main, [str(a) for a in arguments]).exit_code == 0
    mesh = wrt.TriangleMesh.load(path)
    upward = (0, 0, 1) if suffix == "stl" else (0, 1, 0)
    given = wrt.PinholeCamera.framing(mesh, 30, 20, fov=35, up=upward)
    for camera in (*seen, *(wrt.PinholeCamera.framing(geometry, 30, 20, fov=35) for geometry in (mesh, wrt.Scene(mesh)))):
        np.testing.assert_array_equal(camera.up, given.up)
        np.testing.assert_array_equal(camera.position, given.position)
    assert given.up @ upward > 0.9
    other = wrt.PinholeCamera.framing(mesh, 30, 20, up=(1, 0, 0))
    assert other.up[0] > 0.9


def test_framing_takes_z_if_meshes_differ_in_their_upward_direction():
    one, two = (
        wrt.TriangleMesh(random_triangles(5).vertices, random_triangles(5).faces, up=up) for up in ((0, 1, 0), (1, 0, 0))
    )
    assert wrt.PinholeCamera.framing(wrt.Scene([one, two]), 8, 8).up[2] > 0.9
    assert wrt.PinholeCamera.framing(wrt.Scene([one, random_triangles(5)]), 8, 8).up[1] > 0.9


def test_framing_a_single_point_of_view_on_a_flat_mesh():
    flat = wrt.TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]], [[0, 1, 2]])
    camera = wrt.PinholeCamera.framing(flat, 10, 10, towards=(0, 0, -1), up=(0, 1, 0))
    assert wrt.Scene(flat).intersect(camera.rays()).is_hit.sum() > 20


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"width": 0}, "width is 0"),
        ({"height": -3}, "height is -3"),
        ({"width": 2**17, "height": 2**16}, "at most"),
        ({"fov": 0.0}, "between 0 and 180"),
        ({"fov": 180.0}, "between 0 and 180"),
        ({"fov": float("nan")}, "fov is nan"),
        ({"position": (0, 5, 0)}, "position and look_at are the same"),
        ({"position": (0, 0)}, "position must be three numbers"),
        ({"look_at": (0, np.nan, 0)}, r"look_at is \(0, nan, 0\)"),
        ({"look_at": (0, np.inf, 0)}, "finite"),
        ({"up": (0, -3, 0)}, "up is parallel.*choose another"),
        ({"up": (0, 0, 0)}, "up is zero"),
    ],
)
def test_bad_values_name_the_argument(change, message):
    arguments = {"width": 4, "height": 4, "position": ORIGIN, "look_at": (0, 5, 0)} | change
    with pytest.raises(ValueError, match=message):
        wrt.PinholeCamera(arguments.pop("width"), arguments.pop("height"), **arguments)


def test_bad_types_and_samples():
    with pytest.raises(TypeError, match=r"width must be an int, not float 4\.0; pass 4"):
        forward_camera(4.0, 4)
    with pytest.raises(TypeError, match="position must hold real numbers"):
        wrt.PinholeCamera(4, 4, position="here", look_at=ORIGIN)
    with pytest.raises(TypeError, match="fov must be a number"):
        forward_camera(fov="wide")
    with pytest.raises(ValueError, match="view_height is 0"):
        wrt.OrthographicCamera(4, 4, view_height=0, position=ORIGIN, look_at=(0, 1, 0))
    for arguments, message in (((4, 4), "sample is 4"), ((-1, 4), "sample is -1"), ((0, 0), "samples is 0")):
        with pytest.raises(ValueError, match=message):
            forward_camera().rays(*arguments)
