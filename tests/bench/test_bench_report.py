"""The benchmark's report and its command: everything that was measured is in them, and nothing looks better than it is."""

import json
import os
from io import StringIO

import pytest
import warp as wp
from click.testing import CliRunner
from rich.console import Console

from wrt.bench.commands import command_options
from wrt.bench.commands.benchmark import COMPARISONS, BenchOptions, bench, run_benchmark
from wrt.bench.comparisons import startup_times as startup
from wrt.bench.core import benchmark_plot as plot
from wrt.bench.core.agreement import Agreement
from wrt.bench.core.benchmark_report import ReportPrinter, build_table, percent, ray_table, times
from wrt.bench.core.benchmark_results import Question, Row
from wrt.bench.core.workloads import WORKLOADS
from wrt.builders.bvh import BVH_BUILDERS
from wrt.builders.kdtree import KDTREE_BUILDERS
from wrt.cli import main
from wrt.meshes.mesh import TriangleMesh
from wrt.scenes import teapot

SIZE = 16
MESH = teapot(level=2, ground=False)


@pytest.fixture(scope="module")
def printed():
    """A report, and what was printed when each of its questions was answered."""
    out, parts = StringIO(), []
    printer = ReportPrinter(Console(width=180, file=out))

    def show(report, question):
        printer.add(report, question)
        assert report.models[-1].questions[-1] is question
        parts.append(out.getvalue())
        out.seek(0)
        out.truncate()

    options = BenchOptions(size=SIZE, rounds=2, threads=2, startup=False)
    report = run_benchmark([TriangleMesh(MESH.vertices, MESH.faces, name="teapot")], options, on_question=show)
    printer.end(report)
    return report, [*parts, out.getvalue()]


@pytest.fixture(scope="module")
def report(printed):
    return printed[0]


ROW = {"name", "threads", "device", "note", "rays", "seconds", "median", "least", "greatest", "rays_per_second", "ratio"}
ROW |= {"agreement", "details", "error"}


def test_the_report_is_complete_plain_data(report):
    data = json.loads(json.dumps(report.to_dict(), allow_nan=False))
    assert set(data) == {"format", "machine", "options", "models", "startup", "missing"}
    assert {"cpu", "threads", "simd_bits", "target", "lanes", "gpu", "system", "python", "versions"} == set(data["machine"])
    assert {"wrt", "warp-lang", "numpy"} <= set(data["machine"]["versions"])
    (model,) = data["models"]
    assert (model["name"], model["triangles"]) == ("teapot", MESH.triangle_count)
    assert [question["workload"] for question in model["questions"]] == [*WORKLOADS, None]
    for question in model["questions"]:
        assert question["reference"] in [row["name"] for row in question["rows"]]
        for row in question["rows"]:
            assert set(row) == ROW
            assert row["error"] is None
            assert row["least"] <= row["median"] <= row["greatest"]
            assert row["ratio"] > 0
            assert (row["agreement"] is None) == (question["kind"] == "build")
            if row["name"] == question["reference"]:
                assert row["ratio"] == 1.0


def test_every_builder_is_there_with_one_thread_and_with_all(report):
    rows = {row.name: row for row in report.models[0].questions[-1].rows}
    for name in [f"kdtree {name}" for name in KDTREE_BUILDERS] + [f"bvh {name}" for name in BVH_BUILDERS]:
        one, all_threads = rows[f"wrt {name}, 1 thread"], rows[f"wrt {name}, 2 threads"]
        assert one.details["phases"]
        assert one.details["tree_bytes_per_triangle"] == all_threads.details["tree_bytes_per_triangle"] > 0
        assert one.details["record_bytes_per_triangle"] >= 36
        assert one.details["speedup_over_one_thread"] is None
        assert all_threads.details["speedup_over_one_thread"] > 0


def test_tables_show_every_contender_when_they_are_ready(printed):
    """A comparison into a pipe was silent for minutes, until all of it was known."""
    report, (*parts, end) = printed
    assert len(parts) == len(report.models[0].questions)
    for question, text in zip(report.models[0].questions, parts, strict=True):
        assert question.workload is None or f"{question.workload} {question.rays:,}" in text
        assert all(row.name in text for row in question.rows)
        assert os.getcwd() not in text
    assert parts[0].splitlines()[0].startswith(report.machine["cpu"])
    assert sum("Closest hit: teapot" in text for text in parts) == 1
    assert "time / wrt: per ray" in end


def test_steps_are_told_now_and_then(monkeypatch, capsys):
    """Where stderr is no terminal: the first at once, then one every ten seconds; stdout is for figures."""
    now = [100.0]
    monkeypatch.setattr(command_options.time, "monotonic", lambda: now[0])
    with command_options.progress() as step:
        for seconds in (0, 1, 8, 0.9, 0.2, 5, 20):
            now[0] += seconds
            step(f"at {now[0]:.1f}")
        with step.paused():
            pass
    with command_options.progress_bar(3) as step:
        step("of three")
    assert capsys.readouterr() == ("", "bench: at 100.0\nbench: at 110.1\nbench: at 135.1\nbench: of three\n")


