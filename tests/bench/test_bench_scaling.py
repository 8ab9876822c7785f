"""`wrt bench scaling`: all contenders in all jobs, and figures that fit together."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from wrt import scenes
from wrt.bench.commands import scaling_command as scaling
from wrt.bench.comparisons import thread_scaling
from wrt.bench.peers.embree_library import EMBREES, library, thread_limit
from wrt.cli import main


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """Few rays: here it is not the time that counts."""
    monkeypatch.setattr(thread_scaling, "VIEWS", (16,))
    monkeypatch.setattr(thread_scaling, "RANDOM", (2000,))
    monkeypatch.setattr(thread_scaling, "COMPARED_SIZE", 32)


def test_numbers_of_threads():
    assert thread_scaling.powers_of_two(1) == [1]
    assert thread_scaling.powers_of_two(2) == [1, 2]
    assert thread_scaling.powers_of_two(12) == [1, 2, 4, 8, 12]
    assert thread_scaling.powers_of_two(16) == [1, 2, 4, 8, 16]


def test_jobs_run_with_the_threads_they_are_given(monkeypatch):
    mesh = scenes.build("teapot", level=2)
    seen = []
    monkeypatch.setattr(thread_scaling, "Scene", lambda *args, num_threads, **options: seen.append(num_threads))
    for job in thread_scaling.make_jobs(mesh):
        if not job.amount:
            job.prepare(3)()
    assert seen == [3, 3]


def test_scaling(tmp_path):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed: pip install 'wrt[test-all]'")
    command = ["bench", "scaling", "teapot", "--threads", "3", "--rounds", "1", "--no-embree"]
    result = CliRunner().invoke(
        main, [*command, "--json", str(tmp_path / "figures.json"), "--plot", str(tmp_path / "plot.png")]
    )
    assert result.exit_code == 0, result.output
    assert "build kdtree" in result.output
    jobs = json.loads((tmp_path / "figures.json").read_text())["jobs"]
    assert [job["job"] for job in jobs] == ["view 16 x 16", "random 2,000", "build kdtree", "build bvh"]
    for job in jobs:
        assert job["names"] == ["1 thread", "2 threads", "3 threads"]
        assert job["gains"][0] == 1.0
        assert all(figure > 0 for figure in job["figures"])
        ratio = job["figures"][1] / job["figures"][0]
        assert job["gains"][1] == pytest.approx(ratio if job["unit"] == "Mrays/s" else 1 / ratio)
    assert (tmp_path / "plot.png").stat().st_size > 10_000


def test_the_peers_stand_beside_wrt_with_each_number_of_threads(monkeypatch, tmp_path):
    """Embree is asked the same rays, and builds with the threads of its column, no matter which were used before."""
    pytest.importorskip("matplotlib", reason="matplotlib is not installed: pip install 'wrt[test-all]'")
    found = [version for version in EMBREES if library(version) is not None]
    if not found:
        pytest.skip("neither Embree 3 nor Embree 4 is installed")
    limits = []
    commit = thread_scaling.Embree.commit

    def watched(peer):
        commit(peer)
        limits.append((peer.threads, thread_limit(peer.version.number)))

    monkeypatch.setattr(thread_scaling.Embree, "commit", watched)
    command = ["bench", "scaling", "teapot", "--threads", "3", "--rounds", "2", "--json", str(tmp_path / "figures.json")]
    result = CliRunner().invoke(main, [*command, "--plot", str(tmp_path / "plot.png")])
    assert result.exit_code == 0, result.output
    assert ("fastest / wrt" in result.output) == (len(found) > 1)
    rows = json.loads((tmp_path / "figures.json").read_text())["jobs"]
    compared = ["far 1,024", "near 1,024", "random 1,024", "build bvh"]
    for version in found:
        assert f"Embree {version} / wrt" in result.output
        assert [row["job"] for row in rows if row["engine"] == f"Embree {version}"] == compared
    for job in compared:
        own, *peers = (row for row in rows if row["job"] == job)
        assert (own["engine"], own["ratios"]) == ("wrt", [])
        assert [peer["engine"] for peer in peers] == [f"Embree {version}" for version in found]
        for peer in peers:
            assert len(peer["ratios"]) == len(peer["figures"]) == 3
            assert all(figure > 0 for figure in own["figures"] + peer["figures"] + peer["ratios"])
            assert peer["gains"][0] == 1.0
        assert own["least_ratios"] == [min(ratios) for ratios in zip(*(peer["ratios"] for peer in peers), strict=True)]
    assert {threads for threads, limit in limits} == {1, 2, 3}
    assert all(threads == limit for threads, limit in limits)
    assert (tmp_path / "plot.png").stat().st_size > 10_000


def test_scaling_says_that_embree_is_missing(monkeypatch):
    monkeypatch.setattr(scaling.Embree, "available", lambda self: "not installed; install it")
    result = CliRunner().invoke(main, ["bench", "scaling", "teapot", "--threads", "1", "--rounds", "1"])
    assert result.exit_code == 0, result.output
    for version in EMBREES:
        assert f"Embree {version}: not installed; install it" in result.output
        assert f"Embree {version} / wrt" not in result.output
