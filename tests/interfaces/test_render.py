"""Shaded pictures against geometry, and image files."""

import numpy as np
import pytest
import trimesh
import warp as wp

import wrt
import wrt.imaging.ambient_rendering
from wrt.imaging import ambient_rays
from wrt.imaging.integrators import ray_tracer
from wrt.kernels.runtime.launch import use_threads
from wrt.scenes.shapes import boxes, plane

DEVICES = ["cpu", *(["cuda:0"] if wp.is_cuda_available() else [])]
ONLY_LIGHT = {"light_color": 1.0, "ambient_color": 0.0, "albedo": 1.0, "ambient_samples": 0}
ONLY_SKY = {"light_color": 0.0, "ambient_color": 1.0, "albedo": 1.0, "background": 0.0}


def linear(image):
    """Display colours back to linear."""
    image = image.astype(float)
    return np.where(image <= 0.04045, image / 12.92, ((image + 0.055) / 1.055) ** 2.4)


def rotation(seed):
    matrix = np.eye(4)
    matrix[:3, :3] = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    matrix[:3, 0] *= np.linalg.det(matrix[:3, :3])
    return matrix


def moved(mesh, turn, scale, offset):
    """Scaled, turned and moved, in float64."""
    vertices = (mesh.vertices * scale) @ turn[:3, :3].T + offset
    return wrt.TriangleMesh(vertices, mesh.faces)


def sphere(subdivisions=3, radius=1.0, center=(0, 0, 0)):
    return wrt.TriangleMesh.from_trimesh(trimesh.creation.icosphere(subdivisions, radius).apply_translation(center))


def from_above(size, width=32, height=32, at=(0.0, 0.0)):
    """An orthographic camera that looks straight down, +y up in the picture."""
    return wrt.OrthographicCamera(width, height, view_height=size, position=(*at, 50.0), look_at=(*at, 0.0), up=(0.0, 1.0, 0.0))


# -- light and shadow --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("device", DEVICES)
def test_a_sphere_throws_its_shadow_where_geometry_says(device):
    light, center = np.array([4.0, 1.0, 8.0]), np.array([0.0, 0.0, 3.0])
    scene = wrt.Scene([sphere(4, 1.0, center), plane((-9, -9), (9, 9), cells=3)], device=device)
    camera = from_above(12.0, 64, 64)
    image = linear(wrt.render(scene, camera, light=light, **ONLY_LIGHT))[..., 0]
    points = camera.rays().origins * (1, 1, 0)
    toward = light - points
    cosine = toward[..., 2] / np.linalg.norm(toward, axis=-1)
    along = np.clip(((center - points) * toward).sum(-1) / (toward**2).sum(-1), 0, 1)
    distance = np.linalg.norm(points + along[..., None] * toward - center, axis=-1)
    on_plane = np.hypot(points[..., 0], points[..., 1]) > 1.01
    shadow, lit = on_plane & (distance < 0.99), on_plane & (distance > 1.0)
    assert shadow.sum() > 50
    np.testing.assert_array_equal(image[shadow], 0.0)
    np.testing.assert_allclose(image[lit], cosine[lit], atol=1e-4)
    bright = linear(wrt.render(scene, camera, light=light, shadows=False, **ONLY_LIGHT))[..., 0]
    np.testing.assert_allclose(bright[on_plane], cosine[on_plane], atol=1e-4)


def test_both_sides_are_lit_alike():
    quad = plane((-2, -2), (2, 2), cells=2)
    back = wrt.TriangleMesh(quad.vertices, quad.faces[:, ::-1])
    images = [wrt.render(wrt.Scene(mesh), from_above(3.0), light=(1, 2, 3)) for mesh in (quad, back)]
    np.testing.assert_allclose(*images, atol=1e-6)
    below = linear(wrt.render(wrt.Scene(quad), from_above(3.0), light=(1, 2, -3), **ONLY_LIGHT))
    np.testing.assert_array_equal(below, 0.0)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e5])
