"""The light buffer: the same answers as `occluded` for the same rays, to the bit, and what its lists hold."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from support.hits import mixed_rays
from support.meshes import SCENES

import wrt
from wrt.kernels.layout.light_cells import CELL_BYTES, ENTRY_BYTES
from wrt.shadows.light_buffer import default_resolution

pytestmark = pytest.mark.width

PLACES = ("outside", "middle", "vertex", "on a face", "in a plane", "far")


def light_at(mesh: wrt.TriangleMesh, place: str) -> np.ndarray:
    """A position of a light relative to a mesh, hard ones included."""
    low, high = mesh.bounds
    size, face = high - low + 1e-6, mesh.vertices[mesh.faces[5 % mesh.triangle_count]].astype(np.float64)
    return {
        "outside": low - 0.5 * size,
        "middle": (low + high) / 2,
        "vertex": face[0],
        "on a face": face.mean(axis=0),
        "in a plane": face[0] + 3.0 * (face[1] - face[0]) + 0.5 * (face[2] - face[0]),
        "far": low + 60.0 * size,
    }[place]


def agree(buffer: wrt.lights.LightBuffer, points: np.ndarray, t_min=0.0, t_max=1.0, skip=None, **options) -> np.ndarray:
    answers = buffer.occluded(points, t_min, t_max, skip=skip)
    expected = buffer.scene.occluded(buffer.shadow_rays(points, t_min, t_max), skip=skip, **options)
    np.testing.assert_array_equal(answers, expected)
    return answers


@pytest.mark.parametrize("place", PLACES)
def test_as_brute_force(scene_mesh, place):
    scene = wrt.Scene(scene_mesh)
    points, _ = mixed_rays(scene_mesh, 700)
    light = light_at(scene_mesh, place)
    for resolution in (None, 1, 7):
        buffer = wrt.lights.LightBuffer(scene, light, resolution)
        agree(buffer, points, traversal="brute")
        agree(buffer, points, 1e-3)
        agree(buffer, points, 0.2, 0.9)  # ends short of the light


@pytest.mark.parametrize("name", ["teapot", "grid"])
@pytest.mark.parametrize(
    "options", [{"triangle_test": "moeller_trumbore"}, {"cull_backfaces": True}, {"triangle_test": "wald"}], ids=str
)
def test_other_tests_and_culling(name, options):
    """Tests that are not accurate may hit anywhere in the box of a triangle; culled fronts are not listed."""
    mesh = SCENES[name]()
    scene = wrt.Scene(mesh)
    points, _ = mixed_rays(mesh, 1500)
    for place in PLACES:
        agree(wrt.lights.LightBuffer(scene, light_at(mesh, place), **options), points, **options)


def test_skipped_triangles():
    """A ray that ignores the triangle that covers its cell is not occluded by the mark."""
    mesh = SCENES["atrium"]()
    scene = wrt.Scene(mesh)
    hits = scene.intersect(*mixed_rays(mesh, 4000))
    buffer = wrt.lights.LightBuffer(scene, light_at(mesh, "middle"))
    assert buffer.covered_share > 0.1
    agree(buffer, hits.position.astype(np.float32), skip=hits)
    skip = np.random.default_rng(0).integers(-1, mesh.triangle_count, hits.shape)
    agree(buffer, hits.position.astype(np.float32), skip=skip)


def test_float64_points_far_from_the_origin():
    mesh = SCENES["teapot"]()
    moved = wrt.TriangleMesh(mesh.vertices + np.array([1e6, -2e6, 3e6]), mesh.faces)
    scene, (points, _) = wrt.Scene(moved), mixed_rays(mesh, 2000)
    buffer = wrt.lights.LightBuffer(scene, light_at(mesh, "outside") + np.array([1e6, -2e6, 3e6]))
    answers = agree(buffer, points + np.array([1e6, -2e6, 3e6]))
    assert 0.05 < answers.mean() < 0.95


def test_rays_that_lists_do_not_decide():
    """From far outside, and beyond the light."""
    mesh = SCENES["teapot"]()
    buffer = wrt.lights.LightBuffer(wrt.Scene(mesh), light_at(mesh, "outside"))
    points, _ = mixed_rays(mesh, 500)
    agree(buffer, points * np.float32(50.0))
    agree(buffer, points, 0.0, 3.0)
    agree(buffer, points, 0.0, np.linspace(0.0, 2.0, len(points), dtype=np.float32))
    agree(buffer, points, np.float32(0.1), np.inf)


def test_bad_points_and_the_light_itself_are_not_in_shadow():
    mesh = SCENES["teapot"]()
    buffer = wrt.lights.LightBuffer(wrt.Scene(mesh), (0.0, 0.0, 1.0))
    points = np.float32([[np.nan, 0, 0], [np.inf, 0, 0], [0, 0, 1], [0, 0, -9]])
    np.testing.assert_array_equal(buffer.occluded(points), [False, False, False, True])
    assert buffer.occluded(np.zeros((0, 3), np.float32)).shape == (0,)
    assert buffer.occluded(np.zeros((2, 5, 3), np.float32)).shape == (2, 5)


def test_a_covering_triangle_ends_the_list():
    """Behind a wall nothing is listed, and rays from there are answered by the mark."""
    wall = np.float32([[-50, 1, -50], [50, 1, -50], [0, 1, 80]])
    rng = np.random.default_rng(0)
    behind = (rng.random((500, 1, 3)) * [20, 5, 20] + [-10, 3, -10] + rng.normal(size=(500, 3, 3)) * 0.2).astype(np.float32)
    corners = np.concatenate([wall[None], behind]).reshape(-1, 3)
    scene = wrt.Scene(wrt.TriangleMesh(corners, np.arange(len(corners)).reshape(-1, 3)))
    buffer = wrt.lights.LightBuffer(scene, (0.0, 0.0, 0.0), 16)
    assert buffer.covered_share > 1 / 7  # nearly the whole face of +y
    listed = np.unique(buffer._cells.entries.numpy()[: buffer.entry_count].astype(np.uint32))
    assert len(listed) < 50
    points = (rng.random((3000, 3)) * [20, 9, 20] + [-10, 0.1, -10]).astype(np.float32)
    assert 0.5 < agree(buffer, points).mean() < 1.0


def test_lists_do_not_depend_on_threads():
    mesh = SCENES["atrium"]()
    arrays = []
    for threads in (1, 2):
        buffer = wrt.lights.LightBuffer(wrt.Scene(mesh, num_threads=threads), light_at(mesh, "middle"), 64)
        arrays.append((buffer._cells.cells.numpy().copy(), buffer._cells.entries.numpy()[: buffer.entry_count].copy()))
    np.testing.assert_array_equal(arrays[0][0], arrays[1][0])
    np.testing.assert_array_equal(arrays[0][1], arrays[1][1])


def test_follows_its_scene():
    mesh = SCENES["teapot"]()
    scene = wrt.Scene(mesh)
    points, _ = mixed_rays(mesh, 1000)
    buffer = wrt.lights.LightBuffer(scene, light_at(mesh, "outside"))
    before = buffer.occluded(points)
    scene.update(0, vertices=mesh.vertices * np.float32([1.0, 2.0, 0.5]))
    assert (agree(buffer, points) != before).any()
    buffer.update(light_at(mesh, "far"))
    np.testing.assert_array_equal(buffer.position, light_at(mesh, "far"))
    agree(buffer, points)


def test_warp_arrays(device):
    mesh = SCENES["teapot"]()
    scene = wrt.Scene(mesh, device=device)
    points, _ = mixed_rays(mesh, 300)
    buffer = wrt.lights.LightBuffer(scene, light_at(mesh, "outside"))
    answers = buffer.occluded(wp.array(points, dtype=wp.vec3, device=device))
    assert isinstance(answers, wp.array)
    assert answers.dtype is wp.bool
    np.testing.assert_array_equal(answers.numpy(), buffer.occluded(points))


def test_memory_is_bounded():
    scene = wrt.Scene(SCENES["teapot"]())
    buffer = wrt.lights.LightBuffer(scene, (0, 0, 9), 64)
    assert buffer.bytes == 6 * 64**2 * CELL_BYTES + buffer.entry_count * ENTRY_BYTES
    with pytest.raises(MemoryError, match="lower resolution or more max_bytes"):
        wrt.lights.LightBuffer(scene, (0, 0, 9), 64, max_bytes=buffer.bytes - 1)
    with pytest.raises(MemoryError, match="max_bytes"):
        wrt.lights.LightBuffer(scene, (0, 0, 9), 4096)
    position = buffer.position
    buffer._max_bytes = 1
    with pytest.raises(MemoryError):
        buffer.update((1, 2, 3))
    np.testing.assert_array_equal(buffer.position, position)


def test_default_resolution_grows_with_the_mesh():
    found = [default_resolution(count) for count in (1, 1000, 30_000, 100_000, 10**8)]
    assert found == sorted(found)
    assert (found[0], found[-1]) == (32, 512)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (((0, 0),), ValueError, "shape"),
        (((0, 0, np.nan),), ValueError, "finite"),
        (("here",), TypeError, "position"),
        (((0, 0, 1), 0), ValueError, "resolution is 0"),
        (((0, 0, 1), 2.5), TypeError, "resolution must be an int"),
        (((0, 0, 1), 5000), ValueError, "4096"),
    ],
)
def test_bad_arguments(arguments, error, message):
    with pytest.raises(error, match=message):
        wrt.lights.LightBuffer(wrt.Scene(SCENES["teapot"]()), *arguments)


def test_unsuitable_scenes_and_tests():
    mesh = SCENES["teapot"]()
    with pytest.raises(ValueError, match="without instances"):
        wrt.lights.LightBuffer(wrt.Scene([wrt.Instance(mesh)]), (0, 0, 9))
    with pytest.raises(ValueError, match="shared origin"):
        wrt.lights.LightBuffer(wrt.Scene(mesh), (0, 0, 9), triangle_test="komatsu")
    with pytest.raises(ValueError, match="nothing"):
        wrt.lights.LightBuffer(wrt.Scene(mesh), (0, 0, 9), triangle_test="nothing")
