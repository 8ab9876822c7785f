"""`python -m studies cluster`: the model against its own limits, and the command on one process."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

from studies import cluster
from studies.__main__ import studies
from studies.clusters.cluster_simulation import ClusterModel, simulate
from studies.clusters.town import ground_points, sun_directions, town


def test_the_simulation_between_its_bounds():
    """Alike tasks take what the formula says; uneven ones longer, but never less than their work divided among all workers."""
    even = ClusterModel(rays=1e9, rays_a_second=1e6, rays_a_task=1e6, spread=0.0, scene_bytes=0.0)
    for workers in (1, 2, 7, 64):
        assert simulate(even, workers) == pytest.approx(even.bound(workers), rel=0.02)
    uneven = ClusterModel(rays=1e9, rays_a_second=1e6, rays_a_task=1e6, spread=0.5, scene_bytes=0.0)
    times = [simulate(uneven, workers) for workers in (1, 2, 8, 64, 1000)]
    assert times == sorted(times, reverse=True)
    assert 980 / 64 < times[3] < 2 * even.bound(64)


def test_a_client_that_is_too_slow():
    """Beyond the number of workers that it can serve, more of them do not help."""
    model = ClusterModel(rays=1e9, rays_a_second=1e6, rays_a_task=1e5, client_seconds=0.01, scene_bytes=0.0)
    assert simulate(model, 10) == pytest.approx(101, rel=0.1)
    assert simulate(model, 1000) == pytest.approx(simulate(model, 100), rel=0.05)
    assert model.bytes(2) == 10_000 * 3000


def test_the_town():
    mesh = town(20_000)
    assert 15_000 < mesh.triangle_count < 25_000
    points, suns = ground_points(mesh, 100), sun_directions(50)
    assert points.shape == (100, 3)
    np.testing.assert_allclose(np.linalg.norm(suns, axis=1), 1.0)
    assert (suns[:, 2] > 0.0).all()


def test_the_command(tmp_path, monkeypatch):
    """The simulated batch has 1e4 tasks here; of 1e12 rays by this machine's speed it would have more than a million."""
    monkeypatch.setattr(cluster, "ClusterModel", lambda rays, *args, **kw: ClusterModel(1e4 * args[1], *args, **kw))
    given = ["--triangles", "2000", "--points", "50", "--suns", "40", "--task-rays", "400", "--workers", "1", "--rounds", "1"]
    done = CliRunner().invoke(studies, ["cluster", *given, "--json", str(tmp_path / "figures.json")])
    assert done.exit_code == 0, done.output
    assert "same bits: True" in done.output
    assert "1000 workers" in done.output
    (row,) = json.loads((tmp_path / "figures.json").read_text())["rows"]
    assert (row["workers"], row["gain"]) == (1, 1.0)
    assert row["task_seconds"] > 0.0
