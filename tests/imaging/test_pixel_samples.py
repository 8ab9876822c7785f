"""Random numbers of samples: stratification, independence of dimensions, and the spectrum of jittered points."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from wrt.imaging.integrators.wavefront import pixel_samples
from wrt.kernels.runtime.launch import launch
from wrt.kernels.shading.wavefront.pixel_samples import SAMPLERS, list_points, permuted

CPU = "cpu"


def points(sampler, count, pixel=0, dimension=0, seed=0):
    device = wp.get_device(CPU)
    found = wp.empty(count, dtype=wp.vec2, device=device)
    source = pixel_samples(SAMPLERS.index(sampler), count, seed, device)
    launch(list_points, count, [source, pixel, dimension, found], device=device)
    return found.numpy()


@wp.kernel(enable_backward=False)
def permutations(first: int, count: int, seed: wp.uint32, found: wp.array(dtype=int)):
    i = first + wp.tid()
    found[i] = permuted(i, count, seed)


@pytest.mark.parametrize("count", [1, 2, 3, 7, 16, 64, 100, 1000])
def test_permutations(count):
    device = wp.get_device(CPU)
    found, first = wp.empty(count, dtype=int, device=device), []
    for seed in range(300):
        launch(permutations, count, [count, wp.uint32(seed * 7919), found], device=device)
        assert sorted(found.numpy().tolist()) == list(range(count))
        first.append(found.numpy()[0])
    if 1 < count <= 16:  # each place comes first about equally often
        shares = np.bincount(first, minlength=count) / 300
        assert shares.max() < 1 / count + 4 * np.sqrt(1 / count / 300)


@pytest.mark.parametrize("sampler", SAMPLERS)
@pytest.mark.parametrize("dimension", [0, 1, 7, 40])
def test_points_are_in_the_square_and_even(sampler, dimension):
    found = np.concatenate([points(sampler, 64, pixel, dimension) for pixel in range(40)])
    assert found.min() >= 0.0
    assert found.max() < 1.0
    np.testing.assert_allclose(found.mean(axis=0), 0.5, atol=0.03)
    np.testing.assert_allclose(found.var(axis=0), 1 / 12, atol=0.01)


@pytest.mark.parametrize("count", [16, 36, 12, 7])
@pytest.mark.parametrize("sampler", ["regular", "jittered"])
def test_grids_have_a_sample_in_each_cell(sampler, count):
    columns = max(d for d in range(1, int(np.sqrt(count)) + 1) if count % d == 0)
    cells = np.floor(points(sampler, count, 5, 3) * (columns, count // columns)).astype(int)
    assert len({tuple(cell) for cell in cells.tolist()}) == count


def test_sobol_points_are_a_net():
    """Every elementary box of area 1 / 64 has one of 64 points, and 64 rows and columns have one each."""
    for pixel in range(5):
        found = points("sobol", 64, pixel, 4)
        for width in (1, 2, 4, 8, 16, 32, 64):
            cells = np.floor(found * (width, 64 // width)).astype(int)
            assert len({tuple(cell) for cell in cells.tolist()}) == 64


@pytest.mark.parametrize("sampler", ["random", "jittered", "halton", "sobol"])
def test_dimensions_and_pixels_are_independent(sampler):
    """The samples of a pixel have unrelated places in two dimensions; otherwise penumbrae would depend on the lens."""
    a = np.concatenate([points(sampler, 16, pixel, 0) for pixel in range(200)])
    b = np.concatenate([points(sampler, 16, pixel, 3) for pixel in range(200)])
    c = np.concatenate([points(sampler, 16, pixel + 1, 0) for pixel in range(200)])
    for other in (b, c):
        if sampler == "halton" and other is c:
            continue  # the same sequence, shifted: each sample keeps its rank
        correlation = np.corrcoef(np.concatenate([a, other], axis=1).T)[:2, 2:]
        assert np.abs(correlation).max() < 0.08


def spectrum(sampler, frequencies, pixels=300, count=64):
    """Mean power of the points at frequencies, (F, 2) in waves a pixel; 1 for independent points."""
    power = np.zeros(len(frequencies))
    for pixel in range(pixels):
        waves = np.exp(-2j * np.pi * (points(sampler, count, pixel) @ frequencies.T))
        power += np.abs(waves.sum(axis=0)) ** 2 / count
    return power / pixels


def test_jitter_keeps_low_frequencies_empty():
    """Cook's reason for jittering: like a Poisson disk, it has no energy at low frequencies, so that what is above the limit
    turns into noise instead of patterns. A regular grid has all its energy at multiples of the grid; independent points are
    white. By theory the power of jittered points in cells of side s is 1 - sinc^2(f s)."""
    low = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [2.0, 1.0]])
    grid = np.array([[8.0, 0.0], [0.0, 8.0]])
    high = np.array([[9.3, 7.1], [12.6, 3.7], [20.2, 5.5]])
    assert spectrum("jittered", low).max() < 0.25
    np.testing.assert_allclose(spectrum("jittered", low[:1]), 1 - np.sinc(1 / 8) ** 2, atol=0.02)
    np.testing.assert_allclose(spectrum("jittered", high), 1.0, atol=0.25)
    np.testing.assert_allclose(spectrum("random", np.concatenate([low, high])), 1.0, atol=0.25)
    assert spectrum("regular", grid, pixels=1).min() > 63.0
    assert spectrum("regular", low, pixels=1).max() < 1e-6
    assert spectrum("jittered", grid).max() < 2.0
    assert spectrum("sobol", low).max() < 0.25
