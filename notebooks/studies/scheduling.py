"""Ways to divide work among threads, beside each other."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from wrt.bench.commands.command_options import json_option, load_model, progress, threads_option, usage_errors, write_json
from wrt.bench.commands.scaling_command import print_figures
from wrt.bench.comparisons.thread_scaling import measure_schedules
from wrt.bench.core.benchmark_results import machine
from wrt.cli.number_types import Whole
from wrt.kernels.runtime.launch import get_num_threads


@click.command("scheduling")
@click.argument("model", default="teapot")
@click.option("--rounds", default=7, show_default=True, type=Whole(1), help="Rounds per schedule.")
@threads_option
@json_option
def scheduling_command(model: str, rounds: int, threads: int | None, json_file: Path | None) -> None:
    """Compares ways to divide work among threads on MODEL, a mesh file or a built-in scene."""
    mesh, count = load_model(model), threads or get_num_threads()
    with progress() as on_turn, usage_errors():
        figures = measure_schedules(mesh, count, rounds, on_turn)
    print_figures(f"schedules: {mesh.name or 'mesh'}, {mesh.triangle_count:,} triangles, {count} threads", figures)
    write_json(json_file, {"machine": machine("cpu"), "jobs": [asdict(row) for row in figures]})
