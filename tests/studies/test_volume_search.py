"""The search for the cheapest test by volumes: every form is right, the cheapest are known; integers compare as floats."""

from __future__ import annotations

import numpy as np
import pytest

from studies.triangles.isolated_tests import closest
from studies.triangles.volume_search import (
    EDGES,
    STARTS,
    as_test,
    cheapest,
    compare_forms,
    distances,
    forms,
    random_soup,
)
from wrt.kernels.triangle import TRIANGLE_TESTS


def test_every_form_solves_the_equations():
    """t, u and v of random rays and triangles, as by solving the system in float64; no form occurs twice."""
    every = list(forms())
    assert len(every) == len(set(every)) == 9 * 27 * 6 * 6
    a, b, c, o, d = np.random.default_rng(0).normal(size=(5, 3))
    points = {"a": a, "b": b, "c": c, "o": o}
    vectors = {name: points[p] - points[q] for name, (p, q) in (EDGES | STARTS).items()} | {"d": d}
    expected = np.linalg.solve(np.stack([-d, b - a, c - a], axis=1), o - a)
    for form in every:
        det, *others = (sign * vectors[x] @ np.cross(vectors[p], vectors[q]) for sign, (x, p, q) in form.volumes)
        np.testing.assert_allclose(np.array(others) / det, expected, rtol=1e-9)


def test_the_cheapest_forms():
    """Kensler and Shirley's, Moeller and Trumbore's, and its mirror image."""
    found = cheapest()
    assert {tuple(form.crosses) for form in found} == {
        (("d", "sa"), ("e0", "e2")),
        (("d", "e2"), ("e0", "sa")),
        (("d", "e0"), ("e2", "sa")),
    }
    assert {form.operations for form in found} == {51}
    assert sorted({form.operations for form in forms()})[1] == 54


@pytest.mark.parametrize("number", range(3))
def test_forms_as_the_table(number):
    soup, rays = random_soup(300, 200)
    expected_t, expected = closest(TRIANGLE_TESTS["moeller_trumbore"], soup, rays, frustum=0, width=8)()
    t, found = closest(as_test(cheapest()[number]), soup, rays, frustum=0, width=8)()
    assert (found == expected).mean() > 0.99
    same = (found == expected) & (found >= 0)
    assert same.mean() > 0.5
    np.testing.assert_allclose(t[same], expected_t[same], rtol=1e-3)


def test_integers_compare_as_floats():
    """To the bit, with rays that start on triangles (t = 0), are degenerate (NaN) or go away from everything."""
    soup, rays = random_soup(300, 200)
    begins, ways = rays.origins.numpy(), rays.directions.numpy()
    begins[:50] = soup.corners[:50].mean(axis=1)
    ways[50:60] = 0.0
    begins[60:70] += 100.0
    rays = type(rays)(begins, ways)
    t, found = (values.copy() for values in distances(soup, rays, False, 8)())
    assert 0.3 < (found >= 0).mean() < 1.0
    for value, same in zip(distances(soup, rays, True, 8)(), (t, found), strict=True):
        np.testing.assert_array_equal(value, same)


def test_comparison():
    rows = compare_forms(triangles=64, rays=16, width=8, rounds=1)
    assert [row["operations"] for row in rows] == [None, None, 51, 51, 51, None, None]
    assert rows[0]["ratio"] == rows[-2]["ratio"] == 1.0
