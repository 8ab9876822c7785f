"""Path tracing of the Cornell box against a picture of Mitsuba 3 (made by `tests/support/cornell_reference.py`)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import wrt

REFERENCE = np.load(Path(__file__).with_name("cornell_reference.npy")).astype(float)
LUMINANCE = [0.2126, 0.7152, 0.0722]


def rendering(**options):
    scene = wrt.Scene(wrt.scenes.build("cornell_box", cells=1), device="cpu")
    camera = wrt.PinholeCamera(64, 64, **wrt.scenes.BUILTIN_SCENES["cornell_box"].camera)
    return wrt.pictures.Rendering(scene, camera, integrator="path", depth=6, **options).advance()


def relative_mse(picture):
    return (((picture - REFERENCE) / (REFERENCE + 0.01)) ** 2).mean()


def test_the_difference_is_noise():
    """Of independent samples: the squared differences are what the spread of the samples says, and they have no sign."""
    made = rendering(samples=256, sampler="random", seed=5)
    difference, error = (made.linear - REFERENCE) @ LUMINANCE, made.noise
    lit = error > 0.0
    score = difference[lit] / error[lit]
    assert lit.mean() > 0.8
    assert abs(difference.sum()) < 3.0 * np.sqrt((error**2).sum())
    assert 0.75 < (score**2).mean() < 1.5
    np.testing.assert_allclose(made.linear.mean(axis=(0, 1)), REFERENCE.mean(axis=(0, 1)), rtol=5e-3)


@pytest.mark.parametrize("sampler", ["sobol", "jittered"])
def test_more_samples_come_closer(sampler):
    few, many = (relative_mse(rendering(samples=samples, sampler=sampler).linear) for samples in (16, 256))
    assert many < 0.1 * few
    assert many < 0.004


def test_division_does_not_show():
    """The box of small triangles is the same box: the picture differs by rounding only, but for a few paths."""
    scene = wrt.Scene(wrt.scenes.build("cornell_box", cells=3), device="cpu")
    camera = wrt.PinholeCamera(64, 64, **wrt.scenes.BUILTIN_SCENES["cornell_box"].camera)
    fine = wrt.pictures.Rendering(scene, camera, integrator="path", depth=6, samples=256).advance().linear
    assert scene.triangle_count == 36 * 9
    assert relative_mse(fine) < 0.004
    np.testing.assert_allclose(fine.mean(axis=(0, 1)), REFERENCE.mean(axis=(0, 1)), rtol=5e-3)


def test_whitted_has_no_light_between_walls():
    """The same box with direct light only is darker, and its shadows are black."""
    direct = rendering(samples=64, seed=1)
    scene = wrt.Scene(wrt.scenes.build("cornell_box", cells=1), device="cpu")
    camera = wrt.PinholeCamera(64, 64, **wrt.scenes.BUILTIN_SCENES["cornell_box"].camera)
    only = wrt.pictures.Rendering(scene, camera, integrator="distribution", samples=64).advance().linear
    short = wrt.pictures.Rendering(scene, camera, integrator="path", depth=2, samples=64).advance().linear
    np.testing.assert_allclose(only.mean(axis=(0, 1)), short.mean(axis=(0, 1)), rtol=0.02)
    assert only.mean() < 0.8 * direct.linear.mean()