@pytest.mark.parametrize("offset", [0.0, 1e4])
@pytest.mark.parametrize("cells", [1, 8])
def test_a_lit_plane_has_no_specks(scale, offset, cells):
    """Self-shadowing would show as dark pixels; the lights stand at grazing angles, too. `offset` counts in scales."""
    turn = rotation(int(cells + scale))
    shift = scale * offset * np.array([1.0, -2.0, 0.5])
    scene = wrt.Scene(moved(plane((-5, -5), (5, 5), cells=cells), turn, scale, shift))

    def place(point):
        return turn[:3, :3] @ (scale * np.array(point)) + shift

    camera = wrt.PinholeCamera(48, 48, fov=50, position=place((1, -6, 4)), look_at=place((0, 0, 0)), up=turn[:3, 2])
    rays = camera.rays()
    hits = scene.intersect(rays)
    for light in ((3, 1, 8), (40, 10, 0.4), (-2, 1, 0.05)):
        image = linear(wrt.render(scene, camera, light=place(light), background=0.0, **ONLY_LIGHT))[..., 0]
        toward = place(light) - hits.position
        cosine = np.abs(toward @ turn[:3, 2]) / np.linalg.norm(toward, axis=-1)
        np.testing.assert_allclose(image[hits.is_hit], cosine[hits.is_hit], atol=2e-3)
    sky = wrt.render(scene, camera, ambient_samples=8, **ONLY_SKY)[..., 0]
    np.testing.assert_array_equal(sky, hits.is_hit.astype(np.float32))


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e5])
def test_a_convex_body_does_not_darken_itself(scale):
    ball = moved(sphere(4), rotation(1), scale, scale * np.array([30.0, 0, 0]))
    camera = wrt.PinholeCamera.framing(ball, 64, 64)
    scene = wrt.Scene(ball)
    hit = scene.intersect(camera.rays()).is_hit
    image = wrt.render(scene, camera, ambient_samples=8, smooth=False, **ONLY_SKY)[..., 0]
    np.testing.assert_array_equal(image, hit.astype(np.float32))
    lit = {
        light: wrt.render(
            scene, camera, light=(scale * 60, scale * 40, scale * 30), smooth=False, shadows=light, background=0.0, **ONLY_LIGHT
        )
        for light in (True, False)
    }
    np.testing.assert_allclose(lit[True], lit[False], atol=0.05)  # only faces edge-on to the light may differ


@pytest.mark.parametrize("seed", [5, 10, 12])
def test_slivers_do_not_darken_themselves(seed):
    """The narrow sides of a beam are triangles a thousand times longer than high; rounding moves hits along them."""
    turn = rotation(seed)
    beam = moved(boxes((-1, -0.01, -3), (1, 0.02, 40)), turn, 1.0, np.array([3.0, -2.0, 1.0]))
    camera = wrt.PinholeCamera.framing(beam, 200, 200, towards=turn[:3, :3] @ (1.0, 0.4, 0.2), up=turn[:3, 1])
    scene = wrt.Scene(beam)
    image = wrt.render(scene, camera, ambient_samples=8, **ONLY_SKY)[..., 0]
    np.testing.assert_array_equal(image, scene.intersect(camera.rays()).is_hit.astype(np.float32))


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e5])
@pytest.mark.parametrize("shape", ["box", "wedge"])
@pytest.mark.parametrize("seed", [0, 1])
def test_no_light_leaks_into_a_closed_room(shape, scale, seed):
    """Lights close to the outside of walls and edges, cameras in the corners: every pixel is black."""
    room = boxes((-1, -1, -1), (1, 1, 1))
    if shape == "wedge":  # two walls at an angle of 20 degrees
        x, y = (2 * np.cos(np.radians(10)), 2 * np.sin(np.radians(10)))
        flat = np.array([[-1.0, 0, -1], [x - 1, -y, -1], [x - 1, y, -1]])
        corners = np.concatenate([flat, flat + np.array([0, 0, 2])])
        faces = [[0, 2, 1], [3, 4, 5], [0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4], [2, 0, 3], [2, 3, 5]]
        room = wrt.TriangleMesh(corners, faces)
    turn = rotation(seed) if seed else np.eye(4)
    shift = scale * seed * np.array([100.0, 20.0, -50.0])
    scene = wrt.Scene(moved(room, turn, scale, shift))

    def place(point):
        return turn[:3, :3] @ (scale * np.array(point)) + shift

    for target, light in (
        ((-1, 0, -1), (-1.01, -1.01, -1.01)),
        ((-1, 0, 0), (-1.001, 0.0, 0.2)),
        ((0.5, 0.1, -1), (0.5, 0.3, -1.001)),
        ((0.9, 0.3, 1), (3.0, 4.0, 5.0)),
    ):
        camera = wrt.PinholeCamera(96, 96, fov=120, position=place((0.4, 0.01, 0.02)), look_at=place(target))
        image = wrt.render(scene, camera, light=place(light), background=1.0, ambient_samples=4)
        assert np.count_nonzero(image) == 0


