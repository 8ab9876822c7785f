"""Pruning that leaks nothing: the hits of the watertight test, bit by bit, and its bound against float64."""

from __future__ import annotations

import numpy as np
import pytest

from studies.triangles import pichler_variants as tried
from studies.triangles.isolated_tests import Beams, Soup, closest, exits, pairs
from studies.triangles.pichler_tables import Case
from studies.triangles.triangle_precision import solve
from wrt.kernels.classics.studies.variants.watertight_pruning import MIN_HEIGHT, PRUNED, ROUNDINGS, UNPRUNED
from wrt.kernels.triangle import TRIANGLE_TESTS

pytestmark = pytest.mark.classics

COUNT = 40_000
FLOAT = np.float32
WOOP = TRIANGLE_TESTS["woop"]


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def triangles(rng: np.random.Generator, count: int, least_height: float = 1e-5) -> np.ndarray:
    """(N, 3, 3) of all shapes, many of them slim, with a longest edge of about 1."""
    along = unit(rng.normal(size=(count, 3)))
    across = unit(np.cross(along, rng.normal(size=(count, 3))))
    height = 10.0 ** rng.uniform(np.log10(least_height), 0, (count, 1))
    corners = np.stack([np.zeros((count, 3)), along, rng.random((count, 1)) * along + height * across], axis=1)
    return np.take_along_axis(corners, rng.permuted(np.tile(np.arange(3), (count, 1)), axis=1)[..., None], axis=1)


def on_rims(rng: np.random.Generator, count: int) -> np.ndarray:
    """(N, 3) weights: vertices, points of edges, points very near to edges, and others."""
    weights = rng.dirichlet((1, 1, 1), count)
    kind = rng.integers(4, size=count)
    weights[kind == 0] = np.eye(3)[rng.integers(3, size=(kind == 0).sum())]
    weights[kind == 1, rng.integers(3)] = 0.0
    near = kind == 2
    weights[near, rng.integers(3)] = rng.choice([-1, 1], near.sum()) * 10.0 ** rng.uniform(-8, -3, near.sum())
    return weights / weights.sum(axis=1, keepdims=True)


