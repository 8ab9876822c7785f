"""The comparison of triangle tests: complete, paired, and right where the answer is known. No timings here."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import warp as wp
from click.testing import CliRunner

import wrt
from studies.__main__ import studies
from studies.triangles import komatsu_tables as tables
from studies.triangles.triangle_precision import MARGIN, aimed_pairs, errors, leaks, precision, solve
from studies.triangles.triangle_test_comparison import SITUATIONS, ratios, run_triangle_tests
from wrt.bench.comparisons.auto_cases import subdivided
from wrt.bench.core.paired_timing import Timing
from wrt.kernels.classics.studies.komatsu_2008 import PUBLISHED
from wrt.kernels.triangle import TRIANGLE_TESTS, moeller_trumbore
from wrt.kernels.triangle.support.record_blocks import Corners
from wrt.kernels.triangle.support.vectors import PlainRay

MESH = wrt.scenes.teapot(level=3, ground=False)


@wp.func
def facing_only(ray: PlainRay, corners: Corners):
    """Moeller and Trumbore's test, wrong: half of the triangles are not seen."""
    hit = moeller_trumbore.intersect(ray, corners)
    return wp.where(wp.dot(wp.cross(corners.b - corners.a, corners.c - corners.a), ray.direction) < 0.0, hit, wp.vec3(wp.nan))


@wp.func
def twice_as_far(ray: PlainRay, corners: Corners):
    """Moeller and Trumbore's test, wrong: t is doubled."""
    hit = moeller_trumbore.intersect(ray, corners)
    return wp.vec3(2.0 * hit[0], hit[1], hit[2])


def is_plain(value) -> bool:
    """Whether JSON takes it."""
    return json.loads(json.dumps(value)) == value


@pytest.fixture(scope="module")
def report():
    """All situations, of two tests beside the reference."""
    return run_triangle_tests(MESH, tests=("woop", "komatsu"), size=16, rounds=2)


def test_report_is_complete(report):
    names = [result.name for result in report.results]
    assert names == ["moeller_trumbore", "woop", "komatsu"], "the reference is there whether named or not"
    assert is_plain(report.to_dict())
    reference, woop, komatsu = report.results
    for result in report.results:
        assert list(result.speed) == list(SITUATIONS)
        for name, ratio in result.speed.items():
            if (result.name, name) == ("komatsu", "stream"):
                assert ratio is None, "random rays share no origin"
            else:
                assert 0 < ratio.least <= ratio.median <= ratio.greatest
                assert ratio.nanoseconds > 0
        exits = result.exits["exits"]
        assert sum(entry["tests"] for entry in exits) == pytest.approx(1)
        assert sum(entry["vectors"] for entry in exits) == pytest.approx(1)
        assert exits[-1]["exit"] == "hit"
        assert 0 < result.exits["hit_rate"] < 0.1
        done = result.operations_done
        assert done["alone"] <= done["together"] <= result.operations
    assert all(ratio.median == 1.0 for ratio in reference.speed.values())
    assert len(reference.exits["exits"]) == 4, "the paper's exits, not the one that is compiled"
    assert len({result.exits["hit_rate"] for result in report.results}) == 1, "generic rays hit the same by all tests"
    assert reference.operations_done["compiled"] == reference.operations
    assert (woop.record_bytes, komatsu.record_bytes, komatsu.test_bytes) == (36, 88, 52)


def test_ratios_are_taken_round_by_round():
    timings = {"a": Timing(2, [1.0, 2.0, 8.0]), "b": Timing(1, [1.0, 0.5, 1.0])}
    found = ratios(timings, "a")["b"]
    assert (found.median, found.least, found.greatest) == (0.5, 0.25, 2.0)
    assert found.nanoseconds == 1e9
    with pytest.raises(RuntimeError, match="b failed: no memory"):
        ratios({"a": timings["a"], "b": Timing(1, error="no memory")}, "a")


def test_unknown_names_are_refused():
    with pytest.raises(ValueError, match="tests 'magic' is unknown; choose from"):
        run_triangle_tests(MESH, tests=("magic",), size=16)
    with pytest.raises(ValueError, match="situations 'rain' is unknown; choose from soup"):
        run_triangle_tests(MESH, situations=("rain",), size=16)


