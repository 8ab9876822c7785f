"""`python -m studies build-sizes`: every contender builds every size, and figures fit together."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

from studies.__main__ import studies
from studies.build_sizes import measure_sizes, wavy_sheet
from wrt.bench.peers.peer_table import make_peers


@pytest.mark.parametrize("triangles", [50, 1000, 6000])
def test_sheets_have_about_so_many_triangles(triangles):
    sheet = wavy_sheet(triangles)
    assert 0.8 * triangles <= sheet.triangle_count <= 1.2 * triangles
    assert not sheet.is_closed
    assert len(np.unique(sheet.face_normals.round(6), axis=0)) > 0.4 * sheet.triangle_count


def test_contenders_are_new_for_each_size():
    made = []

    def make():
        made.append(make_peers(["wrt"], 1, "cpu")[0])
        return made[-1]

    figures = measure_sizes(make, [10, 50], 2)
    assert len(made) == 2
    assert [peers[0].scene.triangle_count for peers in made] == [row.triangles for row in figures]
    assert all(row.seconds["wrt"] > 0 and row.ratios["wrt"] == 1.0 for row in figures)


def test_the_command_writes_figures(tmp_path):
    path = tmp_path / "figures.json"
    command = ["build-sizes", "--triangles", "50", "--triangles", "200", "--rounds", "1", "--threads", "2"]
    done = CliRunner().invoke(studies, [*command, "--json", str(path)])
    assert done.exit_code == 0, done.output
    assert "Build by size, 2 threads" in done.output
    data = json.loads(path.read_text())
    assert [row["triangles"] for row in data["sizes"]] == [50, 200]
    for row in data["sizes"]:
        assert set(row["seconds"]) == set(row["ratios"])
        assert row["ratios"]["wrt"] == 1.0
        for name, ratio in row["ratios"].items():
            assert ratio == pytest.approx(row["seconds"][name] / row["seconds"]["wrt"])
