"""`python -m studies builders`: kd-tree builders beside each other, and how they grow."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner, Result

from studies.__main__ import studies
from studies.builders import print_figures
from studies.kdtrees.kdtree_comparison import BuilderFigures
from wrt.bench.commands.command_options import table_console
from wrt.meshes.mesh import TriangleMesh
from wrt.scenes import teapot

MESH = teapot(level=2, ground=False)


def run(*arguments: object) -> Result:
    return CliRunner().invoke(studies, [str(argument) for argument in arguments])


def test_bench_builders(tmp_path):
    """Ratios refer to the sweep; exact builders cost the same; growth is shown from the smallest mesh on."""
    file = tmp_path / "builders.json"
    names = [part for name in ("in_place", "binned", "spatial_median") for part in ("--builder", name)]
    options = ["--size", 16, "--rounds", 1, "--threads", 1, "--growth", 1000, "--json", file]
    result = run("builders", "wood", *names, *options)
    assert result.exit_code == 0, result.output
    found = json.loads(file.read_text())
    rows = {row["builder"]: row for row in found["builders"]}
    assert [*rows] == ["sweep", "in_place", "binned", "spatial_median"]
    assert all(name in result.output for name in rows)
    assert rows["sweep"]["build_ratio"] == rows["sweep"]["sah_ratio"] == 1.0
    assert rows["in_place"]["sah_ratio"] == 1.0 < rows["binned"]["sah_ratio"] < rows["spatial_median"]["sah_ratio"]
    for row in rows.values():
        assert row["seconds"] > 0
        assert row["peak_bytes"] > row["tree_bytes"] > 0
        assert set(row["trace_ratios"]) == {"near", "random"}
    assert "Growth" in result.output
    (growth,) = [grown for grown in found["growth"] if grown["builder"] == "binned"]
    assert len(growth["triangles"]) == len(growth["per_n_log_n"]) == 1
    assert run("builders", "--builder", "none such").exit_code == 2


def test_growth_of_builders():
    from studies.kdtrees.kdtree_growth import growth_sizes, growth_turns, measure_growth

    assert growth_sizes(3_000_000) == [1_000, 10_000, 100_000, 1_000_000, 3_000_000]
    assert growth_sizes(1_000) == [1_000]
    turns, sizes = [], (500, 20_000)
    small, naive = measure_growth(["binned", "naive"], sizes, rounds=1, on_turn=turns.append)
    assert len(turns) == growth_turns(["binned", "naive"], sizes, rounds=1) == 6
    assert small.triangles[0] < small.triangles[1]
    assert naive.triangles == small.triangles[:1]  # more than can be waited for
    assert small.per_n_log_n[0] == naive.per_n_log_n[0] == 1.0
    assert all(peak > tree > 0 for peak, tree in zip(small.peak_bytes, small.tree_bytes, strict=True))


@pytest.mark.parametrize(
    ("builder", "size", "exact"), [("streaming", 8192, True), ("streaming", 8193, False), ("binned", 9, False)]
)
def test_streaming_below_its_threshold_is_told(builder, size, exact, capsys):
    """A comparison of builders on a mesh of 4,032 triangles took streaming's exact tree for what its sampling is worth."""
    mesh = TriangleMesh(MESH.vertices, np.resize(MESH.faces, (size, 3)), name="many")
    row = BuilderFigures(builder, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, {"near": 1.0, "random": 1.0})
    print_figures([row], mesh, 1, table_console())
    assert ("its tree is the exact one" in capsys.readouterr().out) == exact
