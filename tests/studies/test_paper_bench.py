"""`studies pichler` and `studies komatsu`, and Komatsu's bundles: complete and consistent. Times are not checked."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

import wrt
from studies.__main__ import studies
from studies.komatsu import KOMATSU, PICHLER
from studies.triangles import komatsu_packets as packets
from studies.triangles import komatsu_tables
from wrt.bench.core.workloads import WorkloadMaker

BALL = wrt.scenes.build("teapot", level=2, ground=False)


def run(tmp_path, *arguments):
    """What a command wrote."""
    file = tmp_path / "tables.json"
    result = CliRunner().invoke(studies, [*arguments, "--rounds", "1", "--json", str(file)])
    assert result.exit_code == 0, result.output
    return json.loads(file.read_text())["tables"], result.output


def test_pichler(tmp_path):
    """A table that is counted and one that is timed; titles are printed."""
    options = ["--scene", "needles", "--size", "8", "--table", "6.1", "--table", "edge-planes"]
    tables, output = run(tmp_path, "pichler", *options)
    assert [*tables] == ["6.1", "edge-planes"]
    assert PICHLER["6.1"] in output
    assert {row["scene"] for rows in tables.values() for row in rows} == {"needles"}
    assert [row["test"] for row in tables["edge-planes"]] == ["volumes", "edge planes"]


def test_komatsu(tmp_path):
    """The tables that are counted, of a built-in scene."""
    tables, output = run(tmp_path, "komatsu", "random_triangles", "--tests", "1024", "--table", "1", "--table", "3")
    assert [row["algorithm"] for row in tables["1"]] == ["Möller", "Projection", "Pluecker", "Proposed"]
    assert {row["scene"] for row in tables["3"]} == {"random_triangles"}
    assert KOMATSU["3"] in output


def test_no_such_size(tmp_path):
    result = CliRunner().invoke(studies, ["pichler", "--table", "6.1", "--scene", "needles", "--size", "10"])
    assert result.exit_code != 0
    assert "multiple of 4" in result.output


def test_paper_times():
    """Speeds of the paper's Fig. 6 are 1.1 to 1.3, as its text says."""
    times = komatsu_tables.PAPER_TABLE_2
    speeds = [times["Möller"][name] / times["Proposed"][name] for name in times["Möller"]]
    assert len(speeds) == 6
    assert 1.1 < min(speeds) < max(speeds) < 1.3


@pytest.mark.parametrize("kind", packets.KINDS)
def test_bundles_are_of_their_kind(kind):
    """Rays of a bundle start at its origin: towards the mesh, the lamp, or away from the surface, evenly by the cosine law."""
    found = packets.bundles_of(BALL, kind, 256, 3)
    assert len(found) == (1 if kind == "camera" else 3)
    scene, (places, _) = wrt.Scene(BALL), WorkloadMaker(BALL, size=64).visible
    for origin, directions in found:
        assert directions.shape == (256, 3)
        if kind == "camera":
            assert scene.intersect(np.tile(origin, (256, 1)), directions).is_hit.any()
        else:
            assert (places == origin).all(axis=1).any()
        if kind == "diffuse":
            np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0)
            mean = directions.mean(axis=0)
            assert np.linalg.norm(mean) == pytest.approx(2.0 / 3.0, abs=0.01)  # of the cosine law, along the normal
    assert len(np.unique(packets.grid(64), axis=0)) == 64
    with pytest.raises(ValueError, match="power of 4"):
        packets.grid(6)


def test_bundles_count_the_precomputation():
    """Records of an origin are shared by its rays; tests that have none are not charged."""
    rows = {row["contender"]: row for row in packets.bundles(BALL, ("diffuse",), rays=4, points=2, rounds=1, pairs=1 << 12)}
    for name, row in rows.items():
        assert row["counted"] == pytest.approx(row["nanoseconds"] + row["records"] / 4)
        assert (row["records"] > 0.0) == (name in ("Pluecker", "Proposed"))
    (row,) = packets.with_records(BALL, ("shadow",), rays=64, rounds=1)
    assert row["records"] > 0.0


def test_scenes(tmp_path):
    """Four built-in ones, and models where there are files of them."""
    (tmp_path / "bunny.ply").write_bytes(BALL.to_trimesh().export(file_type="ply"))
    found = packets.scenes(tmp_path)
    assert [*found] == ["bunny", *packets.SCENES]
    assert found["bunny"].triangle_count == BALL.triangle_count
    assert all(name == mesh.name for name, mesh in found.items())
