"""Distance queries of `wrt.compat.RaycastingScene`: what Open3D's documentation says, and Open3D itself."""

from __future__ import annotations

import numpy as np
import pytest
from support.open3d_scene import PARTS

import wrt

POINTS = np.random.default_rng(3).uniform(-1.6, 1.6, (600, 3)).astype(np.float32)
QUERIES = ("compute_distance", "compute_signed_distance", "compute_occupancy", "compute_closest_points")


def arrays(result) -> dict[str, np.ndarray]:
    """What a query returns, of ours or of the peer, by names."""
    named = result if isinstance(result, dict) else {"result": result}
    return {name: np.asarray(values.numpy() if hasattr(values, "numpy") else values) for name, values in named.items()}


@pytest.mark.parametrize("query", QUERIES)
@pytest.mark.parametrize("shape", [(600, 3), (20, 30, 3)])
def test_as_the_peer(scene, theirs, open3d, query, shape):
    """Keys, shapes and types; values but for triangles at the same distance."""
    points = POINTS.reshape(shape)
    ours, expected = arrays(getattr(scene, query)(points)), arrays(getattr(theirs, query)(open3d.core.Tensor(points)))
    assert ours.keys() == expected.keys()
    for name, values in expected.items():
        assert (ours[name].shape, ours[name].dtype) == (values.shape, values.dtype), name
    if query == "compute_closest_points":
        same = (ours["primitive_ids"] == expected["primitive_ids"]) & (ours["geometry_ids"] == expected["geometry_ids"])
        assert same.mean() > 0.7
        np.testing.assert_allclose(ours["points"], expected["points"], atol=2e-3)
        for name in ("primitive_uvs", "primitive_normals"):
            np.testing.assert_allclose(ours[name][same], expected[name][same], atol=5e-3)
    else:
        assert np.isclose(ours["result"], expected["result"], atol=1e-5).mean() > 0.995  # rays at edges are lost there


def test_what_is_documented(scene):
    """Without the peer: distances of known bodies, negative inside, where occupancy is 1; ids and weights give the points."""
    ball = wrt.compat.RaycastingScene(device="CPU:0")
    ball.add_triangles(*PARTS[0])
    away = np.linalg.norm(POINTS, axis=1) - 1.0
    np.testing.assert_allclose(ball.compute_distance(POINTS), np.abs(away), atol=0.04)
    signed = ball.compute_signed_distance(POINTS, nthreads=1, nsamples=3)
    np.testing.assert_allclose(signed, away, atol=0.04)
    np.testing.assert_array_equal(ball.compute_occupancy(POINTS, nsamples=5), (signed < 0).astype(np.float32))
    found = scene.compute_closest_points(POINTS)
    np.testing.assert_allclose(np.linalg.norm(found["points"] - POINTS, axis=1), scene.compute_distance(POINTS), atol=1e-5)
    for number, (vertices, faces) in enumerate(PARTS):
        own = found["geometry_ids"] == number
        corners, (u, v) = vertices[faces[found["primitive_ids"][own]]], found["primitive_uvs"][own].T[..., None]
        at = (1 - u - v) * corners[:, 0] + u * corners[:, 1] + v * corners[:, 2]
        np.testing.assert_allclose(at, found["points"][own], atol=1e-5)


def test_where_there_is_nothing():
    """An empty scene, and points with a NaN or an infinity."""
    empty, ball = wrt.compat.RaycastingScene(), wrt.compat.RaycastingScene()
    ball.add_triangles(*PARTS[0])
    bad = np.float32([[np.nan, 0, 0], [0, np.inf, 0], [0, 0, 0]])
    np.testing.assert_array_equal(empty.compute_distance(bad), [np.nan, np.nan, np.inf])
    np.testing.assert_array_equal(empty.compute_signed_distance(bad), [np.nan, np.nan, np.inf])
    np.testing.assert_array_equal(empty.compute_occupancy(bad), [0, 0, 0])
    assert np.isnan(ball.compute_distance(bad)[:2]).all()
    np.testing.assert_array_equal(ball.compute_occupancy(bad), [0, 0, 1])
    for one, expected in ((empty, [True] * 3), (ball, [True, True, False])):
        found = one.compute_closest_points(bad)
        np.testing.assert_array_equal(found["primitive_ids"] == one.INVALID_ID, expected)
        np.testing.assert_array_equal(np.isnan(found["points"]).all(axis=1), expected)
        assert (found["primitive_uvs"].dtype, found["primitive_normals"].shape) == (np.float32, (3, 3))


@pytest.mark.parametrize("query", QUERIES)
def test_what_is_refused(scene, query):
    with pytest.raises(ValueError, match=r"query_points must have shape \(\.\.\., 3\)"):
        getattr(scene, query)(np.zeros((2, 6), np.float32))
    with pytest.raises(TypeError, match="query_points"):
        getattr(scene, query)([["a", "b", "c"]])
    with pytest.raises(ValueError, match="nthreads"):
        getattr(scene, query)(POINTS, nthreads=-1)
    if query in ("compute_signed_distance", "compute_occupancy"):
        with pytest.raises(ValueError, match="nsamples must be odd, not 2"):
            getattr(scene, query)(POINTS, nsamples=2)
        with pytest.raises(ValueError, match="nsamples"):
            getattr(scene, query)(POINTS, nsamples=-1)
