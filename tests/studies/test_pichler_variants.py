"""What Pichler 2018 tried beside what he kept: every form against float64, and the tables that measure them."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
import warp as wp

from studies.triangles import pichler_variants as tried
from studies.triangles.isolated_tests import Beams, Soup, closest, pairs
from studies.triangles.pichler_tables import Case
from studies.triangles.triangle_precision import aimed_pairs, errors
from wrt.kernels.classics.studies.dammertz_keller import TEST as DAMMERTZ_KELLER
from wrt.kernels.classics.studies.pichler_2018 import (
    BOX_SPHERE,
    FREE_COLUMNS,
    FREE_MATRIX,
    MATRIX,
    STUDIED,
    UNIT_RAY,
    WAYS,
)
from wrt.kernels.classics.triangle.ferko.record_part import join
from wrt.kernels.triangle.support.block_packing import pack_blocks

pytestmark = pytest.mark.classics

RNG = np.random.default_rng(11)
CORNERS = RNG.normal(size=(200, 3, 3)).astype(np.float32)


def floats_of(part, corners):
    """(triangles, floats) of a part of a record."""
    soup, record = Soup(corners), join((part,))
    ids = wp.array(np.arange(len(corners), dtype=np.int32), dtype=int, device="cpu")
    values = pack_blocks(record, soup.vertices, soup.faces, ids, 1).records.numpy()
    return values.reshape(len(corners), record.components)[:, 9:].astype(np.float64)


def test_inverse_of_the_vertices():
    """Way 1 is X A^-1, the product of equations 4.2 and 4.3, by NumPy's inverse of a 4 x 4 matrix."""
    target = np.zeros((4, 4))
    target[0, 1] = target[1, 2] = target[3, 3] = 1.0
    for corners, values in zip(CORNERS.astype(np.float64), floats_of(MATRIX, CORNERS), strict=True):
        source = np.eye(4)
        source[:3, :3] = corners.T
        source[3, :3] = 0.0
        expected = target @ np.linalg.inv(source)
        np.testing.assert_allclose(values.reshape(4, 4), expected, atol=1e-6 * np.abs(expected).max())


def test_printed_inverses_with_a_free_vector():
    """Equations 5.2 to 5.4, one for each main axis, are the inverse of 5.1, by NumPy; way 5 is way 4 without a column."""
    seen = set()
    columns = floats_of(FREE_COLUMNS, CORNERS)
    for corners, values, kept in zip(CORNERS.astype(np.float64), floats_of(FREE_MATRIX, CORNERS), columns, strict=True):
        a, b, c = corners
        axis = int(np.argmax(np.abs(np.cross(b - a, c - a))))
        seen.add(axis)
        onto = np.eye(4)
        onto[:3] = np.stack([b - a, c - a, np.eye(3)[axis], a], axis=1)
        expected = np.linalg.inv(onto)[:3]
        matrix = values.reshape(3, 4)
        np.testing.assert_allclose(matrix, expected, atol=1e-6 * np.abs(expected).max())
        np.testing.assert_array_equal(matrix[:, axis], [0.0, 0.0, 1.0])
        assert kept[0] == axis
        np.testing.assert_array_equal(kept[1:].reshape(3, 3), matrix[:, [(axis + 1) % 3, (axis + 2) % 3, 3]])
    assert seen == {0, 1, 2}


@pytest.mark.parametrize("name", [*STUDIED, "unit_ray", "dammertz_keller"])
def test_against_float64(name):
    """No clear hit is missed and none is invented, from near and from far; t, u and v are right."""
    test = {**STUDIED, "unit_ray": UNIT_RAY, "dammertz_keller": DAMMERTZ_KELLER}[name]
    rough = 200.0 if name == "dammertz_keller" else 10.0 if name in ("utm_matrix", "utm_rows") else 1.0
    for distance in (1.0, 100.0):
        found = errors(test, *aimed_pairs(4000, distance, 1.0, 1.0, 3))
        assert found["missed"] <= (1e-3 if rough == 10.0 else 0.0)
        assert found["invented"] <= (1e-3 if rough == 10.0 else 0.0)
        assert found["t"]["p99"] < 1e-6 * (100.0 if rough == 200.0 else 1.0)
        assert max(found["u"]["p99"], found["v"]["p99"]) < 2e-6 * rough * distance


def test_planes_through_the_origin():
    """The inverse of the vertices does not exist there, so ways 1 to 3 lose the triangle; the free vector does not care."""
    corners = np.array([[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, -1.0, 0.0]]])
    soup, ray = Soup(corners), Beams(np.array([[0.1, 0.1, 2.0]]), np.array([[0.0, 0.0, -1.0]]))
    hit = {name: not np.isnan(pairs(STUDIED[name], soup, ray)[0, 0]) for name in WAYS}
    assert hit == {name: "free" in name for name in WAYS}


