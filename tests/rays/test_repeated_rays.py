"""Vectors that are broadcast on the device are those that NumPy broadcasts."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

import wrt
from wrt.engine.rays.device_rays import repeated, repeats_of

CENTER = np.array([100.0, -7.0, 0.25])


@pytest.mark.parametrize(
    ("own", "shape"),
    [
        ((5, 1), (5, 7)),
        ((7,), (5, 7)),
        ((3, 1, 4), (3, 2, 4)),
        ((1, 2, 1), (3, 2, 4)),
        ((2, 1, 3, 1), (2, 5, 3, 4)),
        ((6, 1, 1), (6, 1, 9)),
    ],
)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_repeated_vectors(own, shape, dtype):
    given = np.random.default_rng(0).normal(size=(*own, 3)).astype(dtype)
    expected = np.broadcast_to(given, (*shape, 3))
    for values in (given, expected):
        repeats = repeats_of(values, shape)
        assert repeats is not None
        found = repeated(values, shape, repeats, wp.get_device("cpu"), CENTER).numpy().reshape(*shape, 3)
        wanted = expected if dtype == np.float32 else (expected - CENTER).astype(np.float32)
        np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize(("own", "shape"), [((5, 7), (5, 7)), ((), (5, 7)), ((1, 1), (5, 7)), ((1,), (1, 1)), ((0, 1), (0, 4))])
def test_what_is_left_to_the_host(own, shape):
    """Vectors that are all there, one for all rays, and none."""
    assert repeats_of(np.zeros((*own, 3)), shape) is None


def test_shapes_of_many_axes_are_left_to_the_host():
    assert repeats_of(np.zeros((2, 1, 1, 1, 1, 3)), (2, 1, 1, 1, 4)) is None


@pytest.mark.cuda
@pytest.mark.skipif(not wp.get_cuda_devices(), reason="needs a GPU")
def test_every_direction_from_every_point_on_a_gpu():
    mesh = wrt.scenes.build("teapot", level=3)
    points = np.random.default_rng(1).uniform(*mesh.bounds, (300, 1, 3))
    directions = np.random.default_rng(2).normal(size=(500, 3))
    found = wrt.Scene(mesh, device="cuda:0").intersect(points, directions)
    expected = wrt.Scene(mesh, device="cpu").intersect(points, directions)
    np.testing.assert_array_equal(found.primitive_id, expected.primitive_id)
    np.testing.assert_array_equal(found.t, expected.t)
