"""Ways to divide work among threads, beside each other."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from studies.study_options import described, model_argument, number, threads_option
from wrt.bench.commands.command_options import json_option, load_model, progress, usage_errors, write_json
from wrt.bench.commands.scaling_command import print_figures
from wrt.bench.comparisons.thread_scaling import measure_schedules
from wrt.bench.core.benchmark_results import machine


@click.command("scheduling")
@model_argument("teapot")
@number("--rounds", 7, "Rounds per schedule.")
@threads_option
@json_option
def scheduling_command(model: str, rounds: int, threads: int, json_file: Path | None) -> None:
    """Compares ways to divide work among threads on MODEL, a mesh file or a built-in scene."""
    mesh = load_model(model)
    with progress() as on_turn, usage_errors():
        figures = measure_schedules(mesh, threads, rounds, on_turn)
    print_figures(f"schedules: {described(mesh, threads)}", figures)
    write_json(json_file, {"machine": machine("cpu"), "jobs": [asdict(row) for row in figures]})
