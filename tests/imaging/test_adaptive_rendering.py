"""Adaptive pictures: more samples where there is noise, less error for the same number, and none in the mean without bias."""

from __future__ import annotations

import numpy as np
import pytest

import wrt
from wrt.imaging.integrators.adaptive_rendering import REACH, averaged, shared_out
from wrt.pictures import AdaptiveRendering, Rendering
from wrt.scenes.shapes import boxes, plane

FLOOR = plane((-3, -3), (3, 3), z=0.0).with_materials(wrt.Material(color=0.7))
BLOCK = boxes([[-0.5, -0.5, 0.0]], [[0.5, 0.5, 1.0]]).with_materials(wrt.Material(color=0.5))
SCENE = wrt.Scene([FLOOR, BLOCK], device="cpu")
CAMERA = wrt.PinholeCamera(position=(0, -5, 2.5), look_at=(0, 0, 0.6), up=(0, 0, 1), width=32, height=24, fov=60)
LIGHTS = [wrt.lights.AreaLight.sphere((2.5, -1.0, 3.0), 0.5, radiance=30.0), wrt.lights.Sky(0.2)]
OPTIONS = {"integrator": "path", "lights": LIGHTS, "depth": 3}


def errors(image, reference):
    """Squared errors, relative to the luminance as far as it is not dark."""
    return (((image - reference) / (reference + 0.1 * reference.mean())) ** 2).mean()


def test_noisy_pixels_get_more_samples():
    """Less error than with as many samples everywhere, with bias and without; the number is about what was asked for."""
    whole = Rendering(SCENE, CAMERA, samples=1024, seed=90_000, **OPTIONS).advance()
    reference = whole.linear
    even = np.mean(
        [errors(Rendering(SCENE, CAMERA, samples=32, seed=s, **OPTIONS).advance().linear, reference) for s in (1, 2)]
    )
    relative = (whole.noise / (reference.mean(axis=-1) + 0.1 * reference.mean())).ravel().argsort()
    for unbiased in (False, True):
        made = [
            AdaptiveRendering(SCENE, CAMERA, samples=32, unbiased=unbiased, seed=s, **OPTIONS).advance() for s in (1000, 2000)
        ]
        assert all(abs(one.counts.mean() / 32 - 1.0) < 0.05 for one in made)
        assert np.mean([errors(one.linear, reference) for one in made]) < 0.7 * even
        counts = made[0].counts.ravel()
        assert counts.min() >= 8
        assert counts[relative[-77:]].mean() > 1.5 * counts[relative[:384]].mean()
        assert made[0].noise.shape == (24, 32)
        true = np.sqrt(((made[0].linear - reference) ** 2).mean())
        assert 0.3 * true < np.sqrt((made[0].noise ** 2).mean()) < 10.0 * true  # spread of even samples is an upper estimate


@pytest.mark.slow
def test_means_have_no_bias_without_it():
    """A small lamp that only scattered rays find: a pixel whose first samples miss it gets few, and stays too dark if these
    count. The mean over many pictures is compared with that of even samples."""
    lamp = plane((-0.25, -0.25), (0.25, 0.25), z=2.0).with_materials(wrt.Material(color=0.0, emission=60.0))
    scene = wrt.Scene([FLOOR, lamp], device="cpu")
    camera = wrt.PinholeCamera(position=(0, -2, 1.0), look_at=(0, 0, 0), up=(0, 0, 1), width=12, height=9, fov=35)
    options = {"integrator": "path", "lights": [], "depth": 2, "sample_lights": False, "sampler": "random"}
    even = Rendering(scene, camera, samples=20_000, **options).advance()
    expected, runs = even.linear.mean(), 100
    means = {}
    for unbiased in (False, True):
        made = [
            AdaptiveRendering(scene, camera, samples=8, pilot=4, unbiased=unbiased, seed=1000 * seed, **options).advance()
            for seed in range(runs)
        ]
        means[unbiased] = np.array([one.linear.mean() for one in made])
    error = np.hypot(means[True].std() / np.sqrt(runs), np.sqrt((even.noise**2).sum()) / even.pixels)
    assert abs(means[True].mean() - expected) < 3.5 * error
    assert means[False].mean() < expected - 3.5 * error


def test_adaptive_pictures_repeat():
    """The same arguments give the same picture; an equal spread gives all pixels about the same."""
    first, second = (AdaptiveRendering(SCENE, CAMERA, samples=8, seed=5, **OPTIONS).advance() for _ in range(2))
    np.testing.assert_array_equal(first.linear, second.linear)
    np.testing.assert_array_equal(first.image(), second.image())
    assert first.image().max() <= 1.0
    assert first.advance() is first
    assert "8 samples" in repr(first)
    empty = AdaptiveRendering(SCENE, CAMERA, samples=8, integrator="path", lights=[wrt.lights.Sky(0.0)]).advance()
    assert empty.linear.max() == 0.0
    assert np.ptp(empty.counts) == 0 or empty.counts.std() < 1.0


def test_means_over_squares():
    values = np.random.default_rng(1).random((7, 9))
    expected = [
        [values[max(r - REACH, 0) : r + REACH + 1, max(c - REACH, 0) : c + REACH + 1].mean() for c in range(9)]
        for r in range(7)
    ]
    np.testing.assert_allclose(averaged(values), expected)


def test_samples_are_shared_out():
    """In proportion, none above its room, and what does not fit goes to the others."""
    found = shared_out(10.0, np.array([1.0, 2.0, 0.0, 7.0]), np.array([9.0, 9.0, 9.0, 4.0]))
    np.testing.assert_allclose(found, [2.0, 4.0, 0.0, 4.0])
    np.testing.assert_allclose(shared_out(10.0, np.ones(2), np.array([1.0, 2.0])), [1.0, 2.0])


def test_adaptive_pictures_refuse_what_is_wrong():
    with pytest.raises(ValueError, match="no samples"):
        _ = AdaptiveRendering(SCENE, CAMERA, **OPTIONS).linear
    with pytest.raises(ValueError, match="sampler"):
        AdaptiveRendering(SCENE, CAMERA, sampler="jittered", **OPTIONS)
    with pytest.raises(ValueError, match="samples"):
        AdaptiveRendering(SCENE, CAMERA, samples=4, **OPTIONS)
    with pytest.raises(TypeError, match="motion"):
        AdaptiveRendering(SCENE, CAMERA, motion=None, **OPTIONS)
