"""`python -m studies triangle-tests`: every ray-triangle test beside Moeller and Trumbore's."""

from __future__ import annotations

from pathlib import Path

import click

from studies.study_options import model_argument, number, several
from studies.triangles.triangle_test_comparison import SITUATIONS, run_triangle_tests
from wrt.bench.commands.command_options import json_option, load_model, progress, table_console, usage_errors, write_json
from wrt.cli.arguments import target_options
from wrt.kernels.runtime.launch import MAX_THREADS
from wrt.kernels.triangle import TRIANGLE_TESTS


@click.command("triangle-tests")
@model_argument("teapot")
@target_options
@several("--test", "tests", TRIANGLE_TESTS, "Tests; may be repeated. [all]")
@several("--situation", "situations", SITUATIONS, "What to time. [all]")
@number("--size", 512, "Views have SIZE x SIZE pixels.", 16)
@number("--rounds", 9, "Rounds per test.")
@number("--threads", 1, "CPU threads.", 1, MAX_THREADS)
@click.option("--precision/--no-precision", default=True, show_default=True, help="Measure errors and leaks.")
@json_option
@click.option("--plot", "plot_file", type=click.Path(dir_okay=False, writable=True, path_type=Path), help="Write a picture.")
def triangle_tests(
    model: str,
    tests: tuple[str, ...],
    situations: tuple[str, ...],
    size: int,
    rounds: int,
    threads: int,
    precision: bool,
    json_file: Path | None,
    plot_file: Path | None,
) -> None:
    """Compares ray-triangle tests on MODEL: a mesh file or the name of a built-in scene.

    Speed with and without a tree, as ratios to Moeller and Trumbore's test taken round by round; what is computed and held
    beforehand; operations, and where tests end; errors against float64 and rays that leak between triangles.
    """
    from studies.triangles.triangle_test_report import print_tests_report, save_tests_plot
    from wrt.bench.core.benchmark_plot import matplotlib_missing

    if plot_file is not None and (reason := matplotlib_missing()) is not None:
        raise click.UsageError(reason)
    mesh = load_model(model)
    with progress() as on_turn, usage_errors():
        report = run_triangle_tests(
            mesh,
            tests=tests or tuple(TRIANGLE_TESTS),
            situations=situations or tuple(SITUATIONS),
            size=size,
            rounds=rounds,
            threads=threads,
            precise=precision,
            on_turn=on_turn,
        )
    print_tests_report(report, table_console(200))
    write_json(json_file, report.to_dict())
    if plot_file is not None:
        with usage_errors():
            save_tests_plot(report, plot_file)
