"""Lights under a sky of one colour: paths find such a sky by scattering, and choose a light each time."""

from __future__ import annotations

import numpy as np
import pytest

import wrt
from wrt.lights import device_lights
from wrt.scenes.shapes import boxes, plane

CAMERA = wrt.PinholeCamera(24, 24, position=(2, -6, 4), look_at=(0, 0, 0.5))
SUN = wrt.lights.DirectionalLight((0.4, 0.3, -1.0), 3.0)


def pictures(lights, count=16):
    """(count, 24, 24, 3) float64, pictures of a box on a floor."""
    material = wrt.Material(color=0.8)
    meshes = [boxes((-1, -1, 0.0), (1, 1, 1.5)).with_materials(material), plane((-5, -5), (5, 5)).with_materials(material)]
    scene = wrt.Scene(meshes, device="cpu")
    options = {"integrator": "path", "lights": lights, "samples": 64, "sampler": "random", "depth": 5, "smooth": False}
    made = [wrt.pictures.Rendering(scene, CAMERA, seed=seed, **options).advance().linear for seed in range(count)]
    return np.array(made, dtype=np.float64)


def chosen(lights):
    """Probabilities with which lights are chosen, the sky's last."""
    rendering = wrt.pictures.Rendering(
        wrt.Scene(plane((-5, -5), (5, 5)), device="cpu"), CAMERA, integrator="path", lights=lights
    )
    return np.diff(rendering._lit.lights.sums.numpy())


@pytest.mark.parametrize("light", [SUN, wrt.lights.AreaLight.sphere((-2, -2, 4), 0.4, 40.0)])
def test_a_sky_that_is_not_chosen_gives_the_same_light_with_less_noise(light, monkeypatch):
    lights = [wrt.lights.Sky((0.8, 0.9, 1.0)), light]
    assert chosen(lights).tolist() == [1.0, 0.0]
    found = pictures(lights)
    monkeypatch.setattr(device_lights, "EVEN_SKY_SHARE", 0.0)
    assert chosen(lights).min() > 0.0
    reference = pictures(lights)
    error = np.sqrt((found.var(axis=0, ddof=1) + reference.var(axis=0, ddof=1)) / len(found))
    apart = np.abs(found.mean(axis=0) - reference.mean(axis=0)) / np.maximum(error, 1e-6)
    assert np.percentile(apart, 95) < 3.0
    assert abs(found.mean() / reference.mean() - 1.0) < 3e-3
    assert found.var(axis=0, ddof=1).mean() < 0.9 * reference.var(axis=0, ddof=1).mean()


def test_other_skies_are_chosen():
    """A sky alone, one much brighter than the lights, and one of several colours."""
    assert chosen([wrt.lights.Sky(1.0)]).tolist() == [1.0]
    assert chosen([wrt.lights.Sky(1.0), wrt.lights.DirectionalLight((0, 0, -1), 0.1)])[-1] > 0.7
    assert chosen([wrt.lights.Sky.gradient(0.4, 0.8), SUN])[-1] > 0.0