# -- ambient occlusion -------------------------------------------------------------------------------------------------


def test_openness_in_front_of_a_wall():
    """A long wall of height h at distance d hides (1 - d / sqrt(d^2 + h^2)) / 2 of the sky; half of it in the corner."""
    height = 2.0
    wall = moved(plane((0, -200), (height, 200)), np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0.0]]), 1.0, 0.0)
    scene = wrt.Scene([plane((-20, -20), (20, 20)), wall])
    camera = from_above(0.5, 256, 8, at=(8.0, 0.0))
    image = linear(wrt.render(scene, camera, ambient_samples=256, **ONLY_SKY))[..., 0].mean(axis=0)
    distance = camera.rays().origins[0, :, 0]
    expected = 1 - (1 - distance / np.hypot(distance, height)) / 2
    away = distance > 0
    np.testing.assert_allclose(image[away], expected[away], atol=0.012)
    assert image[away][0] == pytest.approx(0.5, abs=0.03)


def test_ambient_distance_limits_what_darkens():
    scene = wrt.Scene(boxes((-1, -1, -1), (1, 1, 1)))
    camera = wrt.PinholeCamera(33, 33, fov=90, position=(0, -0.9, 0), look_at=(0, 1, 0))
    closed = wrt.render(scene, camera, **ONLY_SKY)
    np.testing.assert_array_equal(closed, 0.0)
    near = wrt.render(scene, camera, ambient_distance=0.5, **ONLY_SKY)
    assert near[16, 16, 0] == 1.0
    assert near[0, 0, 0] < 0.9


def test_no_ambient_samples_leave_the_sky_open():
    scene = wrt.Scene(boxes((-1, -1, -1), (1, 1, 1)))
    camera = wrt.PinholeCamera(8, 8, position=(0, 0, 0), look_at=(0, 1, 0))
    np.testing.assert_array_equal(wrt.render(scene, camera, ambient_samples=0, **ONLY_SKY), 1.0)


def test_ambient_grain_is_fine_and_fades_with_samples():
    """Pixels are independent (no bands), and the error falls faster than that of plain random rays."""
    wall = moved(plane((0, -200), (1, 200)), np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0.0]]), 1.0, 0.0)
    scene = wrt.Scene([plane((-20, -20), (20, 20)), wall])
    camera = from_above(0.01, 64, 64, at=(1.0, 0.0))
    spread = {}
    for samples in (16, 64):
        values = linear(wrt.render(scene, camera, ambient_samples=samples, **ONLY_SKY))[..., 0]
        spread[samples] = values.std()
        errors = values - values.mean()
        neighbours = (errors[:, 1:] * errors[:, :-1]).mean() / values.var()
        assert abs(neighbours) < 0.08
    hidden = (1 - 0.5**0.5) / 2
    assert spread[16] < 0.7 * (hidden * (1 - hidden) / 16) ** 0.5
    assert spread[64] < 0.42 * spread[16]


# -- normals -----------------------------------------------------------------------------------------------------------


def test_smooth_normals_follow_a_sphere_without_a_jagged_terminator():
    ball = wrt.Scene(sphere(2))
    camera = wrt.OrthographicCamera(64, 64, view_height=1.9, position=(0, -5, 0), look_at=(0, 0, 0))
    light = np.array([8.0, -6.0, 3.0])
    image = linear(wrt.render(ball, camera, light=light, background=0.0, **ONLY_LIGHT))[..., 0]
    origins = camera.rays().origins
    inside = np.hypot(origins[..., 0], origins[..., 2]) < 0.85
    radius_left = np.sqrt(1 - origins[inside][:, 0] ** 2 - origins[inside][:, 2] ** 2)
    points = np.stack([origins[inside][:, 0], -radius_left, origins[inside][:, 2]], axis=-1)
    toward = light - points
    cosine = np.maximum(0, (points * toward).sum(-1) / np.linalg.norm(toward, axis=-1))
    np.testing.assert_allclose(image[inside], cosine, atol=0.08)
    flat = linear(wrt.render(ball, camera, light=light, background=0.0, smooth=False, **ONLY_LIGHT))[..., 0]
    assert np.abs(flat[inside] - cosine).max() > 0.1


