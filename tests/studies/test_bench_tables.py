"""Tables of speed from reports of `wrt bench --json`: which number of which report a cell shows."""

from __future__ import annotations

import json
from itertools import count

import pytest
from click.testing import CliRunner

from studies.__main__ import studies
from studies.evidence import bench_tables, results
from studies.evidence.bench_tables import LAYOUTS, table_of, write_table
from wrt.bench.core.benchmark_results import ModelResult, Question, Report, Row

MACHINE = {"cpu": "A CPU", "gpu": None, "target": "x86-64-v4", "lanes": 16, "system": "Linux x86_64"}
WORKLOADS = ("far", "near", "random", "shadow", "ao", "all_far", "all_random", "inside", None)
PEERS = ("Open3D", "wp.Mesh", "trimesh+embreex", "Embree 3.13", "Embree 4.4", "Embree 4.4 flat")


def report(model: str, factor: float = 1.0, machine: dict = MACHINE) -> dict:
    """A report in which no two numbers are equal: the ratio of peer p to wrt for workload w is factor * (w + p / 100)."""
    questions = []
    for number, workload in enumerate(WORKLOADS, 1):
        names = [f"{name}{'' if workload else ', 2 threads'}" for name in ("wrt", *PEERS)]
        rows = [
            Row(
                name,
                2,
                "cpu",
                median=0.001 * number,
                ratio=factor * (number + place / 100),
                rays_per_second=factor * number * 1e6,
            )
            for place, name in enumerate(names)
        ]
        questions.append(Question("closest" if workload else "build", workload, 10, names[0], rows))
    return Report(machine, {}, [ModelResult(model, 12, 8, questions)]).to_dict()


def test_layouts_are_those_of_the_stored_tables():
    for name, layout in LAYOUTS.items():
        held = json.loads((results.FOLDER / "tables" / f"{name}.json").read_text(encoding="utf-8"))
        assert [layout.corner, *(column for column, *_ in layout.columns)] == held["columns"]
        assert [form for _, form, _ in layout.columns] == held["forms"]
        assert [*layout.rows] == [row[0] for row in held["rows"]]


def test_cells_of_the_first_table():
    runs = {"avx512": [report("bunny", factor) for factor in (1.0, 3.0, 2.0)]}
    runs |= {name: [report("bunny", factor)] for factor, name in ((10.0, "avx2"), (20.0, "one-thread"), (40.0, "gpu"))}
    made = table_of("queries", runs, commit="abc", measured="2026-11-27")
    assert made["origin"] == {
        "of": "wrt bench --json", "commit": "abc", "measured": "2026-11-27",
        "note": "reports: avx512 3, avx2 1, one-thread 1, gpu 1",
    }  # fmt: skip
    assert made["machine"] == "A CPU, x86-64-v4, 16 lanes, Linux x86_64"
    assert made["rows"][2] == ["random rays", 6.0, 6.08, 6.02, 60.4, 60.6, 30.0, 30.4, 30.1, 120.0, 120.8]


def test_ranges_and_several_meshes():
    files = count(1)
    meshes = bench_tables.SCENES.values()
    runs = {name: [report(mesh, next(files)) for _ in range(3) for mesh in meshes] for name in ("avx512", "avx2")}
    made = table_of("by-scene-zen4", runs, commit="abc", measured="2026-11-27")
    assert made["rows"][1][:2] == ["AVX-512, dragon_res2", [6.24, 2.08, 10.4]]  # factors 2, 6, 10 of the faster Embree's 1.04
    assert made["rows"][4][1] == [17.68, 13.52, 21.84]


def test_builds():
    made = table_of("builds", {name: [report(name)] for name in ("bunny", "dragon")}, commit="abc", measured="2026-11-27")
    assert made["rows"][0] == ["bunny", 9.0, 9.01, 9.04, 9.02, 9.03]


def test_what_is_missing_is_an_error():
    with pytest.raises(ValueError, match=r"no report of any mesh in the run 'dragon'; pass dragon=FILE"):
        table_of("builds", {"bunny": [report("bunny")]}, commit="abc", measured="2026-11-27")
    other = report("bunny", machine={**MACHINE, "cpu": "Another"})
    with pytest.raises(ValueError, match=r"different machines: A CPU.*; Another"):
        table_of("builds", {"bunny": [report("bunny"), other], "dragon": [report("dragon")]}, commit="abc", measured="")
    with pytest.raises(ValueError, match=r"'a\.json' does not name its run"):
        write_table("builds", ["a.json"], commit="abc", measured="")


def test_the_command_writes_the_table(tmp_path, monkeypatch):
    monkeypatch.setattr(bench_tables, "FOLDER", tmp_path)
    monkeypatch.setattr("studies.evidence.page_filling.fill_pages", list)
    (tmp_path / "tables").mkdir()
    for name in ("bunny", "dragon"):
        (tmp_path / f"{name}.json").write_text(json.dumps(report(name)))
    files = [f"{name}={tmp_path / name}.json" for name in ("bunny", "dragon")]
    done = CliRunner().invoke(studies, ["figures", "--bench", "builds", "--commit", "abc", "--measured", "2026-11-27", *files])
    assert done.exit_code == 0, done.output
    held = json.loads((tmp_path / "tables" / "builds.json").read_text())
    assert held["rows"][1][:2] == ["dragon", 9.0]
    assert CliRunner().invoke(studies, ["figures", "--bench", "speeds", *files]).exit_code != 0