def test_command(tmp_path):
    pytest.importorskip("matplotlib")
    figures, picture = tmp_path / "figures.json", tmp_path / "picture.png"
    options = ["--test", "woop", "--situation", "soup", "--situation", "stream", "--size", "16", "--rounds", "1"]
    call = ["triangle-tests", "teapot", *options, "--no-precision", "--json", str(figures), "--plot", str(picture)]
    result = CliRunner().invoke(studies, call)
    assert result.exit_code == 0, result.output
    for text in ("Speed", "soup", "stream", "Cost", "Exits", "moeller_trumbore", "woop", "hit"):
        assert text in result.output
    assert "Precision" not in result.output
    found = json.loads(figures.read_text())
    assert [entry["name"] for entry in found["results"]] == ["moeller_trumbore", "woop"]
    assert list(found["results"][1]["speed"]) == ["soup", "stream"]
    assert picture.stat().st_size > 5000


def test_command_says_what_it_takes():
    runner = CliRunner()
    assert "--situation" in runner.invoke(studies, ["triangle-tests", "--help"]).output
    assert runner.invoke(studies, ["triangle-tests", "--test", "magic"]).exit_code == 2
    missing = runner.invoke(studies, ["triangle-tests", "no_such_model"])
    assert missing.exit_code == 2
    assert "built-in scenes are" in missing.output


def test_precision_is_against_float64(report):
    """Pairs are what they are said to be; errors grow with slimness and distance, and not with scale."""
    corners, origin, directions = aimed_pairs(4000, 10.0, 0.1, 7.0, 0)
    a, b, c = np.moveaxis(corners.astype(np.float64), 1, 0)
    longest = np.linalg.norm(b - c, axis=1)
    np.testing.assert_allclose(longest, 7.0, rtol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 49, 0.1 * np.sqrt(0.75), rtol=1e-3)
    distance = np.linalg.norm(corners.mean(axis=1) - origin, axis=1) / 7.0
    assert 9.0 < distance.min() <= distance.max() < 11.0
    t, u, v = solve(corners, origin, directions).T
    points = a + u[:, None] * (b - a) + v[:, None] * (c - a)
    np.testing.assert_allclose(origin + t[:, None] * directions.astype(float), points, atol=1e-4)
    inside = np.minimum(np.minimum(u, v), 1 - u - v) > MARGIN
    assert 0.3 < inside.mean() < 0.7
    for result in report.results:
        found = result.precision
        for case in found["distance"] + found["scale"] + found["slimness"][:3]:
            assert case["missed"] == case["invented"] == 0.0
            assert case["t"]["median"] < 1e-5
            assert case["t"]["median"] <= case["t"]["p99"] <= case["t"]["max"]
        by_distance = [case["u"]["p99"] for case in found["distance"]]
        by_slimness = [case["u"]["p99"] for case in found["slimness"]]
        assert all(far > 3 * near for near, far in pairwise(by_distance))
        assert all(slim > 3 * plain for plain, slim in pairwise(by_slimness))
        by_scale = [case["u"]["p99"] for case in found["scale"]]
        assert max(by_scale) < 1.5 * min(by_scale)


def test_a_wrong_test_shows():
    """The published tests are one-sided: they miss what is turned away, here half of it; others miss nothing."""
    reference = TRIANGLE_TESTS["moeller_trumbore"]
    corners, origin, directions = aimed_pairs(2000, 3.0, 1.0, 1.0, 1)
    one_sided = replace(reference, intersect=facing_only)
    assert errors(reference, corners, origin, directions)["missed"] == 0.0
    assert 0.3 < errors(one_sided, corners, origin, directions)["missed"] < 0.7
    doubled = errors(replace(reference, intersect=twice_as_far), corners, origin, directions)
    assert doubled["t"]["median"] == pytest.approx(1.0)
    assert doubled["u"]["max"] < 1e-4
    empty = errors(reference, corners[:0], origin, directions[:0])
    assert empty["missed"] is empty["t"] is None


def test_leaks(report):
    """As Komatsu's docstring says: none at edges, some at vertices; the watertight test has none."""
    reference, woop, komatsu = (result.leaks for result in report.results)
    assert all(entry["leaked"] == 0 for entry in woop.values())
    assert komatsu["edges"]["leaked"] == 0
    assert 0 < komatsu["vertices"]["per_million"] < reference["vertices"]["per_million"]
    assert all(entry["per_million"] > 10_000 for entry in reference.values())
    few = leaks(TRIANGLE_TESTS["woop"], origins=2, subdivisions=1)
    assert few["edges"]["rays"] == 2 * 2 * 3 * 120
    assert few["vertices"]["rays"] == 2 * 2 * 42
    assert precision(TRIANGLE_TESTS["woop"], count=50)["scale"][0]["scale"] == 1e-6


# -- Komatsu's tables --------------------------------------------------------------------------------------------------