def test_creases_stay_sharp_and_winding_does_not_matter():
    cube = boxes((-1, -1, -1), (1, 1, 1))
    camera = wrt.PinholeCamera.framing(cube, 48, 48)
    smooth, flat = (wrt.render(wrt.Scene(cube), camera, smooth=s, ambient_samples=2) for s in (True, False))
    np.testing.assert_allclose(smooth, flat, atol=1e-6)
    ball = sphere(2)
    faces = ball.faces.copy()
    faces[::3] = faces[::3, ::-1]
    mixed = wrt.TriangleMesh(ball.vertices, faces)
    split = wrt.TriangleMesh(ball.vertices[ball.faces].reshape(-1, 3), np.arange(ball.faces.size).reshape(-1, 3))
    images = [wrt.render(wrt.Scene(mesh), camera, ambient_samples=2, light=(4, -4, 6)) for mesh in (ball, mixed, split)]
    np.testing.assert_allclose(images[1], images[0], atol=2e-2)
    np.testing.assert_allclose(images[2], images[0], atol=1e-5)


def test_corner_normals_of_a_cylinder_keep_the_rim():
    mesh = wrt.TriangleMesh.from_trimesh(trimesh.creation.cylinder(1.0, 2.0, sections=32))
    scene = wrt.Scene(mesh)
    normals = wrt.imaging.sampled_picture.corner_normals(scene, 30.0).numpy().reshape(-1, 3, 3)
    assert wrt.imaging.sampled_picture.corner_normals(scene, 30.0) is wrt.imaging.sampled_picture.corner_normals(scene, 30.0)
    side = np.abs(mesh.face_normals[:, 2]) < 0.5
    radial = mesh.vertices[mesh.faces[side]] * (1, 1, 0)
    np.testing.assert_allclose(normals[side], radial, atol=1e-5)
    np.testing.assert_allclose(normals[~side], np.repeat(mesh.face_normals[~side][:, None], 3, axis=1), atol=1e-6)


# -- the same picture, whatever the engine -----------------------------------------------------------------------------


def small_scene():
    return wrt.Scene([sphere(2, 1.0, (0, 0, 1)), plane((-6, -6), (6, 6), cells=2)])


def small_camera():
    return wrt.PinholeCamera(70, 50, position=(3, -5, 3), look_at=(0, 0, 1))


def test_threads_and_tiles_do_not_show(monkeypatch):
    scene, camera = small_scene(), small_camera()
    images = []
    for threads, tile in ((1, 1 << 16), (3, 1 << 16), (2, 999)):
        monkeypatch.setattr(wrt.imaging.ambient_rendering, "TILE_PIXELS", tile)
        with use_threads(threads):
            images.append(wrt.render(scene, camera, samples=2, ambient_samples=3))
    np.testing.assert_array_equal(images[0], images[1])
    np.testing.assert_array_equal(images[0], images[2])
    assert images[0].shape == (50, 70, 3)
    assert images[0].dtype == np.float32
    assert 0.0 <= images[0].min() < images[0].max() <= 1.0


def test_batches_of_ambient_rays_do_not_show(monkeypatch):
    """A point's rays are traced at once, those of misses not at all, and batches of all sizes by one plan: each would need its
    own kernels."""
    scene, camera = small_scene(), small_camera()
    whole = wrt.render(scene, camera, samples=2, ambient_samples=20)
    plans = set()
    trace = ray_tracer.trace_chosen

    def note(state, chosen, rays, *more):
        plans.add(chosen.plan)
        return trace(state, chosen, rays, *more)

    monkeypatch.setattr(ray_tracer, "trace_chosen", note)
    monkeypatch.setattr(ambient_rays, "DIRECTIONS_AT_ONCE", 7)
    monkeypatch.setattr(wrt.imaging.ambient_rendering, "TILE_PIXELS", 700)  # the uppermost tiles have few hits
    np.testing.assert_array_equal(wrt.render(scene, camera, samples=2, ambient_samples=20), whole)
    assert len(plans) == 1


def test_seeds_change_the_grain_only():
    scene, camera = small_scene(), small_camera()
    one, other = (wrt.render(scene, camera, samples=4, ambient_samples=8, seed=seed) for seed in (0, 1))
    assert (one != other).any()
    assert np.abs(one - other).mean() < 0.02


@pytest.mark.parametrize("names", [{"traversal": "brute"}, {"triangle_test": "woop"}])
def test_traversal_and_triangle_test_are_handed_on(names):
    scene, camera = small_scene(), small_camera()
    np.testing.assert_array_equal(
        wrt.render(scene, camera, ambient_samples=2, **names), wrt.render(scene, camera, ambient_samples=2)
    )
    with pytest.raises(ValueError, match="unknown"):
        wrt.render(scene, camera, **dict.fromkeys(names, "no_such"))


