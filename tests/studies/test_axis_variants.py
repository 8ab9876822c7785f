"""Shevtsov's flag of axis-aligned triangles, and axes found by a table, by division or by shifts: the same bits as without."""

from __future__ import annotations

import numpy as np
import pytest

import wrt
from studies.triangles.axis_variants import check_same, compare_flag, compare_selections, flag_in_table
from studies.triangles.isolated_tests import Beams, Soup, closest, pairs
from wrt.kernels.classics.studies.variants.axis_flag import ALIGNED, TEST
from wrt.kernels.classics.studies.variants.axis_selection import SELECTIONS
from wrt.kernels.classics.triangle import shevtsov
from wrt.kernels.triangle import TRIANGLE_TESTS

pytestmark = pytest.mark.classics

AWKWARD = np.array([-0.0, 0.0, 1.0, -1.0, np.inf, np.nan, 1e-40, -3e38], dtype=np.float32)


def aligned_triangles(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of which most are parallel to a coordinate plane, some of them through the origin, at 0 or -0; and the axes
    that they are normal to, -1 for the others."""
    rng = np.random.default_rng(2)
    corners, axis = rng.normal(size=(count, 3, 3)).astype(np.float32), rng.integers(-1, 3, count)
    for number in range(3):
        chosen = np.flatnonzero(axis == number)
        corners[chosen, :, number] = corners[chosen, :1, number]
        corners[chosen[::5], :, number] = 0.0
        corners[chosen[1::5], :, number] = -0.0
    return corners, axis


def rays_to(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A ray for each triangle: towards a point near its middle, along an axis, in its plane, or with awkward numbers."""
    rng = np.random.default_rng(3)
    origins = rng.normal(size=(len(corners), 3)).astype(np.float32)
    ways = (corners.mean(axis=1) + 0.3 * rng.normal(size=(len(corners), 3)) - origins).astype(np.float32)
    ways[::7, rng.integers(0, 3)] = 0.0
    origins[::11] = corners[::11, 0]
    ways[::13] = np.float32(-0.0)
    ways[::13, 1] = 1.0
    ways[5::17] = rng.choice(AWKWARD, (len(ways[5::17]), 3))
    origins[9::19] = rng.choice(AWKWARD, (len(origins[9::19]), 3))
    return origins, ways


def bits(values: np.ndarray) -> np.ndarray:
    return np.where(np.isnan(values), np.float32(np.nan), values).view(np.uint32)


def test_the_flag_changes_no_bit_of_single_rays():
    """t, u and v, with the sign of a zero: a plane through -0 once gave t = -0 with the flag and 0 without."""
    corners, axis = aligned_triangles(4000)
    soup, rays = Soup(corners), Beams(*rays_to(corners))
    expected, found = pairs(shevtsov.TEST, soup, rays), pairs(TEST, soup, rays)
    np.testing.assert_array_equal(bits(found), bits(expected))
    hit = ~np.isnan(expected[:, 0])
    for number in range(-1, 3):
        assert 0.2 < hit[axis == number].mean() < 0.9


def test_the_flag_changes_no_bit_of_packets():
    """Packets take another loop for aligned triangles, whose steps have fewer operations."""
    corners, _ = aligned_triangles(300)
    ways = np.random.default_rng(4).normal(size=(320, 3))
    ways[::9, 1] = 0.0
    soup, rays = Soup(corners, (0.1, 0.0, -0.2)), Beams(np.array([[0.1, 0.0, -0.2]]), ways)
    results = [closest(test, soup, rays, frustum=64, width=16)() for test in (shevtsov.TEST, TEST)]
    check_same("frusta", *results)
    assert (results[0][1] >= 0).mean() > 0.5
    saved = shevtsov.TEST.lanes.operations[0].arithmetic - ALIGNED.operations[0].arithmetic
    assert saved == 8


@pytest.mark.parametrize("way", [way for way in SELECTIONS if way != "selects"])
def test_axes_are_the_same(way):
    corners, _ = aligned_triangles(1000)
    soup, rays = Soup(corners), Beams(*rays_to(corners))
    np.testing.assert_array_equal(bits(pairs(SELECTIONS[way], soup, rays)), bits(pairs(SELECTIONS["selects"], soup, rays)))


def test_comparisons():
    """A row for each way; the flag is in the table only while it is compared."""
    mesh = wrt.scenes.build("cornell_box")
    assert [row["way"] for row in compare_flag(mesh, size=0, triangles=64, rounds=1)] == ["frusta", "one by one"]
    assert [row["way"] for row in compare_selections(triangles=64, rays=16, widths=(16,), rounds=1)] == list(SELECTIONS)
    with flag_in_table():
        assert TRIANGLE_TESTS["shevtsov_flag"] is TEST
    assert "shevtsov_flag" not in TRIANGLE_TESTS
    with pytest.raises(RuntimeError, match="1 of 2 numbers differ"):
        check_same("any", [np.zeros(2, dtype=np.float32)], [np.array([0.0, -0.0], dtype=np.float32)])
