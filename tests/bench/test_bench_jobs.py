"""`wrt bench jobs`: every job is done by all contenders, with the rays that it says, and figures fit together."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

from wrt.bench.commands.jobs_command import print_jobs
from wrt.bench.comparisons import whole_jobs
from wrt.bench.core.paired_timing import Timing
from wrt.cli import main


@pytest.fixture(scope="module")
def cell():
    return whole_jobs.Cell(0.04, 2)


@pytest.mark.slow
def test_figures(tmp_path):
    path = tmp_path / "jobs.json"
    command = ["bench", "jobs", "scan", "capture", "--size", "0.04", "--rounds", "2", "--no-process", "--json", str(path)]
    done = CliRunner().invoke(main, command)
    assert done.exit_code == 0, done.output
    rows = json.loads(path.read_text())["jobs"]
    assert {row["job"] for row in rows} == {"scan", "capture"}
    for row in rows:
        assert row["error"] is None or "open3d" in row["error"]
        if row["error"] is None:
            assert 0.0 < row["least"] <= row["seconds"]
        if row["contender"] == whole_jobs.RAYS:
            assert row["ratio"] == 1.0
            assert row["rays"] == {"scan": 64 * 41, "capture": 26 * 19}[row["job"]]


def test_a_cell_has_what_it_says(cell):
    """20 instances; the rays that contenders trace alone are those of the sensors."""
    assert len(cell.scene.instances) == whole_jobs.INSTANCES
    origin, directions = cell.lidar_rays
    scan, hits = cell.lidar.scan(cell.scene, cell.lidar_pose), cell.scene.intersect(origin, directions, 0.0, 120.0)
    seen = np.isfinite(scan.range)
    assert seen.mean() > 0.8
    np.testing.assert_allclose(scan.range[seen], hits.t[seen], rtol=1e-5)
    for view, rays in zip(cell.views, cell.camera_rays, strict=True):
        np.testing.assert_allclose(cell.camera.capture(cell.scene, view).distance, cell.scene.intersect(*rays).t, rtol=1e-4)


def test_a_step_writes_its_file(cell):
    for contender in whole_jobs.step_contenders(cell)[:3]:
        contender.run()
    whole_jobs.run_alone("step", 0.04)


def test_sums_are_those_of_the_rays():
    court = whole_jobs.Court(0.03, 2)
    rays, sums, shade, months, folder = (contender.run() for contender in whole_jobs.sun_contenders(court)[:5])
    np.testing.assert_array_equal(sums, rays.sum(axis=0))
    np.testing.assert_array_equal(shade.sum(axis=1), sums)
    lit = len(court.suns) - sums
    assert months.shape == (len(lit), 12)
    assert np.abs(months.sum(axis=1) - lit).mean() < 0.05 * lit.mean()  # other origins, and suns behind the floor
    np.testing.assert_array_equal(folder, shade)
    assert court.rays("sun") == rays.size
    from_floor = whole_jobs.sun_contenders(court)[5].run()
    assert from_floor.shape == rays.shape
    assert (from_floor != rays).mean() < 0.01


def test_contenders_that_are_missing_are_named(capsys):
    """Once each, with what installs them; other failures in full."""
    absent = {
        "Mitsuba": "No module named 'mitsuba'",
        "Embree": "No module named 'trimesh.ray'",
        "Other": "No module named 'mitsuba'",
    }
    timings = {"rays alone": Timing(1, [0.001])} | {
        name: Timing(1, error=f"ModuleNotFoundError: {text}") for name, text in absent.items()
    }
    timings["broken"] = Timing(1, error="RuntimeError: no [such] card")
    print_jobs([whole_jobs.JobTimes("picture", 9, timings, None)])
    lines = capsys.readouterr().out.splitlines()
    assert [line.count("not installed") for line in lines if "picture" in line] == [0, 1, 1, 1, 0]
    assert lines[-3:] == [
        "mitsuba is not installed: pip install mitsuba",
        "trimesh is not installed: pip install trimesh",
        "RuntimeError: no [such] card",
    ]


def test_checks_of_a_print_are_those_of_trimesh():
    pytest.importorskip("embreex", reason="embreex is not installed: pip install 'wrt[test-all]'")
    made = [contender.run() for contender in whole_jobs.print_contenders(whole_jobs.Print(0.01, 2))[1:3]]
    for own, other in zip(*made, strict=True):
        if np.size(own) == 1:
            assert own == pytest.approx(other, rel=1e-6)
        elif own.dtype == bool:
            assert (own == other).mean() > 0.99
        else:
            np.testing.assert_allclose(np.median(own), np.median(other), rtol=1e-3)


@pytest.mark.slow
def test_ranges_of_environments_are_those_of_warp():
    worlds = whole_jobs.Worlds(0.01, 2)
    own, other = whole_jobs.world_contenders(worlds)[1:]
    ranges = own.run()
    worlds.move()  # back, so that the next step is the same again
    assert 0.1 < np.isfinite(ranges).mean() < 0.9
    np.testing.assert_allclose(ranges, other.run(), rtol=1e-4)