def test_sphere_around_the_box():
    """It holds the box of the triangle, and is hardly larger than it must be."""
    for corners, (*centre, square) in zip(CORNERS.astype(np.float64), floats_of(BOX_SPHERE, CORNERS), strict=True):
        low, high = corners.min(axis=0), corners.max(axis=0)
        for corner in (low, high, [low[0], high[1], low[2]]):
            assert np.linalg.norm(corner - np.array(centre)) <= np.sqrt(square)
        assert np.sqrt(square) <= np.linalg.norm(high - low) / 2 + 2e-5


@pytest.mark.parametrize("name", ["sphere_cross", "sphere_projection", "sphere_parametric"])
def test_spheres_are_those_of_the_equations(name):
    """Lines beside the smallest sphere of an equilateral triangle leave at it, others do not; so do rays that begin behind it,
    but for the test that knows only the line."""
    angles = np.radians([0.0, 120.0, 240.0])
    corners = np.stack([np.cos(angles), np.sin(angles), np.zeros(3)], axis=1)[None]
    away = np.array([0.2, 0.9, 0.99, 1.02, 1.5, 3.0])
    origins = np.stack([away, np.zeros(6), np.full(6, 5.0)], axis=1)
    replayed = tried.Replay.__new__(tried.Replay)
    replayed.soup, replayed.count = Soup(corners), 12
    replayed.origins = wp.array(np.concatenate([origins, origins]), dtype=wp.vec3, device="cpu")
    down = np.tile([[0.0, 0.0, -1.0]], (6, 1))
    replayed.directions = wp.array(np.concatenate([down, -down]), dtype=wp.vec3, device="cpu")
    replayed.begin, replayed.slot = wp.array(np.arange(13), dtype=int), wp.zeros(12, dtype=int)
    beside = replayed.run(name, counted=True)()[0]
    assert beside == (6 if name == "sphere_cross" else 3 + 6)


def test_replayed_pairs():
    """The pairs hold each ray's closest hit, nearest boxes first; all forms with a range find it, early or late."""
    case = Case("needles", 12)
    replay = tried.Replay(case)
    expected = np.concatenate([case.scene.intersect(w.rays, triangle_test="ferko_utm").t.ravel() for w in case.workloads])
    for name in ("range_first", "range_delayed", "range_last"):
        found = replay.run(name)()
        np.testing.assert_array_equal(np.isinf(found), np.isinf(expected))
        np.testing.assert_allclose(found, expected, rtol=2e-6)
    first, delayed, last = (replay.run(f"range_{when}", counted=True)() for when in ("first", "delayed", "last"))
    assert first.sum() == delayed.sum() == last.sum() == replay.tests
    assert first[-1] == delayed[-1] == last[-1]
    assert first[0] >= delayed[0] > 0
    rows = tried.replays(("needles",), ("range_last",), size=12, rounds=1)
    assert [row["form"] for row in rows] == ["range_last", "range_delayed"]
    assert rows[0]["tests"] == replay.tests
    assert all(sum(row["exits"].values()) == pytest.approx(1.0 - row["hit_rate"]) for row in rows)
    assert rows[1]["ratio"] == 1.0


def test_subdivision_is_watertight():
    """From inside a ball, at its edges and vertices, nothing passes; NaN and zero directions miss, beside it too."""
    ball = trimesh.creation.icosphere(subdivisions=2)
    a, b = np.moveaxis(ball.vertices[ball.edges_unique], 1, 0)
    points = np.concatenate([ball.vertices, a + 0.3 * (b - a)])
    origins = np.tile([[0.1, -0.2, 0.15]], (len(points), 1))
    run = closest(DAMMERTZ_KELLER, Soup(ball.triangles), Beams(origins, points - origins[0]), frustum=0, width=0)
    t, found = run()
    assert (found >= 0).all()
    np.testing.assert_allclose(t, 1.0, atol=2e-5)
    bad = np.array([[np.nan, 0, 1], [0, 0, 0], [np.inf, 0, 0]])
    assert (closest(DAMMERTZ_KELLER, Soup(ball.triangles), Beams(np.zeros((3, 3)), bad), frustum=0, width=0)()[1] < 0).all()


def test_tables():
    """They are complete, contenders find the same, and the rays that leak do so by the tests that are known to."""
    for rows in (tried.edge_planes(("needles",), size=8, rounds=1), tried.subdivision(("needles",), size=8, rounds=1, rays=16)):
        assert len({row["found"] for row in rows}) == 1
        assert rows[0]["ratio"] == 1.0
        assert rows[0]["found"] > 0
    rows = {row["test"]: row for row in tried.squared_errors(("teapot",), ("woop", *tried.HAVEL_HEROUT), size=16)}
    assert [*rows] == ["woop", *tried.HAVEL_HEROUT, "dammertz_keller"]
    assert all(0.0 < row["point"] < 1e-12 and row["missed"] == 0.0 for name, row in rows.items() if name != "dammertz_keller")
    assert rows["woop"]["uv"] < rows["dammertz_keller"]["uv"] < 1e-5
    leaks = {row["test"]: row for row in tried.leak_counts(("woop", "ferko_prune3"), origins=1, subdivisions=2)}
    assert leaks["woop"]["leaked"] == 0 < leaks["ferko_prune3"]["leaked"]
