"""Properties of every triangle test that hold for any triangle and any ray, at any scale: drawn and shrunk by hypothesis."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.algorithms import CLASSICS
from support.triangle_pairs import all_pairs

from wrt.kernels.triangle import TRIANGLE_TESTS

ROUNDING = 2.0**-24
STEPS = 8
"""How many roundings may add up, each as harmful as the worst."""

fractions = st.integers(-(2**20), 2**20).map(lambda number: number / 2**20)
"""Numbers between -1 and 1: triangles of them have areas down to 2^-41, or none."""

points = st.tuples(fractions, fractions, fractions)
exponents = st.integers(-10, 10) | st.integers(-1, 2)
aims = st.lists(st.tuples(st.sampled_from(("inside", "in the plane", "anywhere")), points), min_size=1, max_size=8)


def exact(corners: np.ndarray, origin: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, ...]:
    """(t, u, v) of the rays' lines in the triangle's plane by Cramer's rule in float64, and how far off float32 may be.

    Every product of a test is at most (edge or distance)^2 times the direction's length, and off by a rounding of that; over
    the determinant, and once more over the sine of the triangle's sharpest angle for tests that divide by a normal.
    """
    a, b, c = corners
    normal = np.cross(b - a, c - a)
    s = origin - a
    det = -directions @ normal
    t = s @ normal / det
    u = np.cross(directions, c - a) @ s / det
    v = directions @ np.cross(s, b - a) / det
    edge = max(np.linalg.norm(b - a), np.linalg.norm(c - b), np.linalg.norm(a - c))
    length = np.linalg.norm(directions, axis=1)
    extent = np.linalg.norm([*corners, origin], axis=1).max() + np.abs(t) * length
    off_t = STEPS * ROUNDING * extent * edge**2 / np.abs(det)
    off_uv = STEPS * ROUNDING * extent * edge**3 / np.linalg.norm(normal) * length / np.abs(det)
    return t, u, v, off_t, off_uv


def target(corners: np.ndarray, kind: str, numbers: tuple[float, float, float], size: float) -> np.ndarray:
    """A point inside the triangle, elsewhere in its plane, or anywhere about it."""
    x, y = np.abs(numbers[:2]) if kind == "inside" else numbers[:2]
    if kind == "inside" and x + y > 1.0:
        x, y = 1.0 - x, 1.0 - y
    point = np.array([1 - x - y, x, y]) @ corners
    return point + np.array(numbers) * size if kind == "anywhere" else point


@pytest.mark.parametrize("tests", ["engine", pytest.param("classics", marks=pytest.mark.classics)])
@settings(max_examples=200, deadline=None, derandomize=True)
@given(st.tuples(points, points, points), points, points, aims, exponents, exponents, st.integers(-5, 5))
def test_hits_are_where_float64_has_them(tests, triangle, place, eye, aims, distance, speed, scale):
    """A triangle somewhere and rays from one point, for every test; lengths in ratios of 1e-10 .. 1e10."""
    size, far = 10.0**scale, 10.0 ** (scale + distance)
    corners = np.float32(np.array(triangle) * size + np.array(place) * far).astype(float)
    origin = np.float32(np.array(eye) * far).astype(float)
    directions = np.array([target(corners, *aim, max(size, far)) for aim in aims]) - origin
    longest = np.abs(directions).max(axis=1, keepdims=True)
    directions = np.float32(directions * 10.0**speed / np.where(longest > 0.0, longest, 1.0)).astype(float)
    directions = directions[directions.any(axis=1)]
    if len(directions) == 0:
        return
    origins = np.broadcast_to(origin, directions.shape)
    with np.errstate(all="ignore"):  # no area, or a line in the plane: nothing is asked where the bounds are not numbers
        t, u, v, off_t, off_uv = exact(corners, origin, directions)
        clearance = np.minimum(np.minimum(u, v), 1 - (u + v))
    for name, test in TRIANGLE_TESTS.items():  # drawing an example takes ten times as long as one test
        if (name in CLASSICS) != (tests == "classics"):
            continue
        got = all_pairs(name, corners[None], origins, directions, 4, "scalar", "cpu")[:, 0].astype(float)
        hit = ~np.isnan(got[:, 0])
        ahead = t > off_t if test.needs_shared_origin else True
        assert hit[(clearance > off_uv) & ahead].all(), name
        assert not hit[clearance < -off_uv].any(), name
        assert np.isfinite(got[hit]).all(), name
        for value, truth, off in zip(got[hit].T, (t[hit], u[hit], v[hit]), (off_t[hit], off_uv[hit], off_uv[hit]), strict=True):
            assert not (np.abs(value - truth) > off).any(), name