def test_progress_counts_up_to_the_end(monkeypatch):
    monkeypatch.setattr(wrt.imaging.ambient_rendering, "TILE_PIXELS", 1000)
    calls = []
    wrt.render(small_scene(), small_camera(), samples=2, ambient_samples=0, progress=lambda *call: calls.append(call))
    assert calls == [(875 * i, 7000) for i in range(1, 9)], "tiles of one size, as each size may need a kernel of its own"


def test_an_interrupted_rendering_leaves_nothing_broken():
    scene, camera = small_scene(), small_camera()
    before = wrt.render(scene, camera, samples=2, ambient_samples=2)

    def stop(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        wrt.render(scene, camera, samples=2, ambient_samples=2, progress=stop)
    np.testing.assert_array_equal(wrt.render(scene, camera, samples=2, ambient_samples=2), before)


# -- colours and errors ------------------------------------------------------------------------------------------------


def test_background_and_albedo():
    quad = plane((0, -4), (4, 4))  # the right half of the picture: two triangles
    scene, camera = wrt.Scene(quad), from_above(2.0, 16, 16)
    sky = {"light_color": 0.0, "ambient_color": 1.0}
    red = wrt.render(scene, camera, albedo=(1, 0, 0), background=(0.2, 0.4, 0.6), **sky)
    np.testing.assert_allclose(red[:, :8], np.broadcast_to((0.2, 0.4, 0.6), (16, 8, 3)), atol=1e-5)
    np.testing.assert_allclose(red[:, 8:], np.broadcast_to((1, 0, 0), (16, 8, 3)), atol=1e-5)
    whole = from_above(8.0, 16, 16, at=(2.0, 0.0))
    each = wrt.render(scene, whole, **sky, albedo=[(0, 1, 0), (0, 0, 1)])[:, 4:12]
    assert {tuple(np.round(c).astype(int)) for c in each.reshape(-1, 3)} == {(0, 1, 0), (0, 0, 1)}
    gradient = wrt.render(scene, camera, background=(0.2, 0.8))[:, 0, 0]
    assert (np.diff(gradient) < 0).all()
    assert 0.2 < gradient[-1] < gradient[0] < 0.8


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"samples": 0}, ValueError, "samples is 0"),
        ({"ambient_samples": -1}, ValueError, "ambient_samples is -1"),
        ({"ambient_distance": 0.0}, ValueError, "ambient_distance is 0"),
        ({"ambient_distance": float("nan")}, ValueError, "ambient_distance is nan"),
        ({"light": (1, 2)}, ValueError, "light must be three numbers"),
        ({"light": (1, 2, float("nan"))}, ValueError, "light is"),
        ({"albedo": 1.5}, ValueError, "albedo must be from 0 to 1"),
        ({"albedo": np.ones((5, 3))}, ValueError, r"albedo must be a number or of shape \(3,\) or"),
        ({"background": "blue"}, ValueError, "background must be"),
        ({"light_color": -1.0}, ValueError, "light_color must be finite and not negative"),
        ({"crease_angle": 90}, ValueError, "crease_angle is 90"),
        ({"samples": 1.5}, TypeError, "samples must be an int"),
        ({"seed": -1}, ValueError, "seed is -1"),
    ],
)
def test_bad_values_name_the_argument(change, error, message):
    with pytest.raises(error, match=message):
        wrt.render(small_scene(), small_camera(), **change)


def test_scene_and_camera_are_checked():
    with pytest.raises(TypeError, match=r"wrt\.Scene\(mesh\)"):
        wrt.render(sphere(), small_camera())
    with pytest.raises(TypeError, match=r"camera must be a wrt\.PinholeCamera"):
        wrt.render(small_scene(), None)


def test_render_stays_a_function_after_its_module_is_imported():
    assert callable(wrt.render)


def test_an_unknown_option_lists_those_of_the_integrator():
    scene, camera = small_scene(), small_camera()
    with pytest.raises(TypeError, match=r"'ambient' has no option 'smaples'; its options are .*samples.*albedo"):
        wrt.render(scene, camera, smaples=4)
    with pytest.raises(TypeError, match=r"'path' has no option 'albedo'; its options are .*samples.*depth"):
        wrt.render(scene, camera, integrator="path", albedo=0.5)
