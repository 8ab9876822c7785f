"""Trees of rays in tiles: the picture and the number of rays are those of whole generations, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import wrt
from wrt.imaging.integrators import tree_chain
from wrt.imaging.integrators.wavefront import Wave
from wrt.scenes.shapes import boxes, plane

CAMERA = wrt.PinholeCamera(48, 40, position=(0.3, -6, 2.5), look_at=(0.3, 0, 0.6))
LIGHTS = [wrt.lights.PointLight((3, -2, 4), 50.0), wrt.lights.DirectionalLight((0.3, 0.5, -1.0), 0.4)]


def ball(material, x, subdivisions=3):
    mesh = trimesh.creation.icosphere(subdivisions, 1.0).apply_translation((x, 0, 1.05))
    return wrt.TriangleMesh.from_trimesh(mesh).with_materials(material)


@pytest.fixture(scope="module")
def scene():
    """Clear glass and a mirror, which are shaded in lanes, beside coloured glass, gloss and a matte floor, which are not."""
    block = boxes((1.2, 0.9, 0.05), (2.0, 1.5, 1.5)).with_materials(
        wrt.Material("glossy", color=(0.9, 0.5, 0.2), roughness=0.4)
    )
    clear, green = wrt.Material("dielectric", index=1.5), wrt.Material("dielectric", index=1.4, absorption=(0.5, 0.1, 0.9))
    return wrt.Scene(
        [ball(clear, -1.1), ball(wrt.Material("mirror", color=0.9), 1.1), ball(green, 3.2), block, plane((-5, -5), (5, 5))],
        device="cpu",
    )


def made(scene, integrator, sky, **options):
    lights = [*LIGHTS, wrt.lights.Sky(0.6) if sky == "even" else wrt.lights.Sky.gradient(0.4, 0.8)]
    return wrt.pictures.Rendering(scene, CAMERA, integrator=integrator, **({"samples": 3, "lights": lights} | options))


def check_equal(in_tiles, by_generations):
    np.testing.assert_array_equal(in_tiles.linear, by_generations.linear)
    assert in_tiles.rays == by_generations.rays
    assert in_tiles.linear.max() > 0.3


@pytest.mark.parametrize(
    ("integrator", "sky", "options"),
    [
        ("whitted", "even", {}),
        ("whitted", "gradient", {"threshold": 0.05}),
        ("whitted", "even", {"roulette": False, "threshold": 0.05, "depth": 3, "smooth": False}),
        ("distribution", "gradient", {"threshold": 0.05, "sampler": "jittered"}),
    ],
)
def test_tiles_of_trees_do_not_show(scene, integrator, sky, options, monkeypatch):
    in_tiles = made(scene, integrator, sky, wave=3000, **options).advance()
    assert in_tiles._wave._chain is not None
    monkeypatch.setattr(Wave, "follow_in_tiles", lambda *_: False)
    check_equal(in_tiles, made(scene, integrator, sky, wave=3000, **options).advance())


@pytest.mark.parametrize("integrator", ["whitted", "distribution"])
def test_trees_that_find_no_place_are_divided(scene, integrator, monkeypatch):
    """A tile has places for some rays of a generation. Its samples are done in halves where they do not suffice, and by whole
    generations where those of one sample do not."""
    reference = made(scene, integrator, "even", threshold=0.0).advance()
    monkeypatch.setattr(tree_chain, "ROOM", 256)
    in_parts = made(scene, integrator, "even", threshold=0.0).advance()
    assert in_parts._wave._chain.min_samples_together < 256
    check_equal(in_parts, reference)
    monkeypatch.setattr(tree_chain, "ROOM", 64)
    many = [
        *LIGHTS,
        *LIGHTS,
        *LIGHTS,
        *LIGHTS,
        *LIGHTS,
        wrt.lights.Sky(0.6),
    ]  # a vector of rays may have more shadow rays than places
    too_small = made(scene, integrator, "even", lights=many).advance()
    assert too_small._wave._chain is None
    monkeypatch.setattr(Wave, "follow_in_tiles", lambda *_: False)
    check_equal(too_small, made(scene, integrator, "even", lights=many).advance())


@pytest.mark.parametrize("sky", ["even", "gradient"])
def test_the_last_rays_among_mirrors_and_glass_need_any_hit(scene, sky, monkeypatch):
    """Nothing but the sky sends light along them. One light with an area, or a matte surface, sends light too."""
    bare = wrt.Scene(scene.meshes[:3], device="cpu")
    in_tiles = made(bare, "whitted", sky, depth=3).advance()
    assert in_tiles._wave._chain.ends_by_any_hit
    light = [wrt.lights.AreaLight.sphere((-1, -3, 3), 0.7, 8.0), wrt.lights.Sky(0.3)]
    by_light = made(bare, "whitted", sky, depth=3, lights=light).advance()
    assert not by_light._wave._chain.ends_by_any_hit
    floor = made(scene, "whitted", sky, depth=3).advance()
    assert not floor._wave._chain.ends_by_any_hit
    monkeypatch.setattr(Wave, "follow_in_tiles", lambda *_: False)
    check_equal(in_tiles, made(bare, "whitted", sky, depth=3).advance())
    check_equal(by_light, made(bare, "whitted", sky, depth=3, lights=light).advance())


def test_threads_of_tiles_do_not_show(scene):
    reference = made(scene, "whitted", "even").advance()
    for threads in (1, 3):
        other = wrt.Scene(scene.meshes, device="cpu", num_threads=threads)
        check_equal(made(other, "whitted", "even").advance(), reference)


def test_an_interrupted_first_pass_leaves_no_light(scene):
    """The film of a first pass is not copied beforehand, because it is empty."""
    reference = made(scene, "whitted", "even", samples=1).advance().linear
    rendering = made(scene, "whitted", "even", samples=1, wave=500)

    def stop(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rendering.advance(progress=stop)
    assert rendering.done == 0
    np.testing.assert_array_equal(rendering.advance().linear, reference)
