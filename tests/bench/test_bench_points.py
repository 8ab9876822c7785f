"""`wrt bench points`: contenders that agree, figures that fit together, and libraries that are missing."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

from wrt import scenes
from wrt.bench.comparisons import point_comparison
from wrt.bench.comparisons.pair_comparison import questions
from wrt.bench.comparisons.point_comparison import POINT_PEERS, compare_points, missing_peers, sets_of_points
from wrt.cli import main


@pytest.mark.slow
def test_contenders_agree(tmp_path):
    command = ["bench", "points", "teapot", "--points", "1100", "--rounds", "1", "--peer", "kdtree", "--peer", "warp_mesh"]
    result = CliRunner().invoke(main, [*command, "--json", str(tmp_path / "figures.json")])
    assert result.exit_code == 0, result.output
    rows = json.loads((tmp_path / "figures.json").read_text())["rows"]
    engines = ["wrt, BVH", "wrt, kd-tree", "wp.Mesh"]
    assert [row["engine"] for row in rows] == engines * 2
    assert all(row["agreement"] > 0.999 and row["speed"] > 0 for row in rows)
    assert rows[0]["ratio"] == rows[3]["ratio"] == 1.0
    for row in (rows[0], rows[3]):
        work = row["work"]
        assert 1 <= work["least nodes"] <= work["nodes"]
        assert 0 < work["least triangles"] <= work["triangles"]
    assert "if its distance were known" in " ".join(result.output.split())


@pytest.mark.parametrize("peer", [name for name in POINT_PEERS if name not in ("kdtree", "warp_mesh")])
def test_other_libraries(peer, monkeypatch):
    """Those that are installed give the same distances; others say how to get them."""
    if reason := missing_peers([peer]).get(peer):
        assert POINT_PEERS[peer][0] in reason
        pytest.skip(reason)
    monkeypatch.setattr(point_comparison, "FEW", 50)
    rows = list(compare_points(scenes.build("teapot", level=2), [peer], 200, 1, 1, lambda name: None))
    assert [row.error for row in rows] == [None] * 4
    assert all(row.agreement > 0.99 for row in rows)


def test_bodies_by_fcl(tmp_path):
    """FCL finds the same distances and pairs of triangles, and the row is in the table."""
    pytest.importorskip("fcl", reason="python-fcl is not installed: pip install python-fcl")
    command = ["bench", "points", "teapot", "--points", "100", "--rounds", "1", "--peer", "fcl", "--json"]
    result = CliRunner().invoke(main, [*command, str(tmp_path / "figures.json")])
    assert result.exit_code == 0, result.output
    rows = json.loads((tmp_path / "figures.json").read_text())["pairs"]
    assert [row["engine"] for row in rows] == ["wrt", "FCL"] * 3
    assert all(row["agrees"] and row["error"] is None and row["seconds"] > 0 for row in rows)
    assert [row["answer"] > 0 for row in rows] == [True] * 6
    assert "triangles that meet" in result.output


def test_bodies():
    """Copies that are apart, meet, and are a crowd, turned about their middle."""
    mesh = scenes.build("teapot", level=2)
    for question, placed in questions(mesh).items():
        rotations, middles = np.array(placed)[:, :3, :3], np.array(placed) @ [*mesh.center, 1.0]
        assert np.allclose(rotations @ rotations.transpose(0, 2, 1), np.eye(3)), question
        shifts = np.linalg.norm(middles[1:, :3] - middles[0, :3], axis=1) / mesh.extent
        assert shifts.min() == pytest.approx({"distance of two": 1.1, "triangles that meet": 0.3}.get(question, 1.2))
    assert missing_peers(["json"]) == {}
    assert "pip install python-fcl" in missing_peers(["fcl"]).get("fcl", "pip install python-fcl")


def test_sets_of_points():
    mesh = scenes.build("teapot", level=2)
    sets = sets_of_points(mesh, 500)
    low, high = mesh.bounds
    assert ((sets["in the box"] >= low) & (sets["in the box"] <= high)).all()
    assert all(points.shape == (500, 3) and points.dtype == np.float32 for points in sets.values())