def attacks(name: str, rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(N, 3, 3) corners, (N, 3) origins and directions, float32: rays at vertices and edges, of one kind."""
    corners = triangles(rng, count, 1e-9 if name == "slivers" else 1e-5)
    away = {"far away": 1e4, "far from the centre": 1.0}.get(name, 10.0 ** rng.uniform(-3, 2, (count, 1)))
    offset = {"far from the centre": 10.0 ** rng.uniform(1, 5, (count, 1, 1))}.get(name, 1.0)
    scale = {"tiny": 1e-17, "huge": 1e9}.get(name, 1.0)
    if name == "along the axes":
        corners = np.round(8.0 * rng.normal(size=corners.shape))
        corners[np.arange(count), :, rng.integers(3, size=count)] = 0.0  # flat
    corners = corners + offset * rng.normal(size=(count, 1, 3))
    corners = (scale * corners).astype(FLOAT)
    exact = corners.astype(np.float64)
    targets = (exact * on_rims(rng, count)[..., None]).sum(axis=1)
    directions = unit(rng.normal(size=(count, 3)))
    if name == "grazing":
        normals = unit(np.cross(exact[:, 1] - exact[:, 0], exact[:, 2] - exact[:, 0]) + 1e-30)
        lift = (10.0 ** rng.uniform(-7, -1, (count, 1)) * rng.choice([-1, 1], (count, 1))) - (directions * normals).sum(
            axis=1, keepdims=True
        )
        directions = directions + lift * normals
    if name == "along the axes":
        directions = np.where(rng.random((count, 1)) < 0.5, np.eye(3)[rng.integers(3, size=count)], directions)
    origins = (targets - scale * away * directions).astype(FLOAT)
    directions = (targets - origins) * (rng.uniform(0.5, 2.0, (count, 1)) / scale)
    return corners, origins, directions.astype(FLOAT)


ATTACKS = ("near", "far away", "far from the centre", "grazing", "slivers", "along the axes", "tiny", "huge")


def excess(corners: np.ndarray, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N,) each: how far the computed point is beyond the comparison that it fails most, and e; in the test's arithmetic."""
    soup = Soup(corners)
    record = soup.records(PRUNED.record, 1).numpy().reshape(len(corners), -1)[:, 9:]
    names = dict(zip(PRUNED.lanes.triangle, record.T, strict=True))
    axis = np.argmax(np.abs(directions), axis=1)
    d = (directions / np.take_along_axis(directions, axis[:, None], axis=1)).T
    o = origins.T

    def dot(a, b):
        return (a[0] * b[0] + a[1] * b[1]) + a[2] * b[2]

    normal = [names[f"n{c}"] for c in "xyz"]
    with np.errstate(all="ignore"):
        along = dot(normal, d)
        t = (names["n0"] - dot(normal, o)) / along
        p = o + t * d
        x, y = (dot([names[f"s{row}{c}"] for c in "xyz"], p) + names[f"s{row}0"] for row in "xy")
        widening = (names["spread"] * (np.abs(o).max(axis=0) + names["reach"])) / np.abs(along)
        apex_x, apex_y = names["apex_x"], names["apex_y"]
        left = y * apex_x - x * apex_y
        right = apex_y * (x - FLOAT(1)) + y * (FLOAT(1) - apex_x)
    assert all(values.dtype == FLOAT for values in (x, y, widening, left, right))
    return np.max([-y, left, right], axis=0), widening


def hits_of(test, soup: Soup, rays: Beams) -> np.ndarray:
    """(N, 3) t, u, v; all NaN for a miss."""
    found = pairs(test, soup, rays)
    return np.where(np.isnan(found[:, :1]), np.float32(np.nan), found)


@pytest.mark.parametrize("name", ATTACKS)
def test_hits_are_those_of_the_watertight_test(name):
    """Rays at vertices, at edges and just beside them: the same t, u and v to the bit, and the same misses (t is NaN)."""
    for seed in range(3):
        corners, origins, directions = attacks(name, np.random.default_rng(seed), COUNT)
        soup, rays = Soup(corners), Beams(origins, directions)
        expected, plain, pruned = (hits_of(test, soup, rays) for test in (WOOP, UNPRUNED, PRUNED))
        assert 0.2 < np.isfinite(expected[:, 0]).mean() < 0.98
        np.testing.assert_array_equal(plain, expected)
        np.testing.assert_array_equal(pruned, expected)


@pytest.mark.parametrize("name", ATTACKS)
def test_bound(name):
    """No hit of the watertight test, and none in float64, is beyond a comparison by more than e; without e many would be."""
    corners, origins, directions = attacks(name, np.random.default_rng(7), 4 * COUNT)
    hit = ~np.isnan(pairs(WOOP, Soup(corners), Beams(origins, directions))[:, 0])
    exact = np.array([solve(c[None], o, d[None])[0] for c, o, d in zip(corners[:2000], origins, directions, strict=False)])
    with np.errstate(invalid="ignore"):
        inside = (exact[:, 1:] >= 0.0).all(axis=1) & (exact[:, 1:].sum(axis=1) <= 1.0)
    hit[:2000] |= inside
    beyond, widening = excess(corners, origins, directions)
    used = hit & (widening < 2.0)
    if name == "slivers":
        assert np.isinf(widening).mean() > 0.2  # too slim to be pruned
    assert used.sum() > 2000
    ratio = beyond[used] / widening[used]
    assert ratio.max() <= 1.0
    assert (beyond[used] > 0.0).mean() > 0.01, "a test of nothing"


def test_a_narrow_bound_would_leak():
    """Random roundings add up to a hundredth of e, which is for the worst ones in the worst place: e / 200 cuts off hits."""
    corners, origins, directions = attacks("far away", np.random.default_rng(1), COUNT)
    hit = ~np.isnan(pairs(WOOP, Soup(corners), Beams(origins, directions))[:, 0])
    beyond, widening = excess(corners, origins, directions)
    ratio = (beyond / widening)[hit & (widening < 2.0)]
    assert 1 / 200 < ratio.max() < 1 / 20


def test_what_is_cut_off():
    """In a scene, pruning cuts off nearly all that misses; the comparisons that leak cut off hardly more."""
    case = Case("teapot", 12)
    replay = tried.Replay(case)
    ends = {name: replay.run(name, counted=True)() for name in (PRUNED.name, UNPRUNED.name, "ferko_prune3")}
    assert len({counts.sum() for counts in ends.values()}) == 1
    assert ends[PRUNED.name][-1] == ends[UNPRUNED.name][-1]
    cut, leaky, missed = ends[PRUNED.name][:3].sum(), ends["ferko_prune3"][:3].sum(), ends[UNPRUNED.name][0]
    assert 0.95 * missed < cut <= missed
    assert cut <= leaky


def test_limits():
    """Triangles without area, too slim, too small and too large have no finite e; others have the one of the formula."""
    base = np.array([[0, 0, 0], [1, 0, 0], [0.5, 1, 0]])
    slim = base * [1, 0.5 * float(MIN_HEIGHT), 1]
    corners = np.array([base, base * [1, 0, 1], slim, base * 2.0**-61, base * 2.0**61, base * 4.0 + 8.0], dtype=FLOAT)
    reach, spread = Soup(corners).records(PRUNED.record, 1).numpy().reshape(len(corners), -1)[:, -2:].T
    np.testing.assert_array_equal(np.isinf(spread), [False, True, True, True, True, False])
    longest = np.sqrt(1.25)
    np.testing.assert_allclose(spread[[0, 5]], [ROUNDINGS / longest, ROUNDINGS / (4 * longest)], rtol=1e-6)
    np.testing.assert_array_equal(reach[[0, 5]], [1.0, 12.0])


def test_lanes():
    """Triangles in lanes and rays in lanes find what pairs one by one do; NaN, infinity and zero directions miss."""
    rng = np.random.default_rng(5)
    corners = triangles(rng, 60, 1e-2) * 3.0 + rng.normal(size=(60, 1, 3))
    directions = rng.normal(size=(256, 3))
    origin = np.array([[0.3, -0.2, 0.1]])
    soup, rays = Soup(corners, origin[0]), Beams(origin, directions)
    expected = closest(WOOP, soup, rays, frustum=0, width=0)()
    for frustum, width in ((0, 8), (64, 8), (0, 0)):
        found = closest(PRUNED, soup, rays, frustum=frustum, width=width)()
        for got, wanted in zip(found, expected, strict=True):
            np.testing.assert_array_equal(got, wanted)
    assert 0.2 < (expected[1] >= 0).mean() < 1.0
    bad = np.array([[np.nan, 0, 1], [0, 0, 0], [np.inf, 0, 0]])
    assert (closest(PRUNED, soup, Beams(origin, bad), frustum=0, width=0)()[1] < 0).all()
    ends = exits(PRUNED, soup, rays)
    assert sum(ends.tests) == 60 * 256
    assert min(ends.tests[:3]) > 0


def test_closed_bodies_do_not_leak():
    """At edges and vertices of closed bodies, where pruning without the bound loses one ray in seven."""
    rows = {
        (row["test"], row["at"]): row for row in tried.leak_counts(("ferko_prune3", PRUNED.name), origins=1, subdivisions=2)
    }
    for at in ("edges", "vertices"):
        assert rows[PRUNED.name, at]["rays"] == rows["ferko_prune3", at]["rays"] > 300
        assert rows[PRUNED.name, at]["leaked"] == 0
        assert rows["ferko_prune3", at]["leaked"] > 0.05 * rows["ferko_prune3", at]["rays"]
