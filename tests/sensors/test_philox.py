"""Random numbers of noise: those of the generator's authors."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

import wrt
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.sensors.philox import normal_pair, random_words
from wrt.sensors import Lidar, LidarPattern


@exact_kernel
def normal_pairs(first: int, words: wp.array(dtype=wp.vec2ui), pairs: wp.array(dtype=wp.vec2d)):
    i = first + wp.tid()
    pairs[i] = normal_pair(words[i][0], words[i][1])


def box_muller(words):
    """The pairs by NumPy."""
    numbers = (words.astype(np.float64) + 0.5) / 2.0**32
    radius, angle = np.sqrt(-2.0 * np.log(numbers[:, 0])), 2.0 * np.pi * numbers[:, 1]
    return radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


@pytest.mark.parametrize(
    ("counter", "key", "expected"),
    [
        ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
        ((0xFFFFFFFF,) * 4, (0xFFFFFFFF,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
        (
            (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
            (0xA4093822, 0x299F31D0),
            (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
        ),
    ],
)
def test_philox_known_answers(device, counter, key, expected):
    """Those that the authors publish with the generator."""
    counters = wp.array(np.array([counter], dtype=np.uint32), dtype=wp.vec4ui, device=device)
    words = wp.empty_like(counters)
    launch(random_words, 1, [wp.vec2ui(*key), counters, words], device=counters.device)
    assert tuple(words.numpy()[0]) == expected


def test_normal_pairs(device):
    """As NumPy's functions have them, also next to 0 and 1, to powers of two and their roots, and to eighths."""
    marks = [0, 1 << 29, 3 << 29, 1 << 30, 1 << 31, 3 << 30, 7 << 29, (1 << 32) - 1, round(2**31.5), round(2**30.5)]
    near = np.unique([min(max(mark + step, 0), (1 << 32) - 1) for mark in marks for step in range(-2, 3)]).astype(np.uint32)
    edges = np.stack(np.meshgrid(near, near), axis=-1).reshape(-1, 2)
    others = np.random.default_rng(0).integers(0, 1 << 32, (50_000, 2), dtype=np.uint32)
    words = np.concatenate([edges, others])
    pairs = wp.empty(len(words), dtype=wp.vec2d, device=device)
    launch(normal_pairs, len(words), [wp.array(words, dtype=wp.vec2ui, device=device), pairs], device=pairs.device)
    np.testing.assert_allclose(pairs.numpy(), box_muller(words), rtol=0.0, atol=1e-14)


def test_noise_of_a_scan_is_that_of_its_words():
    """Of ranges: by the words of each beam's number, and use 0; loops over blocks of beams have the bits of one alone."""
    count, noise, key = 1000, 0.02, (77, 5)
    azimuth = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    beams = np.stack([np.cos(azimuth), np.sin(azimuth), np.full(count, 0.2)], axis=-1)
    lidar = Lidar(pattern=LidarPattern(beams / np.linalg.norm(beams, axis=1, keepdims=True)), range_noise=noise)
    scene, pose = wrt.Scene(wrt.scenes.shapes.boxes([[-2.0] * 3], [[2.0] * 3]), device="cpu"), np.eye(4)
    true = lidar.scan(scene, pose).range.astype(np.float64)
    point = lidar.scan(scene, pose, seed=key[0] + (key[1] << 32)).point
    counters = np.zeros((count, 4), dtype=np.uint32)
    counters[:, 0] = np.arange(count)
    numbers = wp.array(counters, dtype=wp.vec4ui, device="cpu")
    words = wp.empty_like(numbers)
    launch(random_words, count, [wp.vec2ui(*key), numbers, words], device=words.device)
    expected = true + noise * box_muller(words.numpy()[:, :2])[:, 0]
    np.testing.assert_allclose(np.linalg.norm(point, axis=1), expected, rtol=0.0, atol=1e-14)
