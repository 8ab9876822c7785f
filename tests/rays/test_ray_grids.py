"""Flat lists of a camera's rays are traced as the picture that they are, which shows in nothing but speed."""

from __future__ import annotations

import numpy as np
import pytest
from support.hits import assert_same_hits

import wrt
from wrt.engine.rays import coherence as pictures


def flat_rays(mesh: wrt.TriangleMesh, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    rays = wrt.PinholeCamera.framing(mesh, width, height).rays()
    directions = np.asarray(rays.directions).reshape(-1, 3)
    return np.tile(np.reshape(rays.origins, 3), (len(directions), 1)), directions


@pytest.mark.parametrize(("width", "height"), [(80, 60), (64, 65)])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_pictures_are_recognised(width, height, dtype):
    mesh = wrt.scenes.build("teapot", level=3)
    scene = wrt.Scene(mesh, device="cpu")
    origins, directions = (values.astype(dtype) for values in flat_rays(mesh, width, height))
    plan = scene.explain(origins, directions)
    assert plan.shared_origin
    assert plan.reorder == "tiles"
    hits = scene.intersect(origins, directions)
    assert hits.t.shape == (width * height,)
    assert 0.1 < hits.is_hit.mean() < 0.9
    assert_same_hits(hits, scene.intersect(origins, directions, traversal="single"))
    np.testing.assert_array_equal(scene.occluded(origins, directions), hits.is_hit)
    shuffled = np.random.default_rng(0).permutation(len(directions))
    rows = np.random.default_rng(0).permutation(height)[:, None] * width + np.arange(width)
    last = origins + np.arange(len(origins))[:, None] * 1e-3
    for other_origins, other_directions in (
        (last, directions),
        (origins, directions[shuffled]),
        (origins, directions[rows.ravel()]),
        (origins[:-1], directions[:-1]),
        (origins, np.tile(directions[:1], (len(origins), 1))),
        (origins, np.full_like(directions, np.nan)),
    ):
        assert scene.explain(other_origins, other_directions).reorder != "tiles"
    assert_same_hits(scene.intersect(last, directions), scene.intersect(last, directions, traversal="single"))


@pytest.mark.parametrize("shape", [(1, -1, 3), (-1, 1, 3), (1, 60, 80, 3), (60, 1, 80, 3)])
def test_axes_of_one_element_do_not_count(shape):
    """Rays of shape (1, N) were no list, and those of shape (1, rows, columns) no picture."""
    mesh = wrt.scenes.build("teapot", level=3)
    scene = wrt.Scene(mesh, device="cpu")
    origins, directions = flat_rays(mesh, 80, 60)
    hits = scene.intersect(origins[0], directions.reshape(shape))
    assert hits.plan.reorder == "tiles"
    assert hits.t.shape == directions.reshape(shape).shape[:-1]
    np.testing.assert_array_equal(hits.t.ravel(), scene.intersect(origins, directions).t)


def test_the_last_origin_counts():
    """Origins are compared to the end, whatever the sample says; NaN is equal to nothing."""
    origins = np.tile(np.float32([1.0, 2.0, 3.0]), (3 * (1 << 16), 1))
    assert pictures.detect_shared_origin(origins).strides[0] == 0
    for value in (3.5, np.nan):
        other = origins.copy()
        other[-2, 2] = value
        assert pictures.detect_shared_origin(other) is other
    assert pictures.detect_shared_origin(np.full_like(origins, np.nan)).strides[0] != 0