def test_wrt_is_held_to_the_fastest_version_of_embree(capsys):
    rows = [Row("wrt", 1, "cpu", ratio=1.0), Row("Embree 3, 1 thread", 1, "cpu", ratio=1.5)]
    assert Question("build", None, None, "wrt", rows).embree_ratios == [1.5]
    Console(width=180).print(build_table(Question("build", None, None, "wrt", rows)))
    assert "fastest Embree" not in capsys.readouterr().out
    question = Question("build", None, None, "wrt", [*rows, Row("Embree 4, 1 thread", 1, "cpu", ratio=1.25)])
    Console(width=180).print(build_table(question))
    assert next(line.split() for line in capsys.readouterr().out.splitlines() if "fastest" in line)[2] == "1.25x"
    question = Question(
        "closest", "far", 4, "wrt", [Row("Embree 3", 1, "cpu", ratio=2.5), Row("Embree 4", 1, "cpu", ratio=2.0)]
    )
    for row in question.rows:
        row.rays, row.agreement = 4, Agreement(4, 1.0, 1.0, 1.0)
    Console(width=180).print(ray_table("closest", [question]))
    assert next(line.split() for line in capsys.readouterr().out.splitlines() if "fastest" in line)[2] == "2.00x"


def test_numbers_are_not_rounded_to_something_better():
    assert (percent(1.0), percent(0.999999), percent(None)) == ("100 %", "99.999 %", "-")
    assert (times(1.234), times(4321.0), times(None)) == ("1.23x", "4,321x", "-")


def test_startup_runs_fresh_processes(monkeypatch):
    calls = []

    def fake(script, device, threads, *, empty_cache=False):
        calls.append(empty_cache)
        return {"import": 0.5}

    monkeypatch.setattr(startup, "run_process", fake)
    question = startup.ask_startup([], 1, "cpu", 2)
    warm = ["import warp", "import wrt", "wrt, first hit", startup.PICTURE]
    assert [row.name for row in question.rows] == [*warm, startup.EMPTY_CACHE, startup.PICTURE_EMPTY_CACHE]
    assert calls == [False] * 12 + [True] * 2, "four warm-ups, two rounds of four, two empty caches"
    assert all(row.details["phases"] == {"import": 0.5} for row in question.rows)


def test_a_fresh_process_answers_and_failures_say_why():
    phases = startup.run_process(startup.IMPORT_WRT + startup.GRID + startup.USE_WRT, "cpu", 1)
    assert list(phases) == ["import", "init", "data", "scene", "first query"]
    with pytest.raises(RuntimeError, match=r"a fresh process failed:.*no way"):
        startup.run_process("raise ValueError('no way')", "cpu", 1)


def test_the_command_writes_tables_figures_and_a_picture(tmp_path):
    pytest.importorskip("matplotlib")
    MESH.save(tmp_path / "pot.ply")
    command = [str(tmp_path / "pot.ply"), "--size", "8", "--rounds", "1", "--no-startup", "--no-builders", "--peer", "wrt"]
    command += [
        "--workload",
        "far",
        "--workload",
        "shadow",
        "--json",
        str(tmp_path / "a.json"),
        "--plot",
        str(tmp_path / "a.png"),
    ]
    done = CliRunner().invoke(bench, command)
    assert done.exit_code == 0, done.output
    assert "Closest hit: pot" in done.output
    assert "Build" not in done.output
    data = json.loads((tmp_path / "a.json").read_text())
    assert [question["workload"] for question in data["models"][0]["questions"]] == ["far", "shadow"]
    assert str(tmp_path) not in json.dumps(data), "no paths in what is published"
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["no_such_file.ply"], "built-in scenes are teapot"),
        (["teapot", "--workload", "fog"], "'fog' is not one of 'far'"),
        (["teapot", "--peer", "nobody"], "'nobody' is not one of 'wrt'"),
        (["teapot", "--device", "cuda:99"], "device 'cuda:99' does not exist; choose from cpu"),
        (["teapot", "--size", "6"], "multiple of 4"),
        (["teapot", "--rounds", "0"], "--rounds"),
        (["teapot", "--threads", "0"], "--threads"),
    ],
)
def test_the_command_refuses_what_it_cannot_do(arguments, message):
    done = CliRunner().invoke(bench, arguments)
    assert done.exit_code != 0
    assert message in done.output
    assert "Traceback" not in done.output


@pytest.mark.parametrize("command", sorted(COMPARISONS.keys() - {"jobs"}))
def test_warp_keeps_quiet(command, monkeypatch):
    """Lines on modules that are loaded do not stand between the figures of any comparison that takes a model."""
    monkeypatch.setattr(wp.config, "log_level", wp.LOG_INFO)
    done = CliRunner().invoke(main, ["bench", command, "no_such_file.ply"])
    assert "built-in scenes are teapot" in done.output
    assert wp.config.log_level == wp.LOG_WARNING


def test_a_plot_without_matplotlib_says_what_to_install(monkeypatch):
    monkeypatch.setattr(plot, "matplotlib_missing", lambda: "a plot needs matplotlib: pip install it")
    done = CliRunner().invoke(bench, ["teapot", "--plot", "a.png"])
    assert done.exit_code == 2
    assert "a plot needs matplotlib" in done.output
