"""The bounds of rounding by which trees are pruned (`wrt.kernels.points`), and the distance of a triangle by itself."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from support.point_oracles import squares

from wrt.kernels.points.point_triangle import OnTriangle, nearest_on_triangle
from wrt.kernels.runtime.options import exact_kernel

UNIT = 2.0**-24


@exact_kernel
def each_triangle(corners: wp.array2d(dtype=wp.vec3), found: wp.array(dtype=OnTriangle)):
    i = wp.tid()
    found[i] = nearest_on_triangle(corners[i, 0], corners[i, 1], corners[i, 2])


def nearest(corners: np.ndarray) -> np.ndarray:
    """What is nearest to 0 on triangles (N, 3, 3) float32."""
    found = wp.empty(len(corners), dtype=OnTriangle, device="cpu")
    given = wp.array(corners.astype(np.float32), dtype=wp.vec3, device="cpu")
    wp.launch(each_triangle, len(corners), inputs=[given, found], device="cpu", record_tape=False)
    return found.numpy()


def hostile_triangles(count: int) -> np.ndarray:
    """(count, 3, 3) float32: round ones, needles, nearly flat ones, far and near ones, and some through the point."""
    rng = np.random.default_rng(6)
    corners = rng.normal(size=(count, 3, 3)) * 10.0 ** rng.uniform(-3, 3, (count, 1, 1))
    along = rng.normal(size=(count, 1, 3)) * rng.uniform(0, 3, (count, 3, 1))
    needle = rng.random(count) < 0.5
    thickness = 10.0 ** rng.uniform(-9, -1, (count, 1, 1))
    corners[needle] = (along + thickness * corners)[needle]
    shifted = rng.random(count) < 0.5
    corners[shifted] -= np.einsum("nij,ni->nj", corners, rng.dirichlet([1, 1, 1], count))[shifted][:, None]
    corners += rng.normal(size=(count, 1, 3)) * 10.0 ** rng.uniform(-8, 3, (count, 1, 1))
    return corners.astype(np.float32)


def test_a_distance_is_never_much_too_small():
    """No computed distance is below the true one by more than 16 u R; and none is far above, except along needles."""
    corners = hostile_triangles(60_000)
    found = nearest(corners)
    true, reach = np.sqrt(squares(corners.astype(np.float64))), np.abs(corners.astype(np.float64)).max(axis=1).sum(axis=1)
    wrong = (np.sqrt(found["square"].astype(np.float64)) - true) / (UNIT * reach)
    assert wrong.min() > -16.0
    assert wrong.max() < 200.0
    assert wrong.min() < -0.2, "the bound is tested with triangles that round"


def test_weights_and_features():
    """Weights are in the triangle and give the distance; the feature is what they say."""
    corners = hostile_triangles(20_000)
    found = nearest(corners)
    u, v, feature = found["u"].astype(np.float64), found["v"].astype(np.float64), found["feature"]
    assert min(u.min(), v.min()) >= 0.0
    assert (found["u"] + found["v"]).max() <= 1.0
    weights = np.stack([1.0 - u - v, u, v])
    at = np.einsum("nij,in->nj", corners.astype(np.float64), weights)
    reach = np.abs(corners).max(axis=1).sum(axis=1)
    np.testing.assert_array_less(np.abs(np.linalg.norm(at, axis=1) - np.sqrt(found["square"])), 16 * UNIT * reach)
    zeros = (np.abs(weights) < 1e-7).sum(axis=0)
    assert (zeros[feature == 0] == 2).all()
    assert (zeros[feature == 1] >= 1).all()
    assert np.bincount(feature).min() > 500


def test_neighbours_agree_on_their_edge():
    """The distance from an edge has the same bits in both of its triangles, whichever way they name it."""
    rng = np.random.default_rng(8)
    ends = rng.normal(size=(20_000, 2, 3)).astype(np.float32)
    apex = (ends.mean(axis=1) * 3.0 + rng.normal(size=(20_000, 3)) * 0.1).astype(np.float32)  # behind the edge
    forms = [nearest(np.stack([ends[:, i], ends[:, j], apex], axis=1)) for i, j in ((0, 1), (1, 0))]
    forms.append(nearest(np.stack([apex, ends[:, 1], ends[:, 0]], axis=1)))
    on_edge = np.all([one["feature"] < 2 for one in forms], axis=0)
    assert on_edge.mean() > 0.5
    for other in forms[1:]:
        np.testing.assert_array_equal(other["square"][on_edge], forms[0]["square"][on_edge])


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_the_distance_of_a_box_is_never_much_too_large(scale):
    """The formula of kernels/native/points.h in float32: at most 3 u R above the true distance of the box."""
    rng = np.random.default_rng(9)
    low = (rng.normal(size=(100_000, 3)) * scale).astype(np.float32)
    high = (low + np.abs(rng.normal(size=low.shape)) * 10.0 ** rng.uniform(-6, 1, (len(low), 1))).astype(np.float32)
    point = (rng.normal(size=low.shape) * 3.0).astype(np.float32)
    away = np.maximum(np.maximum(low - point, point - high), np.float32(0.0))
    square = (away[:, 0] * away[:, 0] + away[:, 1] * away[:, 1]) + away[:, 2] * away[:, 2]
    assert square.dtype == np.float32
    exact = [each.astype(np.float64) for each in (low, high, point)]
    true = np.linalg.norm(np.maximum(np.maximum(exact[0] - exact[2], exact[2] - exact[1]), 0.0), axis=1)
    reach = np.maximum(np.abs(exact[0] - exact[2]), np.abs(exact[1] - exact[2])).sum(axis=1)
    assert ((np.sqrt(square.astype(np.float64)) - true) / (UNIT * reach)).max() < 3.0


def test_the_nearest_vertex_along_a_line_is_never_much_too_far():
    """The formula of kernels/native/point_blocks.h in float32: at most 10 u R above the true distance of the triangle."""
    corners = hostile_triangles(60_000)
    dots = [(corners[:, 0] * other).astype(np.float32) for other in (corners[:, 0], corners[:, 1], corners[:, 2])]
    aa, ab, ac = ((each[:, 0] + each[:, 1]) + each[:, 2] for each in dots)
    least = np.minimum(np.minimum(aa, ab), ac)
    counts = least > 1e-15
    assert counts.mean() > 0.2
    true, reach = np.sqrt(squares(corners.astype(np.float64))), np.abs(corners.astype(np.float64)).max(axis=1).sum(axis=1)
    along = least[counts].astype(np.float64) / np.sqrt(aa[counts].astype(np.float64))
    over = (along - true[counts]) / (UNIT * reach[counts])
    assert 0.2 < over.max() < 10.0
    assert np.median(along / true[counts]) > 0.5, "the bound leaves something out"
