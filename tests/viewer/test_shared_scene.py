"""The scene that clients share, and the arguments of `wrt.view`: no browser, no server."""

import time

import numpy as np
import pytest

import wrt
from wrt import scenes
from wrt.viewer.panels.scene_panel import polar
from wrt.viewer.shared_scene import SharedScene


@pytest.fixture
def mesh():
    return scenes.build("teapot", level=4)


def test_versions(mesh):
    """A version stays as it was; the caller's updates show after `refresh`, the viewer's own at once."""
    scene = wrt.Scene(mesh, device="cpu")
    shared, told = SharedScene(scene), []
    shared.listen(lambda: told.append(shared.current[0]))
    version, shown = shared.current
    shared.refresh()
    assert shared.current[0] == version
    scene.update(0, vertices=np.add(mesh.vertices, (5.0, 0.0, 0.0)))
    np.testing.assert_allclose(shown.bounds, mesh.bounds, atol=1e-5)
    shared.refresh()
    assert told == [version + 1]
    np.testing.assert_allclose(shared.current[1].bounds, np.add(mesh.bounds, (5.0, 0.0, 0.0)), atol=1e-4)


def test_another_tree_leaves_the_callers_scene(mesh):
    scene = wrt.Scene(mesh, device="cpu")
    shared = SharedScene(scene)
    shared.rebuild("kdtree")
    assert shared.accelerator.kind == "kdtree"
    assert scene.accelerator.kind == "bvh"
    assert shared.build_seconds > 0.0
    scene.update(0, vertices=np.add(mesh.vertices, (1.0, 0.0, 0.0)))
    shared.refresh()
    assert shared.accelerator.kind == "kdtree"
    np.testing.assert_allclose(shared.current[1].bounds, scene.bounds, atol=1e-5)
    with pytest.raises(ValueError, match="octree"):
        shared.rebuild("octree")
    assert shared.accelerator.kind == "kdtree"
    shared.rebuild(None)
    assert shared.accelerator.kind == "bvh"


def test_threads(mesh):
    shared = SharedScene(wrt.Scene(mesh, device="cpu", num_threads=2))
    assert shared.threads == 2
    version = shared.current[0]
    shared.set_threads(1)
    assert (shared.threads, shared.current[0]) == (1, version + 1)
    with pytest.raises(ValueError, match="threads"):
        shared.set_threads(0)


def test_instances_are_moved_in_the_callers_scene(mesh):
    scene = wrt.Scene([wrt.Instance(mesh), wrt.Instance(mesh)], device="cpu")
    shared = SharedScene(scene)
    version, matrix = shared.current[0], np.eye(4)
    matrix[0, 3] = 40.0
    shared.move(1, matrix)
    np.testing.assert_array_equal(scene.instances[1].transform, matrix)
    assert shared.current[0] == version + 1
    assert shared.update_seconds > 0.0
    with pytest.raises(ValueError, match="instance"):
        shared.move(7, matrix)


def test_animation_plays_and_pauses(mesh):
    seen, shown = [], []
    shared = SharedScene(wrt.Scene(mesh, device="cpu"), lambda scene, frame: seen.append(frame), 3)
    shared.play(200.0, lambda: shown.append(shared.frame))
    end = time.perf_counter() + 20.0
    while len(shown) < 5 and time.perf_counter() < end:
        time.sleep(0.005)
    shared.pause()
    assert seen[:5] == [1, 2, 0, 1, 2]
    count = len(seen)
    time.sleep(0.05)
    assert len(seen) == count
    assert not shared.is_playing


def test_scene_without_animation(mesh):
    shared = SharedScene(wrt.Scene(mesh, device="cpu"))
    with pytest.raises(ValueError, match="animate="):
        shared.play(24.0)
    with pytest.raises(ValueError, match="0 frames"):
        shared.show_frame(0)


def test_fuzzy_scenes_have_their_own_animation():
    cloth = scenes.waving_cloth(frames=3)
    scene = wrt.moving.FuzzyScene(cloth.frames, cloth.faces, device="cpu")
    shared = SharedScene(scene)
    assert shared.frames == scene.frame_count == 3
    shared.show_frame(2)
    assert scene.frame == 2


def test_turns_and_stretches_of_instances():
    """A gizmo knows only turns: what else is in a transform is kept."""
    rng = np.random.default_rng(2)
    for _ in range(20):
        matrix = rng.normal(size=(3, 3))
        turn, rest = polar(matrix)
        np.testing.assert_allclose(turn @ rest, matrix, atol=1e-12)
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(turn) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"scene": "bunny.ply"}, TypeError, "scene must be"),
        ({"integrator": "raster"}, ValueError, "raster"),
        ({"camera": "front"}, TypeError, "camera must be"),
        ({"options": {"light": 3}}, ValueError, "no integrator"),
        ({"animate": print}, ValueError, "frames"),
        ({"token": "short"}, ValueError, "token"),
        ({"token": "eight/characters"}, ValueError, "token"),
        ({"token": 12345678}, TypeError, "token"),
        ({"host": "192.0.2.1"}, ValueError, "no network interface"),
        ({"host": "no such host"}, ValueError, "no network interface"),
        ({"up": (0, 0)}, ValueError, "up"),
    ],
)
def test_bad_arguments(mesh, options, error, words):
    """Refused before a server starts."""
    pytest.importorskip("viser", reason="the viewer needs viser: pip install 'wrt[view]'")
    with pytest.raises(error, match=words):
        wrt.view(options.pop("scene", None) or wrt.Scene(mesh, device="cpu"), block=False, port=0, **options)


def test_an_error_ends_the_animation(mesh):
    """The thread used to end with the error on stderr, and the animation was said to play on."""

    def animate(scene, frame):
        raise ValueError("no such frame")

    shared, errors = SharedScene(wrt.Scene(mesh, device="cpu"), animate, 3), []
    shared.play(200.0, failed=errors.append)
    end = time.perf_counter() + 20.0
    while not errors and time.perf_counter() < end:
        time.sleep(0.005)
    assert str(errors[0]) == "no such frame"
    assert not shared.is_playing
    shared.pause()


def test_groups_move(mesh):
    """Of a `wrt.moving.GroupedScene`; another tree of it can be shown."""
    scene = wrt.moving.GroupedScene([mesh, wrt.TriangleMesh(np.add(mesh.vertices, (9.0, 0.0, 0.0)), mesh.faces)], device="cpu")
    vertices = np.asarray(mesh.vertices)
    shared = SharedScene(scene, lambda scene, frame: scene.update({1: np.add(vertices, (9.0 + frame, 0.0, 0.0))}), 4)
    shared.show_frame(3)
    np.testing.assert_allclose(shared.current[1].bounds[1], np.add(mesh.bounds[1], (12.0, 0.0, 0.0)), atol=1e-4)
    shared.rebuild("kdtree")
    np.testing.assert_allclose(shared.current[1].bounds, scene.bounds, atol=1e-4)
