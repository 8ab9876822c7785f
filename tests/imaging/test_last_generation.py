"""Rays of the last generation that can bring the light of the sky only are traced to any hit, or not at all, and tiles develop
their samples. Neither shows: generation by generation, all rays are traced to closest hits, and whole waves are developed.
"""

import numpy as np
import pytest
import trimesh
from support.selection import slow

import wrt
from wrt.imaging.integrators.wavefront import Wave
from wrt.scenes.shapes import plane

CAMERA = wrt.PinholeCamera(48, 32, fov=55, position=(0, -3.0, 1.6), look_at=(0, 0, 0.4), up=(0, 0, 1))

SKIES = {
    "dark": [],
    "even": [wrt.lights.Sky((0.5, 0.8, 1.0))],
    "gradient": [wrt.lights.Sky.gradient(0.8, (0.2, 0.4, 0.9), 0.2)],
}

LIGHTS = {
    "none": [],
    "point": [wrt.lights.PointLight((0.5, -1.0, 2.0), 4.0)],
    "sphere": [wrt.lights.AreaLight.sphere((0.2, 0.0, 1.5), 0.4, 8.0)],
    "rectangle": [wrt.lights.AreaLight.rectangle((-1, -1, 1.2), (2, 0, 0), (0, 2, 0), 5.0, two_sided=True)],
    "triangle": [wrt.lights.AreaLight.triangle((-1, -1, 1.2), (1, -1, 1.2), (-1, 1, 1.2), 5.0)],
    "in a body": [wrt.lights.AreaLight.sphere((-0.5, 0.2, 0.5), 0.2, 8.0)],
}


def bodies(emits: bool, level: int) -> wrt.Scene:
    """Matte ground, absorbing glass with a hollow place for a light, a mirror, and a small emissive tile in the air."""
    ball = trimesh.creation.icosphere(subdivisions=level, radius=0.5)
    corners = np.asarray(ball.vertices)
    glass = wrt.Material("dielectric", index=1.4, absorption=(0.3, 1.0, 2.0))
    parts = [
        plane((-2, -2), (2, 2), z=0.0).with_materials(wrt.Material(color=(0.7, 0.6, 0.5))),
        wrt.TriangleMesh(corners + np.array((-0.5, 0.2, 0.5)), ball.faces).with_materials(glass),
        wrt.TriangleMesh(corners + np.array((0.7, 0.3, 0.5)), ball.faces).with_materials(wrt.Material("mirror", color=0.9)),
        plane((-0.3, -0.3), (0.1, 0.3), z=1.7).with_materials(wrt.Material(color=0.3, emission=6.0 * emits)),
    ]
    return wrt.Scene(parts, device="cpu")


@pytest.fixture(scope="module", params=[(False, 1), (True, 1), (True, 3)], ids=["few", "few emissive", "many emissive"])
def scene(request):
    return bodies(*request.param)


@pytest.mark.parametrize("depth", [4, *slow(2)])
@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("sky", SKIES)
def test_closest_hits_and_any_hit_make_the_same_picture(scene, sky, light, depth, monkeypatch):
    options = {"lights": SKIES[sky] + LIGHTS[light], "integrator": "path", "samples": 4, "depth": depth}
    in_tiles = wrt.pictures.Rendering(scene, CAMERA, **options).advance()
    assert in_tiles._wave.develops_in_tiles(4)
    monkeypatch.setattr(Wave, "follow_in_tiles", lambda *_: False)
    by_generations = wrt.pictures.Rendering(scene, CAMERA, **options).advance()
    np.testing.assert_array_equal(in_tiles.linear, by_generations.linear)
    np.testing.assert_array_equal(in_tiles.noise, by_generations.noise)
    assert in_tiles.rays == by_generations.rays


@pytest.mark.parametrize(
    ("emits", "sky", "light", "most"), [(True, "dark", "none", 0.2), (False, "even", "sphere", 0.4), (False, "even", "none", 0)]
)
def test_few_rays_of_the_last_generation_need_closest_hits(emits, sky, light, most):
    """Those that may meet a light or an emissive triangle."""
    options = {"lights": SKIES[sky] + LIGHTS[light], "integrator": "path", "samples": 16, "depth": 3, "roulette": False}
    rendering = wrt.pictures.Rendering(bodies(emits, 1), CAMERA, **options).advance()
    chain = rendering._wave._chain._chain
    last = chain.items.sum(axis=1)[-3:]  # closest hits, their step, development
    parted = chain.items.sum(axis=1)[-6 if sky == "even" else -4]
    assert last[0] == last[1] <= most * parted
    assert last[2] == rendering.pixels * 16
    assert parted > 1000
    assert most == 0 or last[0] > 10


@pytest.mark.parametrize("samples", [(4, 4), (1, 2, 5), (3, 5), (8,)])
def test_samples_are_developed_once(samples, monkeypatch):
    """Tiles develop waves whose number of samples divides them, also after a wave of another number."""
    options = {"lights": SKIES["even"] + LIGHTS["sphere"], "integrator": "path", "samples": 8, "depth": 3, "max_radiance": 2.0}
    scene = bodies(True, 1)
    in_steps = wrt.pictures.Rendering(scene, CAMERA, **options)
    for count in samples:
        in_steps.advance(count)
    assert in_steps.done == 8
    monkeypatch.setattr(Wave, "follow_in_tiles", lambda *_: False)
    at_once = wrt.pictures.Rendering(scene, CAMERA, **options).advance()
    np.testing.assert_array_equal(in_steps.linear, at_once.linear)
    np.testing.assert_array_equal(in_steps.noise, at_once.noise)


def test_records_of_triangles_are_those_of_the_scene_as_it_is():
    """They are kept with their scene until it changes, and made anew for other normals."""
    scene = bodies(True, 2)
    options = {"lights": SKIES["even"], "integrator": "path", "samples": 2, "depth": 3}
    before = {
        smooth: wrt.pictures.Rendering(scene, CAMERA, smooth=smooth, **options).advance().linear for smooth in (True, False)
    }
    assert np.abs(before[True] - before[False]).max() > 0.01
    for smooth in (True, False):
        np.testing.assert_array_equal(
            wrt.pictures.Rendering(scene, CAMERA, smooth=smooth, **options).advance().linear, before[smooth]
        )
    moved = scene.meshes[2].vertices + np.array((0.0, 0.0, 0.3))
    scene.update(2, vertices=moved)
    made = wrt.pictures.Rendering(scene, CAMERA, smooth=False, **options).advance().linear
    other = bodies(True, 2)
    other.update(2, vertices=moved)
    np.testing.assert_array_equal(made, wrt.pictures.Rendering(other, CAMERA, smooth=False, **options).advance().linear)
    assert np.abs(made - before[False]).max() > 0.01
