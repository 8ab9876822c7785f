"""Bounds of rounding errors have no counterexamples; `python -m tests.bounds` searches more."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from bounds.search import BOUNDS, batches

FOUND = {
    "slab": 0.5,
    "exact": 0.35,
    "fused": 0.2,
    "sheared": 0.9,
    "hits": 0.1,
    "spawn": 0.4,
    "edges": 0.1,
    "vertices": 0.01,
    "planes": 0.4,
    "ends": 0.3,
    "clip": 0.1,
}
"""Least ratio that a search must find, so that one that compares nothing is noticed."""


@pytest.mark.parametrize("name", BOUNDS)
def test_no_counterexamples(name):
    ratios = np.concatenate([found for _, found in batches(name, 100_000, 1)])
    assert ratios.max() <= 1.0, f"case {ratios.argmax()}: {ratios.max()}"
    assert ratios.max() >= FOUND[name]
    assert (ratios > 0.0).mean() > 0.1


def test_sums_of_roundings():
    """What the proofs add up, in rational numbers: in units of u R, or of the products that they name."""
    f = Fraction
    sheared = 1 + f(1, 2) + 1 + 2  # V_x, slope, product, difference
    assert sheared == f(9, 2)
    t = (
        1 + 1 + 2 + 2 + 1 + 1 + 1 + 1
    )  # depth, product, two sums; two sums of areas, reciprocal, product; 1 / direction, product
    assert sheared + 1 + t == f(31, 2)
    assert 2 * 4 + 1 == 9  # M / S, of N / S = 4
    assert 1 + 2 * sheared**2 <= f(645, 100) ** 2
    assert f(645, 100) + f(87, 100) < 8  # an offset
    assert f(3, 4) <= f(87, 100) ** 2  # sqrt(3) / 2
    assert f(1124, 10) ** 2 >= (14**2 + 1) * 8**2
    assert f(1124, 10) / 2**24 < f(67, 10**7)
    coefficients = 3 * (2 * 3 + 2) + 4 + 6
    assert f(coefficients, 16) <= f(22, 10)
    area = f(124, 10) / 16 + 1  # of S D; D = 2 h + 3 S
    assert 2 * area <= f(36, 10)
    assert 3 * area <= f(54, 10)
    size = f(16, 15)  # S / d
    assert (f(22, 10) + f(36, 10)) * size + 8 < f(143, 10) < 16
    assert f(54, 10) * size**2 < f(62, 10) < 16
    far = 5 * f(1, 32)  # of apart, by 5 u r and r <= 2^19 apart + 2^-4 |o|
    near = 3 + f(5, 16)  # of u |o|
    assert far <= f(157, 1000)
    assert near <= f(34, 10)
    left = f(1, 4) - f(157, 1000) - f(1, 10**4)
    assert 32 * left >= 2  # 2^-19 r of apart, in u r; 2^-23 r are 2 u r
    assert 16 - f(34, 10) - 2 * left >= 12  # of u |o|
    assert 4 + 2 + 1 == 7 < 16  # the end of a ray
    assert f(1024 - 1 - 28, 4) > 248  # E of a clipped scene
