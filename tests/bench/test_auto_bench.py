"""`wrt bench auto`: its cases, and the table of choices."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

import wrt
from wrt.bench.commands.benchmark import bench
from wrt.bench.comparisons import auto_choices, auto_journeys
from wrt.bench.comparisons.auto_cases import BEAMS, KINDS, PLACES, SHORT, TURN, cases, city, scene_of
from wrt.kernels.traversal.packet import CULLINGS


@pytest.fixture(scope="module")
def teapot() -> wrt.TriangleMesh:
    return wrt.scenes.build("teapot", level=2)


def test_cases(teapot):
    found = {case.kind: case for case in cases(teapot, sizes=(16,))}
    assert tuple(found) == (*(kind for kind in KINDS if kind != "places"), *(f"place {number}" for number in range(PLACES)))
    assert found["place 7"].rays.directions.shape == (BEAMS, TURN, 3)
    assert (teapot.bounds[0] <= found["place 7"].rays.origins).all()
    assert (found["place 7"].rays.origins <= teapot.bounds[1]).all()
    assert found["scan"].rays.directions.shape == (BEAMS, 4, 3)
    assert found["scan"].rays_count == 256
    assert found["view"].rays_count == found["random"].rays_count == 256
    assert 0 < found["shadow"].rays_count == found["ao"].rays_count == found["short"].rays_count < 256
    assert [kind for kind, case in found.items() if case.is_occlusion] == ["shadow", "ao"]


def test_rays_in_other_orders(teapot):
    """They are the same rays: those of a view in any order, and random ones by octants."""
    found = {case.kind: case.workload for case in cases(teapot, ("view", "shuffled", "random", "sorted"), sizes=(16,))}
    for one, other in (("view", "shuffled"), ("random", "sorted")):
        before, after = (np.concatenate([found[kind].origins, found[kind].directions], axis=1) for kind in (one, other))
        assert not np.array_equal(before, after)
        assert np.array_equal(np.unique(before, axis=0), np.unique(after, axis=0))
    octants = (found["sorted"].directions < 0.0) @ np.array([4, 2, 1])
    assert (np.diff(octants) >= 0).all()


def test_short_rays_start_outside(teapot):
    """They leave the surface on the side that the view sees, and end nearby."""
    (case,) = cases(teapot, ("short",), sizes=(32,))
    assert case.rays.t_max == pytest.approx(SHORT * teapot.extent)
    assert np.linalg.norm(case.rays.directions, axis=1) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.slow
def test_journeys(teapot, monkeypatch):
    """What "auto" loses while it learns counts."""
    monkeypatch.setattr(auto_journeys, "places", lambda mesh: np.array([mesh.center, mesh.center + 1.0]))
    monkeypatch.setattr(auto_journeys, "STAYS", (1, 2))
    monkeypatch.setattr(auto_choices, "CULLINGS", {"interval": CULLINGS["interval"]})
    scene, mesh = scene_of("model", teapot, 1)
    rows = [*auto_journeys.compare_journeys("model", scene, mesh)]
    assert [row.kind for row in rows] == ["journey, 1", "journey, 2"]
    assert all(row.rays == BEAMS * TURN and row.ratio > 0.5 for row in rows)


def test_a_city_is_of_closed_houses_on_a_ground():
    mesh = city(3)
    assert mesh.triangle_count == 9 * 12 + 2
    houses = wrt.TriangleMesh(mesh.vertices[:-4], mesh.faces[:-2])
    assert houses.is_closed
    assert houses.to_trimesh().volume > 0.0


def test_world_and_instances_are_the_same_triangles(teapot):
    (one, mesh), (many, flat) = scene_of("world", teapot), scene_of("instances", teapot)
    assert len(many.instances) == 11
    assert not one.instances
    assert mesh.triangle_count == flat.triangle_count == one.triangle_count == many.triangle_count


def test_command(tmp_path, monkeypatch):
    """One culling, so that few kernels are compiled; the best engine is at most as slow as the one that was chosen."""
    monkeypatch.setattr(auto_choices, "CULLINGS", {"transient_frustum": CULLINGS["transient_frustum"]})
    target = tmp_path / "auto.json"
    arguments = ["auto", "teapot", "--scene", "model", "--kind", "view", "--size", "64", "--rounds", "1", "--json", target]
    done = CliRunner().invoke(bench, [*map(str, arguments)])
    assert done.exit_code == 0, done.output
    assert "1 cases: " in done.output
    (row,) = json.loads(target.read_text())["choices"]
    assert row["rays"] == 4096
    assert row["ratio"] > 0.0
    assert row["rules_ratio"] >= 1.0, "the rules choose one of the engines"
    assert row["noise"] >= 1.0
    assert "the best engine against itself: at most" in done.output
    assert row["rules"] in row["compared"]
    assert row["best"] in row["milliseconds"]
    assert row["rules"] in row["milliseconds"]


def test_more_turns_time_the_best_engine_twice():
    """On a clock that each run advances by what it takes, the engine's second name included."""
    now = 0.0

    def takes(seconds):
        def run() -> None:
            nonlocal now
            now += seconds

        return run

    runs = {"auto": takes(0.3), "stream": takes(0.2)}
    times = {"auto": 500.0, "stream": 100.0, "single": 400.0}  # so long that there are two rounds
    noise = auto_choices.take_more_turns(times, "stream", runs, 2, lambda: now, lambda name: None)
    assert times == {"auto": pytest.approx(300.0), "stream": 100.0, "single": 400.0}
    assert noise == pytest.approx(1.0)


def test_sizes_divide_into_tiles():
    done = CliRunner().invoke(bench, ["auto", "teapot", "--size", "18"])
    assert done.exit_code == 2
    assert "multiple of 4" in done.output
