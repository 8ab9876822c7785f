"""Multi-frusta: the same answers as `occluded` for the same rays, to the bit."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from support.hits import mixed_rays
from support.meshes import SCENES

import wrt
from wrt.kernels.layout.light_samples import pattern_of

pytestmark = pytest.mark.width


def agree(light: wrt.lights.AreaLightVisibility, points: np.ndarray, t_min=0.0, t_max=1.0, **options) -> np.ndarray:
    answers = light.occluded(points, t_min, t_max)
    expected = light.scene.occluded(light.shadow_rays(points, t_min, t_max), **options)
    np.testing.assert_array_equal(answers, expected)
    dark = expected.sum(axis=-1).astype(np.float32)
    fraction = light.visible(points, t_min, t_max)
    np.testing.assert_array_equal(fraction, np.float32(1.0) - dark / np.float32(light.samples))
    return answers


@pytest.mark.parametrize("samples", [1, 5, 16, 40, 300])
def test_as_brute_force(scene_mesh, samples):
    """Lights outside, inside and behind geometry, on a face, flat along an axis; points on the light's plane."""
    scene = wrt.Scene(scene_mesh, wrt.Bvh())
    points, _ = mixed_rays(scene_mesh, 1600 // max(samples, 16) + 20)
    low, high = scene_mesh.bounds
    size = high - low + 1e-6
    face = scene_mesh.vertices[scene_mesh.faces[3 % scene_mesh.triangle_count]].astype(np.float64)
    for corner, u, v in (
        (high + 0.3 * size, [0.3, 0, 0], [0, 0.3, 0]),
        ((low + high) / 2, [0.3, 0, 0.1], [0, 0.3, -0.1]),
        (low - 2.0 * size, [0.5, 0.1, 0], [0, 0.1, 0.6]),
        (face[0], (face[1] - face[0]) / size, (face[2] - face[0]) / size),
    ):
        light = wrt.lights.AreaLightVisibility.rectangle(scene, corner, u * size, v * size, samples)
        agree(light, points, traversal="brute" if samples <= 16 else "auto")
        agree(light, points, 1e-3, 0.9)


@pytest.mark.parametrize("triangle_test", ["moeller_trumbore", "wald"])
@pytest.mark.parametrize("name", ["atrium", "needles"])
def test_other_triangle_tests(name, triangle_test):
    mesh = SCENES[name]()
    scene = wrt.Scene(mesh, wrt.Bvh())
    low, high = mesh.bounds
    options = {"triangle_test": triangle_test}
    light = wrt.lights.AreaLightVisibility.rectangle(
        scene, high, (low - high) * [0.3, 0, 0], (low - high) * [0, 0.3, 0.1], **options
    )
    agree(light, mixed_rays(mesh, 300)[0], **options)


def test_directions_around_an_axis():
    """Intervals of directions that contain 0, end at 0, or are 0."""
    mesh = SCENES["grid"]()
    scene = wrt.Scene(mesh, wrt.Bvh())
    flat = np.linspace(-0.25, 0.25, 16)
    for axis in range(3):
        for spread in (0.0, 1.0, 1e-30):
            samples = np.zeros((16, 3))
            samples[:, axis] = 2.0
            samples[:, (axis + 1) % 3] = 0.5 + spread * flat
            samples[:, (axis + 2) % 3] = 0.5
            light = wrt.lights.AreaLightVisibility(scene, samples)
            points = np.full((40, 3), 0.5, dtype=np.float32)
            points[:, axis] = np.linspace(-1.0, 2.0, 40)
            points[::2, (axis + 1) % 3] = 0.25
            agree(light, points)
            agree(light, points, 0.0, np.inf)


def test_bad_points_see_everything():
    scene = wrt.Scene(SCENES["teapot"](), wrt.Bvh())
    light = wrt.lights.AreaLightVisibility(scene, [[0, 0, 9], [0, 1, 9]])
    points = np.float32([[np.nan, 0, 0], [0, np.inf, 0], [0, 0, 9], [0, 0, -9]])
    np.testing.assert_array_equal(light.visible(points), [1, 1, 1, 0])
    agree(light, points)
    assert light.occluded(np.zeros((0, 3), np.float32)).shape == (0, 2)
    assert light.visible(np.zeros((2, 3, 3), np.float32)).shape == (2, 3)


def test_float64_points_and_ranges_of_their_own():
    mesh = SCENES["teapot"]()
    offset = np.array([3e5, -2e5, 1e5])
    scene = wrt.Scene(wrt.TriangleMesh(mesh.vertices + offset, mesh.faces), wrt.Bvh())
    light = wrt.lights.AreaLightVisibility.rectangle(scene, offset + np.array([-3, -3, 8]), (6, 0, 0), (0, 6, 0), 20)
    points = mixed_rays(mesh, 500)[0] + offset
    answers = agree(light, points, np.linspace(0, 0.5, 500, dtype=np.float32), np.linspace(0.4, 2, 500, dtype=np.float32))
    assert 0.0 < answers.mean() < 1.0


@pytest.mark.parametrize("accelerator", ["kdtree", "bvh"])
def test_every_scene_answers(accelerator, device):
    """Other trees and CUDA make the rays and trace them."""
    mesh = SCENES["teapot"]()
    scene = wrt.Scene(mesh, accelerator, device=device)
    light = wrt.lights.AreaLightVisibility.rectangle(scene, (-3, -3, 8), (6, 0, 0), (0, 6, 0), 9)
    points, _ = mixed_rays(mesh, 200)
    answers = agree(light, points)
    warp = light.occluded(wp.array(points, dtype=wp.vec3, device=device))
    assert isinstance(warp, wp.array)
    np.testing.assert_array_equal(warp.numpy(), answers)


def test_follows_its_scene():
    mesh = SCENES["teapot"]()
    scene = wrt.Scene(mesh, wrt.Bvh())
    light = wrt.lights.AreaLightVisibility.rectangle(scene, (-3, -3, 8), (6, 0, 0), (0, 6, 0))
    points, _ = mixed_rays(mesh, 300)
    before = light.occluded(points)
    scene.update(0, vertices=mesh.vertices * np.float32([1.0, 2.0, 0.5]))
    assert (agree(light, points) != before).any()


@pytest.mark.parametrize("samples", [1, 7, 12, 16, 64, 256])
def test_samples_are_stratified(samples):
    """One in each cell of a grid; the same arguments give the same; patterns differ."""
    scene = wrt.Scene(SCENES["teapot"](), wrt.Bvh())
    light = wrt.lights.AreaLightVisibility.rectangle(scene, (0, 0, 9), (1, 0, 0), (0, 1, 0), samples, patterns=3)
    again = wrt.lights.AreaLightVisibility.rectangle(scene, (0, 0, 9), (1, 0, 0), (0, 1, 0), samples, patterns=3)
    np.testing.assert_array_equal(light.positions, again.positions)
    assert len(np.unique(light.positions[:, 0, 0])) == 3
    across = max(n for n in range(1, int(samples**0.5) + 1) if samples % n == 0)
    for pattern in light.positions:
        cells = np.floor(pattern[:, :2] * [across, samples // across]).astype(int)
        assert len(np.unique(cells, axis=0)) == samples
    assert set(pattern_of(np.arange(500), 3)) == {0, 1, 2}


def test_an_unobstructed_half():
    """A wall hides the half of the light behind it: the visible fraction is 1/2 within a row of samples."""
    wall = np.float32([[0, -50, 1], [0, 50, 1], [60, 0, 1]])
    scene = wrt.Scene(wrt.TriangleMesh(wall, [[0, 1, 2]]), wrt.Bvh())
    light = wrt.lights.AreaLightVisibility.rectangle(scene, (-1, -1, 2), (2, 0, 0), (0, 2, 0), 256)
    assert abs(light.visible(np.zeros(3, np.float32)) - 0.5) <= 1 / 16


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (((0, 0), (1, 0, 0), (0, 1, 0)), ValueError, "corner must be three numbers"),
        (((0, 0, 1), (np.inf, 0, 0), (0, 1, 0)), ValueError, "edge_u is .* must be finite"),
        (((0, 0, 1), (1, 0, 0), "v"), TypeError, "edge_v"),
        (((0, 0, 1), (1, 0, 0), (0, 1, 0), 0), ValueError, "samples is 0"),
        (((0, 0, 1), (1, 0, 0), (0, 1, 0), 1.5), TypeError, "samples must be an int"),
    ],
)
def test_bad_arguments(arguments, error, message):
    scene = wrt.Scene(SCENES["teapot"](), wrt.Bvh())
    with pytest.raises(error, match=message):
        wrt.lights.AreaLightVisibility.rectangle(scene, *arguments)


def test_bad_samples():
    scene = wrt.Scene(SCENES["teapot"](), wrt.Bvh())
    for positions, message in ((np.zeros((0, 3)), "0 samples"), (np.zeros((4, 2)), "shape"), ([[np.nan, 0, 0]], "finite")):
        with pytest.raises(ValueError, match=message):
            wrt.lights.AreaLightVisibility(scene, positions)
    with pytest.raises(ValueError, match="shared origin"):
        wrt.lights.AreaLightVisibility(scene, [[0, 0, 1]], triangle_test="komatsu")