def test_table_1_is_the_papers():
    for row in tables.table_1():
        assert row["bytes"] == row["paper_bytes"]
        assert row["precomputation"] == row["paper_precomputation"]
        if row["algorithm"] == "Projection":
            assert abs(row["test"] - row["paper_test"]) <= 1
        else:
            assert row["test"] == row["paper_test"]


def test_frusta_are_tiles_of_the_view():
    soup, rays = tables.frusta(MESH, pixels=32, edge=4, tests=MESH.triangle_count * 16 * 5)
    assert len(soup) == MESH.triangle_count
    directions = rays.directions.numpy().reshape(-1, 16, 3)
    assert len(directions) == 5
    whole = tables.frusta(MESH, pixels=32, edge=4, tests=10**9)[1].directions.numpy().reshape(-1, 16, 3)
    assert len(whole) == 64
    spread = np.linalg.norm(whole - whole.mean(axis=1, keepdims=True), axis=2).max()
    assert spread < 0.2 * np.linalg.norm(whole[0, 0] - whole[-1, 0])
    assert {tuple(tile.ravel()) for tile in directions} <= {tuple(tile.ravel()) for tile in whole}
    with pytest.raises(ValueError, match="multiple of 4"):
        tables.frusta(MESH, pixels=30, edge=4)


def test_timed_tables():
    """Shapes and references; the forms with and without exits give the same hits."""
    few = {"rounds": 1, "pixels": 32, "tests": 1 << 16}
    rows = tables.contenders(MESH, **few)
    assert [row["contender"] for row in rows] == ["Möller", "Projection", "Pluecker", "Proposed"]
    assert rows[0]["ratio"] == 1.0
    assert all(row["seconds"] == pytest.approx(row["nanoseconds"] * 1e-9 * 1024 * MESH.triangle_count) for row in rows)
    assert len(tables.early_exits(MESH, **few)) == 9
    assert {row["pixels"] for row in tables.resolutions(MESH, (16, 32), rounds=1, tests=1 << 14)} == {16, 32}
    assert [row["edge"] for row in tables.frustum_sizes(MESH, (1, 2), **few)] == [1, 1, 2, 2]
    assert {row["order"] for row in tables.foreseen(MESH, rounds=1, tests=1 << 14)} == {"file", "tree", "exit"}
    assert is_plain(rows)
    shares = tables.exit_shares(MESH, pixels=32)
    for name in PUBLISHED:
        own = [row for row in shares if row["contender"].lower().replace("ö", "oe") == name]
        assert sum(row["tests"] for row in own) == pytest.approx(1)
        if name == "projection":
            assert [row["paper"] for row in own] == pytest.approx([0.296, 0.342, 0.243, 0.119]), "no row is missing"
            assert all(row["tests"] > 0.03 for row in own)
        else:
            assert 0.3 < own[0]["tests"] < 0.7, "about half of a closed surface is turned away"
    rows = tables.with_tree(MESH, pixels=32, rounds=1)
    assert len(rows) == 6
    assert all(row["records"] > 0 for row in rows)


def test_order_by_exit():
    """Each triangle's end is not before that of the one ahead of it, by the very steps of the test."""
    from studies.triangles.isolated_tests import Beams, Soup, exits

    rng = np.random.default_rng(0)
    corners = (rng.normal(size=(60, 1, 3)) + 0.3 * rng.normal(size=(60, 3, 3)) + [0, 0, 4]).astype(np.float32)
    direction = np.float32([0.1, 0.2, 1.0])
    ends = []
    for number in tables.exit_order(corners, direction):
        found = exits(PUBLISHED["proposed"], Soup(corners[number : number + 1]), Beams(np.zeros((1, 3)), direction[None]))
        ends.append(min(int(np.argmax(found.tests)), 4))
    assert ends == sorted(ends)
    assert len(set(ends)) >= 4


def test_forms_with_other_exits_hit_the_same():
    from studies.triangles.isolated_tests import closest

    soup, rays = tables.frusta(MESH, pixels=16, edge=4)
    form = PUBLISHED["proposed"]
    expected = [values.copy() for values in closest(form, soup, rays, frustum=16, width=16)()]
    for other in (tables.without_exits(form), tables.one_exit(form), replace(form, name="again")):
        for value, same in zip(closest(other, soup, rays, frustum=16, width=16)(), expected, strict=True):
            np.testing.assert_array_equal(value, same)
    assert (expected[1] >= 0).any()


def test_subdivision_keeps_the_surface():
    divided = subdivided(MESH, 2)
    assert divided.triangle_count == 16 * MESH.triangle_count
    area = [mesh.to_trimesh().area for mesh in (MESH, divided)]
    assert area[1] == pytest.approx(area[0], rel=1e-4)
